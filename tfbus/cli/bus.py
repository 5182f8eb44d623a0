"""The bus that a command looks at, by a session or a listener, or a recording of it.

Zenoh is imported with the first look at a bus, and readers of frames with the first at a recording:
no command needs both, and none for its help.
"""

import sys
from collections.abc import Collection, Iterator, Sized
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tfbus.base import scheduler
from tfbus.base.log import open_log
from tfbus.base.wording import counted, duration, listed, printable, wall
from tfbus.bus.graph import Graph
from tfbus.bus.settings import NodeSettings
from tfbus.cli.output import paint, say, warn
from tfbus.command.recordings import BagChoice, OpenBag
from tfbus.wire.fleet import Fleet
from tfbus.wire.keys import stream_of

if TYPE_CHECKING:
    from tfbus.bus.session import Session
    from tfbus.frames.command_listener import Listening
    from tfbus.frames.recorded import RecordedFrames

# A command that has waited for a CPU for less was not held up.
_STARVED_S = 1.0

# A warning names at most this many.
_NAMED = 5

# Nodes answer at once unless they are busy.
_PATIENCE_S = 2.0


def open_bus(settings: NodeSettings) -> "Session":
    """A session that has found the others; it is not listed as a node itself."""
    from tfbus.bus.session import Session

    session = Session(settings, open_log("/tfbus", settings.name, settings.log_level))
    session.settle()
    return session


def listening(
    settings: NodeSettings, fleet: Fleet | None, **given: Any
) -> AbstractContextManager["Listening"]:
    """Listen to all transforms, as `listening` of frames/command_listener.py does."""
    from tfbus.frames.command_listener import listening as listening_to_all

    return listening_to_all(settings, fleet, **given)


def look(session: "Session", *, warns: bool = True) -> Graph:
    """The topics and services. Warns of each description that it skips, and once of all nodes and
    streams that do not answer in time, if `warns`.
    """
    from tfbus.bus.presence import ask_graph

    found = ask_graph(session, timeout_s=_PATIENCE_S)
    for error in found.unreadable if warns else ():
        warn(error)
    left_out = [
        *(f"node {name!r}" for name in found.silent_nodes),
        *(f"stream {printable(stream_of(key))!r}" for key in found.silent_streams),
    ]
    if left_out and warns:
        warn(f"left out, without an answer in {_PATIENCE_S:g} s: {listed(left_out)}")
    return found.graph(session.settings.namespace)


def warn_if_starved(names: Collection[str]) -> None:
    """Warn that robots or frames that a command calls gone may be there, if this host was too busy
    for the command to hear of them.
    """
    starved_s = scheduler.longest_wait_for_cpu_s() if names else 0.0
    if starved_s > _STARVED_S:
        warn(
            f"this machine is too busy: this command has waited {duration(starved_s)} for a CPU, "
            f"so {listed(sorted(names), most=_NAMED)} may be there"
        )


def is_running(what: str) -> str:
    """The question if nothing was found that a broadcaster, or another node, would send."""
    return f"is a {what} running, on this network?"


def look_once(session: "Session") -> Graph:
    """The answer of `look`, for a command that shows it or fails: if it is empty, it warns of
    a bus here that the session gets no link to.
    """
    graph = look(session)
    if not graph.topics and not graph.services:
        warn_if_out_of_reach(session)
    return graph


def warn_of_unanswered(names: Collection[str]) -> None:
    """Warn of nodes that are there and did not answer, by their full names."""
    if names:
        are = "is" if len(names) == 1 else "are"
        warn(f"{listed(names)} {are} there, and did not answer: stopped, or too busy?")


def out_of_reach(session: "Session") -> str:
    """A bus here that the session, which finds no node, gets no link to; "" for none."""
    from tfbus.bus.presence import bus_out_of_reach

    return bus_out_of_reach(session)


def warn_if_out_of_reach(session: "Session") -> bool:
    """Warn of a bus that is `out_of_reach`; whether there is one."""
    what = out_of_reach(session)
    if what:
        warn(what)
    return bool(what)


def say_if_empty(session: "Session", found: Sized, kind: str, *, is_all: bool = True) -> None:
    """Of a list that is empty say so on stderr, to a person only: stdout stays empty, as ROS's.

    `is_all` is whether nothing else was found either: a bus out of reach may be the reason then,
    and is warned of.
    """
    if found or (is_all and warn_if_out_of_reach(session)) or not sys.stderr.isatty():
        return
    namespace = session.settings.namespace
    where = f" in namespace {namespace!r}" if namespace else ""
    say(f"No {kind}{where}: {is_running('node')}")


@contextmanager
def frames_at(
    choice: BagChoice, settings: NodeSettings, fleet: Fleet | None
) -> Iterator["RecordedFrames"]:
    """The frames of a recording at the moment that was chosen."""
    with choice.opened() as bag:
        at_ns = bag.at_ns
        frames = _frames_of(bag, settings, fleet)
        frames.seek(at_ns)
        yield frames


@contextmanager
def frames_in_span(
    choice: BagChoice, settings: NodeSettings, fleet: Fleet | None
) -> Iterator[tuple["RecordedFrames", int, int]]:
    """The frames of a recording, and the log times from and to which were chosen."""
    with choice.opened() as bag:
        from_ns, to_ns = bag.span
        yield _frames_of(bag, settings, fleet), from_ns, to_ns


def _frames_of(bag: OpenBag, settings: NodeSettings, fleet: Fleet | None) -> "RecordedFrames":
    from tfbus.frames.recorded_poses import frames_of_bag

    return frames_of_bag(bag, settings, fleet)


def moment_lines(choice: BagChoice, frames: "RecordedFrames") -> list[str]:
    """Lines that say which moment of which recording is shown, and whether it is in a pause."""
    into = duration((frames.at_ns - frames.start_ns) / 1e9)
    lines = [paint(f"{wall(frames.at_ns)}, {into} into {named(choice.paths)}", "faint")]
    if frames.pause is not None:
        lines.append(paint(f"As of before the pause: {frames.said(frames.pause)}", "warning"))
    return lines


def span_lines(
    choice: BagChoice, frames: "RecordedFrames", from_ns: int, to_ns: int
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
