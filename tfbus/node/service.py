"""Services: a request, and one response or a refusal with its reason.

A service type is a class that holds two dataclasses, `Request` and `Response`.
"""

import math
from collections.abc import Callable, Coroutine
from contextlib import ExitStack, suppress
from typing import Any

from tfbus.base import scheduler
from tfbus.base.arguments import seconds_to_wait
from tfbus.base.errors import BusError, ServiceError
from tfbus.bus.query import Answer, Query
from tfbus.bus.session import Session
from tfbus.bus.zenoh_library import new_cancellation
from tfbus.node.endpoint import Lane, NodeEndpoint, check_part
from tfbus.wire.codec import decode_message, encode_message

# A class with the dataclasses Request and Response in it, which types cannot say.
ServiceType = Any

# A busy node lets at most this many requests of a kind wait, and refuses further ones.
PENDING_REQUESTS = 100


def submit_or_refuse(lane: Lane, what: str, serve: Callable[[Query], Any], query: Query) -> None:
    """Serve the query in its lane, or refuse it if 100 of its kind wait already."""
    if not lane.submit(what, serve, query, limit=PENDING_REQUESTS):
        query.refuse(f"busy: {PENDING_REQUESTS} requests are already waiting")
        query.close()


class Service(NodeEndpoint):
    """Answers requests by calling `handler(request)` on the node's thread, or its callback group's.

    The handler returns a Response, or raises ServiceError to refuse: the caller gets its text. It
    may be an `async def`.
    """

    def __init__(
        self,
        session: Session,
        lane: Lane,
        service_type: type[ServiceType],
        name: str,
        handler: Callable[[Any], Any],
    ):
        super().__init__(name, service_type)
        self.service_type = service_type
        self._lane = lane
        self._handler = handler
        self._parts = [session.queryable(name, self._on_query)]

    def _on_query(self, query: Query) -> None:
        submit_or_refuse(self._lane, f"service {self.name}", self._serve, query)

    def _serve(self, query: Query) -> Any:
        """Answer it; a coroutine that does, if the handler returns one."""
        with ExitStack() as ending:
            ending.enter_context(query.answering("the service"))
            response = self._handler(self._request(query))
            if isinstance(response, Coroutine):
                return self._answer_later(query, response, ending.pop_all())
            query.answer(self.name, encode_message(response))

    async def _answer_later(self, query: Query, response: Any, ending: ExitStack) -> None:
        import asyncio  # slow, and it runs already

        with ending:
            try:
                query.answer(self.name, encode_message(await response))
            except asyncio.CancelledError:
                raise ServiceError("the node ends") from None

    def _request(self, query: Query) -> Any:
        return decode_message(self.service_type.Request, query.payload, unknown_fields=False)


class Caller(NodeEndpoint):
    """The client's end of a service or action; knows at any time whether it has a server."""

    kind = "service"

    def __init__(self, session: Session, type_: type, name: str):
        super().__init__(name, type_)
        self._session = session
        self._watch = session.watch_served(name)
        self._parts = [self._watch]

    @property
    def served(self) -> bool:
        """Whether it has a server now."""
        return self._watch.served

    def _wait(self, timeout_s: float | None) -> bool:
        return self._watch.wait(seconds_to_wait(timeout_s))

    def _require_server(self, timeout_s: float | None) -> None:
        self._check_open()
        if not self._wait(timeout_s) and timeout_s is not None:
            raise self._no_server(timeout_s)

    def _check_open(self) -> None:
        if self.closed:
            raise BusError(f"the client of {self.kind} {self.name!r} is closed")

    def _no_server(self, wait_s: float | None) -> ServiceError:
        return ServiceError(f"no {self.kind} {self.name!r} after {wait_s:g} s")


class Client(Caller):
    """Calls a service of another node.

    A callback may call it, and waits for the answer. If the service is one of the same node, the
    two are to be in different callback groups: callbacks of one group run one at a time.
    """

    def __init__(self, session: Session, service_type: type[ServiceType], name: str):
        super().__init__(session, service_type, name)
        self.service_type = service_type

    def wait_for_service(self, timeout_s: float | None = None) -> bool:
        """Wait for a server, at most `timeout_s` (None: for ever); whether there is one."""
        return self._wait(timeout_s)

    def call(self, request: Any, *, timeout_s: float | None = 5.0) -> Any:
        """Send a Request and return the Response.

        Waits for the service and its answer, together at most `timeout_s` (None: for ever). Raises
        TypeError for a request of another type, ServiceError if there is no service or answer in
        that time, or it refuses.
        """
        check_part(f"service {self.name!r}", self.service_type.Request, request)
        wait_s = seconds_to_wait(timeout_s)
        deadline = math.inf if wait_s is None else scheduler.monotonic() + wait_s
        self._require_server(wait_s)
        remaining_s = max(deadline - scheduler.monotonic(), 0.001)
        payload = encode_message(request)
        for answer in self._session.ask(self.name, payload, timeout_s=remaining_s):
            return self._response(answer)
        raise self._no_answer(wait_s)

    async def call_async(self, request: Any, *, timeout_s: float | None = 5.0) -> Any:
        """As `call`, for asyncio and callbacks that are an `async def`; cancel it like any task."""
        import asyncio  # slow, and it runs already

        check_part(f"service {self.name!r}", self.service_type.Request, request)
        self._check_open()
        payload = encode_message(request)
        wait_s = seconds_to_wait(timeout_s)
        loop = asyncio.get_running_loop()
        served, answers = asyncio.Event(), asyncio.Queue[Answer | None]()
        cancellation = new_cancellation()

        def in_loop(function: Callable[..., object], *given: object) -> None:
            with suppress(RuntimeError):  # the loop is closed: nothing waits
                loop.call_soon_threadsafe(function, *given)

        try:
            async with asyncio.timeout(wait_s):
                with self._watch.waking(lambda: in_loop(served.set)):
                    await served.wait()
                self._session.ask_later(
                    self.name,
                    payload,
                    lambda answer: in_loop(answers.put_nowait, answer),
                    lambda: in_loop(answers.put_nowait, None),
                    timeout_s=math.inf if wait_s is None else wait_s,
                    cancellation=cancellation,
                )
                answer = await answers.get()
        except TimeoutError:
            raise (self._no_answer if served.is_set() else self._no_server)(wait_s) from None
        except asyncio.CancelledError:
            cancellation.cancel()
            raise
        if answer is None:
            raise self._no_answer(wait_s)
        return self._response(answer)

    def _response(self, answer: Answer) -> Any:
        if answer.refusal is not None:
            raise ServiceError(answer.refusal or f"{self.name!r} did not answer in time")
        return decode_message(self.service_type.Response, answer.payload)

    def _no_answer(self, wait_s: float | None) -> ServiceError:
        within = "" if wait_s is None else f" within {wait_s:g} s"
        return ServiceError(f"{self.name!r} did not answer{within}")
