"""Two nodes of one name: the one that came second says so."""

import logging

from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.runtime.executor import Executor, Timer
from tfbus.wire.codec import decode_message
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import node_key

# After a link to another process has opened, its declarations take a moment to arrive.
_CHECK_AFTER_S = 0.3


class NamesakeWatch:
    """Warns once of each other node that has this node's name: their parameters and services
    are mixed up.

    Whoever is there when a node starts was there first, whatever the clocks say. One that is met
    later, when two networks join, warns where it was started later.
    """

    def __init__(
        self,
        name: str,
        full_name: str,
        started_ns: int,
        session: Session,
        executor: Executor,
        log: logging.Logger,
    ):
        self._name = name
        self._full_name = full_name
        self._started_ns = started_ns
        self._session = session
        self._executor = executor
        self._log = log
        self._known = {session.id}
        self._check: Timer = executor.after(_CHECK_AFTER_S, self._ask)
        session.watch_links(self._ask_soon)
        self._ask(first=True)

    def _ask_soon(self) -> None:
        if self._check.cancelled:
            self._check = self._executor.after(_CHECK_AFTER_S, self._ask)

    def _ask(self, *, first: bool = False) -> None:
        def on_answer(answer: Answer) -> None:
            if answer.refusal is None:
                self._judge(decode_message(NodeDescription, answer.payload), first)

        self._session.ask_later(node_key(self._name), None, on_answer, lambda: None, timeout_s=1.0)

    def _judge(self, other: NodeDescription, first: bool) -> None:
        newer = (self._started_ns, self._session.id) > (other.started_ns, other.session)
        if other.session not in self._known and (first or newer):
            self._known.add(other.session)
            self._log.warning(
                "There is another node %s, on %s with pid %s: give this one a name of its own "
                "(--name), or a namespace (--namespace)",
                self._full_name,
                other.host,
                other.pid,
            )
