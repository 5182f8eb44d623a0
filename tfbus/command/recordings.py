"""Recordings on a command line: `--bag FILE`, and moments and spans of it."""

import functools
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from tfbus.base.errors import TfbusError
from tfbus.base.installation import install_command
from tfbus.base.standard_error import for_stderr
from tfbus.base.wording import counted, duration, printable, wall
from tfbus.command.options import Several
from tfbus.command.types import Moment, MomentType
from tfbus.wire.limits import size_text

if TYPE_CHECKING:
    from tfbus.recording.part import Part
    from tfbus.recording.reader import RecordingReader
    from tfbus.recording.records import Damage
    from tfbus.recording.state import Statics

F = TypeVar("F", bound=Callable[..., Any])

_S = 1_000_000_000

# Of the places that cannot be read this number is said one by one.
_MOST_DAMAGE = 3

_MOMENTS = {
    "at": ("The moment to show: 3 is 3 s after its beginning, -3 is 3 s before its end.", "--at"),
    "begin": (
        "Begin at this moment: 3 is 3 s after its beginning, -3 is 3 s before its end; or a date "
        "and time, or seconds since 1970.",
        "--from",
    ),
    "end": ("End at this moment, written as that of --from.", "--to"),
}


@dataclass(frozen=True)
class BagChoice:
    """The files of a recording, the moment or span of it, and which static transforms are known at
    a moment, as options give them.
    """

    paths: tuple[Path, ...]
    at: Moment | None = None
    begin: Moment | None = None
    end: Moment | None = None
    statics: "Statics" = "then"

    @property
    def written(self) -> list[str]:
        """The files as on a command line."""
        return [printable(shlex.quote(str(path))) for path in self.paths]

    @contextmanager
    def opened(self) -> "Iterator[OpenBag]":
        """The recording, open. Raises TfbusError if it cannot be read."""
        with open_recording(*self.paths) as reader:
            yield OpenBag(reader, self)


@dataclass(frozen=True)
class OpenBag:
    """An open recording, and the choice of a span or moment of it. Times are log times."""

    reader: "RecordingReader"
    choice: BagChoice

    @property
    def at_ns(self) -> int:
        """The moment, by default the end. Raises click.UsageError if it is outside."""
        if self.choice.at is None:
            return self.reader.end_ns
        return self.moment(self.choice.at)

    def moment(self, moment: Moment, option: str = "--at") -> int:
        """A moment. Raises click.UsageError if it is outside of the recording."""
        start_ns, end_ns = self.reader.start_ns, self.reader.end_ns
        at_ns = moment.within(start_ns, end_ns)
        if start_ns <= at_ns <= end_ns:
            return at_ns
        raise click.UsageError(
            f"{option}: {_outside(moment, at_ns)} {self._extent()}: "
            "3 is 3 s after its beginning, -3 is 3 s before its end"
        )

    def _extent(self) -> str:
        start_ns, end_ns = self.reader.start_ns, self.reader.end_ns
        span = duration((end_ns - start_ns) / _S)
        return f"the recording, which is from {wall(start_ns)} to {wall(end_ns)} ({span})"

    @property
    def span(self) -> tuple[int, int]:
        """From when to when, by default all. Raises click.UsageError if nothing is in it."""
        start_ns, end_ns = self.reader.start_ns, self.reader.end_ns
        begin, end = self.choice.begin, self.choice.end
        from_ns, to_ns = start_ns, end_ns
        if begin is not None:
            from_ns = begin.within(start_ns, end_ns)
            if from_ns > end_ns:
                self.moment(begin, "--from")
        if end is not None:
            to_ns = end.within(start_ns, end_ns)
            if to_ns < start_ns:
                self.moment(end, "--to")
        from_ns, to_ns = max(from_ns, start_ns), min(to_ns, end_ns)
        if from_ns > to_ns:
            raise click.UsageError(
                f"--from ({wall(from_ns)}) must be before --to ({wall(to_ns)}) in {self._extent()}"
            )
        return from_ns, to_ns


def _outside(moment: Moment, at_ns: int) -> str:
    if moment.is_relative or moment.is_from_beginning:
        return f"{moment.ns / _S:{'+' if moment.is_relative else ''}g}s is outside of"
    return f"{wall(at_ns)} is outside of"


def bag_options(*moments: str, statics: bool = False) -> Callable[[F], F]:
    """Add `--bag`, and the options of these moments, "at", "begin" and "end", to a click command,
    which gets them as `bag`: a BagChoice, None for the bus. With `statics` there is `--statics`.

    Raises click.UsageError for a moment, or statics, without a recording.
    """

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def command(*args: Any, bags: tuple[Path, ...], **values: Any) -> Any:
            given = {name: values.pop(f"bag_{name}") for name in moments}
            said: Statics | None = values.pop("statics") if statics else "then"
            if statics and said is not None and not bags:
                raise click.UsageError("--statics is for a recording: give --bag")
            known = said or "always"
            return function(*args, bag=bag_choice(bags, statics=known, **given), **values)

        decorated: Any = statics_option(cast(F, command)) if statics else command
        for name in reversed(moments):
            text, option = _MOMENTS[name]
            decorated = click.option(
                option, f"bag_{name}", metavar="TIME", type=MomentType(), help=f"With --bag: {text}"
            )(decorated)
        return bag_option(cast(F, decorated))

    return decorate


def statics_option(function: F) -> F:
    """Add `--statics`, which gives `statics`, to a click command that looks up in recordings."""
    option = click.option(
        "--statics",
        type=click.Choice(("always", "then")),
        help="With --bag: static transforms hold always, as in tf2 (default), or from when they "
        "were received.",
    )
    return option(function)


class _SeveralRecordings(Several):
    """Recordings after one option, as a shell makes them of `--bag run*.mcap`."""

    def takes(self, word: str) -> bool:
        """Whether the next word is one: an argument may be called as a folder that is there."""
        return super().takes(word) and word.endswith(".mcap") and Path(word).is_file()


def bag_option(function: F) -> F:
    """Add `--bag`, which gives `bags`, a tuple of paths, to a click command."""
    option = click.option(
        "--bag",
        "bags",
        cls=_SeveralRecordings,
        multiple=True,
        type=click.Path(exists=True, path_type=Path),
        metavar="FILE",
        help="Look into a recording, not at the bus: a file, or a folder of its files; repeatable.",
    )
    return option(function)


def bag_choice(
    bags: tuple[Path, ...], *, statics: "Statics" = "then", **moments: Moment | None
) -> BagChoice | None:
    """The choice; None without a recording. Raises click.UsageError for a moment without one."""
    if bags:
        return BagChoice(bags, statics=statics, **moments)
    for name, moment in moments.items():
        if moment is not None:
            raise click.UsageError(f"{_MOMENTS[name][1]} is a moment of a recording: give --bag")
    return None


@contextmanager
def open_recording(*paths: Path, says_damage: bool = True) -> "Iterator[RecordingReader]":
    """The recording in these files or folders.

    Raises TfbusError if it cannot be read. On stderr it is said where it is cut short and, unless
    the tool says it itself, which parts cannot be read.
    """
    met = _Damage()
    try:
        from tfbus.recording.reader import RecordingReader

        reader = RecordingReader(*paths, on_damage=met.report)
    except ImportError as error:
        raise TfbusError(
            f"recordings need {error.name or 'mcap'}, which is not installed: "
            f"{install_command('bag')}"
        ) from error
    with reader:
        if not reader.end_ns:
            raise TfbusError(_why_empty(reader, printable(str(paths[0])), met))
        for line in _cut_short(reader):
            click.echo(for_stderr(line), err=True)
        if not says_damage:
            yield reader
            return
        met.say_of(reader)
        try:
            yield reader
        finally:
            met.say_rest()


# Of files that are cut short at most this number is named.
_MOST_CUT_SHORT = 3


def _cut_short(reader: "RecordingReader") -> "Iterator[str]":
    """The files that are being written, or are cut short, and where each ends."""
    of_many = len(reader.parts) > 1
    for part in reader.parts:
        if part.is_growing:
            ends = f"up to {wall(part.end_ns)} so far" if part.end_ns else "nothing is in it yet"
            yield f"{part.name if of_many else 'The recording'} is being written: {ends}"
    files = [part for part in reader.parts if not (part.is_complete or part.is_growing)]
    for part in files[:_MOST_CUT_SHORT]:
        what = part.name if of_many else "The recording"
        ends = f"it ends at {wall(part.end_ns)}" if part.end_ns else "nothing is in it"
        more = "" if of_many else f" ({_RECOVER})"
        yield f"{what} is cut short: {ends}{more}"
    if of_many and files:
        others = len(files) - _MOST_CUT_SHORT
        also = f"so are {others} more; " if others > 0 else ""
        whole = sum(part.is_complete for part in reader.parts)
        yield f"{also}{whole} of {len(reader.parts)} files are whole ({_RECOVER})"


_RECOVER = "tfbus bag recover writes a whole file"


def _why_empty(reader: "RecordingReader", name: str, met: "_Damage") -> str:
    if met.found:
        return f"nothing of {name} can be read: {met.found[0][1].reason}"
    if any(part.is_growing for part in reader.parts):
        return f"{name} is being written: no message is in it yet"
    if not reader.is_complete:
        return f"{name} is cut short before its first message: nothing is in it"
    return f"{name} is an empty recording: it has no message"


class _Damage:
    """Names the unreadable parts of a recording on stderr, as they are met: the first places one by
    one, further ones together at the end.
    """

    def __init__(self) -> None:
        self.found: list[tuple[Part, Damage]] = []
        self._reader: RecordingReader | None = None

    def report(self, part: "Part", damage: "Damage") -> None:
        self.found.append((part, damage))
        if self._reader is not None and len(self.found) <= _MOST_DAMAGE:
            self._say([(part, damage)], self._reader.start_ns)

    def say_of(self, reader: "RecordingReader") -> None:
        """Name the parts met so far, and later ones, of a reader that is open."""
        self._reader = reader
        self._say(self.found[:_MOST_DAMAGE], reader.start_ns)

    def say_rest(self) -> None:
        rest = [damage for _, damage in self.found[_MOST_DAMAGE:]]
        if rest:
            messages = sum(each.messages or 0 for each in rest)
            with_them = f", with {counted(messages, 'message')}" if messages else ""
            self._print(
                f"{counted(len(rest), 'more part')} of the recording cannot be read: "
                f"{size_text(sum(each.size for each in rest))}{with_them}"
            )

    def _say(self, found: "list[tuple[Part, Damage]]", start_ns: int) -> None:
        for part, damage in found:
            self._print(
                f"{part.name} is damaged: {damage.text(start_ns)} cannot be read "
                f"({printable(damage.reason)}); the rest is"
            )

    def _print(self, line: str) -> None:
        click.echo(for_stderr(line), err=True)
