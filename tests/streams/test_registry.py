"""The state that a listener keeps of each stream and key, and forgets."""

import logging

import pytest

from tests.builders import description, live_stream
from tfbus import Buffer
from tfbus.streams import registry
from tfbus.streams.info import StreamState
from tfbus.streams.reception import DynamicReception, StaticReception, StreamReception
from tfbus.streams.registry import Registry
from tfbus.wire.transforms import TransformReader


class Met:
    """A registry, and how often it was crowded."""

    def __init__(self) -> None:
        self.crowded = 0
        self.forgotten: list[str] = []
        self.registry = Registry(self.make, self.count_crowded, self.forgotten.append)

    def make(self, name: str, key: str) -> StreamReception:
        log = logging.getLogger("test")
        return StreamReception(name, Buffer(), log, lambda: 0, TransformReader())

    def count_crowded(self) -> None:
        self.crowded += 1

    def describe(self, stream: str, *children: str) -> None:
        """A split stream lists dynamic frames."""
        rows = tuple(("world", child, False) for child in children)
        self.registry.forget_removed(live_stream(stream, description(rows, split=True)))


@pytest.fixture
def met() -> Met:
    return Met()


def test_all_keys_of_a_stream_have_one_record(met: Met) -> None:
    """The keys of tokens, of dynamic and of static transforms are of one stream."""
    dynamic, static = met.registry.meet("tf/arm"), met.registry.meet("tf_static/arm")
    assert (type(dynamic), type(static)) == (DynamicReception, StaticReception)
    assert dynamic.stream is static.stream is met.registry.stream("@tfbus/stream/arm").reception
    assert met.registry.meet("tf/arm") is dynamic
    assert list(met.registry.streams()) == ["arm"]
    assert met.registry.get("sim") is None


def test_keys_of_removed_frames_make_room(met: Met) -> None:
    """What a split stream listed and no longer lists is forgotten; other keys stay."""
    keys = ["tf/arm/a", "tf/arm/b", "tf/sim", "tf_static/arm"]
    for key in keys:
        met.registry.meet(key)
    met.describe("arm", "a", "b")
    assert list(met.registry.receptions) == keys
    met.describe("arm", "b")
    assert list(met.registry.receptions) == keys[1:]
    assert met.registry.stream("tf/arm").keys == {"tf/arm/b", "tf_static/arm"}


def test_keys_have_a_limit(met: Met) -> None:
    """From the limit on the registry is full."""
    met.registry.most_keys = 2
    for key, is_full in (("tf/a", False), ("tf/b", True)):
        met.registry.meet(key)
        assert met.registry.is_full is is_full


def test_strangers_are_forgotten_where_there_are_many(
    met: Met, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Forgotten are streams that are gone or silent, but not those that are known or read."""
    monkeypatch.setattr(registry, "MOST_GONE", 2)
    met = Met()
    gone, known, read, silent = (met.registry.stream(f"tf/{n}") for n in ("g", "k", "r", "s"))
    assert met.crowded == 0
    met.registry.meet("tf/g")
    gone.state = known.state = read.state = StreamState("any")
    gone.reception.counts.last_heard_ns = 10**30
    silent.met_ns = 0
    read.read_keys.add("tf/r")
    met.registry.stream("tf/new").reception.counts.last_heard_ns = 10**30
    assert met.crowded == 1
    met.registry.forget_unconfirmed({"k"})
    assert met.registry.streams().keys() == {"k", "r", "new"}
    assert silent not in met.registry.streams().values()
    assert met.forgotten == ["g", "s"]
    assert met.registry.receptions == {}


def test_a_stream_is_forgotten_with_all_its_keys(met: Met) -> None:
    """Met again, it begins as a new one."""
    keys = ["tf/arm/a", "tf/arm/b", "tf_static/arm", "tf/sim"]
    for key in keys:
        met.registry.meet(key)
    stream = met.registry.forget("arm")
    assert stream is not None
    assert stream.keys == set(keys[:3])
    assert list(met.registry.receptions) == ["tf/sim"]
    assert met.registry.forget("arm") is None
    assert met.registry.meet("tf/arm/a").stream is not stream.reception


def test_a_few_strangers_are_kept(met: Met) -> None:
    """Where there are few streams none is forgotten."""
    met.registry.stream("tf/a")
    met.registry.forget_unconfirmed(set())
    assert met.registry.get("a") is not None
