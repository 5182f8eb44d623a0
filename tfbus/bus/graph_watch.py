"""The one watch of the graph: the nodes that are there, and their descriptions as they change."""

import logging
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import islice

from tfbus.base import scheduler
from tfbus.base.clock import Timer
from tfbus.base.errors import BusError, DecodeError
from tfbus.base.executor import Executor
from tfbus.base.log import LogOnce
from tfbus.base.own_pauses import own_pauses
from tfbus.base.structs import replace
from tfbus.base.wording import printable
from tfbus.bus.presence import read_node
from tfbus.bus.query import Answer
from tfbus.bus.session import ENDS_LATE_S, Session
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import ALL_NODES, ALL_NODES_EVERYWHERE, changed_selector, full_name

# A node that was just started has its topics soon: questions follow its token after these times.
_PAUSES_S = (0.02, 0.2, 0.5)
# A new topic of a node is seen about that late. Only nodes that have changed answer, so that it
# costs less than to have all answer every few seconds.
_EVERY_S = 1.0
# An answer may be lost, and the counts of filters are in no other.
_ALL_EVERY_S = 10.0
_ANSWER_WITHIN_S = 0.8
# A node that was too busy to answer has changed for that much longer.
_MORE_S = 2.0

# However often nodes come and go.
_APART_S = 0.2

# At most as many nodes that have not answered are asked one by one.
_FEW = 8

# Names come from the bus: at most as many are known.
_MOST_NODES = 10_000


class GraphWatch:
    """Knows the nodes of other sessions in this namespace, or `everywhere` below it too, from their
    tokens and descriptions; closed by `close()`.

    `on_change(name, description)` is called for each node, for each change of its description, and
    with None as soon as it is gone, or seconds later after a pause of this process. A node's counts
    of its buffers, delays and failures, and which of its streams have no listener, are no change;
    of nodes that share a name the last started counts.
    `on_nodes(descriptions)` is called with all nodes after each question, at least every second,
    changed or not. Calls come one at a time, on a thread of its own.

    A description that cannot be read is logged, once. A node is not gone as long as its token is
    there, however late it answers.
    """

    def __init__(
        self,
        session: Session,
        log: logging.Logger,
        *,
        everywhere: bool = False,
        on_change: Callable[[str, NodeDescription | None], object] = lambda name, node: None,
        on_nodes: Callable[[list[NodeDescription]], object] = lambda nodes: None,
    ) -> None:
        self._session = session
        self._on_change = on_change
        self._on_nodes = on_nodes
        self._once = LogOnce(log)
        self._key = ALL_NODES_EVERYWHERE if everywhere else ALL_NODES
        # Tokens that came or were lost, by their keys: whether they are there, and whether they
        # have come since the last look.
        self._news: dict[str, tuple[bool, bool]] = {}
        self._lock = scheduler.Condition()
        # The keys of the tokens that are there, by the names of their nodes.
        self._living: dict[str, str] = {}
        # By name and session, also the nodes of this session.
        self._nodes: dict[str, dict[str, NodeDescription]] = {}
        # When the tokens came, by the names of their nodes, and after how many questions.
        self._began: dict[str, tuple[float, int]] = {}
        # Nodes whose tokens came though they were known: others may be behind the same names now.
        self._doubtful: dict[str, str] = {}
        self._told: dict[str, NodeDescription] = {}
        self._questions = 0
        self._asks = len(_PAUSES_S)
        self._asked_s = self._asked_all_s = -_ALL_EVERY_S
        self._next_ask: tuple[float, Timer] | None = None
        self._has_answers = False
        self._executor = Executor("nodes", log)
        self._pauses = own_pauses()
        self._pauses.watch(self._executor)
        # The nodes whose tokens were lost with the links of this process, perhaps.
        self._leaving: set[str] = set()
        self._executor.submit("nodes", self._ask_after, _EVERY_S)
        self._tokens = session.watch_living(self._key, self._on_token)

    def close(self) -> None:
        """Stop watching. Twice is fine."""
        self._tokens.close()
        self._executor.close()

    def nodes(self) -> list[NodeDescription]:
        """The descriptions of the nodes of other sessions, as they were known last."""
        with self._lock:
            return [each for name in self._nodes for each in self._others(name)]

    def silent(self) -> list[str]:
        """The full names of the nodes that are there and have not described themselves, sorted."""
        with self._lock:
            return sorted(self._living.keys() - self._nodes.keys())

    def wait(self, timeout_s: float) -> None:
        """Wait until all nodes that are there have described themselves, at most so long."""
        with self._lock:
            self._lock.wait_for(lambda: self._has_answers and not self._lacking(), timeout_s)

    def _lacking(self) -> list[str]:
        return [key for name, key in self._living.items() if name not in self._nodes]

    def _others(self, name: str) -> Iterator[NodeDescription]:
        """The nodes of this name in other sessions."""
        own = self._session.id
        return (each for session, each in self._nodes.get(name, {}).items() if session != own)

    # Tokens

    def _on_token(self, key: str, alive: bool) -> None:
        if key in self._news or len(self._news) < _MOST_NODES:
            has_come = alive or self._news.get(key, (False, False))[1]
            self._news[key] = alive, has_come
            self._executor.submit("tokens", self._take_tokens, limit=1)

    def _take_tokens(self) -> None:
        while self._news:
            key, (alive, has_come) = self._news.popitem()
            name = printable(full_name(key, self._session.settings.namespace))
            self._leaving.discard(name)
            if has_come and (name in self._began or len(self._began) < _MOST_NODES):
                self._began[name] = scheduler.monotonic(), self._questions
            if not alive and self._pauses.left_s():
                self._leaving.add(name)
                self._pauses.after(self._executor, 0.0, self._end_unless_back, name, key)
            elif not alive:
                self._end(name, key)
            elif len(self._living) < _MOST_NODES:
                self._begin(name, key)
            else:
                self._once.warning(
                    "nodes", "Left out node %r: there are more than %d", name, _MOST_NODES
                )

    def _begin(self, name: str, key: str) -> None:
        with self._lock:
            self._living[name] = key
            if name in self._nodes:
                self._doubtful[name] = key
        self._asks = 0
        # Nodes that come together are asked together.
        self._ask_after(max(_PAUSES_S[0], self._asked_s + _APART_S - scheduler.monotonic()))

    def _end_unless_back(self, name: str, key: str) -> None:
        if name in self._leaving:
            self._leaving.discard(name)
            self._end(name, key)

    def _end(self, name: str, key: str) -> None:
        with self._lock:
            self._living.pop(name, None)
            self._nodes.pop(name, None)
            self._doubtful.pop(name, None)
        began_s, _ = self._began.pop(name, (-ENDS_LATE_S, 0))
        self._tell(name)
        if scheduler.monotonic() < began_s + ENDS_LATE_S:
            self._check_end(name, key)

    def _check_end(self, name: str, key: str) -> None:
        """Ask whether a token that was reported gone is still there: the end of a process and the
        begin of the next come on two threads of Zenoh.
        """

        def on_end(living: list[str]) -> None:
            self._executor.submit("a token that was lost", take, key in living)

        def take(is_there: bool) -> None:
            # Any news of the token in the meantime is newer.
            if is_there and key not in self._news and name not in self._living:
                self._on_token(key, True)

        with suppress(BusError):  # the session is closed
            self._session.living_later(key, on_end)

    # Questions

    def _ask_after(self, delay_s: float) -> None:
        """Ask after this time, or earlier if that is due: one question waits at a time."""
        due_s = scheduler.monotonic() + delay_s
        if self._next_ask is not None:
            if self._next_ask[0] <= due_s:
                return
            self._next_ask[1].cancel()
        self._next_ask = due_s, self._executor.after(delay_s, self._ask)

    def _ask(self) -> None:
        """Ask, and wait for no answer here: a node that does not answer holds up no other."""
        self._next_ask = None
        if not self._living:
            self._end_question()
            return
        self._asks += 1
        self._questions += 1
        question = self._questions
        queries = self._keys(scheduler.monotonic())
        # Before a question to all that have a name: the nodes that may not answer any more.
        asks_all = queries == [self._key]
        known = {
            name: {*each}
            for name, each in self._nodes.items()
            if asks_all or self._doubtful.get(name) in queries
        }
        answered: dict[str, set[str]] = {}

        def on_answer(answer: Answer) -> None:
            self._executor.submit("answers", self._take_answer, answer, answered, question)

        def on_end() -> None:
            self._executor.submit("answers", end)

        def end() -> None:
            left.pop()
            if not left:
                self._forget(known, answered)
                self._end_question()

        left = [*queries]
        try:
            for key in queries:
                self._session.ask_later(key, None, on_answer, on_end, timeout_s=_ANSWER_WITHIN_S)
        except BusError:
            self._end_question()  # the session is closed

    def _end_question(self) -> None:
        self._ask_after(_PAUSES_S[self._asks] if self._asks < len(_PAUSES_S) else _EVERY_S)
        self._on_nodes(self.nodes())
        with self._lock:
            self._has_answers = True
            self._lock.notify_all()

    def _keys(self, now_s: float) -> list[str]:
        """The keys to query: all nodes, or changed nodes and nodes that have not answered."""
        lacking = [*self._lacking(), *self._doubtful.values()]
        has_many = self._asks < len(_PAUSES_S) and len(lacking) > _FEW
        since_s, self._asked_s = self._asked_s, now_s
        if has_many or now_s - self._asked_all_s >= _ALL_EVERY_S:
            self._asked_all_s = now_s
            return [self._key]
        return [changed_selector(self._key, now_s - since_s + _MORE_S), *islice(lacking, _FEW)]

    def _take_answer(self, answer: Answer, answered: dict[str, set[str]], question: int) -> None:
        try:
            node = None if answer.refusal is not None else read_node(self._session, answer)
        except DecodeError as error:
            self._once.warning(str(error), "%s", error)
            return
        # The token of one that is not living comes soon, or is lost already; and an answer to a
        # question of before the token may be the previous process's.
        if node is None or question <= self._began.get(node.name, (0.0, 0))[1]:
            return
        if node.name in self._living:
            with self._lock:
                self._nodes.setdefault(node.name, {})[node.session] = node
            answered.setdefault(node.name, set()).add(node.session)
            self._tell(node.name)

    def _forget(self, known: dict[str, set[str]], answered: dict[str, set[str]]) -> None:
        """Forget nodes that did not answer, if one of the same name did: no token tells of them."""
        for name in known.keys() & answered.keys():
            self._doubtful.pop(name, None)
            with self._lock:
                for session in known[name] - answered[name]:
                    self._nodes.get(name, {}).pop(session, None)
            self._tell(name)

    def _tell(self, name: str) -> None:
        """Call `on_change` if there is a change."""
        node = max(
            self._others(name), key=lambda each: (each.started_ns, each.session), default=None
        )
        former = self._told.get(name)
        if node is None:
            if self._told.pop(name, None) is not None:
                self._on_change(name, None)
        else:
            self._told[name] = node
            if former is None or _lasting(former) != _lasting(node):
                self._on_change(name, node)


def _lasting(node: NodeDescription) -> NodeDescription:
    return replace(node, unread=(), buffers=(), delays=(), failures=())
