"""Measuring topics: a window of messages of each, and a report of it every second."""

import math
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import click

from tfbus.cli.bus import look
from tfbus.cli.output import print_json, print_lines, say, table, warn
from tfbus.cli.topic.reports import Report
from tfbus.cli.topic.source import SAY_AFTER_S, subscribe, type_of, why_silent
from tfbus.errors import BusError, DecodeError
from tfbus.monitor.flow import Reading, Window
from tfbus.runtime.clock import SYSTEM_CLOCK

if TYPE_CHECKING:
    from tfbus.node.node import Node

# The number to measure of a message, from its bytes; None if the message does not count.
Meter = Callable[[bytes], float | None]

_PERIOD_S = 1.0


class MeteredTopic:
    """A subscribed topic, and the window of its messages."""

    def __init__(self, node: "Node", topic: str, meter: Meter, window: int):
        self.topic = topic
        self.window = Window(window)
        self.failure: Exception | None = None
        self._node = node
        self._meter = meter
        self._read_total = 0
        self._silent_since_s = time.monotonic()
        self._rejected = 0
        type_name = type_of(look(node.session), topic)
        self._subscription = subscribe(node, topic, type_name, self._take)

    def _take(self, payload: bytes) -> None:
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

    def read_new(self, now_s: float) -> Reading | None:
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
    report: Report,
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
    measured: Mapping[str, dict[str, Any]], report: Report, *, as_table: bool, as_json: bool
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
