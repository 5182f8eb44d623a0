"""Publishers that are killed, closed and started again, as another process sees it."""

import signal

import pytest

from tests.builders import at
from tests.buses import eventually, send_until
from tests.fakes import Lines
from tests.processes.publishers import start
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    Change,
    Node,
    StaleException,
    StaticTransformBroadcaster,
    TransformBroadcaster,
    TransformListener,
)


def gone(buffer: Buffer) -> list[str]:
    """The frames that are marked as gone."""
    return [info.name for info in buffer.all_frames() if info.gone]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT], ids=["killed", "closed"])
def test_a_publisher_that_ends_leaves_marked_frames(
    bus: Bus, buffer: Buffer, receiver: Node, number: int
) -> None:
    """Killed or closed, its frames stay, usable and marked, and lookups can refuse them."""
    log = Lines(receiver.log)
    changes: list[Change] = []
    process = start(bus, "sim", "--moving", "robot", "--static", "camera", "--x", "1.5")
    eventually(lambda: set(buffer.sent_by("sim")) == {"robot", "camera"})
    assert buffer.can_transform("robot", "camera", living=True, max_age_s=10.0)
    buffer.on_change(changes.append)
    process.signal(number)
    process.wait()
    eventually(lambda: gone(buffer) == ["camera", "robot"])
    assert buffer.lookup_transform("world", "camera").transform.x == 1.5
    with pytest.raises(StaleException) as caught:
        buffer.lookup_transform("robot", "camera", living=True)
    assert caught.value.gone
    assert caught.value.authority == "sim"
    report = [(change.kind, change.frame) for change in changes]
    assert sorted(report) == [("publisher gone", "camera"), ("publisher gone", "robot")]
    [line] = eventually(lambda: [line for line in log.lines if "is gone" in line])
    assert line.startswith("Stream 'sim' of /sim ") and f"pid {process.pid}) is gone; " in line
    assert line.endswith(": 'camera', 'robot'")


def test_a_publisher_that_is_started_again_is_back(
    bus: Bus, buffer: Buffer, receiver: Node
) -> None:
    """A restarted publisher's frames are back, even with much older stamps."""
    log = Lines(receiver.log)
    changes: list[Change] = []
    first = start(bus, "sim", "--moving", "robot", "--static", "camera", "--static", "old")
    eventually(lambda: set(buffer.sent_by("sim")) == {"robot", "camera", "old"})
    first.stop(signal.SIGKILL)
    eventually(lambda: gone(buffer) == ["camera", "old", "robot"])
    buffer.on_change(changes.append)
    start(bus, "sim", "--moving", "robot", "--static", "camera", "--from", "100")
    eventually(lambda: gone(buffer) == ["old"])
    found = eventually(
        lambda: buffer.can_transform("world", "robot") and buffer.lookup_transform("world", "robot")
    )
    assert 100 <= found.stamp_ns / 1e9 < 200
    assert buffer.can_transform("world", "old")
    assert {change.frame for change in changes if change.kind == "publisher back"} >= {
        "robot",
        "camera",
    }
    assert len([line for line in log.lines if " restarted: " in line]) == 1
    # Its transforms may come before its token does.
    lines = eventually(lambda: [line for line in log.lines if "is back" in line])
    assert len(lines) == 1


def test_a_frame_is_back_once_its_new_publisher_sends_it(
    bus: Bus, receiver: Node, listener: TransformListener
) -> None:
    """Not when that is there: it would be gone again, until its first transform."""
    buffer, changes = listener.buffer, []
    with bus.node("sim") as first:
        broadcaster = TransformBroadcaster(first)
        send_until(lambda: broadcaster.send_transform(at(1.0)), lambda: buffer.all_frames())
        eventually(lambda: [each for each in listener.streams() if each.alive and each.frames])
        buffer.on_change(changes.append)
    eventually(lambda: changes)
    second = bus.node("sim")
    broadcaster = TransformBroadcaster(second)
    eventually(lambda: [each for each in listener.streams() if each.alive and not each.frames])
    assert [change.kind for change in changes] == ["publisher gone"]
    eventually(
        lambda: broadcaster.send_transform(at(2.0)) or [change.kind for change in changes][1:]
    )
    assert [change.kind for change in changes] == ["publisher gone", "publisher back"]


def test_a_looped_replay_just_works(bus: Bus, buffer: Buffer) -> None:
    """A replay that is ended and started again, at once, is seen from its start again."""
    for _ in range(3):
        process = start(bus, "player", "--moving", "robot", "--from", "100")
        eventually(lambda: buffer.can_transform("world", "robot", living=True))
        assert 100e9 <= buffer.lookup_transform("world", "robot").stamp_ns < 200e9
        process.stop(signal.SIGKILL)


def test_only_its_own_frames_are_gone_with_a_publisher(bus: Bus, buffer: Buffer) -> None:
    """The frames of the others go on."""
    process = start(bus, "sim", "--moving", "robot")
    StaticTransformBroadcaster(bus.node("mount")).send_transform(at(1, "camera"))
    eventually(lambda: set(buffer.frames()) == {"world", "robot", "camera"})
    process.stop(signal.SIGKILL)
    eventually(lambda: gone(buffer) == ["robot"])
    assert buffer.can_transform("world", "camera", living=True)


def test_a_lookup_waits_until_the_publisher_is_back(bus: Bus, buffer: Buffer) -> None:
    """With a timeout, a lookup that wants living publishers waits for one."""
    process = start(bus, "sim", "--static", "camera")
    eventually(lambda: buffer.can_transform("world", "camera"))
    process.stop(signal.SIGKILL)
    eventually(lambda: gone(buffer) == ["camera"])
    start(bus, "sim", "--static", "camera", "--x", "3")
    found = buffer.lookup_transform("world", "camera", living=True, timeout_s=20.0)
    assert found.child_frame_id == "camera"


def test_streams_are_known_with_their_counts(bus: Bus, receiver: Node) -> None:
    """A listener knows of each stream its publisher, what came, and what was missed."""
    buffer = Buffer()
    with TransformListener(buffer, receiver) as listener:
        process = start(bus, "sim", "--moving", "robot", "--static", "camera")
        info = eventually(
            lambda: next((s for s in listener.streams() if s.messages > 5 and s.frames), None)
        )
        assert (info.name, info.node, info.pid, info.alive) == ("sim", "/sim", process.pid, True)
        assert set(info.frames) == {("world", "robot", False), ("world", "camera", True)}
        assert (info.missed, info.outdated, info.rejected, info.excluded) == (0, 0, 0, 0)
        assert info.transforms >= info.messages
        assert info.bytes > 100 * info.messages
        assert info.epoch_ns is not None
        assert info.last_heard_ns is not None
        assert info.delay_s is not None
        process.stop(signal.SIGKILL)
        eventually(lambda: not listener.streams()[0].alive)


def test_a_closed_node_is_gone_for_listeners_in_its_process(bus: Bus, buffer: Buffer) -> None:
    """A node that is closed is gone for all others, those of its own process too."""
    node = bus.node("sim")
    broadcaster = TransformBroadcaster(node)

    def heard() -> bool:
        broadcaster.send_transform(at(1, "robot"))
        return buffer.can_transform("world", "robot")

    eventually(heard)
    node.close()
    eventually(lambda: gone(buffer) == ["robot"])


@pytest.mark.parametrize("kind", ["--moving", "--static"])
def test_a_gone_publisher_is_not_in_the_way_of_the_right_one(
    bus: Bus, buffer: Buffer, receiver: Node, kind: str
) -> None:
    """One has sent an edge the wrong way round and is stopped: a listener that was up then takes
    the edge of the right one.
    """
    wrong = start(bus, "wrong", kind, "odom:map")
    eventually(lambda: buffer.can_transform("odom", "map"))
    wrong.stop(signal.SIGKILL)
    start(bus, "right", kind, "map:odom", "--x", "2.5")
    eventually(lambda: buffer.sent_by("right").keys() == {"odom"})
    assert eventually(lambda: buffer.lookup_transform("map", "odom").transform.x) == 2.5
    assert buffer.can_transform("map", "odom", living=True)
    assert buffer.frame("map").parent is None
