"""The nodes on the bus and their descriptions, which change without a word."""

import logging
from collections.abc import Callable
from dataclasses import replace

from tfbus.bus.session import Session
from tfbus.discover.presence import describe_all
from tfbus.errors import BusError, DecodeError
from tfbus.runtime.executor import Executor
from tfbus.runtime.log_once import LogOnce
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import ALL_NODES, ALL_NODES_EVERYWHERE, full_name

# A node that was just started has its topics soon. All are asked again now and then.
_SOON_S = (0.02, 0.2, 0.7, 2.0)
_EVERY_S = 5.0
_ANSWER_WITHIN_S = 1.0


class NodeRoster:
    """Knows the nodes of this namespace, or `everywhere` below it; closed by `close()`.

    `on_change(name, description)` is called for each node and for each change of its description,
    with None where it is gone, one call at a time on a thread of its own. What a node counts of its
    buffers, and which of its streams have no listener, is no change.
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
        self._living: set[str] = set()
        self._nodes: dict[str, NodeDescription] = {}
        self._is_asked_for = False
        self._closed = False
        self._executor = Executor("nodes", log)
        self._executor.every(_EVERY_S, self._look)
        key = ALL_NODES_EVERYWHERE if everywhere else ALL_NODES
        self._tokens = session.watch_living(key, self._on_token)

    def close(self) -> None:
        """Stop watching. Twice is fine."""
        self._closed = True
        self._tokens.close()
        self._executor.close()

    def _on_token(self, key: str, alive: bool) -> None:
        name = full_name(key, self._session.settings.namespace)
        self._executor.submit("a node", lambda: self._take_token(name, alive))

    def _take_token(self, name: str, alive: bool) -> None:
        if alive:
            self._living.add(name)
            self._look_soon()
            return
        self._living.discard(name)
        if self._nodes.pop(name, None) is not None:
            self._on_change(name, None)

    def _look_soon(self) -> None:
        # Those that come together are asked together.
        if not self._is_asked_for:
            self._is_asked_for = True
            for delay_s in _SOON_S:
                self._executor.after(delay_s, self._look)

    def _look(self) -> None:
        self._is_asked_for = False
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
    return replace(node, unread=(), buffers=())
