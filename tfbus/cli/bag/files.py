"""Files of `tfbus bag`: options for recordings to read, and their parts; and a file to write."""

import functools
import re
import signal
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from tfbus.base.errors import InvalidArgumentException, TfbusError
from tfbus.base.installation import install_command
from tfbus.base.signals import StopSignals
from tfbus.base.whole_file import taking_place_of
from tfbus.base.wording import counted, did_you_mean, duration, listed, printable
from tfbus.cli.output import counted_transforms, many, say, warn
from tfbus.command.options import Several
from tfbus.command.types import FrameName, OutputFile, TopicName
from tfbus.recording.items import EventItem, Item, Selection, TransformItem
from tfbus.wire.limits import size_text

if TYPE_CHECKING:
    from tfbus.recording.reader import RecordingReader
    from tfbus.recording.writer import Compression


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
        """Whether it names items to take; otherwise all are taken but the excluded ones."""
        return bool(self.topics or self.streams or self.frames or self.regex)

    def selection(self, namespace: str = "", more_topics: Iterable[str] = ()) -> Selection:
        """The selection that this is in a namespace, with more topics."""

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
    """Add the options that select the items to record or play.

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
) -> Selection:
    """The selection of these options; names may begin with a slash. Raises click.UsageError for a
    wrong regular expression.
    """
    try:
        return SelectionOptions(topics, streams, frames, regex, exclude, ()).selection()
    except InvalidArgumentException as error:
        raise click.UsageError(str(error)) from error


def check_recorded(asked: Iterable[tuple[str, str, Collection[str]]]) -> None:
    """Raises TfbusError for a name that its recording does not have; each comes with the kind of
    thing that it is of, and the names that the recording has.
    """
    for kind, name, known in asked:
        if name not in known:
            raise TfbusError(
                f"there is no {kind} '{printable(name, 60)}' in the recording"
                + did_you_mean(name, known, none=f", which has no {kind}s")
            )


def warn_of_unreadable(reader: "RecordingReader") -> None:
    """Say on stderr which topics are in a format that tfbus does not read, and left out."""
    names = [topic.name for topic in reader.topics if not topic.is_readable]
    if names:
        warn(f"left out, as their messages cannot be read: {listed(names)}")


# A file says this number of losses of itself.
_MOST_LOST = 20

# The bar moves this many times.
_STEPS = 200

_COMPRESSIONS = ("zstd", "lz4", "none")


@dataclass
class Written:
    """The contents of a new recording; log times in nanoseconds."""

    size: int = 0
    transforms: int = 0
    statics: set[tuple[str, str]] = field(default_factory=set)
    topic_messages: int = 0
    streams: set[str] = field(default_factory=set)
    topics: set[str] = field(default_factory=set)
    from_ns: int | None = None
    to_ns: int = 0

    def add(self, item: Item) -> None:
        """Count an item."""
        if isinstance(item, EventItem):
            return
        self.from_ns = item.log_ns if self.from_ns is None else self.from_ns
        self.to_ns = item.log_ns
        if isinstance(item, TransformItem):
            name = item.stream.name
            if item.static:
                self.statics.update((name, child) for child in item.rows.children())
            else:
                self.transforms += item.rows.count
            self.streams.add(name)
        else:
            self.topic_messages += 1
            self.topics.add(item.topic)

    def __str__(self) -> str:
        if self.from_ns is None:
            return f"{size_text(self.size)}, and no transform or message in it"
        parts = [size_text(self.size), duration((self.to_ns - self.from_ns) / 1e9)]
        if self.streams:
            streams = counted(len(self.streams), "stream")
            parts.append(f"{counted_transforms(self.transforms, len(self.statics))} of {streams}")
        if self.topics:
            topics = counted(len(self.topics), "topic")
            parts.append(f"{many(self.topic_messages, 'message')} of {topics}")
        return ", ".join(parts)


def output_option(function: F) -> F:
    """Add `-o FILE` and `--force` to a click command, as `output` and `force`."""
    function = click.option("--force", is_flag=True, help="Replace the file if it exists.")(
        function
    )
    return click.option(
        "-o",
        "--output",
        required=True,
        type=OutputFile(".mcap"),
        metavar="FILE",
        help="The recording to write (.mcap).",
    )(function)


def compression_option(function: F) -> F:
    """Add `--compression` to a click command."""
    return click.option(
        "--compression",
        type=click.Choice(_COMPRESSIONS),
        default=_COMPRESSIONS[0],
        show_default=True,
        help="How the file is compressed: zstd is the smallest, lz4 the fastest.",
    )(function)


@contextmanager
def new_file(path: Path, *, force: bool, sources: Iterable[Path]) -> Iterator[Path]:
    """The path of a file to make, which takes the place of `path` at the end of the `with`.

    Ctrl-C and SIGTERM end the tool; then, and after an error, there is no such file, or the former.
    Raises click.UsageError if it is one of the `sources`, and if it exists and `force` is not
    given.
    """
    if path.exists() and any(path.samefile(source) for source in sources):
        raise click.UsageError(
            f"{printable(str(path))} is the recording that is read: give the new file another name"
        )
    if path.exists() and not force:
        raise click.UsageError(
            f"{printable(str(path))} exists: give another name, or --force to replace it"
        )
    signals = StopSignals()
    try:
        with taking_place_of(path) as beside:
            yield beside
    except KeyboardInterrupt:
        was_there = "is as it was" if path.exists() else "was not written"
        say(f"Interrupted: {path} {was_there}")
        raise SystemExit(128 + signal.SIGINT) from None
    except OSError as error:
        raise TfbusError(
            f"{printable(str(error.filename or path))} cannot be written: {error.strerror or error}"
        ) from error
    finally:
        signals.uninstall()


def write_recording(
    items: Iterable[Item],
    path: Path,
    *,
    force: bool,
    span: tuple[int, int],
    sources: Iterable[Path],
    compression: "Compression" = "zstd",
    about: Mapping[str, str] | None = None,
    about_at_end: Callable[[], Mapping[str, str]] = dict,
    refuse: Callable[[Item, str], object] | None = None,
) -> Written:
    """Write a recording with these items, which are within this span of log times and come of the
    files `sources`. `about` is its description, with `about_at_end` of facts known at the end.
    `refuse` is called with an item that a recording cannot hold, and why; without it that is an
    error.

    A bar on stderr shows the progress if that is a terminal. Raises as `new_file`, and as reading
    the items does.
    """
    with needing("bag"):
        import mcap.writer  # noqa: F401  RecordingWriter imports it when it is made

        from tfbus.recording.writer import RecordingWriter

    written = Written()
    with new_file(path, force=force, sources=sources) as beside:
        with RecordingWriter(beside, compression=compression, about=about) as writer:
            for item in with_progress(items, span, path.name):
                try:
                    writer.write(item)
                except InvalidArgumentException as error:
                    if refuse is None:
                        raise
                    refuse(item, str(error))
                else:
                    written.add(item)
            if said := about_at_end():
                writer.add_about(said)
        written.size = writer.size
    return written


def with_progress(items: Iterable[Item], span: tuple[int, int], label: str) -> Iterator[Item]:
    """The items, with a bar on stderr that shows how far in the span they are."""
    if not sys.stderr.isatty():
        yield from items
        return
    start_ns, end_ns = span
    step_ns = max(1, (end_ns - start_ns) // _STEPS)
    with click.progressbar(
        length=_STEPS, label=printable(label, 30), file=sys.stderr, width=0
    ) as bar:
        done = 0
        next_ns = start_ns + step_ns
        for item in items:
            yield item
            if item.log_ns >= next_ns:
                now = min(_STEPS, (item.log_ns - start_ns) // step_ns)
                bar.update(now - done)
                done, next_ns = now, start_ns + (now + 1) * step_ns
        bar.update(_STEPS - done)


def about_edited(readers: Iterable["RecordingReader"], verb: str) -> dict[str, str]:
    """The note of a recording on the others that it is made of: their notes, where they were
    recorded, and the edit: `cut of drive.mcap`.
    """
    readers = list(readers)
    about = dict(readers[0].about) if readers else {}
    if hosts := list(dict.fromkeys(each.about["host"] for each in readers if "host" in each.about)):
        about["host"] = ", ".join(hosts)
    return about | {"edited": edited([part.path for each in readers for part in each.parts], verb)}


def lost_of(readers: Iterable["RecordingReader"]) -> dict[str, str]:
    """The note of a recording on losses in the others: their notes, and their unreadable parts."""
    lost: list[str] = []
    for reader in readers:
        lost += filter(None, [reader.about.get("lost", "")])
        lost += [damage.text() for damage in reader.damage]
    return {"lost": listed(lost, most=_MOST_LOST)} if lost else {}


def edited(sources: Collection[Path], verb: str) -> str:
    """The edit and its files: `cut of drive.mcap`."""
    return f"{verb} of {listed([path.name for path in sources])}"


@contextmanager
def needing(extra: str) -> Iterator[None]:
    """Raises TfbusError, with the command that installs an extra, if a module is missing."""
    try:
        yield
    except ImportError as error:
        name = (error.name or extra).partition(".")[0]
        raise TfbusError(
            f"this needs {name}, which is not installed: {install_command(extra)}"
        ) from error
