"""A session without a node, for commands that look at the bus and exit."""

import sys
from collections.abc import Collection, Sized
from typing import TYPE_CHECKING

from tfbus.bus.settings import NodeSettings
from tfbus.cli.output import say, warn
from tfbus.discover.graph import Graph
from tfbus.runtime.log import open_log
from tfbus.wire.keys import stream_of
from tfbus.wording import listed, printable

if TYPE_CHECKING:
    from tfbus.bus.session import Session

# Nodes answer at once unless they are busy.
_PATIENCE_S = 2.0


def open_bus(settings: NodeSettings) -> "Session":
    """A session that has found the others; it is not listed as a node itself."""
    from tfbus.bus.session import Session  # Zenoh, which a recording does not need

    session = Session(settings, open_log("/tfbus", settings.name, settings.log_level))
    session.settle()
    return session


def look(session: "Session", *, warns: bool = True) -> Graph:
    """The topics and services. Warns of each description that it skips, and once of all nodes and
    streams that do not answer in time, if `warns`.
    """
    from tfbus.discover.presence import ask_graph  # Zenoh

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


def warn_if_out_of_reach(session: "Session") -> bool:
    """Warn of a bus here that the session, which finds no node, gets no link to; whether there is
    one.
    """
    from tfbus.discover.presence import bus_out_of_reach  # Zenoh

    what = bus_out_of_reach(session)
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
