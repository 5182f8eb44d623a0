"""The options of `tfbus bag` that say which recordings, topics, streams and frames are meant."""

import functools
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from tfbus.cli.output import warn
from tfbus.command.options import Several
from tfbus.command.types import FrameName, TopicName
from tfbus.errors import InvalidArgumentException
from tfbus.wording import listed

if TYPE_CHECKING:
    from tfbus.recording.items import Selection
    from tfbus.recording.reader import RecordingReader


F = TypeVar("F", bound=Callable[..., Any])

# Options of both `ros2 bag record` and `ros2 bag play` that have no counterpart.
NO_SERVICES = "services and actions are not recorded, so none are played"
CALLED_IN_ROS = {
    "--services": NO_SERVICES,
    "--exclude-services": NO_SERVICES,
    "--actions": NO_SERVICES,
    "--exclude-actions": NO_SERVICES,
    "--qos-profile-overrides-path": "not needed: there is no QoS",
}


@dataclass(frozen=True)
class SelectionOptions:
    """The selection on a command line; names are relative to a namespace, or absolute."""

    topics: tuple[str, ...]
    streams: tuple[str, ...]
    frames: tuple[str, ...]
    regex: str
    exclude: str
    exclude_topics: tuple[str, ...]

    @property
    def is_narrow(self) -> bool:
        """Whether it says what is meant; otherwise everything is, or all but what is excluded."""
        return bool(self.topics or self.streams or self.frames or self.regex)

    def selection(self, namespace: str = "", more_topics: Iterable[str] = ()) -> "Selection":
        """The selection that this is in a namespace, with more topics."""
        from tfbus.recording.items import Selection  # numpy, which `--help` does not need

        def full(names: Iterable[str]) -> tuple[str, ...]:
            return tuple(full_name(name, namespace) for name in names)

        return Selection(
            full((*self.topics, *more_topics)),
            full(self.streams),
            self.frames,
            self.regex,
            self.exclude,
            full(self.exclude_topics),
        )


def full_name(name: str, namespace: str) -> str:
    """A name as a session without a namespace has it."""
    return name[1:] if name.startswith("/") else "/".join(filter(None, (namespace, name)))


class Regex(click.ParamType[str]):
    """A regular expression."""

    name = "regex"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        """The expression; a usage error for a text that is none, or an option."""
        if str(value).startswith("-"):
            self.fail(
                f"{str(value)!r} is an option; an expression that begins with '-' is written "
                "with '[-]'",
                param,
                ctx,
            )
        try:
            re.compile(str(value))
        except re.error as error:
            self.fail(f"{str(value)!r} is no regular expression: {error}", param, ctx)
        return str(value)


def selecting(function: F) -> F:
    """Add the options that say what to record or play.

    The argument `asked` of the click command is then their value, a SelectionOptions.
    """

    @functools.wraps(function)
    def command(
        *args: Any,
        topics: tuple[str, ...],
        streams: tuple[str, ...],
        frames: tuple[str, ...],
        regex: str,
        exclude: str,
        exclude_topics: tuple[str, ...],
        **values: Any,
    ) -> Any:
        asked = SelectionOptions(topics, streams, frames, regex, exclude, exclude_topics)
        return function(*args, asked=asked, **values)

    decorated: Any = command
    for option in reversed(_options()):
        decorated = option(decorated)
    return cast(F, decorated)


TOPICS = "Only these topics; tf stands for dynamic transforms, tf_static for static ones."
STREAMS = "Only transforms of these streams."
FRAMES = "Only transforms of these child frames."


def _options() -> list[Callable[[Any], Any]]:
    several = functools.partial(click.option, cls=Several, multiple=True, metavar="NAME...")
    return [
        several("--topics", type=TopicName(), help=TOPICS),
        several("--streams", help=STREAMS),
        several("--frames", type=FrameName(), help=FRAMES),
        regex_options,
        several(
            "--exclude-topics", type=TopicName(), help="Omit these topics; tf and tf_static too."
        ),
    ]


def regex_options(function: F) -> F:
    """Add `--regex` and `--exclude`, regular expressions, to a click command."""
    regex = functools.partial(click.option, type=Regex(), default="", metavar="REGEX")
    exclude = regex(
        "-x",
        "--exclude",
        "--exclude-regex",
        help="Omit topics and streams in whose names this is found.",
    )
    only = regex("-e", "--regex", help="Only topics and streams in whose names this is found.")
    return only(exclude(function))


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


def names_option(*names: str, text: str) -> Callable[[F], F]:
    """Add an option of names to a click command that reads a recording."""
    return click.option(*names, cls=SeveralNames, multiple=True, metavar="NAME...", help=text)


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
) -> "Selection":
    """The selection of these options; names may begin with a slash. Raises click.UsageError for
    what is no regular expression.
    """
    try:
        return SelectionOptions(topics, streams, frames, regex, exclude, ()).selection()
    except InvalidArgumentException as error:
        raise click.UsageError(str(error)) from error


def warn_of_unreadable(reader: "RecordingReader") -> None:
    """Say on stderr which topics are in a format that tfbus does not read, and left out."""
    names = [topic.name for topic in reader.topics if not topic.is_readable]
    if names:
        warn(f"left out, as their messages cannot be read: {listed(names)}")
