"""The columns of numbers in `tfbus monitor` and `tfbus top`, of edges and of streams.

A function and an entry in `EDGES` or `STREAMS` make a new one, in both tools.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from tfbus.listen.info import StreamInfo
from tfbus.monitor.report import MeasuredEdge, Report
from tfbus.wording import duration

T = TypeVar("T")

# A number, a word in place of one, or nothing.
Value = float | str | None

# Forms of numbers that are seconds, besides those of `format`.
_DURATION, _OFFSET = "duration", "offset"


@dataclass(frozen=True)
class Column(Generic[T]):
    """A column: its heading, its value for a row of a report, and the form of numbers in it.

    80 columns have no room for all: the monitor shows a `rare` one only if a row has a value. `top`
    explains one with a `meaning`. `needs` is "now" for numbers that go stale with a span, "span"
    for times of a recording.
    """

    heading: str
    value: Callable[[Report, T], Value]
    form: str
    meaning: str = ""
    rare: bool = False
    needs: Literal["report", "now", "span"] = "report"

    def has_needs(self, report: Report) -> bool:
        """Whether the report has the numbers of this column."""
        return self.needs == "report" or (report.span is None) == (self.needs == "now")

    def text(self, value: Value) -> str:
        """The text of a value."""
        if value is None or isinstance(value, str):
            return value or ""
        if self.form == _DURATION:
            return duration(value)
        if self.form == _OFFSET:
            return f"{'+' if value >= 0 else ''}{duration(value)}"
        return format(value, self.form)


def _rate(report: Report, row: MeasuredEdge) -> Value:
    return "static" if row.frame.static else row.flow.rate_hz


def _jitter(report: Report, row: MeasuredEdge) -> Value:
    return row.flow.jitter_s


def _median_delay(report: Report, row: MeasuredEdge) -> Value:
    return None if row.flow.delays_s is None else row.flow.delays_s.p50


def _longest_delay(report: Report, row: MeasuredEdge) -> Value:
    return None if row.flow.delays_s is None else row.flow.delays_s.p99


def _age(report: Report, row: MeasuredEdge) -> Value:
    return report.tree.age_s(row.frame)


def _disordered(report: Report, row: MeasuredEdge) -> Value:
    return row.flow.out_of_order or None


def _longest_gap(report: Report, row: MeasuredEdge) -> Value:
    if row.flow.gap_from_ns is None:
        return None
    at_s = (row.flow.gap_from_ns - report.moment.start_ns) / 1e9
    return f"{duration(row.flow.longest_gap_s)} at +{at_s:.1f}s"


EDGES: tuple[Column[MeasuredEdge], ...] = (
    Column("Hz", _rate, ".1f", "messages or samples per second, mean of 10 s"),
    Column("jitter", _jitter, _DURATION, "how irregularly samples come"),
    Column(
        "delay p50", _median_delay, _DURATION, "how old a sample is when it comes, median of 10 s"
    ),
    Column("p99", _longest_delay, _DURATION),
    Column("age", _age, _DURATION, "how old the newest stamp of a frame is", needs="now"),
    Column("disordered", _disordered, "d", rare=True),
    Column("longest gap", _longest_gap, _DURATION, needs="span"),
)


def _messages(report: Report, stream: StreamInfo) -> Value:
    return report.meter.stream(stream.name).messages_hz


def _kilobytes(report: Report, stream: StreamInfo) -> Value:
    load = report.meter.stream(stream.name).bytes_per_s
    return None if load is None else load / 1e3


def _missed(report: Report, stream: StreamInfo) -> Value:
    return stream.missed


def _restarts(report: Report, stream: StreamInfo) -> Value:
    return report.meter.stream(stream.name).restarts or None


def _clock(report: Report, stream: StreamInfo) -> Value:
    return stream.clock_offset_s


STREAMS: tuple[Column[StreamInfo], ...] = (
    Column("Hz", _messages, ".1f"),
    Column("kB/s", _kilobytes, ".1f", rare=True),
    Column("missed", _missed, "d", "messages that were sent and never came"),
    Column("restarts", _restarts, "d", rare=True),
    Column("clock", _clock, _OFFSET, "how far the publisher's clock is ahead of ours", rare=True),
)
