"""Types for click's arguments and options: names on the bus, numbers, times, files to write.

`@click.argument("target", type=FrameName())`. Names are completed from the bus or, with `--bag`,
from the recording.
"""

import math
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from tfbus.base.errors import InvalidNameError, TfbusError
from tfbus.base.wording import mistake_in
from tfbus.bus.settings import LOG_LEVELS, NodeSettings, log_level_of
from tfbus.wire.keys import check_namespace, check_node_name, check_parameter, check_topic
from tfbus.wire.limits import size_in, size_text

_NS_PER_UNIT = {
    "ns": 1,
    "us": 1_000,
    "ms": 1_000_000,
    "s": 1_000_000_000,
    "min": 60_000_000_000,
    "h": 3_600_000_000_000,
}
_NUMBER = re.compile(r"([+-]?)(\d+(?:\.\d*)?|\.\d+)\s*([a-z]*)")
_FRACTION = re.compile(r"(?<=:\d\d)[.,](\d+)")

# Whole numbers without a unit: seconds since 1970 stay below the first for 3000 years, and
# nanoseconds since 1970 passed the second after twelve days.
_SECONDS_BELOW = 10**11
_NANOSECONDS_FROM = 10**15

# Of a recording, numbers below this count from its beginning: three years, so that numbers from
# here on are times since 1970.
_ABSOLUTE_FROM_NS = 10**8 * 10**9

# The last stamp, and the most that can be added to now: 146 years.
_LAST_NS = 2**63 - 1
_FARTHEST_FROM_NOW_NS = 2**62


@dataclass(frozen=True)
class Moment:
    """A time in nanoseconds: since the Unix epoch, or since now if `is_relative`.

    Of a recording, one with `has_plus` counts from the beginning, another relative one from the
    end. A moment that is absolute and `is_number` was written without a sign, and not as a date.
    """

    ns: int
    is_relative: bool = False
    has_plus: bool = field(default=False, compare=False)
    is_number: bool = field(default=False, compare=False)

    def at(self, now_ns: int) -> int:
        """The moment in nanoseconds since the Unix epoch, if now is `now_ns`."""
        return now_ns + self.ns if self.is_relative else self.ns

    @property
    def is_from_beginning(self) -> bool:
        """Whether it counts from the beginning of a recording."""
        return self.has_plus or (self.is_number and self.ns < _ABSOLUTE_FROM_NS)

    def within(self, start_ns: int, end_ns: int) -> int:
        """The moment in a recording from `start_ns` to `end_ns`: `3` and `+3s` are 3 s after its
        beginning, `-3s` is 3 s before its end. A number from 100,000,000 s on counts since 1970. It
        may lie outside of the recording.
        """
        if self.is_from_beginning:
            return start_ns + self.ns
        return self.at(end_ns)


def parse_moment(text: str) -> Moment:
    """The moment that a text says. Raises ValueError for any other text.

    `now` is now. A number with a sign is relative to now, in seconds or in the unit that follows
    (ns, us, ms, s, min, h). A number without a sign counts from the Unix epoch: in its unit, or in
    seconds, or in nanoseconds if it is too large for seconds. Anything else is a date and time of
    ISO 8601, to the nanosecond, in local time if it names no zone.
    """
    text = text.strip()
    if text == "now":
        return Moment(0, is_relative=True)
    number = _NUMBER.fullmatch(text)
    moment = _counted(text, *number.groups()) if number else _dated(text)
    if abs(moment.ns) > (_FARTHEST_FROM_NOW_NS if moment.is_relative else _LAST_NS):
        raise ValueError(f"{text!r} is too far away: nanoseconds of 64 bits end in the year 2262")
    return moment


def _counted(text: str, sign: str, digits: str, unit: str) -> Moment:
    if unit and unit not in _NS_PER_UNIT:
        raise ValueError(f"{text!r} has an unknown unit {unit!r}; use {', '.join(_NS_PER_UNIT)}")
    ns = int(Decimal(digits) * _NS_PER_UNIT[unit or _implied_unit(text, sign, digits)])
    return Moment(
        -ns if sign == "-" else ns,
        is_relative=bool(sign),
        has_plus=sign == "+",
        is_number=not sign,
    )


def _implied_unit(text: str, sign: str, digits: str) -> str:
    if sign or "." in digits or int(digits) < _SECONDS_BELOW:
        return "s"
    if int(digits) >= _NANOSECONDS_FROM:
        return "ns"
    raise ValueError(
        f"{text!r} is too large for seconds and too small for nanoseconds since 1970; "
        "append its unit (ns, us, ms, s)"
    )


def _dated(text: str) -> Moment:
    try:
        # Python reads microseconds only.
        moment = datetime.fromisoformat(_FRACTION.sub("", text))
    except ValueError as error:
        raise ValueError(
            f"{text!r} is not a time; write one from now, or from the end of a recording, such as "
            "-3s, one from its beginning, such as +3s, a date such as 2026-11-21T09:00:00.5Z, or "
            "seconds or nanoseconds since 1970"
        ) from error
    since_epoch = moment.astimezone(UTC) - datetime.fromtimestamp(0, UTC)
    whole_ns = (since_epoch.days * 86_400 + since_epoch.seconds) * 1_000_000_000
    fraction = _FRACTION.search(text)
    return Moment(whole_ns + (int(f"{fraction[1]:0<9.9}") if fraction else 0))


# The options of a command that say where on the bus it is.
_PLACE = ("namespace", "mode", "connect", "listen", "config", "secure", "network")


@dataclass(frozen=True)
class LiveNames:
    """The names that there are to complete with, relative to the namespace of the settings.

    `frames` are the namespace's, `robots` has the frames of each namespace below. `topics` and
    `services` map to types, `parameters` maps names of nodes.
    """

    frames: tuple[str, ...] = ()
    robots: dict[str, tuple[str, ...]] = field(default_factory=dict)
    nodes: tuple[str, ...] = ()
    topics: dict[str, str] = field(default_factory=dict)
    services: dict[str, str] = field(default_factory=dict)
    parameters: dict[str, tuple[str, ...]] = field(default_factory=dict)


class _BusName(click.ParamType[str], ABC):
    """A name on the bus; a subclass says which are candidates."""

    @abstractmethod
    def candidates(self, names: LiveNames, ctx: click.Context) -> Mapping[str, str]:
        """The names to complete with, and a help text for each."""

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        """The name; a usage error for an invalid one."""
        return str(value)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """The names that start with the text; none if the bus cannot be joined."""
        found = self.candidates(names_at(ctx), ctx)
        if incomplete.startswith("/"):
            found = {absolute(name, ctx): text for name, text in found.items()}
            found = found if self._has_full() else {}
        return [
            CompletionItem(name, help=text or None)
            for name, text in sorted(found.items())
            if name.startswith(incomplete) and name.isprintable()
        ]

    def _has_full(self) -> bool:
        """Whether the name may start with a slash."""
        return False


class FrameName(_BusName):
    """The name of a frame: a text that is not empty and does not start with a slash."""

    name = "frame"

    def candidates(self, names: LiveNames, ctx: click.Context) -> Mapping[str, str]:
        """The frames of this namespace; with --fleet also of the ones below, by fleet names."""
        if not ctx.params.get("fleet"):
            return dict.fromkeys(names.frames, "")
        from tfbus.wire.fleet import Fleet  # numpy, which most completion does not need

        fleet = Fleet(ctx.params.get("shared_frames") or ())
        robots = {"": names.frames, **names.robots}
        return {fleet.names(at).outside(name): "" for at in robots for name in robots[at]}

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        """The name; a usage error for an invalid one."""
        name = str(value)
        if mistake := frame_mistake(name):
            self.fail(mistake, param, ctx)
        return name


def frame_mistake(name: str) -> str:
    """The mistake in a frame's name, and a valid name; "" for a valid name."""
    mistake = mistake_in(name)
    return f"a frame's name {mistake}" if mistake else ""


class NodeName(_BusName):
    """The name of a node, relative to the namespace or full."""

    name = "node"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        """The name; a usage error for an invalid one."""
        path, _, name = str(value).rstrip("/").rpartition("/")
        try:
            check_namespace(path)
            check_node_name(name)
        except InvalidNameError as error:
            self.fail(str(error), param, ctx)
        return str(value)

    def candidates(self, names: LiveNames, ctx: click.Context) -> Mapping[str, str]:
        """All nodes."""
        return dict.fromkeys(names.nodes, "")

    def _has_full(self) -> bool:
        return True


class TopicName(_BusName):
    """The name of a topic, relative to the namespace or absolute."""

    name = "topic"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        """The name; a usage error for an invalid one."""
        try:
            return check_topic(str(value), kind=self.name)
        except InvalidNameError as error:
            self.fail(str(error), param, ctx)

    def candidates(self, names: LiveNames, ctx: click.Context) -> Mapping[str, str]:
        """The topics that nodes publish or subscribe to, and their types."""
        return names.topics

    def _has_full(self) -> bool:
        return True


class ServiceName(TopicName):
    """The name of a service or action."""

    name = "service"

    def candidates(self, names: LiveNames, ctx: click.Context) -> Mapping[str, str]:
        """The services and actions of all nodes, and their types."""
        return names.services


class ParameterName(_BusName):
    """The name of a parameter of the node in the command's argument `node`."""

    name = "parameter"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        """The name; a usage error for an invalid one."""
        try:
            return check_parameter(str(value))
        except InvalidNameError as error:
            self.fail(str(error), param, ctx)

    def candidates(self, names: LiveNames, ctx: click.Context) -> Mapping[str, str]:
        """The parameters of that node."""
        node = str(ctx.params.get("node") or "").strip("/")
        return dict.fromkeys(names.parameters.get(node, ()), "")


class Number(click.ParamType[float]):
    """A finite number from `least`, or above it if `more_than_least`, to `most`.

    `zero` is the advice for a 0.
    """

    name = "number"

    def __init__(
        self,
        *,
        least: float = -math.inf,
        most: float = math.inf,
        more_than_least: bool = False,
        zero: str = "",
    ):
        self._least = least
        self._most = most
        self._more = more_than_least
        self._zero = zero

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number; a usage error for another text, or a number out of range."""
        try:
            number = float(str(value))
        except ValueError:
            self.fail(f"{value!r} is not a number", param, ctx)
        if not math.isfinite(number):
            self.fail(f"must be finite, not {value}", param, ctx)
        if number > self._most:
            self.fail(f"must be at most {self._most:g}, not {number:g}", param, ctx)
        if number < self._least or (self._more and number == self._least):
            relation = "more than" if self._more else "at least"
            instead = f": {self._zero}" if self._zero and not number else ""
            self.fail(f"must be {relation} {self._least:g}, not {number:g}{instead}", param, ctx)
        return number


# Seconds: a clock can wait for at most thirty years.
NOT_NEGATIVE = Number(least=0.0, most=1e9)
POSITIVE = Number(least=0.0, most=1e9, more_than_least=True)


class MomentType(click.ParamType[Moment]):
    """A time: seconds or nanoseconds since 1970, ISO 8601, `-3s` from now, or `now`."""

    name = "time"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> Moment:
        """The moment; a usage error for another text."""
        try:
            return value if isinstance(value, Moment) else parse_moment(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


class ByteSize(click.ParamType[int]):
    """A size in bytes, more than 0 and at least `least`: `500MB`, `2GB`, or a plain number.

    `zero` is the advice for a 0.
    """

    name = "size"

    def __init__(self, *, least: int = 1, zero: str = ""):
        self._least = least
        self._zero = zero

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> int:
        """The size; a usage error for another text."""
        size = value if isinstance(value, int) else size_in(str(value))
        if size == 0 and self._zero:
            self.fail(f"must be at least {size_text(self._least)}, not 0: {self._zero}", param, ctx)
        if not size:
            self.fail(
                f"{value!r} is not a size: write a number of bytes, or one with a unit of B, kB, "
                "MB, GB, as in 500MB",
                param,
                ctx,
            )
        if size < self._least:
            self.fail(
                f"must be at least {size_text(self._least)}, not {size_text(size)}", param, ctx
            )
        return size


class SpanOrSize(click.ParamType[tuple[float | None, int | None]]):
    """A time with its unit, `15min`, or a size with its unit, `2GB`: one of seconds and bytes."""

    name = "span|size"

    def __init__(self, *, least_s: float, least_bytes: int):
        self._least_s = least_s
        self._least_bytes = least_bytes

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float | None, int | None]:
        """The seconds or the bytes; a usage error for another text."""
        text = str(value).strip()
        size = None if text.isdecimal() else size_in(text)
        if size is not None:
            if size < self._least_bytes:
                self.fail(
                    f"must be at least {size_text(self._least_bytes)}, not {text}", param, ctx
                )
            return None, size
        found = _NUMBER.fullmatch(text)
        if found is None or found[1] or found[3] not in _NS_PER_UNIT:
            self.fail(
                f"{text!r} is no span and no size: write one with its unit, as in 15min, 2h or 2GB",
                param,
                ctx,
            )
        span_s = float(found[2]) * _NS_PER_UNIT[found[3]] / 1e9
        if not self._least_s <= span_s <= 1e8:
            self.fail(f"must be from {self._least_s:g} s to 3 years, not {text}", param, ctx)
        return span_s, None


class LogLevel(click.Choice[str]):
    """A level of LOG_LEVELS, also by the name that ROS gives it: `warn`."""

    def __init__(self) -> None:
        super().__init__(LOG_LEVELS)

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        """The level; a usage error for any other text."""
        return super().convert(log_level_of(str(value)), param, ctx)


class OutputFile(click.Path):
    """A file to write, whose name ends with one of `endings`; its folder must exist."""

    def __init__(self, *endings: str):
        super().__init__(path_type=Path, dir_okay=False, readable=False)
        self._endings = endings

    def convert(
        self,
        value: str | os.PathLike[str],
        param: click.Parameter | None,
        ctx: click.Context | None,
    ) -> Path:
        """The path; a usage error for another ending, no such folder, or a folder of this name."""
        path = Path(value)
        if path.suffix not in self._endings:
            one_of = "one of " if len(self._endings) > 1 else ""
            self.fail(f"{path} must end with {one_of}{', '.join(self._endings)}", param, ctx)
        if not path.parent.is_dir():
            self.fail(f"there is no folder {path.parent} to write {path.name} into", param, ctx)
        super().convert(path, param, ctx)
        return path


def absolute(name: str, ctx: click.Context) -> str:
    """A name of the namespace typed so far as an absolute one: `/robot7/scan`."""
    namespace = ctx.params.get("namespace") or os.environ.get("TFBUS_NAMESPACE") or ""
    namespace = namespace.strip("/")
    return f"/{namespace}/{name}" if namespace else f"/{name}"


def own_name(kind: str) -> str:
    """A node's name that no other process has: `echo_5d205229`."""
    return f"{kind}_{os.urandom(4).hex()}"


def names_at(ctx: click.Context) -> LiveNames:
    """The names on the bus, or in the recording, that the options typed so far select."""
    from tfbus.command.names import live_names, names_in  # for completion only

    if paths := _recording_in(ctx):
        namespace = ctx.params.get("namespace") or os.environ.get("TFBUS_NAMESPACE") or ""
        return names_in(paths, namespace.strip("/"))
    given: dict[str, Any] = {name: ctx.params[name] for name in _PLACE if ctx.params.get(name)}
    try:
        return live_names(NodeSettings(name="completion", **given))
    except TfbusError:
        return LiveNames()


def _recording_in(ctx: click.Context) -> list[Path]:
    """The files of the recording that the options and arguments typed so far name."""
    given = ctx.params.get("bags") or ctx.params.get("recording") or ()
    return (
        [given] if isinstance(given, Path) else [each for each in given if isinstance(each, Path)]
    )


def matching(values: Iterable[str], incomplete: str) -> list[CompletionItem]:
    """The values that start with the text, as candidates."""
    return [CompletionItem(value) for value in values if value.startswith(incomplete)]


# A file that a command reads; a usage error if it is not there.
IN_FILE = click.Path(path_type=Path, dir_okay=False, exists=True)

# A value that ends so is a file, though there is none.
_ROSTER_FILES = (".txt", ".list", ".lst", ".csv")


class RosterNames(click.ParamType[tuple[str, ...]]):
    """Names of robots, with ranges, or a file with such a name a line: a tuple of names."""

    name = "robots"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """The names; a usage error for a mistake in one, and a file that cannot be read."""
        from tfbus.wire.fleet import roster_of  # which `--help` does not need

        path = Path(value)
        names = [value]
        if path.is_file() or path.suffix in _ROSTER_FILES:
            try:
                lines = path.read_text(encoding="utf-8").splitlines()
            except (OSError, UnicodeDecodeError) as error:
                why = getattr(error, "strerror", None) or error
                self.fail(f"the file {value!r} cannot be read: {why}", param, ctx)
            names = [name for line in lines if (name := line.partition("#")[0].strip())]
        try:
            found = roster_of(names)
        except TfbusError as error:
            self.fail(str(error), param, ctx)
        if not found:
            self.fail(f"{value!r} names no robot", param, ctx)
        return found
