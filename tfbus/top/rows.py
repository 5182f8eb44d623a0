"""The tables of `tfbus top` as values, without a screen, and their source on the bus."""

import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from tfbus.base.errors import TransformException
from tfbus.base.wording import cut, duration, natural_order, printable
from tfbus.bus.graph import ServiceInfo, TopicInfo
from tfbus.frames.command_listener import Listening
from tfbus.frames.document import frame_lines
from tfbus.frames.meter import TransformMeter
from tfbus.frames.moment import State, faults, state
from tfbus.frames.report import EDGES, STREAMS, Column, MeasuredEdge, Report, Value, make_report
from tfbus.frames.windows import MessageWindow
from tfbus.node.node import Node
from tfbus.wire.descriptions import NodeDescription

_SERVICE = "service"

# The characters of a column beside its text, and of the mark of the order in a heading; and the
# free ones that a column needs to come back.
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
class ScreenTable:
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


def frames_table(report: Report) -> ScreenTable:
    """Each frame: its parent, its stream, and how it comes."""
    numbers = [each for each in EDGES if each.has_needs(report)]
    rows = []
    for frame in report.tree.frames.values():
        its_state = state(report.tree, frame)
        row = MeasuredEdge(frame, report.flow(frame))
        names = (frame.name, frame.parent or "", frame.authority if frame.parent else "")
        wrong = ", ".join(faults(report.tree, frame)) if frame.parent else its_state
        cells = (
            *map(_text, names),
            *(_number(each, each.value(report, row) if frame.parent else None) for each in numbers),
            _text(wrong),
        )
        rows.append(Row(frame.name, cells, its_state))
    headings = [each.heading for each in numbers]
    least_useful = _in_order(headings, "jitter", "delay p50", "stream", "parent", "age")
    return ScreenTable(
        "frames", ("frame", "parent", "stream", *headings, "state"), tuple(rows), least_useful
    )


def streams_table(report: Report) -> ScreenTable:
    """Each stream: its publisher and its load."""
    rows = []
    for stream in report.tree.streams.values():
        cells = (
            *map(_text, (stream.name, stream.node, stream.host)),
            *(_number(each, each.value(report, stream)) for each in STREAMS),
            Cell.of(len(stream.frames), "d"),
            _text("" if stream.alive else "gone"),
        )
        rows.append(Row(stream.name, cells, "dynamic" if stream.alive else "gone"))
    numbers = [each.heading for each in STREAMS]
    least_useful = _in_order(numbers, "kB/s", "clock", "frames", "host", "missed", "node")
    headings = ("stream", "node", "host", *numbers, "frames", "state")
    return ScreenTable("streams", headings, tuple(rows), least_useful)


def _number(column: Column[Any], value: Value) -> Cell:
    text = column.text(value)
    return _text(text) if isinstance(value, str) else Cell(text, _last(value))


def _in_order(numbers: Sequence[str], *known: str) -> tuple[str, ...]:
    """The columns that a narrow screen gives up: first of all numbers that are not `known`."""
    return (*(each for each in numbers if each not in (*known, "Hz")), *known)


def nodes_table(nodes: Iterable[NodeDescription], unanswered: Iterable[str] = ()) -> ScreenTable:
    """Each node: where and how long it runs, and the numbers of its topics and services; last the
    full names of nodes that are there and did not answer.
    """
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
    for name in unanswered:
        blank = (Cell.of(None, ""),) * 8
        rows.append(Row(name, (_text(name), _text("NO ANSWER"), *blank)))
    headings = ("node", "host", "pid", "up", "streams", "pub", "sub", "serves", "params", "lost")
    least_useful = ("params", "serves", "sub", "pub", "streams", "pid", "up", "host")
    return ScreenTable("nodes", headings, tuple(rows), least_useful)


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
) -> ScreenTable:
    """Each topic and service: its type, its rate if it is measured, and the nodes on both sides.

    `rates_hz` are by topic.
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
    return ScreenTable("topics", headings, tuple(rows), ("to", "from", "kind", "Hz"))


def is_service(row: Row) -> bool:
    """Whether a row of the table of topics is a service."""
    return row.key.startswith(f"{_SERVICE} ")


def chosen(table: ScreenTable, words: str, column: int, descending: bool) -> list[Row]:
    """The rows that contain every word, in any case, sorted by a column."""
    wanted = words.lower().split()
    rows = [
        row
        for row in table.rows
        if all(any(word in cell.text.lower() for cell in row.cells) for word in wanted)
    ]
    return sorted(rows, key=lambda row: _order(row.cells[column].value), reverse=descending)


def fitting(
    table: ScreenTable, rows: Sequence[Row], width: int, former: Sequence[int]
) -> list[int]:
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
    """A sort key that puts numbers before texts, and texts in their natural order."""
    return isinstance(value, str), natural_order(value) if isinstance(value, str) else value


def _text(text: str) -> Cell:
    return Cell(cut(printable(text), _LONGEST_CELL), text.lower())


def _last(value: float | None) -> float:
    return float("inf") if value is None else value


# The history in a frame's sparklines: 120 looks, one per second.
_LOOKS = 120
# Each history takes 15 kB: further frames have none.
_MOST_PASTS = 2000

# A topic's rate is the mean of this time, over at most `_MOST_MESSAGES`.
_MEAN_OF_S = 10.0
_MOST_MESSAGES = 10_000


@dataclass(frozen=True)
class FramePast:
    """The recent rates and delays of a frame: one per second, 0 if nothing came."""

    rates_hz: tuple[float, ...] = ()
    delays_s: tuple[float, ...] = ()


class TopSource:
    """The content of the tables; `look` is quick, `find_hint` may take a moment."""

    def __init__(self, heard: Listening):
        self._heard = heard
        heard.watch_nodes()
        self._meter = TransformMeter(heard.node, heard.fleet)
        self._past: dict[str, deque[tuple[float, float]]] = {}
        self._report: Report | None = None
        self.hint = ""  # where to look while there is no frame
        self._measured: dict[str, _Rate] = {}

    def tables(self) -> dict[str, ScreenTable]:
        """The tables by name, as they are now."""
        report = self._report = make_report(self._heard, self._meter, None)
        # Before the first answers there would be topics of transforms alone.
        topics = report.moment.topics if report.moment.nodes else {}
        self._remember(report)
        return {
            "frames": frames_table(report),
            "streams": streams_table(report),
            "nodes": nodes_table(report.moment.nodes, report.moment.unanswered),
            "topics": topics_table(topics, report.moment.services, self._rates_hz(report)),
        }

    def measure(self, topic: str) -> None:
        """Subscribe to a topic to measure its rate; a second time, stop that.

        Not all at once: a camera's images would fill a slow link.
        """
        if topic in self._measured:
            self._measured.pop(topic).close()
        elif not is_of_transforms(topic):
            self._measured[topic] = _Rate(self._heard.node, topic)

    def _rates_hz(self, report: Report) -> dict[str, float]:
        """The rates by topic: of measured topics, and of dynamic transforms."""
        streams = {
            name: report.meter.stream(name.partition("tf/")[2]).messages_hz
            for name in report.moment.topics
            if name.startswith("tf/")
        }
        return streams | {name: rate.hz for name, rate in self._measured.items()}

    def find_hint(self) -> None:
        """Look where frames are, while there is none here; every 3 s at most."""
        self.hint = "" if self._heard.buffer.frames() else self._heard.hint_while_empty()

    def past(self, frame: str) -> FramePast:
        """The rates and delays of a frame in the last two minutes."""
        looks = tuple(self._past.get(frame, ()))
        return FramePast(tuple(rate for rate, _ in looks), tuple(delay for _, delay in looks))

    def details(self, frame: str) -> list[str]:
        """All facts of a frame's edge, and its pose in its parent."""
        if self._report is None or frame not in self._report.tree.frames:
            return ["This frame is gone."]
        info = self._report.tree.frames[frame]
        lines = frame_lines(self._report.tree, info)
        try:
            pose = self._heard.buffer.lookup_transform(info.parent or frame, frame).transform
        except TransformException as error:
            return [*lines, str(error)]
        xyz = ", ".join(f"{value:.3f}" for value in pose.xyz)
        rpy = ", ".join(f"{value:.3f}" for value in pose.as_rpy())
        return [*lines, f"Position: {xyz} m", f"Roll, pitch, yaw: {rpy} rad"]

    def _remember(self, report: Report) -> None:
        for name in self._past.keys() - report.tree.frames.keys():
            del self._past[name]
        for frame in report.edges():
            flow = report.flow(frame)
            delay_s = flow.delays_s.p50 if flow.delays_s else 0.0
            if frame.name not in self._past and len(self._past) >= _MOST_PASTS:
                continue
            past = self._past.setdefault(frame.name, deque(maxlen=_LOOKS))
            past.append((flow.rate_hz or 0.0, delay_s))


def is_of_transforms(topic: str) -> bool:
    """Whether it carries the transforms of a stream, which are measured anyway."""
    return not {"tf", "tf_static"}.isdisjoint(topic.split("/"))


class _Rate:
    """How many messages of a topic come per second, as a mean of 10 s."""

    def __init__(self, node: Node, topic: str) -> None:
        self._since_s = time.monotonic()
        self._window = MessageWindow(_MOST_MESSAGES)
        self._subscription = node.create_raw_subscription(topic, self._add)

    def _add(self, payload: bytes) -> None:
        self._window.add(time.monotonic(), len(payload))

    @property
    def hz(self) -> float:
        now_s = time.monotonic()
        arrivals_s = self._window.read().arrivals_s
        recent = [at_s for at_s in arrivals_s if now_s - at_s <= _MEAN_OF_S]
        over_s = min(now_s - self._since_s, _MEAN_OF_S)
        if len(arrivals_s) == _MOST_MESSAGES:  # the oldest of 10 s are not in the window any longer
            over_s = min(over_s, now_s - arrivals_s[0])
        return len(recent) / max(over_s, 1e-3)

    def close(self) -> None:
        """Stop measuring."""
        self._subscription.close()
