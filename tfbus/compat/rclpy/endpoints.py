"""The topics, services and timers of a node, with ROS's methods."""

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future as Answer
from functools import partial
from typing import Any

from tfbus.base.callbacks import CallbackGroup
from tfbus.base.clock import Clock, timer_name
from tfbus.base.clock import Timer as TfbusTimer
from tfbus.base.errors import ServiceError
from tfbus.compat.bus_types import BusType, TransformsPublisher
from tfbus.compat.rclpy.task import Future, Work
from tfbus.compat.rclpy.type_support import TakesTypes
from tfbus.node.endpoint import NodeEndpoint
from tfbus.node.node import Node as TfbusNode
from tfbus.node.service import Client as TfbusClient
from tfbus.node.topic import Publisher as TfbusPublisher

# How often a call that waits for its service looks whether the client is still open.
_LOOKS_EVERY_S = 0.5


class Publisher(TakesTypes):
    """Publishes messages of one type on a topic."""

    def __init__(
        self,
        endpoint: "TfbusPublisher[Any] | TransformsPublisher",
        on_bus: BusType,
        message_type: type,
    ) -> None:
        self.endpoint: NodeEndpoint = endpoint
        self.topic_name = endpoint.name
        self._publisher = endpoint
        self._on_bus = on_bus
        self._type = message_type

    def publish(self, msg: Any) -> None:
        """Send a message. Raises TypeError for a message of another type."""
        if not isinstance(msg, self._type):
            raise TypeError(
                f"topic {self.topic_name!r} carries {self._type.__name__}, not {type(msg).__name__}"
            )
        self._publisher.publish(self._on_bus.to_bus(msg))

    def destroy(self) -> None:
        """End it."""
        self.endpoint.close()


class Subscription(TakesTypes):
    """Keeps the last messages of a topic, `depth` of them, until the node is spun."""

    def __init__(
        self,
        work: Work,
        on_bus: BusType,
        callback: Callable[[Any], Any],
        depth: int,
        group: CallbackGroup | None = None,
        topic: str = "",
    ) -> None:
        self.endpoint: NodeEndpoint | None = None
        self.callback = callback
        self.callback_group = group
        self._work = work
        self._what = f"topic {topic}"
        self._on_bus = on_bus
        # Each message in it has its call of `_deliver`: both change together, also where
        # a signal handler ends it.
        self._lock = threading.RLock()
        self._messages: deque[Any] = deque(maxlen=depth)

    def receive(self, message: Any) -> None:
        """Take a message of the bus; the oldest gives way if there are too many."""
        received = self._on_bus.from_bus(message)
        with self._lock:
            is_full = len(self._messages) == self._messages.maxlen
            self._messages.append(received)
        if not is_full:
            self._work.submit(self._deliver, self.callback_group, self._what)
        elif self._messages.maxlen != 1:  # otherwise only the newest is wanted
            self._work.dropped(self._what, len(self._messages))

    def destroy(self) -> None:
        """End it, also for messages that wait."""
        if self.endpoint is not None:
            self.endpoint.close()
        with self._lock:
            self._messages.clear()

    def _deliver(self) -> Any:
        with self._lock:
            if not self._messages:
                return None
            message = self._messages.popleft()
        return self.callback(message)


class Timer:
    """Calls back every `period_s` seconds of a clock, while the node is spun."""

    def __init__(
        self,
        node: TfbusNode,
        work: Work,
        period_s: float,
        callback: Callable[[], Any],
        group: CallbackGroup | None = None,
        *,
        clock: Clock,
    ) -> None:
        self.callback = callback
        self.callback_group = group
        self._node = node
        self._clock = clock
        self._work = work
        self._period_s = period_s
        self._is_pending = False
        self._due_s = 0.0
        self._what = timer_name(period_s, callback)
        self._timer = self._start()

    @property
    def timer_period_ns(self) -> int:
        """The period, in nanoseconds."""
        return self._timer.period_ns

    def cancel(self) -> None:
        """Call back no longer; `reset` begins again."""
        self._timer.cancel()

    def is_canceled(self) -> bool:
        """Whether it was cancelled."""
        return self._timer.cancelled

    def reset(self) -> None:
        """Begin a new period now."""
        self._timer.cancel()
        self._timer = self._start()

    def destroy(self) -> None:
        """End it."""
        self._timer.cancel()

    def _start(self) -> TfbusTimer:
        return self._node.create_timer(self._period_s, self._tick, clock=self._clock)

    def _tick(self) -> None:
        # One call waits at most: ticks that a long callback held up are not made up for.
        if not self._is_pending:
            self._is_pending = True
            self._due_s = time.monotonic()
            self._work.submit(self._run, self.callback_group, self._what)

    def _run(self) -> Any:
        late_periods = int((time.monotonic() - self._due_s) / self._period_s)
        if late_periods and not self._clock.is_simulated:
            self._work.late(self._what, self._due_s, late_periods)
        self._is_pending = False
        return None if self._timer.cancelled else self.callback()


class Rate:
    """Sleeps until the next period of a clock."""

    def __init__(self, node: TfbusNode, period_s: float, clock: Clock) -> None:
        self._node = node
        self._clock = clock
        self._period_ns = round(period_s * 1e9)
        self._next_ns = clock.elapsed_ns() + self._period_ns

    def sleep(self) -> None:
        """Sleep; returns early if the node is shut down."""
        now_ns = self._clock.elapsed_ns()
        if self._next_ns > now_ns:
            self._node.wait((self._next_ns - now_ns) / 1e9, clock=self._clock)
        self._next_ns = max(self._next_ns, now_ns) + self._period_ns


class Service(TakesTypes):
    """Answers requests by `callback(request, response)`, while the node is spun."""

    def __init__(
        self,
        work: Work,
        type_: Any,
        callback: Callable[[Any, Any], Any],
        group: CallbackGroup | None = None,
        name: str = "",
    ) -> None:
        self.endpoint: NodeEndpoint | None = None
        self.callback = callback
        self.callback_group = group
        self._work = work
        self._type = type_
        self._what = f"service {name}"

    async def handle(self, request: Any) -> Any:
        """The response, from a thread that spins the node."""
        ask = partial(self._respond, request)
        answer = ask_while_spun(self._work, ask, self.callback_group, self._what)
        return await asyncio.wrap_future(answer)

    def destroy(self) -> None:
        """End it."""
        if self.endpoint is not None:
            self.endpoint.close()

    def _respond(self, request: Any) -> Any:
        return self.callback(request, self._type.Response())


def ask_while_spun(
    work: Work, ask: Callable[[], Any], group: Any = None, what: str = ""
) -> "Answer[Any]":
    """A future of the value of `ask()` in a thread that spins the node, of a coroutine its result;
    its exception is a ServiceError.
    """
    answer: Answer[Any] = Answer()
    answer.set_running_or_notify_cancel()

    async def run() -> None:
        try:
            found = ask()
            answer.set_result(await found if hasattr(found, "send") else found)
        except BaseException as error:
            answer.set_exception(ServiceError(f"{type(error).__name__}: {error}"))
            raise

    work.submit(run, group, what)
    return answer


class Client(TakesTypes):
    """Calls a service of another node."""

    def __init__(self, client: TfbusClient, work: Work) -> None:
        self.endpoint: NodeEndpoint = client
        self.srv_name = client.name
        self._client = client
        self._work = work
        # Both change together; a signal handler may call, too.
        self._lock = threading.RLock()
        self._calls: deque[tuple[Any, Future]] = deque()
        self._is_calling = False

    def service_is_ready(self) -> bool:
        """Whether it has a server now."""
        return self._client.served

    def wait_for_service(self, timeout_sec: float | None = None) -> bool:
        """Wait for a server; whether there is one."""
        return self._client.wait_for_service(timeout_sec)

    def call(self, request: Any, timeout_sec: float | None = None) -> Any:
        """The response; waits for it, also in a callback. Raises ServiceError."""
        return self._client.call(request, timeout_s=timeout_sec)

    def call_async(self, request: Any) -> Future:
        """A future of the response; its exception is a ServiceError if the service refuses.

        Calls of one client go one after the other, once there is a server.
        """
        future = Future(run=self._work.submit)
        with self._lock:
            self._calls.append((request, future))
            if not self._is_calling:
                name = f"calls of {self.srv_name}"
                threading.Thread(target=self._call_all, name=name, daemon=True).start()
                self._is_calling = True
        return future

    def destroy(self) -> None:
        """End it."""
        self.endpoint.close()

    def _call_all(self) -> None:
        while (call := self._next_call()) is not None:
            request, future = call
            try:
                self._wait_while_open()
                if not future.done():
                    future.set_result(self._client.call(request, timeout_s=None))
            except Exception as error:
                future.set_exception(error)

    def _next_call(self) -> tuple[Any, Future] | None:
        with self._lock:
            self._is_calling = bool(self._calls)
            return self._calls.popleft() if self._calls else None

    def _wait_while_open(self) -> None:
        while not self._client.wait_for_service(_LOOKS_EVERY_S):
            if self._client.closed:
                raise ServiceError(f"the client of {self.srv_name!r} is closed")
