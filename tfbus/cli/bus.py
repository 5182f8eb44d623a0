"""A session without a node, for commands that look at the bus and exit."""

from collections.abc import Callable

from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.cli.output import warn
from tfbus.discover.graph import Graph, graph_of
from tfbus.discover.presence import describe_all, describe_streams
from tfbus.errors import DecodeError
from tfbus.runtime.log import open_log

# Nodes answer at once unless they are busy.
_PATIENCE_S = 2.0


def open_bus(settings: NodeSettings) -> Session:
    """A session that has found the others; it is not listed as a node itself."""
    session = Session(settings, open_log("/tfbus", settings.name, settings.log_level))
    session.settle()
    return session


def from_here(name: str, settings: NodeSettings) -> str:
    """A topic or service as seen from the namespace: `/robot7/scan` is `scan` in robot7, and
    `robot7/scan` without a namespace. A name elsewhere keeps its slash.
    """
    prefix = f"/{settings.namespace}/" if settings.namespace else "/"
    return name.removeprefix(prefix)


def look(session: Session, on_unreadable: Callable[[DecodeError], object] = warn) -> Graph:
    """The topics and services; `on_unreadable(error)` is called for each description it skips."""
    nodes = describe_all(session, on_unreadable, timeout_s=_PATIENCE_S)
    streams = describe_streams(session, on_unreadable, timeout_s=_PATIENCE_S)
    return graph_of(nodes, streams, session.settings.namespace)
