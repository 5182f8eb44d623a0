"""Two processes that publish one frame: the log, and the transforms that count."""

import signal

import pytest

from tests.builders import x_of
from tests.buses import eventually
from tests.fakes import Lines
from tests.processes.publishers import start
from tests.simulated_bus import Bus
from tfbus import Buffer, Change, TransformListener
from tfbus.streams.conflicts import Rule


class Listening:
    """A listener with a node and a buffer of its own."""

    def __init__(self, bus: Bus, name: str, rule: Rule) -> None:
        self.node = bus.node(name)
        self.log = Lines(self.node.log)
        self.buffer = Buffer()
        self.changes: list[Change] = []
        self.buffer.on_change(self.changes.append)
        self.listener = TransformListener(self.buffer, self.node, conflicts=rule)

    def x_of(self, child: str) -> float | None:
        return x_of(self.buffer, "world", child)

    def excluded(self) -> dict[str, int]:
        return {info.name: info.excluded for info in self.listener.streams() if info.excluded}

    def conflicts(self) -> list[tuple[str, str, str]]:
        return [
            (c.frame, c.authority, c.former_authority)
            for c in self.changes
            if c.kind == "conflict" and c.stamp_ns == 0
        ]

    def warnings(self) -> list[str]:
        return [line for line in self.log.lines if line.startswith("Two publishers")]


def test_a_publisher_started_twice_is_told_and_followed(bus: Bus) -> None:
    """Two processes of one name: one warning names the node, and where the second is killed, the
    first is heard again, with its static transforms.
    """
    listening = Listening(bus, "receiver", "latest")
    first = start(bus, "arm", "--moving", "tool", "--static", "base", "--x", "1")
    eventually(lambda: (listening.x_of("tool"), listening.x_of("base")) == (1, 1))
    second = start(bus, "arm", "--moving", "tool", "--static", "base", "--x", "2")
    eventually(lambda: (listening.x_of("tool"), listening.x_of("base")) == (2, 2))
    [line] = eventually(
        lambda: [line for line in listening.log.lines if line.startswith("Two processes")]
    )
    assert "stream 'arm': /arm " in line and line.endswith("(--name)")
    second.stop(signal.SIGKILL)
    eventually(lambda: (listening.x_of("tool"), listening.x_of("base")) == (1, 1))
    eventually(lambda: listening.buffer.can_transform("base", "tool", living=True, max_age_s=1.0))
    (info,) = eventually(
        lambda: [each for each in listening.listener.streams() if each.pid == first.pid]
    )
    assert (info.alive, info.node) == (True, "/arm")
    first.stop(signal.SIGKILL)
    eventually(lambda: not listening.listener.streams()[0].alive)
    eventually(lambda: listening.buffer.frame("tool").gone and listening.buffer.frame("base").gone)
    assert sum(line.startswith("Two processes") for line in listening.log.lines) == 1


def test_two_publishers_of_one_frame_are_told_once(bus: Bus) -> None:
    """One warning and one change name both; by default the last sender counts, as in tf2."""
    listening = Listening(bus, "receiver", "latest")
    first = start(bus, "one", "--moving", "robot", "--x", "1")
    eventually(lambda: listening.x_of("robot") == 1)
    second = start(bus, "two", "--moving", "robot", "--x", "2")
    eventually(listening.warnings)
    (line,) = listening.warnings()
    one, two = line.split(" and ", 1)
    assert "'robot': stream 'one' of /one " in one and f"pid {first.pid})" in one
    assert "stream 'two' of /two " in two and f"pid {second.pid})" in two
    assert "(conflicts='latest')" in two
    assert listening.conflicts() == [("robot", "two", "one")]
    # What the second sent before it listed the frame.
    before = listening.excluded()
    # Both are heard, again and again.
    for x in (1, 2, 1, 2):
        eventually(lambda x=x: listening.x_of("robot") == x)
    assert listening.excluded() == before
    assert [line for line in listening.log.lines if "does not list it" in line] == []
    assert len(listening.warnings()) == 1


@pytest.mark.parametrize("kind", ["--moving", "--static"])
def test_the_first_wins_in_every_listener(bus: Bus, kind: str) -> None:
    """With "first" all listeners accept the publisher that started first."""
    early = Listening(bus, "early", "first")
    start(bus, "one", kind, "robot", "--x", "1")
    start(bus, "two", kind, "robot", "--x", "2", "--moving", "other")
    late = Listening(bus, "late", "first")
    for listening in (early, late):
        eventually(lambda listening=listening: listening.warnings())
        eventually(lambda listening=listening: listening.x_of("robot") == 1)
        eventually(lambda listening=listening: listening.x_of("other") == 2)
        assert "'one' wins" in listening.warnings()[0]
    if kind == "--moving":
        before = late.excluded().get("two", 0)
        eventually(lambda: late.excluded().get("two", 0) > before + 10)
    assert [listening.x_of("robot") for listening in (early, late)] == [1, 1]


@pytest.mark.parametrize("kind", ["--moving", "--static"])
def test_when_the_winner_is_killed_the_next_takes_over(bus: Bus, kind: str) -> None:
    """The frames of a publisher that is gone are taken from the next, moving or static."""
    listening = Listening(bus, "receiver", "first")
    first = start(bus, "one", kind, "robot", "--x", "1")
    start(bus, "two", kind, "robot", "--x", "2")
    eventually(listening.warnings)
    eventually(lambda: listening.x_of("robot") == 1)
    first.stop(signal.SIGKILL)
    eventually(lambda: listening.x_of("robot") == 2)
    eventually(lambda: listening.buffer.can_transform("world", "robot", living=True))
    # Started again it is the younger one.
    start(bus, "one", kind, "robot", "--x", "3", "--static", "again")
    eventually(lambda: listening.x_of("again") == 3)
    eventually(lambda: listening.x_of("robot") == 2)


def test_the_higher_priority_wins_in_every_listener(bus: Bus) -> None:
    """With "priority" all listeners accept the stream of the higher priority."""
    early = Listening(bus, "early", "priority")
    start(bus, "one", "--moving", "robot", "--x", "1")
    two = start(bus, "two", "--moving", "robot", "--x", "2", "--priority", "5")
    late = Listening(bus, "late", "priority")
    for listening in (early, late):
        eventually(lambda listening=listening: listening.x_of("robot") == 2)
    eventually(lambda: late.excluded().get("one", 0) > 10)
    assert [listening.x_of("robot") for listening in (early, late)] == [2, 2]
    priorities = {info.name: info.priority for info in late.listener.streams()}
    assert priorities == {"one": 0, "two": 5}
    two.stop(signal.SIGKILL)
    for listening in (early, late):
        eventually(lambda listening=listening: listening.x_of("robot") == 1)
