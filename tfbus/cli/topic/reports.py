"""Reports of a window of messages, in ROS's words: rate, bandwidth, delay."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tfbus.monitor.flow import Reading, Spread, spread_of
from tfbus.wording import counted


@dataclass(frozen=True)
class Report:
    """A measure as numbers, as lines, and as a row of a table of several topics.

    `numbers` takes a reading and the time now (monotonic s), and returns None for too few messages.
    """

    name: str
    numbers: Callable[[Reading, float], dict[str, Any] | None]
    lines: Callable[[dict[str, Any]], list[str]]
    headings: tuple[str, ...]
    row: Callable[[dict[str, Any]], list[str]]


def _spread(spread: Spread, unit: str) -> dict[str, float]:
    names = ("min", "max", "std_dev", "p50", "p95", "p99")
    return {f"{name}_{unit}": getattr(spread, name) for name in names}


def _rate(reading: Reading, now_s: float) -> dict[str, Any] | None:
    spread = spread_of(reading.intervals_s)
    if spread is None or spread.mean <= 0.0:
        return None
    return {
        "rate_hz": 1.0 / spread.mean,
        **_spread(spread, "s"),
        "window": len(reading.arrivals_s),
    }


def _delay(reading: Reading, now_s: float) -> dict[str, Any] | None:
    spread = spread_of(reading.numbers)
    if spread is None:
        return None
    return {"mean_s": spread.mean, **_spread(spread, "s"), "window": spread.count}


def _bandwidth(reading: Reading, now_s: float) -> dict[str, Any] | None:
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


def _bandwidth_lines(it: dict[str, Any]) -> list[str]:
    mean, least, most = _sizes(it)
    return [
        f"{_in_bytes(it['bytes_per_s'])}/s from {counted(it['window'], 'message')}",
        f"\tMessage size mean: {mean} min: {least} max: {most}",
    ]


RATE = Report(
    "hz",
    _rate,
    lambda it: [f"average rate: {it['rate_hz']:.3f}", _spread_line(it)],
    ("rate", "min_delta", "max_delta", "std_dev", "window"),
    lambda it: [f"{it['rate_hz']:.3f}", *_spread_row(it)],
)
BANDWIDTH = Report(
    "bw",
    _bandwidth,
    _bandwidth_lines,
    ("bandwidth", "mean", "min", "max", "window"),
    lambda it: [f"{_in_bytes(it['bytes_per_s'])}/s", *_sizes(it), str(it["window"])],
)
DELAY = Report(
    "delay",
    _delay,
    lambda it: [f"average delay: {it['mean_s']:.3f}", _spread_line(it)],
    ("delay", "min", "max", "std_dev", "window"),
    lambda it: [f"{it['mean_s']:.5f}", *_spread_row(it)],
)
