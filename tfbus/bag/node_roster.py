"""The nodes on the bus and their descriptions, which change without a word."""

import logging
from collections.abc import Callable
from dataclasses import replace

from tfbus.bus.session import Session
from tfbus.discover.presence import describe_all
from tfbus.errors import BusError, DecodeError
from tfbus.runtime import scheduler
from tfbus.runtime.executor import Executor
from tfbus.runtime.log_once import LogOnce
from tfbus.runtime.timer import Timer
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import ALL_NODES, ALL_NODES_EVERYWHERE, full_name

# A node that was just started has its topics soon: all are asked after these times, one after the
# other, and then now and then.
_PAUSES_S = (0.02, 0.2, 0.5, 1.3)
_EVERY_S = 5.0
_ANSWER_WITHIN_S = 1.0

# However often nodes come and go.
_APART_S = 0.2

# Names come from the bus: at most as many are known.
_MOST_NODES = 10_000


class NodeRoster:
    """Knows the nodes of this namespace, or `everywhere` below it; closed by `close()`.

    `on_change(name, description)` is called for each node and for each change of its description,
    with None if it is gone, one call at a time on a thread of its own. What a node counts of its
    buffers and delays, and which of its streams have no listener, is no change.
    """

    def __init__(
        self,
        session: Session,
        on_change: Callable[[str, NodeDescription | None], None],
        *,
        everywhere: bool = False,
        log: logging.Logger,
    ) -> None:
        self._session = session
        self._on_change = on_change
        self._once = LogOnce(log)
        # Tokens that came or were lost, by their nodes.
        self._news: dict[str, bool] = {}
        self._living: set[str] = set()
        self._nodes: dict[str, NodeDescription] = {}
        self._looks = 0
        self._looked_s = -_APART_S
        self._next_look: tuple[float, Timer] | None = None
        self._closed = False
        self._executor = Executor("nodes", log)
        key = ALL_NODES_EVERYWHERE if everywhere else ALL_NODES
        self._tokens = session.watch_living(key, self._on_token)

    def close(self) -> None:
        """Stop watching. Twice is fine."""
        self._closed = True
        self._tokens.close()
        self._executor.close()

    def _on_token(self, key: str, alive: bool) -> None:
        name = full_name(key, self._session.settings.namespace)
        if name in self._news or len(self._news) < _MOST_NODES:
            self._news[name] = alive
            self._executor.submit("nodes", self._take_tokens, limit=1)

    def _take_tokens(self) -> None:
        while self._news:
            self._take_token(*self._news.popitem())

    def _take_token(self, name: str, alive: bool) -> None:
        if alive:
            if len(self._living) >= _MOST_NODES:
                self._once.warning(
                    "nodes", "Did not record node %r: there are more than %d", name, _MOST_NODES
                )
                return
            self._living.add(name)
            self._looks = 0
            # Those that come together are asked together.
            self._look_after(max(_PAUSES_S[0], self._looked_s + _APART_S - scheduler.monotonic()))
            return
        self._living.discard(name)
        if self._nodes.pop(name, None) is not None:
            self._on_change(name, None)

    def _look_after(self, delay_s: float) -> None:
        """Look after this time, or earlier if that is due: one look waits at a time."""
        due_s = scheduler.monotonic() + delay_s
        if self._next_look is not None:
            if self._next_look[0] <= due_s:
                return
            self._next_look[1].cancel()
        self._next_look = due_s, self._executor.after(delay_s, self._look)

    def _look(self) -> None:
        self._next_look = None
        self._looks += 1
        self._ask()
        self._looked_s = scheduler.monotonic()
        self._look_after(_PAUSES_S[self._looks] if self._looks < len(_PAUSES_S) else _EVERY_S)

    def _ask(self) -> None:
        if self._closed or not self._living:
            return
        try:
            described = describe_all(self._session, self._warn, timeout_s=_ANSWER_WITHIN_S)
        except BusError:
            return  # the session is closed
        # Of several nodes of one name always the same counts.
        for node in sorted(described, key=lambda node: (node.name, node.started_ns, node.session)):
            if node.name in self._living and node.session != self._session.id:
                self._take(node)

    def _take(self, node: NodeDescription) -> None:
        former = self._nodes.get(node.name)
        if former is None or _lasting(former) != _lasting(node):
            self._nodes[node.name] = node
            self._on_change(node.name, node)

    def _warn(self, error: DecodeError) -> None:
        self._once.warning("unreadable", "Did not record a node: %s", error)


def _lasting(node: NodeDescription) -> NodeDescription:
    return replace(node, unread=(), buffers=(), delays=())
