"""What the frames of a robot are called from outside of its namespace."""

import pytest

from tfbus import InvalidArgumentException
from tfbus.description import StreamDescription
from tfbus.fleet import Fleet, FrameNames

NAMES = FrameNames("robot7", ("world", "map"))


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
    names = FrameNames("")
    assert names.outside("base") == "base"
    assert names.all_outside(("map", "base")) == ("map", "base")


def test_a_table_of_names_is_made_once() -> None:
    """Messages with the same table of names share one table of outside names; of a stream that
    makes up ever new ones, few are kept.
    """
    names = FrameNames("robot7", ("map",))
    first = names.all_outside(("map", "base"))
    assert first == ("map", "robot7/base")
    assert names.all_outside(("map", "base")) is first
    for number in range(1000):
        assert names.all_outside((f"{number}",)) == (f"robot7/{number}",)
    assert names.all_outside(("map", "base")) == first


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
