"""Gathers what `tfbus top` shows from the bus."""

import threading
import time
from collections import deque
from dataclasses import dataclass

from tfbus.errors import TransformException
from tfbus.frames.command_listener import Listening
from tfbus.frames.document import frame_lines
from tfbus.monitor.flow import Window
from tfbus.monitor.meter import TransformMeter
from tfbus.monitor.report import Report, make_report
from tfbus.node.node import Node
from tfbus.top.rows import Table, frames_table, nodes_table, streams_table, topics_table

# The history in a frame's sparklines: 120 looks, one per second.
_LOOKS = 120
# Each history takes 15 kB: further frames have none.
_MOST_PASTS = 2000
_ASK_WITHIN_S = 0.8

# A topic's rate is the mean of this time, over at most `_MOST_MESSAGES`.
_MEAN_OF_S = 10.0
_MOST_MESSAGES = 10_000


@dataclass(frozen=True)
class FramePast:
    """The recent rates and delays of a frame: one per second, 0 if nothing came."""

    rates_hz: tuple[float, ...] = ()
    delays_s: tuple[float, ...] = ()


class Source:
    """The content of the tables; `look` is quick, `ask` takes up to 0.8 s."""

    def __init__(self, heard: Listening):
        self._heard = heard
        self._meter = TransformMeter(heard.node, heard.fleet)
        self._past: dict[str, deque[tuple[float, float]]] = {}
        self._report: Report | None = None
        self._asking = threading.Lock()
        self.hint = ""  # where to look while there is no frame
        self._measured: dict[str, _Rate] = {}

    def look(self) -> dict[str, Table]:
        """The tables by name, as they are now."""
        report = self._report = make_report(self._heard, self._meter, None)
        # Before the first answers there would be those of transforms alone.
        topics = report.moment.topics if report.moment.nodes else {}
        self._remember(report)
        return {
            "frames": frames_table(report),
            "streams": streams_table(report),
            "nodes": nodes_table(report.moment.nodes),
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
        """The rates of topics by name: those measured, and those of dynamic transforms."""
        streams = {
            name: report.meter.stream(name.partition("tf/")[2]).messages_hz
            for name in report.moment.topics
            if name.startswith("tf/")
        }
        return streams | {name: rate.hz for name, rate in self._measured.items()}

    def ask(self) -> None:
        """Ask all nodes for their descriptions, unless another call is doing so."""
        if self._asking.acquire(blocking=False):
            try:
                self._heard.ask_nodes(_ASK_WITHIN_S)
                self.hint = "" if self._heard.buffer.frames() else self._heard.hint()
            finally:
                self._asking.release()

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
        self._window = Window(_MOST_MESSAGES)
        self._subscription = node.create_raw_subscription(topic, self._take)

    def _take(self, payload: bytes) -> None:
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
