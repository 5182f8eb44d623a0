"""The recordings that a tool reads."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tfbus.cli.output import warn
from tfbus.command.option_kinds import Several
from tfbus.errors import InvalidArgumentException
from tfbus.recording.selection import Selection
from tfbus.wording import listed

if TYPE_CHECKING:
    from tfbus.recording.reader import RecordingReader

F = TypeVar("F", bound=Callable[..., Any])


class RecordingPath(click.Path):
    """A file that is there; for `run`, as `tfbus bag record -o run` was told, it names run.mcap."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """As click's own, with the name that was meant."""
        full = f"{value}.mcap"
        if not Path(value).exists() and Path(full).exists():
            self.fail(f"{str(value)!r} does not exist; did you mean {full!r}?", param, ctx)
        return super().convert(value, param, ctx)


RECORDING = RecordingPath(exists=True, path_type=Path)


def recordings_argument(function: F) -> F:
    """Add an argument of one or more files of a recording, or their folder, as `recordings`."""
    return click.argument(
        "recordings",
        metavar="FILE...",
        nargs=-1,
        required=True,
        type=RECORDING,
    )(function)


class SeveralNames(Several):
    """Names after one option, which a recording that is there ends, as one that begins with `-`:
    `--topics a b drive.mcap`.
    """

    def takes(self, word: str) -> bool:
        """Whether the next word is a name."""
        return super().takes(word) and not (Path(word).suffix and Path(word).exists())


def names_of(given: tuple[str, ...]) -> tuple[str, ...]:
    """The names that an option was given: one by one, or with commas. Raises click.UsageError if
    there is only the option, which would otherwise mean all.
    """
    names = tuple(name.strip() for text in given for name in text.split(",") if name.strip())
    if given and not names:
        raise click.UsageError("an option for names has an empty text: give a name, or omit it")
    return names


def selected(
    topics: tuple[str, ...] = (),
    streams: tuple[str, ...] = (),
    frames: tuple[str, ...] = (),
    regex: str = "",
    exclude: str = "",
) -> Selection:
    """The selection of these options; names may begin with a slash. Raises click.UsageError for
    what is no regular expression.
    """
    full = [tuple(name.removeprefix("/") for name in names) for names in (topics, streams)]
    try:
        return Selection(full[0], full[1], frames, regex, exclude)
    except InvalidArgumentException as error:
        raise click.UsageError(str(error)) from error


def warn_of_unreadable(reader: "RecordingReader") -> None:
    """Say on stderr which topics are in a format that tfbus does not read, and left out."""
    names = [topic.name for topic in reader.topics if not topic.is_readable]
    if names:
        warn(f"left out, as their messages cannot be read: {listed(names)}")
