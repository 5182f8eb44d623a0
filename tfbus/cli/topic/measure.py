"""`tfbus topic hz|bw|delay`: the rate, the bandwidth and the delay of messages."""

import functools
import math
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import click
from click.core import ParameterSource

from tfbus.base.clock import SYSTEM_CLOCK
from tfbus.base.errors import BusError, DecodeError
from tfbus.base.wording import counted
from tfbus.bus.graph import TRANSFORMS_TYPE
from tfbus.bus.settings import NodeSettings
from tfbus.cli import Answering
from tfbus.cli.bus import look
from tfbus.cli.output import json_option, print_json, print_lines, say, table, warn
from tfbus.cli.topic.message_view import MessageFilter
from tfbus.cli.topic.source import (
    SAY_AFTER_S,
    RecordedMessage,
    full_topic,
    reader_of,
    reading_of,
    subscribe,
    type_of,
    visiting,
    why_silent,
)
from tfbus.command.options import bus_options
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import POSITIVE, TopicName
from tfbus.frames.clocks import is_another_time, whose_clock, why_no_stamp
from tfbus.frames.snapshot import REMEDIES
from tfbus.frames.windows import MessageWindow, Spread, WindowReading, spread_of
from tfbus.recording.items import TransformItem
from tfbus.wire.codec import decode_map, stamp_in
from tfbus.wire.keys import relative
from tfbus.wire.transforms import newest_stamp

if TYPE_CHECKING:
    from tfbus.node.node import Node


F = TypeVar("F", bound=Callable[..., Any])

# The number to measure of a message, from its bytes; None if the message does not count.
Meter = Callable[[bytes], float | None]


class Measure:
    """A measure as numbers, as lines, and as a row of a table of several topics."""

    name: ClassVar[str]
    headings: ClassVar[tuple[str, ...]]

    @abstractmethod
    def numbers(self, reading: WindowReading, now_s: float) -> dict[str, Any] | None:
        """The numbers at a monotonic time in s; None for too few messages."""

    @abstractmethod
    def lines(self, it: dict[str, Any]) -> list[str]:
        """Lines of these numbers."""

    @abstractmethod
    def row(self, it: dict[str, Any]) -> list[str]:
        """A row of these numbers, below the headings."""


class _Rate(Measure):
    name = "hz"
    headings = ("rate", "min_delta", "max_delta", "std_dev", "window")

    def numbers(self, reading: WindowReading, now_s: float) -> dict[str, Any] | None:
        spread = spread_of(reading.intervals_s)
        if spread is None or spread.mean <= 0.0:
            return None
        return {
            "rate_hz": 1.0 / spread.mean,
            **_spread(spread, "s"),
            "window": len(reading.arrivals_s),
        }

    def lines(self, it: dict[str, Any]) -> list[str]:
        return [f"average rate: {it['rate_hz']:.3f}", _spread_line(it)]

    def row(self, it: dict[str, Any]) -> list[str]:
        return [f"{it['rate_hz']:.3f}", *_spread_row(it)]


class _Bandwidth(Measure):
    name = "bw"
    headings = ("bandwidth", "mean", "min", "max", "window")

    def numbers(self, reading: WindowReading, now_s: float) -> dict[str, Any] | None:
        spread = spread_of(reading.numbers)
        if spread is None or spread.count < 2:
            return None
        return {
            "bytes_per_s": spread.mean * spread.count / (now_s - reading.arrivals_s[0]),
            "mean_bytes": spread.mean,
            "min_bytes": spread.min,
            "max_bytes": spread.max,
            "window": spread.count,
        }

    def lines(self, it: dict[str, Any]) -> list[str]:
        mean, least, most = _sizes(it)
        return [
            f"{_in_bytes(it['bytes_per_s'])}/s from {counted(it['window'], 'message')}",
            f"\tMessage size mean: {mean} min: {least} max: {most}",
        ]

    def row(self, it: dict[str, Any]) -> list[str]:
        return [f"{_in_bytes(it['bytes_per_s'])}/s", *_sizes(it), str(it["window"])]


class _Delay(Measure):
    name = "delay"
    headings = ("delay", "min", "max", "std_dev", "window")

    def numbers(self, reading: WindowReading, now_s: float) -> dict[str, Any] | None:
        spread = spread_of(reading.numbers)
        if spread is None:
            return None
        return {"mean_s": spread.mean, **_spread(spread, "s"), "window": spread.count}

    def lines(self, it: dict[str, Any]) -> list[str]:
        return [f"average delay: {it['mean_s']:.3f}", _spread_line(it)]

    def row(self, it: dict[str, Any]) -> list[str]:
        return [f"{it['mean_s']:.5f}", *_spread_row(it)]


RATE, BANDWIDTH, DELAY = _Rate(), _Bandwidth(), _Delay()


def _spread(spread: Spread, unit: str) -> dict[str, float]:
    names = ("min", "max", "std_dev", "p50", "p95", "p99")
    return {f"{name}_{unit}": getattr(spread, name) for name in names}


def _spread_line(it: dict[str, Any]) -> str:
    return (
        f"\tmin: {it['min_s']:.3f}s max: {it['max_s']:.3f}s std dev: {it['std_dev_s']:.5f}s "
        f"window: {it['window']}"
    )


def _spread_row(it: dict[str, Any]) -> list[str]:
    return [f"{it[name]:.5f}" for name in ("min_s", "max_s", "std_dev_s")] + [str(it["window"])]


def _in_bytes(number: float) -> str:
    for unit, size in (("MB", 1e6), ("KB", 1e3)):
        if number >= size:
            return f"{number / size:.2f} {unit}"
    return f"{number:.0f} B"


def _sizes(it: dict[str, Any]) -> list[str]:
    return [_in_bytes(it[name]) for name in ("mean_bytes", "min_bytes", "max_bytes")]


_PERIOD_S = 1.0


class MeteredTopic:
    """A subscribed topic, and the window of its messages."""

    def __init__(self, node: "Node", topic: str, meter: Meter, window: int):
        self.topic = topic
        self.window = MessageWindow(window)
        self.failure: Exception | None = None
        self._node = node
        self._meter = meter
        self._read_total = 0
        self._silent_since_s = time.monotonic()
        self._rejected = 0
        type_name = type_of(look(node.session), topic)
        self._subscription = subscribe(node, topic, type_name, self._measure)

    def _measure(self, payload: bytes) -> None:
        at_s = time.monotonic()
        try:
            number = self._meter(payload)
        except DecodeError as error:
            self._rejected += 1
            if self._rejected == 1:
                warn(f"skipped a message of {self.topic!r}: {error} (warned once)")
        except (BusError, click.UsageError) as error:
            self.failure = error
        else:
            if number is not None:
                self.window.add(at_s, number)

    def read_new(self, now_s: float) -> WindowReading | None:
        """The window; None if nothing came since the last call. Prints once that nothing comes.

        Raises the error of a message that cannot be measured.
        """
        if self.failure is not None:
            raise self.failure
        reading = self.window.read()
        if reading.total != self._read_total:
            self._read_total, self._silent_since_s = reading.total, now_s
            return reading
        if now_s - self._silent_since_s >= SAY_AFTER_S:
            self._silent_since_s = math.inf
            silent = f"No new messages on {self.topic!r}"
            say(silent if reading.total else why_silent(self._node, self.topic))
        return None


def measure(
    node: "Node",
    meters: Mapping[str, Meter],
    report: Measure,
    *,
    window: int,
    once: bool,
    timeout_s: float | None,
    as_json: bool,
) -> None:
    """Print a report of each topic every second, until the node is shut down.

    Raises BusError if there is nothing to report for the first `timeout_s` (None: never), and
    KeyboardInterrupt if the node is shut down before the only report.
    """
    topics = [MeteredTopic(node, topic, meter, window) for topic, meter in meters.items()]
    give_up_s = None if timeout_s is None else time.monotonic() + timeout_s
    while node.wait(_period_s(give_up_s), clock=SYSTEM_CLOCK):
        now_s = time.monotonic()
        measured = {}
        for each in topics:
            reading = each.read_new(now_s)
            numbers = report.numbers(reading, now_s) if reading else None
            if numbers is not None:
                measured[each.topic] = numbers
        print_measured(measured, report, as_table=len(topics) > 1, as_json=as_json)
        if measured:
            give_up_s = None
            if once:
                return
        elif give_up_s is not None and now_s >= give_up_s:
            names = ", ".join(repr(each.topic) for each in topics)
            raise BusError(f"too few messages on {names} after {timeout_s:g} s")
    if once:
        raise KeyboardInterrupt


def _period_s(give_up_s: float | None) -> float:
    if give_up_s is None:
        return _PERIOD_S
    return min(_PERIOD_S, max(give_up_s - time.monotonic(), 0.01))


def print_measured(
    measured: Mapping[str, dict[str, Any]], report: Measure, *, as_table: bool, as_json: bool
) -> None:
    """Print a report of each topic; of several as a table."""
    if as_json:
        for topic, numbers in measured.items():
            print_json({"topic": topic, **numbers})
    elif as_table and measured:
        rows = [[topic, *report.row(numbers)] for topic, numbers in measured.items()]
        right = range(1, len(report.headings) + 1)
        print_lines([*table(("topic", *report.headings), rows, right=right), ""])
    else:
        print_lines(line for numbers in measured.values() for line in report.lines(numbers))


_OF_HZ = {"--wall-time": "not needed: rates are measured by this host's clock"}


def _measuring(window: int) -> Callable[[F], F]:
    """The arguments and options of all three."""
    options = (
        click.argument("topics", type=TopicName(), nargs=-1, required=True, metavar="TOPIC..."),
        click.option(
            "-w",
            "--window",
            type=click.IntRange(min=2),
            default=window,
            metavar="N",
            show_default=True,
            help="Measure the last N messages.",
        ),
        click.option("--once", is_flag=True, help="Print one report and exit."),
        click.option(
            "--timeout",
            "timeout_s",
            type=POSITIVE,
            metavar="S",
            help="Fail if there is no report after S seconds.",
        ),
        json_option("Print each report as one line of JSON."),
        bus_options("topic"),
    )
    return lambda function: functools.reduce(lambda f, option: option(f), options[::-1], function)


@click.command(
    "hz", cls=Answering, hints=_OF_HZ, epilog="Example: tfbus topic hz turtle1/pose tf/broadcaster1"
)
@click.option(
    "--filter",
    "expression",
    metavar="EXPR",
    help="Count only messages m for which this is true: 'm.x > 5'.",
)
@bag_options("begin", "end")
@_measuring(10_000)
def hz_command(
    settings: NodeSettings,
    topics: tuple[str, ...],
    expression: str | None,
    bag: BagChoice | None,
    **how: Any,
) -> None:
    """Print the rate of TOPIC's messages, once a second.

    The rate is one over the mean time between messages; the spread of these times is printed too.
    With --bag, print that of a recording, or of a span of it, once.
    """
    wanted = MessageFilter(expression) if expression else None
    if bag is not None:

        def counted(message: RecordedMessage) -> float | None:
            return 0.0 if wanted is None or wanted.takes(message.values) else None

        _run_recorded(settings, topics, bag, RATE, counted, **how)
        return

    def number_of(node: "Node", topic: str) -> Meter:
        if wanted is None:
            return lambda payload: 0.0
        takes = wanted.takes
        read = reader_of(type_of(look(node.session), topic))
        return lambda payload: 0.0 if takes(read(payload)) else None

    _run(settings, topics, RATE, number_of, **how)


@click.command("bw", cls=Answering, epilog="Example: tfbus topic bw turtle1/pose")
@bag_options("begin", "end")
@_measuring(100)
def bw_command(
    settings: NodeSettings, topics: tuple[str, ...], bag: BagChoice | None, **how: Any
) -> None:
    """Print the bandwidth of TOPIC and the sizes of its messages, once a second.

    Counts the messages alone, without the network's overhead. With --bag, print that of a
    recording, or of a span of it, once.
    """
    if bag is not None:
        _run_recorded(settings, topics, bag, BANDWIDTH, lambda it: it.size, **how)
        return
    _run(settings, topics, BANDWIDTH, lambda node, topic: len, **how)


@click.command("delay", cls=Answering, epilog="Example: tfbus topic delay turtle1/pose")
@bag_options("begin", "end")
@_measuring(10_000)
def delay_command(
    settings: NodeSettings, topics: tuple[str, ...], bag: BagChoice | None, **how: Any
) -> None:
    """Print the age of TOPIC's messages on arrival, by their stamps, once a second.

    The stamp is the field stamp_ns of the message or its header; for transforms, the newest
    stamp. A difference between the clocks of two machines adds to the age. With --bag, print that
    of a recording, or of a span of it, once.
    """
    if bag is not None:
        _run_recorded(settings, topics, bag, DELAY, _age_s, **how)
        return

    def number_of(node: "Node", topic: str) -> Meter:
        is_of_transforms = type_of(look(node.session), topic) == TRANSFORMS_TYPE
        stamp_of = newest_stamp if is_of_transforms else functools.partial(_stamp, topic)
        return _Age(node, topic, stamp_of)

    _run(settings, topics, DELAY, number_of, **how)


def _run(
    settings: NodeSettings,
    topics: tuple[str, ...],
    report: Measure,
    number_of: Callable[["Node", str], Meter],
    *,
    once: bool,
    **how: Any,
) -> None:
    topics = tuple(relative(topic, settings.namespace) for topic in topics)
    with visiting(settings, report.name, goes_on=not once) as node:
        meters = {topic: number_of(node, topic) for topic in topics}
        measure(node, meters, report, once=once, **how)


def _run_recorded(
    settings: NodeSettings,
    topics: tuple[str, ...],
    bag: BagChoice,
    report: Measure,
    number_of: Callable[[RecordedMessage], float | None],
    *,
    timeout_s: float | None,
    as_json: bool,
    **_: object,
) -> None:
    given = click.get_current_context().get_parameter_source("window")
    if timeout_s is not None or given is not ParameterSource.DEFAULT:
        raise click.UsageError("--window and --timeout are of a bus: omit them with --bag")
    measured = {}
    for topic in topics:
        reading = reading_of(bag, full_topic(topic, settings), number_of)
        arrivals_s = reading.arrivals_s
        has_span = len(arrivals_s) > 1 and arrivals_s[-1] > arrivals_s[0]
        numbers = report.numbers(reading, arrivals_s[-1]) if has_span else None
        if numbers is None:
            raise BusError(f"too few messages on {topic!r} in the recording, or in that span of it")
        measured[topic] = numbers
    print_measured(measured, report, as_table=len(topics) > 1, as_json=as_json)


def _age_s(message: RecordedMessage) -> float | None:
    if (stamp_ns := message.stamp_ns) is not None:
        return (message.received_ns - stamp_ns) / 1e9
    if isinstance(message.item, TransformItem):
        return None  # it has no rows
    raise _no_stamp(message.topic)


class _Age:
    """The ages of a topic's messages; warns once of one that none has by the same clock."""

    def __init__(self, node: "Node", topic: str, stamp_of: Callable[[bytes], int | None]) -> None:
        self._node = node
        self._topic = topic
        self._stamp_of = stamp_of
        self._has_warned = False

    def __call__(self, payload: bytes) -> float | None:
        if (stamp_ns := self._stamp_of(payload)) is None:
            return None
        now_ns = self._node.now_ns()
        age_s = (now_ns - stamp_ns) / 1e9
        clock = self._node.clock
        if is_another_time(age_s) and clock.is_running and not self._has_warned:
            self._has_warned = True
            said = f"are of another clock: {whose_clock(is_simulated=clock.is_simulated)}"
            if why := why_no_stamp(stamp_ns, now_ns):
                said = f"{why}, and stamps are nanoseconds: {REMEDIES['unit']}"
            warn(f"the stamps on {self._topic!r} {said}")
        return age_s


def _stamp(topic: str, payload: bytes) -> int:
    stamp_ns = stamp_in(decode_map(payload, in_place=True))
    if stamp_ns is None:
        raise _no_stamp(topic)
    return stamp_ns


def _no_stamp(topic: str) -> BusError:
    return BusError(f"messages on {topic!r} have no field stamp_ns, so their age is unknown")
