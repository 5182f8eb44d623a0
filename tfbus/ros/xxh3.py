"""XXH3, 128 bits: the hash by which rmw_zenoh makes the gid of a publisher from its token.

After https://github.com/Cyan4973/xxHash/blob/dev/doc/xxhash_spec.md, without a seed and for the
default secret; without what it has for inputs below 17 bytes, which no token is. It takes 20 to
100 us for a token, and each is hashed once.
"""

import struct

_MASK = (1 << 64) - 1

_PRIME32_1, _PRIME32_2, _PRIME32_3 = 0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D
_PRIME64_1, _PRIME64_2, _PRIME64_3, _PRIME64_4, _PRIME64_5 = (
    0x9E3779B185EBCA87,
    0xC2B2AE3D27D4EB4F,
    0x165667B19E3779F9,
    0x85EBCA77C2B2AE63,
    0x27D4EB2F165667C5,
)
_PRIME_MX1 = 0x165667919E3779F9

_SECRET = bytes.fromhex(
    "b8fe6c3923a44bbe7c01812cf721ad1cded46de9839097db7240a4a4b7b3671f"
    "cb79e64eccc0e578825ad07dccff7221b8084674f743248ee03590e6813a264c"
    "3c2852bb91c300cb88d0658b1b532ea371644897a20df94e3819ef46a9deacd8"
    "a8fa763fe39c343ff9dcbbc7c70b4f1d8a51e04bcdb45931c89f7ec9d9787364"
    "eac5ac8334d3ebc3c581a0fffa1363eb170ddd51b7f0da49d316552629d4689e"
    "2b16be587d47a1fc8ff8b8d17ad031ce45cb3a8f95160428afd7fbcabb4b407e"
)
_LAST_SECRET = len(_SECRET) - 64

_TWO = struct.Struct("<2Q")
_STRIPE = struct.Struct("<8Q")
_BLOCK = 1024


def xxh3_128(data: bytes) -> bytes:
    """The hash of at least 17 bytes: its lower half, then its higher one, each little-endian."""
    if len(data) < 17:
        raise ValueError(f"xxh3_128 takes at least 17 bytes, not {len(data)}")
    return _TWO.pack(*(_of_short(data) if len(data) <= 240 else _of_long(data)))


def _avalanche(value: int) -> int:
    value ^= value >> 37
    value = value * _PRIME_MX1 & _MASK
    return value ^ value >> 32


def _folded(one: int, other: int) -> int:
    product = one * other
    return product & _MASK ^ product >> 64


# Up to 240 bytes


def _of_short(data: bytes) -> tuple[int, int]:
    size = len(data)
    low, high = size * _PRIME64_1 & _MASK, 0

    def mix(first: int, second: int, secret: int) -> None:
        nonlocal low, high
        a, b = _TWO.unpack_from(data, first)
        c, d = _TWO.unpack_from(data, second)
        s, t = _TWO.unpack_from(_SECRET, secret)
        u, v = _TWO.unpack_from(_SECRET, secret + 16)
        low = low + _folded(a ^ s, b ^ t) & _MASK ^ c + d & _MASK
        high = high + _folded(c ^ u, d ^ v) & _MASK ^ a + b & _MASK

    if size <= 128:
        for at in range((size - 1) // 32 * 16, -1, -16):
            mix(at, size - at - 16, at * 2)
    else:
        for at in range(0, 128, 32):
            mix(at, at + 16, at)
        low, high = _avalanche(low), _avalanche(high)
        for at in range(128, size - 31, 32):
            mix(at, at + 16, at - 125)
        mix(size - 16, size - 32, 103)
    mixed = low * _PRIME64_1 + high * _PRIME64_4 + size * _PRIME64_2 & _MASK
    return _avalanche(low + high & _MASK), -_avalanche(mixed) & _MASK


# Beyond that


def _of_long(data: bytes) -> tuple[int, int]:
    size = len(data)
    lanes = [_PRIME32_3, _PRIME64_1, _PRIME64_2, _PRIME64_3]
    lanes += [_PRIME64_4, _PRIME32_2, _PRIME64_5, _PRIME32_1]
    # The last byte is left to the last stripe, which may overlap with the one before.
    for at in range(0, size - 64, 64):
        _accumulate(lanes, data, at, at % _BLOCK // 8)
        if at % _BLOCK == _BLOCK - 64:
            _scramble(lanes)
    _accumulate(lanes, data, size - 64, _LAST_SECRET - 7)
    return (
        _merged(lanes, size * _PRIME64_1 & _MASK, 11),
        _merged(lanes, ~(size * _PRIME64_2) & _MASK, _LAST_SECRET - 11),
    )


def _accumulate(lanes: list[int], data: bytes, at: int, secret: int) -> None:
    stripe = _STRIPE.unpack_from(data, at)
    secrets = _STRIPE.unpack_from(_SECRET, secret)
    for lane, (word, key) in enumerate(zip(stripe, secrets, strict=True)):
        value = word ^ key
        lanes[lane ^ 1] = lanes[lane ^ 1] + word & _MASK
        lanes[lane] = lanes[lane] + (value & 0xFFFFFFFF) * (value >> 32) & _MASK


def _scramble(lanes: list[int]) -> None:
    for lane, key in enumerate(_STRIPE.unpack_from(_SECRET, _LAST_SECRET)):
        value = lanes[lane]
        lanes[lane] = (value ^ value >> 47 ^ key) * _PRIME32_1 & _MASK


def _merged(lanes: list[int], start: int, secret: int) -> int:
    keys = _STRIPE.unpack_from(_SECRET, secret)
    result = start
    for lane in range(0, 8, 2):
        result += _folded(lanes[lane] ^ keys[lane], lanes[lane + 1] ^ keys[lane + 1])
    return _avalanche(result & _MASK)
