"""Frames that are taken out, corrected or cleared, as listeners in other processes see it."""

import signal
from collections.abc import Iterator

import pytest

from tests.builders import x_of
from tests.buses import eventually
from tests.processes.publishers import start
from tests.simulated_bus import Bus
from tfbus import Buffer, Change, TransformListener


@pytest.fixture
def buffer(bus: Bus) -> Iterator[Buffer]:
    """The buffer of a listener that is there first, and asks for history."""
    buffer = Buffer()
    with TransformListener(buffer, bus.node("receiver"), history_s=5.0):
        yield buffer


def test_a_frame_that_is_removed_leaves_every_listener(bus: Bus, buffer: Buffer) -> None:
    """A frame that its broadcaster removes goes, dynamic or static; late listeners never see it."""
    changes: list[Change] = []
    buffer.on_change(changes.append)
    frames = ["--moving", "robot", "--moving", "arm", "--static", "camera", "--static", "lamp"]
    process = start(bus, "sim", *frames, "--remove", "arm", "--remove", "lamp")
    eventually(lambda: buffer.frames() == ["arm", "camera", "lamp", "robot", "world"])
    process.signal(signal.SIGUSR1)
    eventually(lambda: buffer.frames() == ["camera", "robot", "world"])
    removed = {change.frame for change in changes if change.kind == "removed"}
    assert removed == {"arm", "lamp"}
    late = Buffer()
    with TransformListener(late, bus.node("late"), history_s=5.0):
        eventually(lambda: late.frames() == ["camera", "robot", "world"])
        # What was kept from before has come too.
        eventually(lambda: late.frame("robot").samples > 10)
        assert late.frames() == ["camera", "robot", "world"]


def test_a_corrected_static_replaces_the_old_one_everywhere(bus: Bus, buffer: Buffer) -> None:
    """A static that is sent again is the new one for those who are there and who come later."""
    process = start(bus, "sim", "--static", "camera", "--static", "lamp", "--correct", "camera")
    eventually(lambda: x_of(buffer, "world", "camera") == 0)
    process.signal(signal.SIGUSR1)
    eventually(lambda: x_of(buffer, "world", "camera") == 1)
    late = Buffer()
    with TransformListener(late, bus.node("late")):
        eventually(lambda: x_of(late, "world", "camera") == 1)
        assert x_of(late, "world", "lamp") == 0


def test_statics_stay_when_a_buffer_is_cleared(bus: Bus, buffer: Buffer) -> None:
    """Clearing forgets dynamic transforms until they are sent again, and keeps static ones."""
    process = start(bus, "sim", "--moving", "robot", "--static", "camera", "--x", "2")
    eventually(lambda: x_of(buffer, "world", "robot") == 2)
    eventually(lambda: x_of(buffer, "world", "camera") == 2)
    process.stop(signal.SIGKILL)
    buffer.clear()
    assert x_of(buffer, "world", "robot") is None
    assert x_of(buffer, "world", "camera") == 2
    start(bus, "sim", "--moving", "robot")
    eventually(lambda: x_of(buffer, "world", "robot") == 0)
