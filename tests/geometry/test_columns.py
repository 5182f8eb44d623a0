"""Columns of transforms, and values found for them."""

import pytest

from tests.builders import S, at
from tfbus.geometry.columns import Columns, FoundOfRows


def rows(*children: str, stamp_ns: int = S, parent: str = "world") -> Columns:
    """A row for each child."""
    return Columns.of_transforms([at(1.0, child, stamp_ns, parent=parent) for child in children])


def test_what_was_found_holds_for_other_stamps_and_poses() -> None:
    """Rows with the same names and edges are alike, also of another message."""
    found = FoundOfRows(10)
    found.put(rows("robot", "arm"), "both")
    later = Columns.of_transforms([at(2.0, "robot", 9 * S), at(3.0, "arm", 9 * S)])
    assert found.get(later) == "both"


@pytest.mark.parametrize(
    "other",
    [
        rows(),
        rows("arm"),
        rows("arm", "robot"),
        rows("robot", "robot", "arm"),
        rows("lamp", "arm"),
        rows("robot", "arm", parent="map"),
        rows("robot", "arm").with_frames(("world", "arm", "robot")),
    ],
)
def test_what_was_found_holds_for_no_other_edges(other: Columns) -> None:
    """Another number, order, name or parent makes other rows."""
    found = FoundOfRows(10)
    found.put(rows("robot", "arm"), "both")
    assert found.get(other) is None


def test_names_are_compared_as_texts() -> None:
    """Of two batches with the same names the texts are other objects, if a program made them."""
    found = FoundOfRows(10)
    first = rows("robot", "arm")
    found.put(first, "both")
    others = tuple("".join(list(name)) for name in first.frames)
    assert all(one is not other for one, other in zip(first.frames, others, strict=True))
    assert found.get(first.with_frames(others)) == "both"


def test_messages_that_alternate_are_all_found() -> None:
    """As of a publisher that sends its frames one by one."""
    found = FoundOfRows(10)
    for child in ("robot", "arm", "lamp"):
        found.put(rows(child), child)
    assert [found.get(rows(child)) for child in ("robot", "arm", "lamp")] == [
        "robot",
        "arm",
        "lamp",
    ]
    found.put(rows("robot"), "again")
    assert found.get(rows("robot")) == "again"


def test_names_beside_the_rows_are_not_kept() -> None:
    """A message of one row may name a million frames."""
    found = FoundOfRows(10)
    one = rows("robot")
    beside = Columns.of_bytes((*one.frames, "lamp"), one.edges, one.stamps, one.poses)
    found.put(beside, "beside")
    assert (found.get(beside), found.count) == (None, 0)


def test_what_is_kept_is_bounded() -> None:
    """A publisher may send any number of frames: beyond so many rows it begins again."""
    found = FoundOfRows(10)
    for i in range(100):
        found.put(rows(f"frame_{i}", f"other_{i}"), i)
        assert found.count <= 10
    found.put(rows(*(f"frame_{i}" for i in range(11))), "too many")
    assert found.get(rows(*(f"frame_{i}" for i in range(11)))) is None
    assert found.get(rows("frame_99", "other_99")) == 99
