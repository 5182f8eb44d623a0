"""What the frames of a robot are called from outside of its namespace."""

import numpy as np
import pytest

from tfbus import InvalidArgumentException, TransformBatch
from tfbus.description import StreamDescription
from tfbus.fleet import Fleet, FrameNames

NAMES = FrameNames("robot7", ("world", "map"))


def batch_of(*frames: str) -> TransformBatch:
    """One transform from the first of the frames to the second."""
    return TransformBatch(frames, np.uint32([[0, 1]]), np.array([5]), np.zeros((1, 7)))


@pytest.mark.parametrize(
    ("frame", "outside"),
    [
        ("base_link", "robot7/base_link"),
        ("arm/left", "robot7/arm/left"),
        ("map", "map"),
        ("map/tile", "robot7/map/tile"),
        ("", ""),
        ("/base", "/base"),
    ],
)
def test_a_frame_has_its_robots_name_in_front(frame: str, outside: str) -> None:
    """Frames get the namespace in front, but for shared ones; what is no name becomes none."""
    assert NAMES.outside(frame) == outside


def test_without_a_namespace_names_stay() -> None:
    """Frames of streams outside of all namespaces are called as they are."""
    names, batch = FrameNames(""), batch_of("map", "base")
    assert names.outside("base") == "base"
    assert names.batch_outside(batch) is batch


def test_the_rows_of_a_batch_stay() -> None:
    """A batch seen from outside has the same rows, between frames of other names."""
    batch = batch_of("map", "base")
    outside = NAMES.batch_outside(batch)
    assert outside.frames == ("map", "robot7/base")
    assert outside.edges is batch.edges
    assert outside.stamps_ns is batch.stamps_ns
    assert outside.poses is batch.poses
    assert batch.frames == ("map", "base")


def test_a_table_of_names_is_made_once() -> None:
    """Messages with the same table of names share one table of outside names; of a stream that
    makes up ever new ones, few are kept.
    """
    names = FrameNames("robot7")
    first = names.batch_outside(batch_of("a", "b")).frames
    assert names.batch_outside(batch_of("a", "b")).frames is first
    for number in range(1000):
        assert names.batch_outside(batch_of("a", f"{number}")).frames[1] == f"robot7/{number}"
    assert names.batch_outside(batch_of("a", "b")).frames == first


def test_a_description_is_seen_from_outside() -> None:
    """The frames that a stream describes are called as its transforms are."""
    told = StreamDescription(1, "/robot7/sim", 1, (("map", "base", False), ("base", "arm", True)))
    assert NAMES.description_outside(told).frames == (
        ("map", "robot7/base", False),
        ("robot7/base", "robot7/arm", True),
    )


def test_shared_frames_are_names_of_frames() -> None:
    """Shared frames are several names; one text, or what no frame can be called, is refused."""
    assert Fleet(["map"]).names("robot7").outside("map") == "map"
    with pytest.raises(InvalidArgumentException, match=r"write \('map',\)"):
        Fleet("map")
    with pytest.raises(InvalidArgumentException):
        Fleet(("/map",))


def test_names_stand_for_as_many_frames() -> None:
    """A batch is not given fewer names than it has frames."""
    with pytest.raises(
        InvalidArgumentException, match="1 names cannot stand for those of 2 frames"
    ):
        batch_of("a", "b").with_frames(("a",))
