"""Shared by the tools that look into a recording."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tfbus.bus.settings import NodeSettings
from tfbus.cli.output import paint
from tfbus.command.recordings import BagChoice, wall
from tfbus.frames.recorded import RecordedFrames
from tfbus.frames.recorded_poses import frames_of_bag
from tfbus.wire.fleet import Fleet
from tfbus.wording import counted, duration, printable


@contextmanager
def frames_at(
    choice: BagChoice, settings: NodeSettings, fleet: Fleet | None
) -> Iterator[RecordedFrames]:
    """The frames at the moment that was chosen."""
    with choice.opened() as bag:
        at_ns = bag.at_ns
        frames = frames_of_bag(bag, settings, fleet)
        frames.seek(at_ns)
        yield frames


def moment_lines(choice: BagChoice, frames: RecordedFrames) -> list[str]:
    """Lines that say which moment of which recording is shown, and whether it is in a pause."""
    into = duration((frames.at_ns - frames.start_ns) / 1e9)
    lines = [paint(f"{wall(frames.at_ns)}, {into} into {named(choice.paths)}", "faint")]
    if frames.pause is not None:
        lines.append(paint(f"As of before the pause: {frames.said(frames.pause)}", "warning"))
    return lines


def span_lines(
    choice: BagChoice, frames: RecordedFrames, from_ns: int, to_ns: int
) -> Iterator[str]:
    """Lines that say which span of which recording is shown, and the longest pause in it."""
    length = duration((to_ns - from_ns) / 1e9)
    yield paint(f"{wall(from_ns)} to {wall(to_ns)}, {length} of {named(choice.paths)}", "faint")
    pauses = [each for each in frames.pauses if each.from_ns < to_ns and each.to_ns > from_ns]
    if pauses:
        longest = max(pauses, key=lambda each: each.to_ns - each.from_ns)
        more = f", and {counted(len(pauses) - 1, 'more time')}" if len(pauses) > 1 else ""
        yield paint(f"Not counted: {frames.said(longest)}{more}", "faint")


def named(paths: tuple[Path, ...]) -> str:
    """The files, shortly: `run.mcap`, or `run_0.mcap and 3 more`."""
    more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
    return f"{printable(paths[0].name or str(paths[0]))}{more}"
