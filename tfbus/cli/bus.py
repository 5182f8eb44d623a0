"""The bus as a command sees it that looks, or asks, and goes: a session without a node."""

from tfbus.log import open_log
from tfbus.session import Session
from tfbus.settings import NodeSettings


def open_bus(settings: NodeSettings) -> Session:
    """A session that has found who is there; it is not listed as a node itself."""
    session = Session(settings, open_log("/tfbus", settings.name, settings.log_level))
    session.settle()
    return session
