"""The recordings that a tool reads."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tfbus.cli.output import warn
from tfbus.wording import listed

if TYPE_CHECKING:
    from tfbus.recording.reader import RecordingReader

F = TypeVar("F", bound=Callable[..., Any])


def recordings_argument(function: F) -> F:
    """Add an argument of one or more files of a recording, or their folder, as `recordings`."""
    return click.argument(
        "recordings",
        metavar="FILE...",
        nargs=-1,
        required=True,
        type=click.Path(exists=True, path_type=Path),
    )(function)


def warn_of_unreadable(reader: "RecordingReader") -> None:
    """Say on stderr which topics are in a format that tfbus does not read, and left out."""
    names = [topic.name for topic in reader.topics if not topic.is_readable]
    if names:
        warn(f"left out, as their messages cannot be read: {listed(names)}")
