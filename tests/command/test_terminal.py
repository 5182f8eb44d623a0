"""Keys from a terminal's bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus.command.terminal import KeyReader


def keys_of(*pieces: bytes) -> list[str]:
    reader = KeyReader()
    return [key for piece in pieces for key in reader.feed(piece)] + reader.flush()


def test_letters_and_control_characters_are_keys_by_themselves() -> None:
    """A typed character is a key of that name, upper and lower case apart."""
    assert keys_of(b"gQ \x03") == ["g", "Q", " ", "\x03"]


@pytest.mark.parametrize("prefix", [b"\x1b[", b"\x1bO", b"\x1b[1;5", b"\x1b[1;2"])
def test_arrows_come_in_normal_and_application_mode_and_with_modifiers(prefix: bytes) -> None:
    """An arrow is an arrow in either cursor mode, with and without Shift or Ctrl."""
    data = b"".join(prefix + last for last in (b"A", b"B", b"C", b"D"))
    assert keys_of(data) == ["up", "down", "right", "left"]


def test_capital_letters_of_the_arrows_do_not_drive() -> None:
    """Typing capital A, B, C, D gives letters; only whole sequences are arrows."""
    assert keys_of(b"ABCD") == ["A", "B", "C", "D"]


@given(
    st.lists(st.sampled_from([b"\x1b[A", b"\x1bOB", b"\x1b[1;5C", b"g", b"\x1b[15~"])), st.data()
)
def test_sequences_may_be_split_anywhere(events: list[bytes], data: st.DataObject) -> None:
    """However the bytes are cut into reads, the keys are the same."""
    typed = b"".join(events)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(typed)))))
    pieces = [typed[a:b] for a, b in zip([0, *cuts], [*cuts, len(typed)], strict=True)]
    assert keys_of(*pieces) == keys_of(typed)


@pytest.mark.parametrize(
    "sequence",
    [
        b"\x1b[15~",  # F5
        b"\x1b[[B",  # F2 of the Linux console
        b"\x1bOP",  # F1
        b"\x1b[3~",  # Delete
        b"\x1b[I",  # the window got the focus
        b"\x1b[?1;2c",  # an answer to "what are you?"
        b"\x1b]11;rgb:1e1e/1e1e/1e1e\x1b\\",  # an answer to "what is your background?"
        b"\x1b]11;rgb:1e1e/1e1e/1e1e\x07",
        b"\x1bg",  # Alt+G
        "é".encode(),
    ],
)
def test_no_letter_within_a_sequence_counts_as_typed(sequence: bytes) -> None:
    """Keys without a name here are one `other` each, whatever letters their bytes contain."""
    assert keys_of(sequence, b"t") == ["other", "t"]


def test_escape_alone_is_a_key_when_nothing_follows() -> None:
    """An escape character is the Escape key once a pause or another escape follows."""
    reader = KeyReader()
    assert reader.feed(b"\x1b") == []
    assert reader.flush() == ["escape"]
    assert reader.feed(b"\x1b\x1b[A") == ["escape", "up"]


def test_a_sequence_that_breaks_off_does_not_swallow_the_next_key() -> None:
    """An incomplete sequence followed by another key is one `other`, then that key."""
    assert keys_of(b"\x1b[\x1b[A") == ["other", "up"]
    assert keys_of(b"\x1bO\rg") == ["other", "\r", "g"]
    assert keys_of(b"\x1b]11;rgb\x1b[A") == ["other", "up"]


@given(st.binary())
def test_after_a_pause_every_key_is_read_again(noise: bytes) -> None:
    """After any bytes and a pause, the next key is read."""
    reader = KeyReader()
    reader.feed(noise)
    reader.flush()
    assert reader.feed(b"r\x1b[A") == ["r", "up"]
