"""The frames that a stream lists, and removed ones."""

import pytest

from tfbus.streams import stream_facts
from tfbus.streams.stream_facts import Listing, Publisher

SAME, OTHER = ("/sim", 7, "ab12"), ("/sim", 8, "cd34")


def replace(
    listed: Listing, epoch_ns: int, children: str, publisher: Publisher | None = SAME
) -> frozenset[str]:
    """Take a list of frames of one letter each; those that were removed since the last."""
    return listed.replace(epoch_ns, frozenset(children), publisher)


@pytest.mark.parametrize(
    ("epoch_ns", "publisher", "removed"),
    [(1, SAME, {"b"}), (1, None, {"b"}), (2, SAME, {"b"}), (2, OTHER, set()), (2, None, set())],
)
def test_only_the_same_publisher_removes_frames(
    epoch_ns: int, publisher: Publisher | None, removed: set[str]
) -> None:
    """In the same epoch, or with a clock that went back; another process removes nothing."""
    listed = Listing()
    assert replace(listed, 1, "ab") == set()
    assert replace(listed, epoch_ns, "a", publisher) == removed
    assert listed.removed_in(epoch_ns) == removed


def test_removed_frames_are_those_of_the_epoch() -> None:
    """They add up until a frame is listed again, and say nothing of other epochs."""
    listed = Listing()
    for children in ("abc", "ab", "a"):
        replace(listed, 1, children)
    assert set(listed.removed_in(1)) == {"b", "c"}
    assert set(listed.removed_in(2)) == set()
    replace(listed, 1, "ab")
    assert listed.removed_in(1) == {"c"}


def test_removed_frames_are_not_remembered_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of more names than the limit only the last are remembered."""
    monkeypatch.setattr(stream_facts, "_MOST_REMOVED", 2)
    listed = Listing()
    for children in ("abcd", "bcd", "cd", "d"):
        replace(listed, 1, children)
    assert listed.removed_in(1) == {"c"}
