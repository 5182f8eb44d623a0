"""XXH3-128: values that the reference library computes."""

import pytest

from tfbus.ros.xxh3 import xxh3_128

# By xxhash.xxh3_128 of the bytes 0, 1, 2...: one of each way by length, and where one ends.
KNOWN = {
    17: "685bc458b37d057fc06e233df7729217",
    32: "25e7c9b3424ceed2457d9566b6fcd697",
    33: "02175c3aabb00637e08d84951339de86",
    128: "14792fc3af88dc6c05321a0b64d67b41",
    129: "dd5e74ac6b45f54ebc30b63382b09a3b",
    160: "4e95c1cd6dc7bb85c67fcd13c31b09f4",
    240: "65b5be86da5540e7c92b68e16f83bbb6",
    241: "1da1cb61bcb8a2a102e8cd95421c6d02",
    320: "5b6936509fe4670f8a1836a6cc02f09e",
    1024: "d0ac1f7b93bf57b9e5d78bafa45b2aa5",
    1025: "2882ebca04ec915ce95c42288f28186e",
    2048: "a5141efedfefc1af25339063db861586",
    2100: "de8d160f1a47aafbf46ce9f4248eb269",
}


def data(size: int) -> bytes:
    """Bytes that count."""
    return bytes(each % 251 for each in range(size))


@pytest.mark.parametrize("size", KNOWN)
def test_values_are_those_of_the_reference(size: int) -> None:
    """Of each way by length, and at the lengths where one ends and the next begins."""
    assert xxh3_128(data(size))[::-1].hex() == KNOWN[size]


def test_short_input_is_refused() -> None:
    """Tokens are longer than 16 bytes, so what it has for those is left out."""
    with pytest.raises(ValueError, match="at least 17 bytes, not 16"):
        xxh3_128(data(16))
