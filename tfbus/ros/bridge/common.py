"""The parts that both directions share: options, publishers, streams, and crossed transforms."""

import logging
import threading
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal

from tfbus.base import scheduler
from tfbus.base.bounded import Bounded
from tfbus.base.executor import Executor
from tfbus.base.log import LogOnce
from tfbus.base.wording import mistake_in, printable
from tfbus.geometry.columns import Columns
from tfbus.node.node import Node
from tfbus.ros.bridge.legs import Leg
from tfbus.streams.info import StreamState
from tfbus.streams.watch import StreamWatch

ClockWay = Literal["auto", "to-ros", "from-ros", "off"]


@dataclass(frozen=True)
class BridgeOptions:
    """The transforms that cross, and the clock.

    `frames` are patterns of child frames as the bus names them, such as `robot1/*`: given, only
    these cross. `frame_prefix` is put before the names of frames that come from ROS, and taken off
    names that go there. `rate_limit_hz` is how often a frame goes at most, in each direction.
    `ros_namespace` holds for topics in ROS: "robot1" for /robot1/tf. With `clock` "auto" the side
    that has a clock gives it to the other.
    """

    to_ros: bool = True
    from_ros: bool = True
    frames: tuple[str, ...] = ()
    frame_prefix: str = ""
    rate_limit_hz: float | None = None
    ros_namespace: str = ""
    clock: ClockWay = "auto"

    def selects(self, child: str) -> bool:
        """Whether the frame that the bus knows by this name crosses."""
        return not self.frames or any(fnmatchcase(child, each) for each in self.frames)

    def topic(self, name: str) -> str:
        """The full name of a topic in ROS: "/robot1/tf"."""
        namespace = self.ros_namespace.strip("/")
        return f"/{namespace}/{name}" if namespace else f"/{name}"

    @property
    def directions(self) -> str:
        """Its direction, in words."""
        if self.to_ros and self.from_ros:
            return "both directions"
        return "only to ROS" if self.to_ros else "only from ROS"


# Names come from ROS: at most this many are remembered.
_MOST_NAMES = 100_000


class RosFrameNames:
    """Turns the names of one side into the names of the other; safe from any thread.

    A frame of the bus without the prefix keeps its name in ROS, unless ROS has a frame of that name
    itself: that is another one.
    """

    def __init__(self, options: BridgeOptions) -> None:
        self._prefix = options.frame_prefix
        # As ROS has them; with a prefix only, since otherwise one name is one frame.
        self._of_ros: set[str] = set()

    def on_bus(self, name: str) -> str:
        """The name on the bus of a frame of ROS; ROS 1 begins names with a slash."""
        return self._prefix + name.lstrip("/")

    def mistake_in(self, name: str) -> str:
        """Why a frame of ROS cannot be on the bus, as the end of a sentence; "" if it can."""
        return mistake_in(self.on_bus(name)) if name.strip("/") else "must not be empty"

    def met(self, name: str) -> bool:
        """Note a frame that ROS has; whether it is new and may change the frames that go there."""
        name = name.lstrip("/")
        if not self._prefix or name in self._of_ros or len(self._of_ros) >= _MOST_NAMES:
            return False
        self._of_ros.add(name)
        return True

    def in_ros(self, name: str) -> str | None:
        """The name in ROS of a frame of the bus; None if that is another frame there."""
        if not self._prefix:
            return name
        if name.startswith(self._prefix) and name != self._prefix:
            return name[len(self._prefix) :]
        return None if name in self._of_ros else name


# One that is missing from this many looks, one after the other, is gone.
_GONE_AFTER = 2

# Messages of a publisher that is gone may still come by another bridge.
_REMEMBERED_S = 10.0

# A message may be faster than the word of its publisher: then it is looked for this often.
_POLL_AGAIN_S = 0.05


class RosPublishers:
    """The publishers of some topics by their gids, as the last look showed them; safe from any
    thread.
    """

    def __init__(
        self,
        leg: Leg,
        topics: Sequence[str],
    ) -> None:
        self._leg = leg
        self._topics = topics
        self._lock = threading.Lock()
        self._nodes: dict[str, str] = {}
        self._missed: dict[str, int] = {}
        self._left_s: dict[str, float] = {}
        self._next_poll_s = 0.0

    @property
    def nodes(self) -> dict[str, str]:
        """The node of each publisher by its gid, "" if it is not known; without publishers that are
        gone.
        """
        return self._nodes

    def poll(self) -> set[str]:
        """Look for publishers; the gids of publishers that are gone since."""
        listed = self._listed()
        with self._lock:
            self._add(listed)
            gone = set()
            for gid in self._nodes.keys() - listed.keys():
                self._missed[gid] = self._missed.get(gid, 0) + 1
                if self._missed[gid] >= _GONE_AFTER:
                    gone.add(gid)
            self._forget(gone)
        return gone

    def find_node(self, gid: str) -> str | None:
        """The node of a publisher that is new, None if it is not known yet."""
        if gid not in self._nodes and scheduler.monotonic() >= self._next_poll_s:
            self._next_poll_s = scheduler.monotonic() + _POLL_AGAIN_S
            listed = self._listed()
            with self._lock:
                self._add(listed)
        return self._nodes.get(gid)

    def replaced_by(self, gid: str, others: set[str]) -> set[str]:
        """The gids among `others`, publishers of the same node, that are no longer there: the node
        was started again.
        """
        if not others:
            return set()
        listed = self._listed()
        with self._lock:
            gone = others - listed.keys()
            self._forget(gone)
        return gone

    def has(self, gid: str) -> bool:
        """Whether a publisher is there, or was a few seconds ago."""
        return gid in self._nodes or self._left_s.get(gid, 0.0) > scheduler.monotonic()

    def _listed(self) -> dict[str, str]:
        return {
            each.gid: printable(each.node, 255)
            for topic in self._topics
            for each in self._leg.publishers(topic)
        }

    def _add(self, listed: dict[str, str]) -> None:
        # A new map each time: others read it without the lock.
        self._nodes = {**self._nodes, **listed}
        for gid in listed:
            self._missed.pop(gid, None)

    def _forget(self, gids: set[str]) -> None:
        if gids:
            now_s = scheduler.monotonic()
            self._nodes = {gid: node for gid, node in self._nodes.items() if gid not in gids}
            self._left_s = {gid: left for gid, left in self._left_s.items() if left > now_s}
            for gid in gids:
                self._missed.pop(gid, None)
                self._left_s[gid] = now_s + _REMEMBERED_S


# A stream says where it comes from soon after its first message, and the ROS around may know a
# publisher later than another bridge does: until then nothing of it goes to ROS.
_PATIENCE_S = 2.0

# The listener of the same node logs the faults of a stream.
_SILENT = logging.getLogger("tfbus.ros.bridge.silent")
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
    ) -> None:
        self._session = node.session.id
        self._publishers = publishers
        self._on_change = on_change
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
        """Whether the transforms of a stream go to ROS; not if they come from there. None if that
        is not known yet.
        """
        if self.is_own(stream):
            return False
        state = self._states.get(stream)
        description = state.description if state is not None else None
        met_s = self._met_s.setdefault(stream, scheduler.monotonic())
        is_new = scheduler.monotonic() < met_s + _PATIENCE_S
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
        """The stream of another bridge that carries these publishers' transforms, and was there
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


Way = Literal["to ROS", "from ROS"]
_OTHER: dict[Way, Way] = {"to ROS": "from ROS", "from ROS": "to ROS"}

# Of a frame that goes both ways this many stamps are remembered: 2.5 s at 100 Hz.
_MOST_STAMPS = 256

# Names come from the network: at most this many are remembered in each direction.
_MOST_FRAMES = 100_000

# When a frame begins to come from the other side too, its last stamps are not known yet: until they
# are, it does not go that way.
_LEARNING_S = 1.0


class Crossed:
    """Remembers the stamps of frames that go both ways, by the names of the bus; safe from any
    thread.

    `on_contested` is called when a frame begins to go both ways.
    """

    def __init__(
        self,
        on_contested: Callable[[], object],
    ) -> None:
        self._on_contested = on_contested
        self._lock = threading.Lock()
        self._going: dict[Way, set[str]] = {"to ROS": set(), "from ROS": set()}
        # Of each frame that goes both ways: its stamps by direction, and which direction came
        # second, and when.
        self._stamps: dict[str, dict[Way, Bounded[int, None]]] = {}
        self._second: dict[str, tuple[Way, float]] = {}

    def record(self, way: Way, children: Iterable[str]) -> bool:
        """Note that frames go this way; whether any of them goes the other way too."""
        begins = is_contested = False
        with self._lock:
            going, back = self._going[way], self._going[_OTHER[way]]
            for child in children:
                if child not in going and len(going) < _MOST_FRAMES:
                    going.add(child)
                    if child in back:
                        begins = True
                        self._stamps[child] = {each: Bounded(_MOST_STAMPS) for each in _OTHER}
                        self._second[child] = way, scheduler.monotonic() + _LEARNING_S
                is_contested |= child in self._stamps
        if begins:
            self._on_contested()
        return is_contested

    def forget(self, way: Way, children: Iterable[str]) -> None:
        """These frames go this way no longer."""
        with self._lock:
            for child in children:
                self._going[way].discard(child)
                self._stamps.pop(child, None)
                self._second.pop(child, None)

    def crosses(self, way: Way, rows: Columns) -> list[int]:
        """The indices of rows, with the names of the bus, that have not come the other way."""
        frames = rows.frames
        stamps = rows.stamps_as_ints()
        with self._lock:
            return [
                at
                for at, (_, child) in enumerate(rows.pairs())
                if self._crosses(way, frames[child], stamps[at])
            ]

    def _crosses(self, way: Way, child: str, stamp_ns: int) -> bool:
        stamps = self._stamps.get(child)
        if stamps is None:
            return True
        if stamp_ns in stamps[_OTHER[way]]:
            return False
        second, until_s = self._second[child]
        if way == second and scheduler.monotonic() < until_s:
            return False
        stamps[way][stamp_ns] = None
        return True


# A bridge that was here first still sends the frames that it has sent within this time.
_STILL_SENT_S = 3.0


class SentBySeniors:
    """Remembers the frames that a bridge of this bus, which was there first, sends to ROS, by their
    names on the bus. `on_news` is called when it begins to send one.
    """

    def __init__(self, on_news: Callable[[], object]) -> None:
        self._on_news = on_news
        self._last_s: dict[str, float] = {}

    def record(self, child: str) -> None:
        """Such a bridge has sent a frame."""
        if len(self._last_s) >= _MOST_FRAMES:
            self._last_s.clear()
        is_news = not self.has(child)
        self._last_s[child] = scheduler.monotonic()
        if is_news:
            self._on_news()

    def has(self, child: str) -> bool:
        """Whether such a bridge sends a frame."""
        last_s = self._last_s.get(child)
        return last_s is not None and scheduler.monotonic() < last_s + _STILL_SENT_S


@dataclass(frozen=True)
class Common:
    """Of one bridge: its node and options, the publishers on either side, the crossed transforms,
    and the thread on which its parts decide.
    """

    node: Node
    options: BridgeOptions
    names: RosFrameNames
    publishers: RosPublishers
    bus: BusStreams
    crossed: Crossed
    sent_by_seniors: SentBySeniors
    executor: Executor
    once: LogOnce
