"""The tutorial, recorded, and replayed once its processes have ended."""

from pathlib import Path

import pytest

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import Buffer, TransformListener

pytest.importorskip("mcap")


FRAMES = ("turtle1", "drone")


def oldest_ns(buffer: Buffer, frame: str) -> int:
    """The first stamp that it holds of a frame."""
    return buffer.frame(frame).oldest_ns or 0


def newest_ns(buffer: Buffer, frame: str) -> int:
    """The last stamp that it holds of a frame."""
    return buffer.frame(frame).newest_ns or 0


def test_a_replay_has_the_same_lookups(bus: Bus, tmp_path: Path) -> None:
    """The lookups of a listener give the same from the recording as they gave live, to the bit."""
    file = tmp_path / "turtle.mcap"
    live = Buffer()
    with TransformListener(live, bus.node("live")):
        recorder = bus.start("bag", "record", "-o", str(file))
        recorder.wait_for_line("Recording to")
        tutorial = [
            bus.start("simulator", "--headless"),
            bus.start("broadcaster"),
            bus.start("static", "world", "camera", "--x", "1"),
            bus.start("draw_square"),
        ]
        tutorial[-1].wait_for_line("New goal")
        eventually(lambda: live.can_transform("camera", "drone"))
        since_ns = live.lookup_transform("world", "drone").stamp_ns
        eventually(lambda: live.can_transform("camera", "drone", since_ns + 2_000_000_000))
        for program in (recorder, *tutorial):
            assert program.stop() == 0
    replayed = Buffer()
    with TransformListener(replayed, bus.node("listener")):
        player = bus.start("bag", "play", str(file), "--stamps", "recorded")
        assert player.wait() == 0, player.stderr
        first_ns = max(oldest_ns(each, frame) for each in (live, replayed) for frame in FRAMES)
        last_ns = min(newest_ns(each, frame) for each in (live, replayed) for frame in FRAMES)
        assert last_ns - first_ns > 1_000_000_000
        for at in range(101):
            stamp_ns = first_ns + (last_ns - first_ns) * at // 100
            expected = live.lookup_transform("camera", "drone", stamp_ns)
            assert replayed.lookup_transform("camera", "drone", stamp_ns) == expected
