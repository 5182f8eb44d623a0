"""CDR: fields at their alignment, and nothing read that is not there."""

import pytest

from tfbus import DecodeError
from tfbus.ros.cdr import CdrReader, CdrWriter


def test_fields_are_aligned_behind_the_header() -> None:
    """A field begins at a multiple of its size, counted from behind the four bytes of header."""
    writer = CdrWriter()
    writer.text("ab")
    writer.align(8)
    writer.octets(b"\xff")
    writer.count(7)
    expected = "00010000 03000000 616200 00 01000000 ff 000000 07000000"
    assert writer.data == bytes.fromhex(expected)
    reader = CdrReader(bytes(writer.data))
    assert reader.text() == "ab"
    assert (reader.skip(0, 8), reader.octets(), reader.u32()) == (12, b"\xff", 7)
    reader.finish()


def test_both_byte_orders_are_read() -> None:
    """The header says which it is."""
    assert CdrReader(bytes.fromhex("00000000 00000102")).u32() == 0x102
    assert CdrReader(bytes.fromhex("00010000 02010000")).u32() == 0x102


def test_an_empty_text_may_have_no_zero() -> None:
    """Some write an empty text as nothing."""
    assert CdrReader(bytes.fromhex("00010000 00000000")).text() == ""
    assert CdrReader(bytes.fromhex("00010000 01000000 00")).text() == ""


def test_what_is_not_there_is_not_read() -> None:
    """Numbers, texts, bytes and counts that go beyond the end say so."""
    reader = CdrReader(bytes.fromhex("00010000 05000000 41"))
    with pytest.raises(DecodeError, match=r"5 bytes .* byte 8"):
        reader.text()
    reader.at = 4
    with pytest.raises(DecodeError, match="ends too early"):
        reader.octets()
    reader.at = 4
    with pytest.raises(DecodeError, match=r"5 items.* 1 byte"):
        reader.count(1)
    reader.at = 9
    with pytest.raises(DecodeError, match=r"4 bytes .* byte 12"):
        reader.u32()
