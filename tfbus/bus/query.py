"""Queries: of other processes, their answers, and asking until an answer has come."""

from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, NamedTuple

import zenoh

from tfbus.base import scheduler
from tfbus.base.errors import BusError, TfbusError
from tfbus.base.executor import Executor
from tfbus.base.structs import Struct
from tfbus.base.wording import printable
from tfbus.bus import zenoh_library
from tfbus.bus.callbacks import Callbacks
from tfbus.bus.zenoh_library import bus_errors
from tfbus.wire.limits import DEFAULT_LIMITS, Limits, kind_of_query

# Zenoh's error in the place of an answer that has not come in time.
_NO_ANSWER_IN_TIME = b"Timeout"

# A refusal is one sentence: this much of it is read.
_MOST_OF_A_REFUSAL = 1000


# Called at the end of a question, on any thread.
OnEnd = Callable[[], object]


class Answer(NamedTuple):
    """An answer to a query: its key and payload, or a refusal with its text.

    `refusal` is "" if the answer has not come in time, None if it is no refusal. `sender` is
    the id of the session that answered, as Zenoh names it; "" if it does not.
    """

    key: str
    payload: bytes
    refusal: str | None = None
    sender: str = ""


def answer_of(reply: zenoh.Reply, key: str, callbacks: Callbacks) -> Answer:
    """The answer in a reply of Zenoh's to a query at `key`.

    A refusal, of which a terminal can show all, if the payload is larger than one that is read.
    """
    if reply.ok is not None:
        if mistake := callbacks.mistake_in_answer(key, size_of(reply.ok.payload)):
            return Answer(
                str(reply.ok.key_expr), b"", refusal=f"the answer was dropped unread: {mistake}"
            )
        sender = "" if reply.replier_id is None else str(reply.replier_id.zid)
        return Answer(str(reply.ok.key_expr), reply.ok.payload.to_bytes(), sender=sender)
    payload = reply.err.payload.to_bytes() if reply.err is not None else b""
    if payload == _NO_ANSWER_IN_TIME:
        payload = b""
    reason = payload[: 4 * _MOST_OF_A_REFUSAL].decode(errors="replace")
    return Answer("", b"", refusal=printable(reason, _MOST_OF_A_REFUSAL))


def size_of(payload: Any) -> int:
    """The size of a payload of Zenoh's in bytes, without reading it."""
    return len(payload)  # which Zenoh's stubs do not know


class Query:
    """A query of another process: give it any number of answers, then close it."""

    def __init__(self, query: zenoh.Query, limits: Limits = DEFAULT_LIMITS):
        self._query = query
        zenoh_library.holders.add(self, "_query")
        self._limits = limits
        self.key = str(query.key_expr)

    @property
    def payload(self) -> bytes:
        """The payload of the query; b"" for none."""
        return self._query.payload.to_bytes() if self._query.payload is not None else b""

    def check_size(self) -> None:
        """Raise BusError if it brings more than the limit of its kind; nothing of it is read."""
        if self._query.payload is not None:
            self._check(size_of(self._query.payload), "the query was dropped unread")

    def parameter(self, name: str) -> str | None:
        """The value of this name in the selector `key?name=value`; None if it has none."""
        return self._query.parameters.get(name)

    def answer(self, key: str, payload: bytes) -> None:
        """Send one answer, of the query's priority; `key` lies within its key expression.

        Raises BusError if it is larger than the asker takes.
        """
        self._check(len(payload), "the answer cannot be sent")
        with bus_errors(f"answer the query for {self.key}"):
            # An absolute key: this query came to the session without a namespace.
            self._query.reply(key.removeprefix("/"), payload)

    def _check(self, size: int, what: str) -> None:
        if mistake := self._limits.mistake_in(kind_of_query(self.key), size):
            raise BusError(f"{what}: {mistake}")

    def refuse(self, reason: str) -> None:
        """Answer that this cannot be done, and why; the asker gets the reason."""
        with bus_errors(f"refuse the query for {self.key}"):
            self._query.reply_err(reason.encode(errors="backslashreplace"))

    @contextmanager
    def answering(self, what: str) -> Iterator[None]:
        """Close the query at the end; an exception becomes a refusal, `what` failed and how."""
        try:
            yield
        except TfbusError as error:
            self.refuse(str(error))
        except Exception as error:
            self.refuse(f"{what} failed ({type(error).__name__}: {error})")
            raise
        finally:
            self.close()

    def close(self) -> None:
        """End the answers: the asker waits for no further ones."""
        if not zenoh_library.is_lost_by_fork():
            self._query.drop()


def within(key: str, expression: str) -> bool:
    """Whether the key lies within the key expression."""
    return zenoh.KeyExpr(expression).includes(zenoh.KeyExpr(key))


class Pauses(Struct):
    """The pauses between questions.

    `again_s` are the pauses in turn; with `forever` the last of them repeats, without it the
    questions end. A question that is open for longer than `lost_after_s` counts as unanswered, and
    the next pause begins; None waits for its end.
    """

    again_s: tuple[float, ...]
    forever: bool = False
    lost_after_s: float | None = None

    def after(self, turn: int) -> float | None:
        """The pause after the question of this turn, the first being 0; None: ask no further."""
        if turn < len(self.again_s):
            return self.again_s[turn]
        return self.again_s[-1] if self.forever else None


class AskUntil:
    """Asks until `is_settled()`, until `close()`, or until the pauses end.

    A question may be lost, come before the way to the publisher is open, or before it has anything
    to answer. So it is asked again after a pause, each time on the thread of an executor.

    A subclass says what is asked. All but the first question and `close()` run on the executor's
    thread, and `what` names them in the log.
    """

    def __init__(self, executor: Executor, what: str, pauses: Pauses) -> None:
        self._executor = executor
        self._what = what
        self._pauses = pauses
        self._lock = scheduler.Lock()
        self.is_over = False

    @abstractmethod
    def ask(self, turn: int, on_end: OnEnd) -> None:
        """Ask the question of a turn, the first being 0; `on_end` may be called on any thread."""

    @abstractmethod
    def is_settled(self) -> bool:
        """Whether to ask no further; called before each question and at the end of each, also of
        one that counted as lost.
        """

    def on_unanswered(self, turn: int) -> None:
        """A question has ended that settled nothing; called once for each."""

    def on_over(self) -> None:
        """All questions have ended; called once."""

    def start(self) -> None:
        """Ask the first question, on the calling thread."""
        self._take_turn(0)

    def close(self) -> None:
        """Ask no further. Twice is fine."""
        with self._lock:
            was_over, self.is_over = self.is_over, True
        if not was_over:
            self.on_over()

    def _take_turn(self, turn: int) -> None:
        if self._has_ended():
            return
        is_counted = False

        def end() -> None:
            nonlocal is_counted
            if not self._has_ended() and not is_counted:
                is_counted = True
                self._pause(turn)

        with suppress(BusError):  # the session is closed
            self.ask(turn, partial(self._executor.submit, self._what, end))
            if self._pauses.lost_after_s is not None:
                self._executor.after(self._pauses.lost_after_s, end)

    def _pause(self, turn: int) -> None:
        self.on_unanswered(turn)
        pause_s = self._pauses.after(turn)
        if pause_s is None:
            self.close()
        else:
            self._executor.after(pause_s, self._take_turn, turn + 1)

    def _has_ended(self) -> bool:
        if not self.is_over and self.is_settled():
            self.close()
        return self.is_over
