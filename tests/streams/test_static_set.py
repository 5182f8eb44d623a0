"""The static transforms of one stream as a set."""

import pytest

from tests.builders import at, message
from tfbus.streams.stream_facts import StaticSet
from tfbus.wire.transforms import TransformMessage


def of_world(*children: str, epoch_ns: int = 1, seq: int | None = None) -> TransformMessage:
    """Static transforms below `world`."""
    return message([at(0, child) for child in children], epoch_ns, seq)


@pytest.fixture
def statics() -> StaticSet:
    """A set that lists and has `lamp` and `post`."""
    statics = StaticSet()
    statics.listed = frozenset({"lamp", "post"})
    statics.replace(of_world("lamp", "post", seq=5), is_current=True)
    return statics


def held(statics: StaticSet) -> set[str]:
    return set() if statics.batch is None else set(statics.batch.children())


def test_a_message_is_the_whole_set(statics: StaticSet) -> None:
    """The answer are the children that the new set of the same epoch lacks."""
    assert statics.replace(of_world("post", "wall", seq=6), is_current=True) == frozenset({"lamp"})
    assert held(statics) == {"post", "wall"}
    assert statics.replace(of_world("door", epoch_ns=2), is_current=True) == frozenset()


def test_an_earlier_set_of_the_epoch_is_not_taken(statics: StaticSet) -> None:
    """A set that comes late has a lower number than the last one."""
    assert statics.replace(of_world("lamp", seq=4), is_current=True) is None
    assert held(statics) == {"lamp", "post"}


def test_listed_transforms_may_be_missing(statics: StaticSet) -> None:
    """Listed ones that have not come are missing; others than those are no fault."""
    assert not statics.is_missing()
    statics.listed = frozenset({"post"})
    assert not statics.is_missing()
    statics.listed = frozenset({"post", "wall"})
    assert statics.is_missing()
    assert not StaticSet().is_missing()


def test_a_set_that_may_have_changed_is_missing(statics: StaticSet) -> None:
    """After the publisher was gone, until it comes again from a live one."""
    statics.expire()
    for is_current in (False, True):
        assert statics.is_missing()
        statics.replace(of_world("lamp", "post", seq=5), is_current=is_current)
    assert not statics.is_missing()


def test_of_another_process_any_set_is_taken(statics: StaticSet) -> None:
    """Its epoch and numbers may be lower; until it comes the former set stays, and is missing."""
    statics.accept_any()
    assert (held(statics), statics.is_missing()) == ({"lamp", "post"}, True)
    assert statics.replace(of_world("lamp", epoch_ns=0, seq=0), is_current=True) == frozenset()
    assert held(statics) == {"lamp"}


def test_a_set_that_is_cleared_is_missing(statics: StaticSet) -> None:
    """Read again, its transforms have to come again."""
    statics.clear()
    assert (held(statics), statics.is_missing()) == (set(), True)
