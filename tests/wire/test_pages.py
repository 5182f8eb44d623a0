"""Pages of kept messages: sent ones come back, and bad bytes do no more harm."""

import math
import zlib
from contextlib import suppress

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus.base.errors import DecodeError
from tfbus.wire.pages import KeptMessage, Page, decode_page, encode_page, is_page

MESSAGES = st.lists(
    st.builds(KeptMessage, st.text(max_size=9), st.integers(0, 2**63 - 1), st.binary(max_size=99))
)


@given(MESSAGES, st.text(max_size=30), st.floats(0, 1e9), st.integers(0, 2**62))
def test_a_page_comes_back(
    messages: list[KeptMessage], after: str, left_s: float, now_ns: int
) -> None:
    """With all that it says."""
    page = Page(messages, after, left_s, now_ns)
    payload = encode_page(page)
    assert is_page(payload) and decode_page(payload) == page


@given(st.binary(max_size=30), st.integers(0, 200), st.integers(0, 255))
def test_a_damaged_page_is_an_error(more: bytes, at: int, letter: int) -> None:
    """It is read, or it raises DecodeError."""
    payload = bytearray(encode_page(Page([KeptMessage("tf/sim", 1, b"abc")] * 3, "place")))
    payload[at % len(payload)] = letter
    with suppress(DecodeError):
        decode_page(bytes(payload) + more)


@pytest.mark.parametrize(
    "rows",
    [b"", b"no zlib", zlib.compress(b"\xc1"), zlib.compress(msgpack.packb([["tf/sim", -1]]))],
)
def test_messages_of_another_form_are_refused(rows: bytes) -> None:
    """They are an error, and not read."""
    with pytest.raises(DecodeError):
        decode_page(msgpack.packb({"page": 1, "next": "", "messages": rows}))


def test_messages_that_would_fill_the_memory_are_refused() -> None:
    """They may have 64 MB."""
    said = {"page": 1, "next": "", "messages": zlib.compress(bytes(65_000_000), 1)}
    with pytest.raises(DecodeError, match="64 MB"):
        decode_page(msgpack.packb(said))


@pytest.mark.parametrize(
    "said",
    [{"left_s": math.nan}, {"left_s": math.inf}, {"left_s": -1.0}, {"now": -1}, {"now": 2**63}],
)
def test_times_of_a_page_that_are_none_are_refused(said: dict[str, float]) -> None:
    """A recording would be filled at such times, or its progress shown by them."""
    rows = zlib.compress(msgpack.packb([]))
    with pytest.raises(DecodeError, match="left_s or now"):
        decode_page(msgpack.packb({"page": 1, "next": "", "messages": rows, **said}))
