"""What the frames of a robot are called from outside of its namespace."""

import numpy as np
import pytest

from tfbus import InvalidArgumentException, TransformBatch
from tfbus.geometry.columns import Columns
from tfbus.listen.names import StreamNames
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.fleet import Fleet, FrameNames
from tfbus.wire.transforms import TransformMessage, TransformReader, encode_transforms

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


def test_messages_are_read_between_frames_as_they_are_called_outside() -> None:
    """A message of a robot is read as it stands, but for the names of its frames."""
    batch = TransformBatch(
        ("map", "base"), np.uint32([[0, 1]]), np.array([5]), np.float64([[1, 2, 3, 0, 0, 0, 1]])
    )
    payload = encode_transforms(TransformMessage(batch, 7, 3))
    reader = TransformReader(NAMES)
    message = reader.read(payload)
    assert message.batch.frames == ("map", "robot7/base")
    assert message.batch.edges.tolist() == [[0, 1]]
    assert message.batch.stamps_ns.tolist() == [5]
    assert message.batch.poses.tolist() == batch.poses.tolist()
    assert (message.epoch_ns, message.seq) == (7, 3)
    for rows in (batch, Columns.of_batch(batch)):
        with pytest.raises(InvalidArgumentException, match="1 names for 2 frames"):
            rows.with_frames(("map",))


def test_names_of_many_namespaces_are_not_kept_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of namespaces that come and go so many of the last are remembered."""
    monkeypatch.setattr("tfbus.listen.names.MOST_NAMESPACES", 3)
    names = StreamNames(Fleet())
    first = names.at("robot0/tf/sim")
    assert names.at("robot0/tf_static/sim") is first
    assert names.reader("robot0/tf/sim") is names.reader("robot0/tf_static/sim")
    for number in range(1, 4):
        names.at(f"robot{number}/tf/sim")
    again = names.at("robot0/tf/sim")
    assert again is not first
    assert again is not None
    assert again.outside("base") == "robot0/base"
