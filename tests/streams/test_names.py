"""How the frames of a robot are called from outside its namespace."""

import numpy as np
import pytest

from tfbus import InvalidArgumentException, TransformBatch
from tfbus.geometry.columns import columns_of_batch
from tfbus.streams.frame_names import StreamNames
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.fleet import Fleet, FrameNames, has_name, shared_name
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
    """Frames get the namespace in front, except shared ones; no name becomes valid by it."""
    assert NAMES.outside(frame) == outside


def test_without_a_namespace_names_stay() -> None:
    """Frames of streams outside all namespaces keep their names."""
    names = FrameNames("")
    assert names.outside("base") == "base"
    assert names.all_outside(("map", "base")) == ("map", "base")


@pytest.mark.parametrize(
    ("name", "is_its"),
    [
        ("base", True),
        ("robot7/base", True),
        ("fleet/robot7/base", True),
        ("7/base", False),
        ("robot8/base", False),
        ("fleet/base", False),
        ("robot7", False),
        ("arm", False),
    ],
)
def test_a_frame_has_its_name_in_each_namespace_above(name: str, is_its: bool) -> None:
    """Its own, and those with the namespaces in front."""
    assert has_name("base", "fleet/robot7", name) is is_its


@pytest.mark.parametrize(
    ("first", "second", "shared"),
    [
        ("robot7/world", "robot8/world", "world"),
        ("robot7/world", "robot8/map", ""),
        ("robot7/world", "robot7/world", ""),
        ("world", "robot7/world", ""),
        ("robot7/world", "world", ""),
    ],
)
def test_frames_of_two_robots_may_be_shared(first: str, second: str, shared: str) -> None:
    """Where they have one name in two namespaces."""
    assert shared_name(first, second) == shared


def test_a_table_of_names_is_made_once() -> None:
    """Messages with the same table of names share one table of outside names; only some tables are
    kept of a stream that has a new one in each message.
    """
    names = FrameNames("robot7", ("map",))
    first = names.all_outside(("map", "base"))
    assert first == ("map", "robot7/base")
    assert names.all_outside(("map", "base")) is first
    for number in range(1000):
        assert names.all_outside((f"{number}",)) == (f"robot7/{number}",)
    assert names.all_outside(("map", "base")) == first


def test_long_tables_of_names_make_room_for_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of at most so many names together tables are kept; one that is longer alone is not."""
    monkeypatch.setattr("tfbus.wire.fleet._MOST_NAMES", 10)
    names = FrameNames("robot7")
    tables = [tuple(f"{table}{number}" for number in range(4)) for table in "abc"]
    first, _, kept = [names.all_outside(table) for table in tables]
    assert names.all_outside(tables[2]) is kept
    again = names.all_outside(tables[0])
    assert again is names.all_outside(tables[0]) is not first
    assert names.all_outside(tables[2]) is kept
    long = tuple(map(str, range(11)))
    assert names.all_outside(long) is not names.all_outside(long)


def test_a_description_is_seen_from_outside() -> None:
    """The frames in a description are called as those of its transforms."""
    report = StreamDescription(1, "/robot7/sim", 1, (("map", "base", False), ("base", "arm", True)))
    assert NAMES.description_outside(report).frames == (
        ("map", "robot7/base", False),
        ("robot7/base", "robot7/arm", True),
    )


def test_shared_frames_are_frame_ids() -> None:
    """A single text, or a name that no frame can have, is refused."""
    assert Fleet(["map"]).names("robot7").outside("map") == "map"
    with pytest.raises(InvalidArgumentException, match=r"write \('map',\)"):
        Fleet("map")
    with pytest.raises(InvalidArgumentException):
        Fleet(("/map",))


def test_messages_are_read_with_outside_names() -> None:
    """Only the names of its frames change when a robot's message is read."""
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
    for rows in (batch, columns_of_batch(batch)):
        with pytest.raises(InvalidArgumentException, match="1 names for 2 frames"):
            rows.with_frames(("map",))


def test_the_namespaces_whose_names_are_kept_have_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond the limit, names are made again."""
    monkeypatch.setattr("tfbus.streams.frame_names.MOST_NAMESPACES", 3)
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
