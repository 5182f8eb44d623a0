"""Actions: work that takes a while, with feedback on the way, a result, and a way to cancel.

An action type is a class that holds three dataclasses, `Goal`, `Feedback` and `Result`. On the bus
each goal is one query: its answers are `{"accepted": id}`, any number of `{"feedback": {...}}`, and
at the end `{"status": "succeeded" | "canceled" | "aborted", "result": {...}}`. A query of
`<name>/cancel` with `{"id": id}` cancels a goal, with `{"id": ""}` all goals of the server.
"""

import os
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Literal, get_args

from tfbus.base import scheduler
from tfbus.base.arguments import check_callback, check_plain, is_async, seconds_to_wait
from tfbus.base.errors import BusError, DecodeError, ServiceError
from tfbus.bus.query import Answer, Query
from tfbus.bus.session import Session
from tfbus.node.endpoint import Lane, NodeEndpoint, check_part
from tfbus.node.service import Caller, Service, submit_or_refuse
from tfbus.wire.codec import (
    as_map,
    decode_map,
    decode_message,
    encode_map,
    encode_message,
    from_map,
)

# A class with the dataclasses Goal, Feedback and Result in it, which types cannot say.
GoalType = Any

GoalStatus = Literal["succeeded", "canceled", "aborted"]

# The client gives up on a goal after this time.
GOAL_TIMEOUT_S = 3600.0


@dataclass(frozen=True)
class GoalResult:
    """How a goal ended, and the Result of its server; `reason` says why if it was aborted."""

    status: GoalStatus
    result: Any
    reason: str = ""


class CancelGoal:
    """Cancels one goal by its id, or all goals of a server by an empty id."""

    @dataclass(frozen=True)
    class Request:
        """The goal's id; "" for all goals."""

        id: str = ""

    @dataclass(frozen=True)
    class Response:
        """How many goals it was."""

        canceled: int


class GoalHandle:
    """The server's end of a goal: call `succeed`, `cancel` or `abort` once, from any callback."""

    def __init__(self, server: "GoalServer", request: Any, query: Query):
        self.id = os.urandom(16).hex()
        self.request = request
        self.active = True
        self._server = server
        self._query = query
        self._on_cancel: Callable[[], object] = lambda: False
        self._is_accepted = False
        # Guards the query: one thread may answer while another one ends it.
        self._lock = scheduler.RLock()

    def on_cancel(self, callback: Callable[[], object]) -> None:
        """Call `callback()` when the client cancels; then stop, and end the goal by `cancel`. If
        it returns False, or without a callback, the goal goes on. It may be an `async def`.
        """
        check_callback("on_cancel(callback)", callback)
        self._on_cancel = callback

    def accept(self) -> None:
        """Tell the client that the goal is accepted, for a server whose handler `decides`."""
        with self._lock:
            if not self._is_accepted:
                self._is_accepted = True
                self._answer({"accepted": self.id})

    def feedback(self, message: Any) -> None:
        """Send the client a Feedback."""
        self._answer({"feedback": as_map(message)})

    def succeed(self, result: Any) -> None:
        """End it as done."""
        self._end("succeeded", result)

    def cancel(self, result: Any) -> None:
        """End it as cancelled, with how far it came."""
        self._end("canceled", result)

    def abort(self, result: Any, reason: str) -> None:
        """End it as not finished, with how far it came and why."""
        self._end("aborted", result, reason)

    def _end(self, status: GoalStatus, result: Any, reason: str = "") -> None:
        ending = {"status": status, "result": as_map(result)}
        with self._lock:
            if self.active:
                self._answer(ending | ({"reason": reason} if reason else {}))
                self._leave()

    def _refuse(self, reason: str) -> None:
        with self._lock:
            if self.active:
                with suppress(BusError):
                    self._query.refuse(reason)
                self._leave()

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        """An exception of its handler becomes a refusal."""
        try:
            yield
        except ServiceError as error:
            self._refuse(str(error))
        except Exception as error:
            self._refuse(f"the action failed ({type(error).__name__}: {error})")
            raise

    def _leave(self) -> None:
        self.active = False
        self._server._forget(self)
        self._query.close()

    def _answer(self, answer: dict[str, Any]) -> None:
        with self._lock:
            self.accept()
            # If the client is gone or has given up, the goal itself continues.
            if self.active:
                with suppress(BusError):
                    self._query.answer(self._server.name, encode_map(answer))


class GoalServer(NodeEndpoint):
    """Calls `handler(handle)` once for each goal, on the node's thread or its callback group's, as
    `on_cancel` of its goals.

    The handler raises ServiceError to refuse a goal. Otherwise it returns soon, and any callback
    of the node ends the handle later; or it is an `async def`, or in a ReentrantCallbackGroup, and
    ends the handle itself. A goal is accepted before, unless the handler `decides`: then by
    `handle.accept()`.
    """

    def __init__(
        self,
        session: Session,
        lane: Lane,
        goal_type: type[GoalType],
        name: str,
        handler: Callable[[GoalHandle], Any],
        *,
        decides: bool = False,
    ):
        super().__init__(name, goal_type)
        self.goal_type = goal_type
        self._lane = lane
        self._handler = handler
        self._decides = decides
        self._accept = self._accept_async if is_async(handler) else self._accept_now
        self._active: dict[str, GoalHandle] = {}
        self._parts = [
            session.queryable(name, self._on_query),
            Service(session, lane, CancelGoal, f"{name}/cancel", self._cancel),
        ]

    def _on_query(self, query: Query) -> None:
        submit_or_refuse(self._lane, f"action {self.name}", self._accept, query)

    def _accept_now(self, query: Query) -> None:
        if handle := self._handle(query):
            with handle._refusing():
                self._handler(handle)

    async def _accept_async(self, query: Query) -> None:
        if handle := self._handle(query):
            with handle._refusing():
                await self._handler(handle)

    def _handle(self, query: Query) -> GoalHandle | None:
        """The handle of an accepted goal; None if the goal cannot be read."""
        try:
            request = decode_message(self.goal_type.Goal, query.payload, unknown_fields=False)
        except DecodeError as error:
            query.refuse(str(error))
            query.close()
            return None
        handle = GoalHandle(self, request, query)
        self._active[handle.id] = handle
        if not self._decides:
            handle.accept()
        return handle

    def _forget(self, handle: GoalHandle) -> None:
        self._active.pop(handle.id, None)

    def _cancel(self, request: CancelGoal.Request) -> Any:
        handles = [h for h in [*self._active.values()] if request.id in ("", h.id)]
        answers = [handle._on_cancel() for handle in handles]
        if any(isinstance(answer, Coroutine) for answer in answers):
            return self._canceled(answers)
        return CancelGoal.Response(sum(answer is not False for answer in answers))

    async def _canceled(self, answers: list[Any]) -> CancelGoal.Response:
        ended = [await each if isinstance(each, Coroutine) else each for each in answers]
        return CancelGoal.Response(sum(answer is not False for answer in ended))


class SentGoal:
    """The client's end of a goal."""

    def __init__(
        self,
        session: Session,
        goal_type: type[GoalType],
        name: str,
        goal: Any,
        on_feedback: Callable[[Any], None],
        on_result: Callable[[GoalResult], None],
    ):
        self._session = session
        self._goal_type = goal_type
        self._name = name
        self._on_feedback = on_feedback
        self._on_result = on_result
        self._id = ""
        self._accepted = scheduler.Event()
        self._ended = scheduler.Event()
        self._outcome: GoalResult | ServiceError = ServiceError(f"no action {name!r}")
        session.ask_later(
            name, encode_message(goal), self._on_answer, self._on_end, timeout_s=GOAL_TIMEOUT_S
        )

    @property
    def id(self) -> str:
        """Its id at the server; "" before it is accepted."""
        return self._id

    def accepted(self, *, timeout_s: float | None = None) -> bool:
        """Wait until the server has accepted or refused it, at most `timeout_s` (None: for ever);
        whether it is accepted.
        """
        return self._accepted.wait(seconds_to_wait(timeout_s)) and self._id != ""

    def cancel(self, *, timeout_s: float = 1.0) -> bool:
        """Ask the server to cancel this goal; its result then has how far it came. Whether the
        server does.
        """
        if not self.accepted(timeout_s=timeout_s) or self._ended.is_set():
            return False
        request = encode_message(CancelGoal.Request(self._id))
        for answer in self._session.ask(f"{self._name}/cancel", request, timeout_s=timeout_s):
            if answer.refusal is None:
                return decode_message(CancelGoal.Response, answer.payload).canceled > 0
        return False

    @property
    def ended(self) -> bool:
        """Whether the goal has ended, or was refused."""
        return self._ended.is_set()

    def result(self, *, timeout_s: float | None = None) -> GoalResult:
        """Wait for the end of the goal, at most `timeout_s` (None: for ever); how it ended.

        Raises ServiceError if it was refused, its server is gone, or it does not end in time.
        """
        wait_s = seconds_to_wait(timeout_s)
        if not self._ended.wait(wait_s):
            raise ServiceError(f"timed out after {wait_s:g} s: action {self._name!r} has not ended")
        if isinstance(self._outcome, ServiceError):
            raise self._outcome
        return self._outcome

    def _on_answer(self, answer: Answer) -> None:
        if answer.refusal is not None:
            self._outcome = ServiceError(answer.refusal)
            return
        values = decode_map(answer.payload)
        if "accepted" in values:
            self._id = values["accepted"]
            self._outcome = ServiceError(f"the server of action {self._name!r} is gone")
            self._accepted.set()
        elif "feedback" in values:
            self._on_feedback(from_map(self._goal_type.Feedback, values["feedback"]))
        else:
            self._outcome = self._read_result(values)

    def _read_result(self, values: dict[str, Any]) -> GoalResult | ServiceError:
        status: Any = values.get("status")
        if status not in get_args(GoalStatus):
            return ServiceError(f"action {self._name!r} ended with an unknown status {status!r}")
        try:
            result = from_map(self._goal_type.Result, values.get("result", {}))
        except DecodeError as error:
            return ServiceError(f"action {self._name!r} ended with an unreadable result: {error}")
        return GoalResult(status, result, str(values.get("reason", "")))

    def _on_end(self) -> None:
        self._ended.set()
        self._accepted.set()
        if isinstance(self._outcome, GoalResult):
            self._on_result(self._outcome)


class GoalClient(Caller):
    """Sends goals of one type to their action server."""

    kind = "action"

    def __init__(self, session: Session, goal_type: type[GoalType], name: str):
        super().__init__(session, goal_type, name)
        self.goal_type = goal_type

    def wait_for_server(self, timeout_s: float | None = None) -> bool:
        """Wait for a server, at most `timeout_s` (None: for ever); whether there is one."""
        return self._wait(timeout_s)

    def send(
        self,
        goal: Any,
        *,
        on_feedback: Callable[[Any], None] = lambda feedback: None,
        on_result: Callable[[GoalResult], None] = lambda result: None,
        timeout_s: float | None = 5.0,
    ) -> SentGoal:
        """Send a Goal; the callbacks run on threads of Zenoh's.

        Waits for a server, at most `timeout_s` (None: for ever), but not for the goal. Raises
        TypeError if the goal is of another type, ServiceError if there is no server in that
        time.
        """
        check_part(f"action {self.name!r}", self.goal_type.Goal, goal)
        for callback in (on_feedback, on_result):
            check_plain("send(goal, on_feedback=..., on_result=...)", callback)
        self._require_server(seconds_to_wait(timeout_s))
        return SentGoal(self._session, self.goal_type, self.name, goal, on_feedback, on_result)
