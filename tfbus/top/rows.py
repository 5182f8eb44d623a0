"""The tables of `tfbus top` as values, without a screen."""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from tfbus.discover.graph import ServiceInfo, TopicInfo
from tfbus.frames.state import State, faults, state
from tfbus.monitor.report import Report
from tfbus.wire.descriptions import NodeDescription
from tfbus.wording import cut, duration, printable

_SERVICE = "service"

# The characters of a column beside its text, and of the mark of the order in a heading; and those
# that are to be free before a column comes back.
_BESIDE, _MARK, _SPARE = 2, 2, 4

# Longer texts would push all other columns off the screen.
_LONGEST_CELL = 60


@dataclass(frozen=True)
class Cell:
    """The text of a cell, and the value to sort by."""

    text: str
    value: Any

    @staticmethod
    def of(value: float | None, form: str) -> "Cell":
        """A number in a format; for None an empty cell, sorted last."""
        return Cell("" if value is None else format(value, form), _last(value))

    @staticmethod
    def of_time(value: float | None) -> "Cell":
        """A time in seconds."""
        return Cell("" if value is None else duration(value), _last(value))


@dataclass(frozen=True)
class Row:
    """A row with a stable key, and its state."""

    key: str
    cells: tuple[Cell, ...]
    state: State = "dynamic"


@dataclass(frozen=True)
class Table:
    """A table: its name, headings and rows; of several rows with one key, the last.

    A node that answers twice, or two names that look the same, would be two such rows. A narrow
    screen gives up the columns of `least_useful`, the first of them first.
    """

    name: str
    headings: tuple[str, ...]
    rows: tuple[Row, ...]
    least_useful: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        rows = {row.key: row for row in self.rows}
        object.__setattr__(self, "rows", tuple(rows.values()))


def frames_table(report: Report) -> Table:
    """Each frame: its parent, its stream, and how it comes."""
    rows = []
    for frame in report.tree.frames.values():
        its_state = state(report.tree, frame)
        if frame.parent is None:
            cells = (
                _text(frame.name),
                *[_text("")] * 2,
                *[Cell.of(None, "")] * 4,
                _text(its_state),
            )
            rows.append(Row(frame.name, cells, its_state))
            continue
        flow = report.flow(frame)
        cells = (
            _text(frame.name),
            _text(frame.parent),
            _text(frame.authority),
            Cell.of(flow.rate_hz, ".1f") if not frame.static else _text("static"),
            Cell.of_time(report.tree.age_s(frame)),
            Cell.of_time(flow.delays_s.p50 if flow.delays_s else None),
            Cell.of_time(flow.jitter_s),
            _text(", ".join(faults(report.tree, frame))),
        )
        rows.append(Row(frame.name, cells, its_state))
    headings = ("frame", "parent", "stream", "Hz", "age", "delay", "jitter", "state")
    return Table("frames", headings, tuple(rows), ("jitter", "delay", "stream", "parent", "age"))


def streams_table(report: Report) -> Table:
    """Each stream: its publisher and its load."""
    rows = []
    for stream in report.tree.streams.values():
        flow = report.meter.stream(stream.name)
        cells = (
            _text(stream.name),
            _text(stream.node),
            _text(stream.host),
            Cell.of(flow.messages_hz, ".1f"),
            Cell.of(None if flow.bytes_per_s is None else flow.bytes_per_s / 1e3, ".1f"),
            Cell.of(len(stream.frames), "d"),
            Cell.of(stream.missed, "d"),
            Cell.of_time(stream.clock_offset_s),
            _text("" if stream.alive else "gone"),
        )
        rows.append(Row(stream.name, cells, "dynamic" if stream.alive else "gone"))
    headings = ("stream", "node", "host", "Hz", "kB/s", "frames", "missed", "clock", "state")
    least_useful = ("kB/s", "clock", "frames", "host", "missed", "node")
    return Table("streams", headings, tuple(rows), least_useful)


def nodes_table(nodes: Iterable[NodeDescription]) -> Table:
    """Each node: where and how long it runs, and the numbers of its topics and services."""
    rows = []
    for node in nodes:
        up_s = time.time() - node.started_ns / 1e9
        cells = (
            _text(node.name),
            _text(node.host),
            Cell.of(node.pid, "d"),
            Cell.of_time(up_s),
            Cell.of(len(node.streams), "d"),
            Cell.of(len(node.publishes), "d"),
            Cell.of(len(node.subscribes), "d"),
            Cell.of(len(node.serves), "d"),
            Cell.of(len(node.parameters), "d"),
            _held_up(node),
        )
        rows.append(Row(f"{node.name} {node.session}", cells))
    headings = ("node", "host", "pid", "up", "streams", "pub", "sub", "serves", "params", "lost")
    least_useful = ("params", "serves", "sub", "pub", "streams", "pid", "up", "host")
    return Table("nodes", headings, tuple(rows), least_useful)


def _held_up(node: NodeDescription) -> Cell:
    """How many ticks and messages it lost, and the callback that held up the most of them."""
    if not node.delays:
        return Cell.of(None, "")
    lost = sum(delay.lost for delay in node.delays)
    return Cell(cut(f"{lost} by {node.delays[0].by}", _LONGEST_CELL), lost)


def topics_table(
    topics: Mapping[str, TopicInfo],
    services: Mapping[str, ServiceInfo],
    rates_hz: Mapping[str, float] = MappingProxyType({}),
) -> Table:
    """Each topic and service: its type, its rate if it is measured, and the nodes on both sides.

    `rates_hz` are those of topics by name.
    """
    rows = []
    for topic in topics.values():
        heard_by = topic.subscribers
        cells = (
            _text(topic.name),
            _text("topic"),
            _text(", ".join(topic.types)),
            Cell.of(rates_hz.get(topic.name), ".1f"),
            _text(", ".join(end.node for end in topic.publishers)),
            _text("" if heard_by is None else ", ".join(end.node for end in heard_by)),
        )
        rows.append(Row(f"topic {topic.name}", cells))
    for service in services.values():
        cells = (
            _text(service.name),
            _text(_SERVICE),
            _text(", ".join(service.types)),
            Cell.of(None, ""),
            _text(", ".join(end.node for end in service.servers)),
            _text(", ".join(end.node for end in service.clients)),
        )
        rows.append(Row(f"{_SERVICE} {service.name}", cells))
    headings = ("name", "kind", "type", "Hz", "from", "to")
    return Table("topics", headings, tuple(rows), ("to", "from", "kind", "Hz"))


def is_service(row: Row) -> bool:
    """Whether a row of the table of topics is a service."""
    return row.key.startswith(f"{_SERVICE} ")


def chosen(table: Table, words: str, column: int, descending: bool) -> list[Row]:
    """The rows that contain every word, in any case, sorted by a column."""
    wanted = words.lower().split()
    rows = [
        row
        for row in table.rows
        if all(any(word in cell.text.lower() for cell in row.cells) for word in wanted)
    ]
    return sorted(rows, key=lambda row: _order(row.cells[column].value), reverse=descending)


def fitting(table: Table, rows: Sequence[Row], width: int, former: Sequence[int]) -> list[int]:
    """The numbers of the columns that fit into so many characters, with these rows.

    A column that is not among the `former` ones comes when there is room to spare, so that it does
    not come and go with a digit.
    """
    kept = list(range(len(table.headings)))
    taken = [
        _BESIDE + max(len(heading) + _MARK, *(len(row.cells[at].text) for row in rows), 0)
        for at, heading in enumerate(table.headings)
    ]
    for heading in table.least_useful:
        at = table.headings.index(heading)
        if sum(taken[each] for each in kept) + (0 if at in former else _SPARE) <= width:
            break
        kept.remove(at)
    return kept


def _order(value: Any) -> tuple[bool, Any]:
    """A sort key that puts numbers before texts."""
    return isinstance(value, str), value


def _text(text: str) -> Cell:
    return Cell(cut(printable(text), _LONGEST_CELL), text.lower())


def _last(value: float | None) -> float:
    return float("inf") if value is None else value
