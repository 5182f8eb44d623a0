"""Types for click's arguments and options: names on the bus, numbers, times, files to write.

`@click.argument("target", type=FrameName())`. Names are completed from the bus or, with `--bag`,
from the recording.
"""

import math
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from tfbus.bus.settings import LOG_LEVELS, NodeSettings, log_level_of
from tfbus.command.moment import Moment, parse_moment
from tfbus.errors import InvalidNameError, TfbusError
from tfbus.names import mistake_in
from tfbus.wire.keys import check_namespace, check_node_name, check_parameter, check_topic
from tfbus.wire.limits import size_in, size_text

if TYPE_CHECKING:
    from tfbus.command.names import LiveNames

# The options of a command that say where on the bus it is.
_PLACE = ("namespace", "mode", "connect", "listen", "config", "secure")


class _BusName(click.ParamType[str]):
    """A name on the bus; a subclass says which are candidates."""

    def candidates(self, names: "LiveNames", ctx: click.Context) -> Mapping[str, str]:
        """The names to complete with, and a help text for each."""
        raise NotImplementedError

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

    def candidates(self, names: "LiveNames", ctx: click.Context) -> Mapping[str, str]:
        """The frames of this namespace; with --fleet also of those below, by their names then."""
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
    """The mistake in a frame's name, and what to write instead; "" for a valid name."""
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

    def candidates(self, names: "LiveNames", ctx: click.Context) -> Mapping[str, str]:
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

    def candidates(self, names: "LiveNames", ctx: click.Context) -> Mapping[str, str]:
        """The topics that nodes publish or subscribe to, and their types."""
        return names.topics

    def _has_full(self) -> bool:
        return True


class ServiceName(TopicName):
    """The name of a service or action."""

    name = "service"

    def candidates(self, names: "LiveNames", ctx: click.Context) -> Mapping[str, str]:
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

    def candidates(self, names: "LiveNames", ctx: click.Context) -> Mapping[str, str]:
        """The parameters of that node."""
        node = str(ctx.params.get("node") or "").strip("/")
        return dict.fromkeys(names.parameters.get(node, ()), "")


class Number(click.ParamType[float]):
    """A finite number from `least`, or above it if `more_than_least`, to `most`.

    `zero` says what to write in place of a 0.
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


# Seconds: what a clock can wait for, thirty years.
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


class Size(click.ParamType[int]):
    """A size in bytes, more than 0 and at least `least`: `500MB`, `2GB`, or a plain number.

    `zero` says what to write in place of a 0.
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


def names_at(ctx: click.Context) -> "LiveNames":
    """The names on the bus, or in the recording, that the options typed so far select."""
    from tfbus.command.names import LiveNames, live_names  # Zenoh, which only completion needs

    if paths := _recording_in(ctx):
        from tfbus.command.names import names_in

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
