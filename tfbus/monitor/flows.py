"""How transforms come, measured for the checks."""

import threading
import time
from collections import Counter
from itertools import pairwise

from tfbus.doctor.examination import Flow
from tfbus.errors import DecodeError
from tfbus.listen.names import StreamNames
from tfbus.node.node import Node
from tfbus.wire.fleet import Fleet
from tfbus.wire.keys import ALL_TRANSFORMS, ALL_TRANSFORMS_EVERYWHERE, stream_of
from tfbus.wire.transforms import decode_transforms

# Of more edges than these nothing is measured; names come from the bus.
_MOST_EDGES = 20_000
_MOST_SAMPLES = 5_000


class FlowMeter:
    """Notes when each sample came, from when it is made until it is closed."""

    def __init__(self, node: Node, fleet: Fleet | None = None):
        self.largest: Counter[str] = Counter()
        self._node = node
        self._lock = threading.Lock()
        # Of each stream and frame: arrivals (s), stamps and ages at arrival (ns).
        self._samples: dict[tuple[str, str], list[tuple[float, int, int]]] = {}
        self._names = StreamNames(fleet)
        keys = ALL_TRANSFORMS if fleet is None else ALL_TRANSFORMS_EVERYWHERE
        self._subscriber = node.session.subscriber(keys, self._take)

    def close(self) -> None:
        """Note no more."""
        self._subscriber.close()

    def flows(self) -> tuple[Flow, ...]:
        """What came, frame by frame."""
        with self._lock:
            return tuple(
                _flow(stream, frame, samples) for (stream, frame), samples in self._samples.items()
            )

    def _take(self, key: str, payload: bytes) -> None:
        now_ns = self._node.now_ns()
        # Rates are compared with those by stamps, which go by the node's clock.
        at_s = now_ns / 1e9 if self._node.clock.is_simulated else time.monotonic()
        try:
            batch = decode_transforms(payload).batch
        except DecodeError:
            return  # the listener counts it
        stream, frames = stream_of(key), self._names.of_message(key, batch.frames)
        with self._lock:
            self.largest[stream] = max(self.largest[stream], len(payload))
            rows = zip(batch.edges[:, 1].tolist(), batch.stamps_ns.tolist(), strict=True)
            for child, stamp_ns in rows:
                edge = (stream, frames[child])
                if edge in self._samples or len(self._samples) < _MOST_EDGES:
                    samples = self._samples.setdefault(edge, [])
                    if len(samples) < _MOST_SAMPLES:
                        samples.append((at_s, stamp_ns, now_ns - stamp_ns))


def _flow(stream: str, frame: str, samples: list[tuple[float, int, int]]) -> Flow:
    between_s = [later[0] - earlier[0] for earlier, later in pairwise(samples)]
    steps_ns = [later[1] - earlier[1] for earlier, later in pairwise(samples)]
    mean_s = sum(between_s) / len(between_s) if between_s else 0.0
    jitter_s = None
    if between_s:
        jitter_s = (sum((one - mean_s) ** 2 for one in between_s) / len(between_s)) ** 0.5
    return Flow(
        stream,
        frame,
        rate_hz=1.0 / mean_s if mean_s else None,
        jitter_s=jitter_s,
        longest_gap_s=max(steps_ns, default=0) / 1e9,
        delay_s=min(age_ns for _, _, age_ns in samples) / 1e9,
        at_zero=sum(stamp_ns == 0 for _, stamp_ns, _ in samples),
        out_of_order=sum(step_ns < 0 for step_ns in steps_ns),
    )
