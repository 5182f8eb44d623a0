"""A recording of 12 s in which everything happens that the page's timeline marks, for tests."""

from pathlib import Path

import pytest

from tests.builders import S, moved
from tfbus import TransformStamped
from tfbus.geometry.columns import Columns
from tfbus.recording.items import EventItem, RecordedStream, TransformItem

START_NS = 1_795_252_263 * S
END_S = 12.0

SIM, LAMPS, TWIN = "sim", "lamps", "twin"


def at(seconds: float) -> int:
    """The log time this many seconds after the beginning."""
    return START_NS + round(seconds * S)


def described(
    log_s: float, stream: str, epoch_s: float, *frames: tuple[str, str, bool]
) -> EventItem:
    """A stream is there, with these frames."""
    facts = {
        "v": 1,
        "node": f"/{stream}",
        "epoch": at(epoch_s),
        "frames": [list(row) for row in frames],
        "host": "robot",
        "pid": 7,
    }
    return EventItem(at(log_s), "stream", stream, facts)


def gone(log_s: float, stream: str) -> EventItem:
    """The token of a stream is lost."""
    return EventItem(at(log_s), "stream gone", stream)


# What happens: sim is gone from 5 s to 6 s, and restarted; twin sends its frame from 8 s to 9 s.
EVENTS = (
    described(0.0, LAMPS, -1.0, ("map", "lamp", True)),
    described(0.0, SIM, -1.0, ("map", "base", False)),
    gone(5.0, SIM),
    described(6.0, SIM, 6.0, ("map", "base", False)),
    described(8.0, TWIN, -1.0, ("map", "base", False)),
    gone(9.0, TWIN),
)


def base_at(seconds: float) -> TransformStamped:
    """The base has gone as many metres as seconds."""
    return moved(at(seconds), "map", "base", seconds)


def record(path: Path) -> Path:
    """Write it: the base comes 20 times a second, but not from 2 s to 4 s, and not while gone. A
    chunk is a second.
    """
    pytest.importorskip("mcap", reason="needs mcap: the extra bag")
    from tfbus.recording.writer import RecordingWriter

    events = list(EVENTS)
    with RecordingWriter(path) as writer:
        writer.write(events.pop(0))
        lamp = Columns.of_transforms([moved(START_NS, "map", "lamp", 2.0)])
        writer.write(
            TransformItem(START_NS, RecordedStream(LAMPS, epoch_ns=at(-1.0)), lamp, True, 0)
        )
        for number in range(int(END_S * 20) + 1):
            now_s = number / 20
            while events and events[0].log_ns <= at(now_s):
                writer.write(events.pop(0))
            if not (2.0 < now_s < 4.0 or 5.0 <= now_s < 6.0):
                stream = RecordedStream(SIM, epoch_ns=at(6.0 if now_s >= 6.0 else -1.0))
                rows = Columns.of_transforms([base_at(now_s)])
                writer.write(TransformItem(at(now_s), stream, rows, seq=number))
            if number % 20 == 10:
                writer.flush()
    return path
