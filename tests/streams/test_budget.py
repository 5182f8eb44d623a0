"""How much memory the streams of a listener take, and which of them go."""

import pytest

from tests.builders import S, at, moved, payload, x_of
from tests.buses import eventually, send_until
from tests.fakes import Lines
from tests.simulated_bus import Bus
from tests.streams.received import receive, watch_of
from tfbus import (
    Buffer,
    Node,
    StaticTransformBroadcaster,
    TransformBroadcaster,
    TransformException,
    TransformListener,
)
from tfbus.streams import listener as module
from tfbus.streams.info import StreamState
from tfbus.streams.registry import Budget


@pytest.fixture
def small() -> Budget:
    return Budget(most_bytes=100, most_bytes_a_peer=60)


def test_the_oldest_of_a_peer_that_takes_too_much_goes(small: Budget) -> None:
    """Its own streams make room, and none of another peer."""
    assert small.resize("honest", "h", 10) == []
    assert [small.resize(f"s{number}", "largest", 25) for number in range(4)] == [
        [],
        [],
        ["s0"],
        ["s1"],
    ]
    assert small.bytes == 60
    assert small.resize("s9", "largest", 1000) == ["s2", "s3", "s9"]
    assert small.bytes == 10


def test_where_all_take_too_much_the_largest_gives(small: Budget) -> None:
    """However it is divided, those who take little keep what they have."""
    small.resize("honest", "h", 10)
    small.resize("a", "first", 50)
    assert small.resize("b", "second", 45) == ["a"]
    assert small.resize("honest", "h", 20) == []


def test_a_stream_that_shrinks_or_is_forgotten_makes_room(small: Budget) -> None:
    """What counts is how much it takes now, and whose it is now."""
    small.resize("a", "first", 50)
    assert small.resize("a", "first", 5) == []
    assert small.resize("a", "second", 6) == []
    assert (small.bytes, small.peer_of("a")) == (6, "second")
    small.forget("a")
    small.forget("unknown")
    assert (small.bytes, small.peer_of("a"), small.oldest_of_the_largest()) == (0, None, None)


@pytest.fixture
def narrow(monkeypatch: pytest.MonkeyPatch) -> Budget:
    """The budget of a listener: room for some ten streams that do not say whose they are."""
    budget = Budget(most_bytes=200_000, most_bytes_a_peer=60_000)
    monkeypatch.setattr(module, "Budget", lambda: budget)
    return budget


def test_a_flood_of_static_keys_is_bounded_and_harms_no_other(bus: Bus, narrow: Budget) -> None:
    """Of 200 keys of a stranger the last are kept, one line says so, and another's static stays."""
    receiver = bus.node("receiver")
    log, buffer = Lines(receiver.log), Buffer()
    with TransformListener(buffer, receiver):
        sim = bus.node("sim")
        broadcaster = StaticTransformBroadcaster(sim)
        broadcaster.send_transform(at(2, "post"))
        eventually(lambda: x_of(buffer, "world", "post") == 2)
        # Until then the stream counts as one of a stranger.
        eventually(lambda: narrow.peer_of("sim") == sim.session.id)
        session = bus.node("stranger").session
        assert session.watch_heard("tf_static/stranger0").wait(20.0)

        def send(number: int) -> None:
            data = payload([at(number, f"frame{number}")])
            session.publisher(f"tf_static/stranger{number}").put(data)

        for number in range(200):
            send(number)
        # Sent alone, since a further flood would push it out.
        send_until(lambda: send(199), lambda: x_of(buffer, "world", "frame199") == 199)
        eventually(lambda: len(buffer.frames()) < 20)
        assert x_of(buffer, "world", "post") == 2
        lines = [line for line in log.lines if line.startswith("Forgot stream")]
        assert len(lines) == 1


def test_who_takes_all_keys_makes_room_for_another(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the limit of keys on, the stream of the peer that takes most goes for a new one."""
    monkeypatch.setattr("tfbus.streams.registry.MOST_KEYS", 5)
    receiver, buffer = bus.node("receiver"), Buffer()
    log = Lines(receiver.log)
    with TransformListener(buffer, receiver) as listener:
        for number in range(6):
            rows = [at(1, f"frame{number}")]
            receive(listener, f"tf/stranger/frame{number}", payload(rows))
        # A stream makes no room for itself.
        assert buffer.frames() == [*(f"frame{number}" for number in range(5)), "world"]
        assert listener.dropped == 1
        assert "on more than 5 keys" in log.lines[-1]
        sim = bus.node("sim")
        broadcaster = TransformBroadcaster(sim)
        send_until(
            lambda: broadcaster.send_transform(at(2, "robot", sim.now_ns())),
            lambda: x_of(buffer, "world", "robot") == 2,
        )
        assert buffer.frames() == ["robot", "world"]


@pytest.mark.usefixtures("narrow")
def test_frames_without_end_on_one_key_are_bounded(bus: Bus) -> None:
    """A stream that sends ever new frames is forgotten with all of them, and begins again."""
    buffer = Buffer()
    with TransformListener(buffer, bus.node("receiver")) as listener:
        for number in range(0, 6_000, 50):
            rows = [at(1, f"frame{number + more}") for more in range(50)]
            receive(listener, "tf/stranger", payload(rows))
            assert len(buffer.frames()) < 1200


@pytest.mark.usefixtures("narrow")
def test_a_stream_that_was_given_up_is_described_again(bus: Bus) -> None:
    """What it says later is taken as that of a new one."""
    buffer = Buffer()
    with TransformListener(buffer, bus.node("receiver")) as listener:
        broadcaster = StaticTransformBroadcaster(bus.node("sim"))
        broadcaster.send_transform([at(1, f"post{number}") for number in range(100)])

        def is_given_up() -> bool:
            state = watch_of(listener).streams().get("sim", StreamState("sim"))
            return state.alive and state.description is None

        eventually(is_given_up)
        for number in range(99):
            broadcaster.remove(f"post{number}")
        eventually(lambda: x_of(buffer, "world", "post99") == 1)


def test_a_node_says_which_past_its_buffer_lacked(receiver: Node, buffer: Buffer) -> None:
    """How many lookups a longer cache would have answered, and by how many seconds at most."""
    for second in (50, 51, 61):
        buffer.set_transform(moved(second * S, "world", "robot"))
    assert not buffer.can_transform("world", "robot", 50 * S + S // 2)
    with pytest.raises(TransformException):
        buffer.lookup_transform("world", "robot", 50 * S + S // 2)
    (described,) = receiver.describe()["buffers"]
    assert (described["too_old"], described["missed_by_s"]) == (1, 0.5)
    assert "mistaken" not in described
    buffer.set_transform(moved(1_790_000_000 * S, "world", "robot"))
    with pytest.raises(TransformException):
        buffer.lookup_transform("world", "robot", 1_790_000_000_000)
    (described,) = receiver.describe()["buffers"]
    assert described["mistaken"] == 1 and "milliseconds" in described["mistake"]
