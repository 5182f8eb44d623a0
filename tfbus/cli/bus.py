"""The bus as a command sees it that looks, or asks, and goes: a session without a node."""

import json

import click

from tfbus.log import open_log
from tfbus.session import Session
from tfbus.settings import NodeSettings


def open_bus(settings: NodeSettings) -> Session:
    """A session that has found who is there; it is not listed as a node itself."""
    session = Session(settings, open_log("/tfbus", settings.name, settings.log_level))
    session.settle()
    return session


def warn(what: object) -> None:
    """Say on stderr what is wrong with others, and does not keep the command from its work."""
    click.echo(f"Warning: {what}", err=True)


def as_json(value: object) -> str:
    """One line of JSON; bytes in hexadecimal digits."""
    return json.dumps(value, default=lambda it: it.hex() if isinstance(it, bytes) else str(it))


def as_text(value: object) -> str:
    """A text as it is, all else as JSON."""
    return value if isinstance(value, str) else as_json(value)
