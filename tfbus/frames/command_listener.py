"""A listener for commands that look at all frames, which has met all publishers when it is yielded;
and the bus as programs watch it, by the same listener.
"""

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from tfbus.base import scheduler
from tfbus.base.clock import SYSTEM_CLOCK, Pace
from tfbus.base.errors import TimeoutException
from tfbus.base.own_pauses import MOST_TIMES, own_pauses
from tfbus.base.stamps import MOST_AHEAD_NS
from tfbus.base.wording import listed
from tfbus.buffer.buffer import Buffer
from tfbus.bus.graph_watch import GraphWatch
from tfbus.bus.presence import Described, ask_graph, ask_streams
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.frames.changes import BusChange, Changes, check_period
from tfbus.frames.clocks import simulated_time
from tfbus.frames.moment import BusMoment
from tfbus.frames.snapshot import FrameTree, frame_tree
from tfbus.geometry.sampling import TF2, Sampling
from tfbus.node.node import Node
from tfbus.streams.listener import TransformListener
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.fleet import Fleet

# This much of the publishers' kept transforms gives their rates at once.
_HISTORY_S = 3.0

_CLOCK_WITHIN_S = 5.0

# Links open one after the other, and the descriptions of streams follow.
_QUIET_S = 0.3

_ASK_EVERY_S = 3.0
# Streams begin and end with a change of their nodes; later they may list other frames.
_ASK_STREAMS_EVERY_S = 5.0
_ANSWER_WITHIN_S = 1.0

_NO_FRAMES = Buffer()

# Samples that are so old are of another time, or nothing comes.
_ODD_BEHIND_S = 2.0


@dataclass
class _Asked:
    """The answers of other processes, and when they were asked."""

    answers: Described = field(default_factory=Described)
    hint: str = ""
    graph: GraphWatch | None = None
    hint_pace: Pace = field(default_factory=lambda: Pace(_ASK_EVERY_S))
    streams_pace: Pace = field(default_factory=lambda: Pace(_ASK_STREAMS_EVERY_S))


@dataclass(frozen=True)
class Listening:
    """A command's own node, its buffer and listener: of a whole fleet, or of its namespace."""

    node: Node
    buffer: Buffer
    listener: TransformListener
    fleet: Fleet | None

    _asked: _Asked = field(default_factory=_Asked)

    @property
    def dropped(self) -> int:
        """How many messages were dropped, since transforms came on too many keys."""
        return self.listener.dropped

    def now_ns(self) -> int:
        """The time now, by the node's clock."""
        return self.node.now_ns()

    def unlinked(self) -> str:
        """The router without which this process sees nobody, while there is no link to it; "" if
        there is one, or it needs none.
        """
        session = self.node.session
        # A client has its links by routers alone.
        if session.settings.mode != "client" or session.routers():
            return ""
        return listed(session.settings.connect) or "a router"

    def wait(self, timeout_s: float) -> bool:
        """Wait for this many real seconds; False if the node was shut down."""
        return self.node.wait(timeout_s, clock=SYSTEM_CLOCK)

    def tree(self, *, has_frames: bool = True) -> FrameTree:
        """The tree of frames now."""
        streams = self.listener.streams()
        simulated = simulated_time(self._answers.nodes)
        buffer = self.buffer if has_frames else _NO_FRAMES
        was_paused = own_pauses().left_s() > 0.0
        return frame_tree(buffer, streams, self.now_ns(), simulated, was_paused=was_paused)

    def catch_up(self) -> bool:
        """After a pause of this process wait until others have had the time again that they were
        not heard, at most three times; whether it had to wait.
        """
        waits = 0
        while waits < MOST_TIMES and (left_s := own_pauses().left_s()):
            waits += 1
            if not self.wait(left_s):
                raise KeyboardInterrupt
        return waits > 0

    def ask_about_clocks(self) -> None:
        """Ask the nodes, of which some follow a simulated time, if ages of frames look as if."""
        tree = self.tree()
        ages_s = map(tree.age_s, tree.frames.values())
        if not self.node.clock.is_simulated and any(map(_is_odd, ages_s)):
            self.ask_nodes()

    def ask_nodes(self) -> None:
        """Ask the nodes of other processes for their descriptions, from which `moment` is made; it
        takes up to 2 s. Unreadable ones are left out.
        """
        self.set_answers(ask_others(self.node.session))

    def watch_nodes(self) -> None:
        """From now on `moment` has the nodes and streams as they are then. Waits until the nodes
        have described themselves, 1 s at the most.
        """
        self._asked.graph = GraphWatch(
            self.node.session,
            self.node.log,
            everywhere=True,
            on_change=lambda name, node: self._asked.streams_pace.hurry(),
            on_nodes=self._on_nodes,
        )
        self._asked.graph.wait(_ANSWER_WITHIN_S)

    def close(self) -> None:
        """Watch the nodes no longer, and stop listening. Twice is fine."""
        if self._asked.graph is not None:
            self._asked.graph.close()
        self.listener.close()

    def _on_nodes(self, nodes: list[NodeDescription]) -> None:
        # Of a fleet the listener has all streams.
        if self.fleet is None and self._asked.streams_pace.is_due():
            self.set_answers(ask_streams(self.node.session, timeout_s=_ANSWER_WITHIN_S))

    @property
    def _answers(self) -> Described:
        if (graph := self._asked.graph) is None:
            return self._asked.answers
        nodes, silent = tuple(graph.nodes()), tuple(graph.silent())
        return replace(self._asked.answers, nodes=nodes, silent_nodes=silent)

    def set_answers(self, answers: Described) -> None:
        """Set the answers of nodes that were asked for."""
        self._asked.answers = answers

    def moment(self, *, has_frames: bool = True) -> BusMoment:
        """The bus now, with the nodes as they were when they were asked last, unless they are
        watched. Of many frames it takes long: without them it has the streams and nodes.
        """
        answers = self._answers
        return BusMoment(
            at_ns=SYSTEM_CLOCK.now_ns(),
            tree=self.tree(has_frames=has_frames),
            nodes=answers.nodes,
            unanswered=answers.silent_nodes,
            rejected=dict(self.buffer.rejected),
            dropped=self.dropped,
            elsewhere=answers.streams,
            namespace=self.node.session.settings.namespace,
        )

    def hint(self, frame: str = "") -> str:
        """The other namespaces that have a frame, or any frame at all; "" when none does."""
        return self.listener.where_to_look(frame)

    def hint_while_empty(self) -> str:
        """`hint()` for a screen that shows nothing yet: asked again every 3 s at most."""
        if self._asked.hint_pace.is_due():
            self._asked.hint = self.hint()
        return self._asked.hint


def ask_others(session: Session) -> Described:
    """All streams, and the nodes of other processes."""
    found = ask_graph(session, timeout_s=_ANSWER_WITHIN_S)
    return replace(found, nodes=tuple(each for each in found.nodes if each.session != session.id))


def _is_odd(age_s: float | None) -> bool:
    """Whether an age is not that of a frame which comes now, by the system's time."""
    return age_s is not None and not -MOST_AHEAD_NS / 1e9 < age_s < _ODD_BEHIND_S


@contextmanager
def listening(
    settings: NodeSettings,
    fleet: Fleet | None,
    *,
    within_s: float = 2.0,
    history_s: float = _HISTORY_S,
    cache_time_s: float = 10.0,
    goes_on: bool = False,
    sampling: Sampling = TF2,
) -> Iterator[Listening]:
    """Listen to all transforms; yields once nothing new comes, after `within_s` at the latest.

    Asks each publisher for the last `history_s` seconds that it has kept. Without a router to
    connect to, it waits and says so when `goes_on`, else raises BusError. Ctrl-C and SIGTERM raise
    KeyboardInterrupt, unless they end a `node.wait` inside the `with`.
    """
    buffer = Buffer(cache_time_s, sampling=sampling)
    with (
        _join(settings, goes_on) as node,
        TransformListener(buffer, node, history_s=history_s, fleet=fleet) as listener,
    ):
        wait_for_clock(node)
        heard = Listening(node, buffer, listener, fleet)
        meet_publishers(heard, within_s)
        if node.ok:
            try:
                yield heard
            finally:
                heard.close()
            return
    raise KeyboardInterrupt  # the node's `with` has ended quietly


def _join(settings: NodeSettings, goes_on: bool) -> Node:
    if not goes_on:
        return Node(settings=replace(settings, log_level="error"), patience_s=0.0)
    node = Node(settings=replace(settings, log_level="warning"), patience_s=math.inf)
    node.log.setLevel(logging.ERROR)
    return node


def wait_for_clock(node: Node) -> None:
    """Wait until the node knows the time. Raises TimeoutException after 5 s without a clock."""
    if not node.wait_for_clock(_CLOCK_WITHIN_S) and node.ok:
        raise TimeoutException(
            f"no time on topic 'clock' after {_CLOCK_WITHIN_S:g} s: start a clock (tfbus clock) "
            "or omit --sim-time"
        )


def meet_publishers(heard: Listening, within_s: float) -> None:
    """Wait until all frames that publishers list have come, and no further stream, or so long."""
    deadline = scheduler.monotonic() + within_s
    known, since = _known(heard), scheduler.monotonic()
    while scheduler.monotonic() < deadline and heard.node.ok:
        if not heard.wait(0.02):
            break
        now = _known(heard)
        if now != known:
            known, since = now, scheduler.monotonic()
        elif now[0] and now[1] >= now[0] and scheduler.monotonic() - since > _QUIET_S:
            return


def _known(heard: Listening) -> tuple[int, int, int]:
    """How many frames the living streams list, how many of them have come, and how many streams."""
    streams = [stream for stream in heard.listener.streams() if stream.alive]
    listed = {child for stream in streams for _, child, _ in stream.frames}
    return len(listed), len(listed.intersection(heard.buffer.frames())), len(streams)


# Publishers of a program's watch are met in this time.
_MEET_WITHIN_S = 2.0


class Watch:
    """The bus as it is now, seen by a listener of this node: its namespace, or a `fleet`.

    Use it in a `with`, or `close()` it. It waits until the publishers that are there have been
    heard, 3 s at the most, so make it outside of callbacks. `buffer` has the transforms.
    """

    def __init__(self, node: Node, *, fleet: Fleet | None = None) -> None:
        self.buffer = Buffer()
        listener = TransformListener(self.buffer, node, history_s=_HISTORY_S, fleet=fleet)
        self._node = node
        self._heard = Listening(node, self.buffer, listener, fleet)
        meet_publishers(self._heard, _MEET_WITHIN_S)
        self._heard.watch_nodes()

    def __enter__(self) -> "Watch":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop listening. Twice is fine; closing the node does it too."""
        self._heard.close()

    def now(self) -> BusMoment:
        """The bus now, with topics of nodes as they were up to a second ago."""
        return self._heard.moment()

    def changes(self, period_s: float = 0.2) -> Iterator[BusChange]:
        """The changes of the bus, until the node is closed: first of all that is there, then each
        when it is noticed, at most `period_s` later.
        """
        check_period(period_s)
        return self._changes(period_s)

    def _changes(self, period_s: float) -> Iterator[BusChange]:
        changes = Changes()
        while self._node.ok:
            yield from changes.to(self.now())
            if not self._heard.wait(period_s):
                return
