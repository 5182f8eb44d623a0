"""The streams on the bus: which come from ROS, and by which bridge."""

import logging
import threading
from collections.abc import Callable, Collection

from tfbus.bridge.ros_publishers import RosPublishers
from tfbus.listen.info import StreamState
from tfbus.listen.watch import StreamWatch
from tfbus.node.node import Node
from tfbus.runtime import scheduler

# A stream says where it comes from soon after its first message, and the ROS around may know a
# publisher later than another bridge does: until then nothing of it goes to ROS.
_PATIENCE_S = 2.0

# The listener of the same node logs what is wrong with a stream.
_SILENT = logging.getLogger("tfbus.bridge.silent")
_SILENT.propagate = False
_SILENT.addHandler(logging.NullHandler())


class BusStreams:
    """The knowledge of the streams on the bus; safe from any thread. `on_change` is called when
    that changes, on a thread of its own.
    """

    def __init__(
        self,
        node: Node,
        publishers: RosPublishers,
        on_change: Callable[[], object],
        clock_s: Callable[[], float] = lambda: scheduler.monotonic(),
    ) -> None:
        self._session = node.session.id
        self._publishers = publishers
        self._on_change = on_change
        self._clock_s = clock_s
        self._lock = threading.Lock()
        self._states: dict[str, StreamState] = {}
        self._met_s: dict[str, float] = {}
        self._by_child: dict[str, list[StreamState]] | None = None
        self._watch = StreamWatch(node.session, self._on_stream, log=_SILENT)

    def close(self) -> None:
        """Watch no longer. Twice is fine."""
        self._watch.close()

    def is_own(self, stream: str) -> bool:
        """Whether a stream is known to be of this session."""
        state = self._states.get(stream)
        description = state.description if state is not None else None
        return description is not None and description.session == self._session

    def is_there(self, stream: str) -> bool:
        """Whether the publisher of a stream is there."""
        return stream in self._states

    def goes_to_ros(self, stream: str) -> bool | None:
        """Whether the transforms of a stream go to ROS; not those that come from there. None if
        that is not known yet.
        """
        if self.is_own(stream):
            return False
        state = self._states.get(stream)
        description = state.description if state is not None else None
        met_s = self._met_s.setdefault(stream, self._clock_s())
        is_new = self._clock_s() < met_s + _PATIENCE_S
        if description is None:
            return None if is_new else True
        if not description.origin:
            return True
        if any(map(self._publishers.has, description.origin)):
            return False
        return None if is_new else True

    def has_from_elsewhere(self, child: str, gids: Collection[str]) -> bool:
        """Whether a living stream has this frame that does not come from these publishers in ROS,
        neither by this bridge nor by another.
        """
        return any(
            not any(gid in gids for gid in state.description.origin)
            for state in self._of_child(child)
            if state.description is not None
        )

    def imported_by_another(self, gids: Collection[str], since: tuple[int, str]) -> str:
        """The stream of another bridge that carries what these publishers send, and was there
        before `since`, a time in ns and a session; "" for none.
        """
        with self._lock:
            states = [*self._states.items()]
        for name, state in states:
            description = state.description
            if description is None or description.session == self._session:
                continue
            is_before = (description.started_ns, description.session) < since
            if is_before and any(gid in gids for gid in description.origin):
                return name
        return ""

    def _of_child(self, child: str) -> list[StreamState]:
        with self._lock:
            if self._by_child is None:
                self._by_child = {}
                for state in self._states.values():
                    if state.description is not None:
                        for _, frame, _ in state.description.frames:
                            self._by_child.setdefault(frame, []).append(state)
            return self._by_child.get(child, [])

    def _on_stream(self, state: StreamState) -> None:
        with self._lock:
            former = self._states.get(state.name)
            if state.alive:
                self._states[state.name] = state
            else:
                self._states.pop(state.name, None)
                self._met_s.pop(state.name, None)
            self._by_child = None
        if former is None or _matters(former) != _matters(state):
            self._on_change()


def _matters(state: StreamState) -> tuple[object, ...]:
    description = state.description
    if description is None:
        return (state.alive,)
    return state.alive, description.session, description.origin, description.frames
