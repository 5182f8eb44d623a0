"""Two nodes of one name: the second one warns."""

import logging
from contextlib import suppress

from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.errors import BusError, DecodeError
from tfbus.runtime.executor import Executor
from tfbus.runtime.log_once import LogOnce
from tfbus.runtime.timer import Timer
from tfbus.wire.codec import decode_message
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import node_key
from tfbus.wording import printable

# After a link to another process has opened, its declarations take a moment to arrive.
_CHECK_AFTER_S = 0.3


class DuplicateNameWatch:
    """Warns once of each other node of this node's name: requests may reach either of them.

    A node that is there when this one starts was first, whatever the clocks say. Of two nodes that
    meet later, when two networks join, the one that started later warns.
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
        self._once = LogOnce(log)
        self._known = {session.id}
        self._check: Timer = executor.after(_CHECK_AFTER_S, self._ask)
        session.watch_links(self._ask_soon)
        self._ask(at_start=True)

    def _ask_soon(self) -> None:
        if self._check.cancelled:
            self._check = self._executor.after(_CHECK_AFTER_S, self._ask)

    def _ask(self, *, at_start: bool = False) -> None:
        def on_answer(answer: Answer) -> None:
            if answer.refusal is not None:
                return
            try:
                other = decode_message(NodeDescription, answer.payload)
            except DecodeError as error:
                self._once.warning(
                    "answer",
                    "Ignored another description of node %s: %s",
                    self._full_name,
                    printable(str(error), 400),
                )
                return
            self._compare(other, at_start)

        key = node_key(self._name)
        with suppress(BusError):  # the session may be closed meanwhile, where the node is not
            self._session.ask_later(key, None, on_answer, lambda: None, timeout_s=1.0, others=True)

    def _compare(self, other: NodeDescription, at_start: bool) -> None:
        is_second = at_start or (self._started_ns, self._session.id) > (
            other.started_ns,
            other.session,
        )
        if other.session not in self._known and is_second:
            self._known.add(other.session)
            self._log.warning(
                "There is another node %s, on %s with pid %s: give this one another name "
                "(--name), or a namespace (--namespace)",
                self._full_name,
                other.host,
                other.pid,
            )
