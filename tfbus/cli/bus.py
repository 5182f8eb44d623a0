"""The bus as a command sees it that looks, or asks, and goes: a session without a node."""

from collections.abc import Callable

from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.cli.output import warn
from tfbus.discover.graph import Graph, graph_of
from tfbus.discover.presence import describe_all, describe_streams
from tfbus.errors import DecodeError
from tfbus.runtime.log import open_log

# All answer at once, but where they are busy; one that never does is not waited for any longer.
_PATIENCE_S = 2.0


def open_bus(settings: NodeSettings) -> Session:
    """A session that has found who is there; it is not listed as a node itself."""
    session = Session(settings, open_log("/tfbus", settings.name, settings.log_level))
    session.settle()
    return session


def look(session: Session, on_unreadable: Callable[[DecodeError], object] = warn) -> Graph:
    """The topics and services that there are; `on_unreadable(error)` is told of those who cannot
    be read, and are passed over.
    """
    nodes = describe_all(session, on_unreadable, timeout_s=_PATIENCE_S)
    streams = describe_streams(session, on_unreadable, timeout_s=_PATIENCE_S)
    return graph_of(nodes, streams, session.settings.namespace)
