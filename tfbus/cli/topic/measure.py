"""`tfbus topic hz|bw|delay`: the rate, the bandwidth and the delay of messages."""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tfbus.bus.settings import NodeSettings
from tfbus.cli.bus import look
from tfbus.cli.messages.message import reader_of
from tfbus.cli.messages.view import MessageFilter
from tfbus.cli.output import json_option, warn
from tfbus.cli.topic import reports
from tfbus.cli.topic.meter import Meter, measure, print_measured
from tfbus.cli.topic.source import full_topic, type_of, visiting
from tfbus.cli.verbs import Answering
from tfbus.command.options import bus_options
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import POSITIVE, TopicName
from tfbus.discover.graph import TRANSFORMS_TYPE
from tfbus.errors import BusError
from tfbus.wire.codec import decode_map
from tfbus.wire.keys import relative

if TYPE_CHECKING:
    from tfbus.cli.topic.recorded import RecordedMessage
    from tfbus.node.node import Node

F = TypeVar("F", bound=Callable[..., Any])

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

        def counted(message: "RecordedMessage") -> float | None:
            return 0.0 if wanted is None or wanted.takes(message.values) else None

        _run_recorded(settings, topics, bag, reports.RATE, counted, how["as_json"])
        return

    def number_of(node: "Node", topic: str) -> Meter:
        if wanted is None:
            return lambda payload: 0.0
        takes = wanted.takes
        read = reader_of(type_of(look(node.session), topic))
        return lambda payload: 0.0 if takes(read(payload)) else None

    _run(settings, topics, reports.RATE, number_of, **how)


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
        _run_recorded(settings, topics, bag, reports.BANDWIDTH, lambda it: it.size, how["as_json"])
        return
    _run(settings, topics, reports.BANDWIDTH, lambda node, topic: len, **how)


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
        _run_recorded(settings, topics, bag, reports.DELAY, _age_s, how["as_json"])
        return

    def number_of(node: "Node", topic: str) -> Meter:
        is_of_transforms = type_of(look(node.session), topic) == TRANSFORMS_TYPE
        stamp_of = _newest_stamp if is_of_transforms else functools.partial(_stamp, topic)
        return _Age(node, topic, stamp_of)

    _run(settings, topics, reports.DELAY, number_of, **how)


def _run(
    settings: NodeSettings,
    topics: tuple[str, ...],
    report: reports.Report,
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
    report: reports.Report,
    number_of: Callable[["RecordedMessage"], float | None],
    as_json: bool,
) -> None:
    from tfbus.cli.topic.recorded import reading_of

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


def _age_s(message: "RecordedMessage") -> float:
    if message.stamp_ns is None:
        raise _no_stamp(message.topic)
    return (message.received_ns - message.stamp_ns) / 1e9


class _Age:
    """The ages of a topic's messages; warns once of one that none has by the same clock."""

    def __init__(self, node: "Node", topic: str, stamp_of: Callable[[bytes], int]) -> None:
        self._node = node
        self._topic = topic
        self._stamp_of = stamp_of
        self._has_warned = False

    def __call__(self, payload: bytes) -> float:
        from tfbus.frames.clocks import is_another_time, whose_clock  # for `delay` only

        age_s = (self._node.now_ns() - self._stamp_of(payload)) / 1e9
        clock = self._node.clock
        if is_another_time(age_s) and clock.is_running and not self._has_warned:
            self._has_warned = True
            question = whose_clock(is_simulated=clock.is_simulated)
            warn(f"the stamps on {self._topic!r} are of another clock: {question}")
        return age_s


def _newest_stamp(payload: bytes) -> int:
    from tfbus.wire.transforms import decode_transforms  # which other messages do not need

    return max(decode_transforms(payload).rows.stamps_as_ints(), default=0)


def _stamp(topic: str, payload: bytes) -> int:
    from tfbus.cli.topic.recorded import stamp_in

    stamp_ns = stamp_in(decode_map(payload))
    if stamp_ns is None:
        raise _no_stamp(topic)
    return stamp_ns


def _no_stamp(topic: str) -> BusError:
    return BusError(f"messages on {topic!r} have no field stamp_ns, so their age is unknown")
