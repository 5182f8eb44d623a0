"""What the tools share that look into a recording."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tfbus.bus.settings import NodeSettings
from tfbus.cli.output import paint
from tfbus.command.recordings import BagChoice, wall
from tfbus.frames.recorded import RecordedFrames
from tfbus.frames.recorded_poses import frames_of
from tfbus.wire.fleet import Fleet
from tfbus.wording import duration, printable


@contextmanager
def frames_at(
    choice: BagChoice, settings: NodeSettings, fleet: Fleet | None
) -> Iterator[RecordedFrames]:
    """The frames at the moment that was chosen."""
    with choice.opened() as bag:
        at_ns = bag.at_ns
        frames = frames_of(bag, settings, fleet)
        frames.seek(at_ns)
        yield frames


def moment_line(choice: BagChoice, frames: RecordedFrames) -> str:
    """A line that says which moment of which recording is shown."""
    into = duration((frames.at_ns - frames.start_ns) / 1e9)
    paused = ", while the recorder was paused" if frames.is_paused else ""
    return paint(f"{wall(frames.at_ns)}, {into} into {named(choice.paths)}{paused}", "faint")


def span_line(choice: BagChoice, from_ns: int, to_ns: int) -> str:
    """A line that says which span of which recording is shown."""
    length = duration((to_ns - from_ns) / 1e9)
    return paint(f"{wall(from_ns)} to {wall(to_ns)}, {length} of {named(choice.paths)}", "faint")


def named(paths: tuple[Path, ...]) -> str:
    """The files, shortly: `run.mcap`, or `run_0.mcap and 3 more`."""
    more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
    return f"{printable(paths[0].name or str(paths[0]))}{more}"
