"""A node: one process's name on the bus, and all that it says and hears there."""

import math
import os
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar

from tfbus.broadcast.stream import Stream
from tfbus.bus.query import Query
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.errors import ParameterError, TfbusError
from tfbus.node.action import GoalClient, GoalHandle, GoalServer, GoalType
from tfbus.node.duplicate_name import NamesakeWatch
from tfbus.node.endpoint import Interface
from tfbus.node.parameters import Bounds, Parameter, Parameters, Value
from tfbus.node.service import Client, Service, ServiceType
from tfbus.node.topic import Publisher, RawPublisher, RawSubscription, Subscription
from tfbus.runtime.clock import SYSTEM_CLOCK, Clock, SimulatedClock
from tfbus.runtime.executor import Executor, Timer
from tfbus.runtime.log import open_log
from tfbus.runtime.signals import StopSignals, Wakeup
from tfbus.runtime.version import installed_version
from tfbus.wire.codec import encode_map
from tfbus.wire.keys import check_topic, clock_key, node_key

if TYPE_CHECKING:
    # With the messages it takes long to load, and most nodes have no use for it.
    from tfbus.node.clock_topic import ClockPublisher

# A clock that is there tells a new node the time within this, and nothing is said of it.
_CLOCK_WITHIN_S = 1.0

M = TypeVar("M")
Kept = TypeVar("Kept", bound=Interface)


class Node:
    """A named member of the bus, from its construction until `close()` or the end of its `with`.

    All callbacks of a node (topics, services, goals, timers, parameters) run one at a time on a
    thread of its own: they need no locks among them, there is nothing to spin, and one of them
    may wait for a lookup or a service without stopping the others' messages from arriving.

    Ctrl-C and SIGTERM end `spin()` and `wait()`; elsewhere in the main thread they raise
    KeyboardInterrupt, which the node's `with` ends quietly.

    Its time is that of `clock`: the system's, or with `sim_time` in its settings what the topic
    `clock` says; then timers, `wait` and the timeouts of lookups count simulated seconds.

    `settings` says how to join the bus; without it, `name`, `namespace`, `parameters` and the
    environment do (see NodeSettings). A client's router may come later: it is waited for, at most
    `patience_s` seconds. Raises BusError where the bus cannot be joined.
    """

    def __init__(
        self,
        name: str = "",
        *,
        namespace: str | None = None,
        parameters: Mapping[str, Any] | None = None,
        settings: NodeSettings | None = None,
        patience_s: float = math.inf,
    ):
        if settings is None:
            given: dict[str, Any] = {"namespace": namespace, "parameters": parameters}
            settings = NodeSettings(
                name, **{key: value for key, value in given.items() if value is not None}
            )
        self.settings = settings
        self.name = settings.name
        self.namespace = settings.namespace
        self.full_name = "/" + "/".join(filter(None, (self.namespace, self.name)))
        self.log = open_log(self.full_name, self.name, settings.log_level)
        self.started_ns = time.time_ns()
        self.clock: Clock = SimulatedClock() if settings.sim_time else SYSTEM_CLOCK
        self._closed = False
        self._lock = threading.Lock()
        self._is_ready = False
        self._expects_clock = False
        self._parameters_are_typed_in = False
        self._streams: dict[str, Stream] = {}
        self._buffers: list[Callable[[], dict[str, Any]]] = []
        self._interfaces: dict[str, list[Interface]] = {
            kind: [] for kind in ("publishes", "subscribes", "serves", "calls")
        }
        self._signals = StopSignals()
        try:
            self.session = Session(settings, self.log, patience_s=patience_s)
        except BaseException:
            self._signals.uninstall()
            raise
        with self._signals.held():
            self._declare_itself()
        if not self.ok:
            self.close()
            raise KeyboardInterrupt

    def _declare_itself(self) -> None:
        settings = self.settings
        self._executor = Executor(self.full_name, self.log)
        self._parameters = Parameters(
            self.name, settings.parameters, self.session, self._executor, self.log
        )
        self.session.queryable(node_key(self.name), self._on_info_query)
        self.session.queryable(clock_key(self.name), self._on_clock_query)
        if isinstance(self.clock, SimulatedClock):
            from tfbus.node.clock_topic import TOPIC, ClockSubscription

            topic = self._resolve(TOPIC)
            self._keep("subscribes", ClockSubscription(self.session, self.log, topic, self.clock))
        self._token = self.session.token(node_key(self.name))
        self._namesakes = NamesakeWatch(
            self.name, self.full_name, self.started_ns, self.session, self._executor, self.log
        )

    @classmethod
    def from_settings(cls, settings: NodeSettings) -> "Node":
        """The node that the settings describe."""
        return cls(settings=settings)

    @classmethod
    def from_args(cls, name: str, argv: Sequence[str] | None = None) -> "Node":
        """The node that a command line describes, by the options that every process takes.

        `name` is its name where the command line has no `--name`; `argv` is `sys.argv[1:]`
        where it is None. A mistake in it is told on stderr and exits with 2; a bus that cannot
        be joined, or a parameter that cannot have the value given, exits with 1.
        """
        from tfbus.command.options import settings_from_args

        try:
            node = cls(settings=settings_from_args(name, argv))
        except TfbusError as error:
            raise SystemExit(f"Error: {error}") from error
        except KeyboardInterrupt:
            raise SystemExit(0) from None
        node._parameters_are_typed_in = True
        return node

    def __enter__(self) -> "Node":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> bool:
        stopped_by_signal = kind is KeyboardInterrupt and not self.ok
        if stopped_by_signal:
            # An import defines dataclasses by exec(). Where the signal came in the middle of one,
            # Python would end by SIGINT, though this is its end: the next exec() makes it forget.
            exec("")
        self.close()
        if self._parameters_are_typed_in and isinstance(error, ParameterError):
            raise SystemExit(f"Error: {error}") from None
        return stopped_by_signal

    # How long it lives

    @property
    def ok(self) -> bool:
        """Whether the node goes on: False after Ctrl-C, SIGTERM, `shutdown()` or `close()`."""
        return not self._signals.stopped

    def shutdown(self) -> None:
        """Make `spin()` and `wait()` return; from any thread, twice is fine."""
        self._signals.stop()

    def ready(self, text: str = "ready") -> None:
        """Say in one line of the log that the node works now; only the first call does."""
        if not self._is_ready:
            self._is_ready = True
            for name in self._parameters.unknown():
                known = ", ".join(parameter.name for parameter in self._parameters) or "none"
                self.log.warning(
                    "Parameter %r was given, but this node has none of that name; it has: %s",
                    name,
                    known,
                )
            self.log.info("%s", text)
            self._expect_clock()

    def spin(self) -> None:
        """Say that the node is ready and wait until it is shut down."""
        with self._signals.held():  # a signal between the two ends it as one that comes later
            self.ready()
            self.wait(None)

    def wait(self, timeout_s: float | None, *, clock: Clock | None = None) -> bool:
        """Wait for `timeout_s` seconds (None: for ever), less where the node is shut down.

        Returns whether the node goes on, so that `while node.wait(1.0):` is a loop at 1 Hz. The
        seconds are those of the node's clock, unless another is given.
        """
        clock = clock or self.clock
        if timeout_s is None or not clock.is_simulated:
            return not self._signals.wait(timeout_s)
        with Wakeup() as wakeup, clock.limit(timeout_s, wakeup.wake) as limit:
            if not limit.passed:
                self._signals.wait(None, wakeup)
            return self.ok

    def close(self) -> None:
        """Leave the bus; everything that was created from the node ends. Twice is fine."""
        if not self._closed:
            self._closed = True
            self.shutdown()
            with self._signals.held():
                self.clock.close()
                self._executor.close()
                self.session.close()
            self._signals.uninstall()

    def now_ns(self) -> int:
        """The time now, in nanoseconds since the Unix epoch.

        With simulated time it is 0 until the first message on the topic `clock` has come.
        """
        return self.clock.now_ns()

    def wait_for_clock(self, timeout_s: float | None = None) -> bool:
        """Whether it is known what time it is, waited for at most `timeout_s` (None: for ever).

        These seconds are real ones. The system's time is always known. False also where the
        node is shut down before.
        """
        if not self.clock.is_running:
            self._expect_clock()
            with Wakeup() as wakeup:
                self.clock.call_when_running(wakeup.wake)
                self._signals.wait(timeout_s, wakeup)
        return self.clock.is_running

    def _expect_clock(self) -> None:
        """Say once that nobody tells the time, where that is so for a while."""
        if not self.clock.is_running and not self._expects_clock:
            self._expects_clock = True
            self._executor.after(_CLOCK_WITHIN_S, self._miss_clock)

    def _miss_clock(self) -> None:
        if not self.clock.is_running:
            from tfbus.node.clock_topic import TOPIC

            topic = self._resolve(TOPIC)
            self.log.info("Waiting for the clock: nobody tells the time on topic %r yet", topic)
            self.clock.call_when_running(self._greet_clock)

    def _greet_clock(self) -> None:
        if self.clock.is_running:  # and has not just been closed
            self.log.info("The clock runs")

    # What it says and hears

    def create_publisher(self, message_type: type[M], topic: str) -> Publisher[M]:
        """A publisher of messages of this type, a dataclass."""
        topic = self._resolve(topic)
        return self._keep("publishes", Publisher(self.session, message_type, topic))

    def create_subscription(
        self, message_type: type[M], topic: str, callback: Callable[[M], Any]
    ) -> Subscription[M]:
        """Call `callback(message)` for each message on the topic."""
        topic = self._resolve(topic)
        return self._keep(
            "subscribes",
            Subscription(self.session, self._executor, self.log, message_type, topic, callback),
        )

    def create_raw_publisher(self, topic: str, *, type_name: str = "") -> RawPublisher:
        """A publisher of messages that are bytes already, of a type known by its name only."""
        topic = self._resolve(topic)
        return self._keep("publishes", RawPublisher(self.session, topic, type_name))

    def create_raw_subscription(
        self, topic: str, callback: Callable[[bytes], None], *, type_name: str = ""
    ) -> RawSubscription:
        """Call `callback(payload)` with the bytes of each message, whatever its type.

        It is called on a thread of Zenoh's, before the next message is taken: be quick there.
        """
        topic = self._resolve(topic)
        return self._keep("subscribes", RawSubscription(self.session, topic, callback, type_name))

    def create_service(
        self, service_type: type[ServiceType], name: str, handler: Callable[[Any], Any]
    ) -> Service:
        """Serve requests: `handler(request)` returns a Response or raises ServiceError."""
        name = self._resolve(name)
        return self._keep(
            "serves", Service(self.session, self._executor, self.log, service_type, name, handler)
        )

    def create_client(self, service_type: type[ServiceType], name: str) -> Client:
        """A client that calls a service."""
        name = self._resolve(name)
        return self._keep("calls", Client(self.session, service_type, name))

    def create_goal_server(
        self, goal_type: type[GoalType], name: str, handler: Callable[[GoalHandle], None]
    ) -> GoalServer:
        """Take goals: `handler(handle)` is called once for each and ends the handle later."""
        name = self._resolve(name)
        return self._keep(
            "serves", GoalServer(self.session, self._executor, self.log, goal_type, name, handler)
        )

    def create_goal_client(self, goal_type: type[GoalType], name: str) -> GoalClient:
        """A client that sends goals."""
        name = self._resolve(name)
        return self._keep("calls", GoalClient(self.session, goal_type, name))

    def create_timer(
        self, period_s: float, callback: Callable[[], Any], *, clock: Clock | None = None
    ) -> Timer:
        """Call `callback()` every `period_s` seconds, the first time after one period.

        The seconds are those of the node's clock, unless another is given.
        """
        clock = clock or self.clock
        if isinstance(clock, SimulatedClock):
            return self._executor.every_simulated(clock, period_s, callback)
        return self._executor.every(period_s, callback)

    def create_clock_publisher(self) -> "ClockPublisher":
        """A publisher of the simulated time; it is told to all namespaces within the node's."""
        from tfbus.node.clock_topic import TOPIC, ClockPublisher

        topic = self._resolve(TOPIC)
        return self._keep("publishes", ClockPublisher(self.session, self._executor, topic))

    def declare_parameter(
        self,
        name: str,
        default: Value,
        *,
        description: str = "",
        minimum: float | None = None,
        maximum: float | None = None,
        on_change: Callable[[Any], object] = lambda value: None,
    ) -> Parameter:
        """A parameter of the type of its default; `.value` is what it is now.

        `on_change(value)` is called before a value that came over the bus is taken, and may
        raise ParameterError to refuse it. Raises ParameterError where the value that the node
        was started with is impossible.
        """
        bounds = Bounds(minimum, maximum)
        return self._parameters.declare(Parameter(name, default, description, bounds, on_change))

    def stream(self, name: str | None = None) -> Stream:
        """The stream of this name that the node publishes; the node's own where it is None."""
        name = name or self.name
        with self._lock:
            if name not in self._streams:
                self._streams[name] = Stream(
                    name, self.full_name, self.started_ns, self.session, self._executor, self.log
                )
            return self._streams[name]

    # What it tells about itself

    def tell_of_buffer(self, describe: Callable[[], dict[str, Any]]) -> None:
        """Tell of a buffer that is filled, in the fields of a BufferDescription."""
        self._buffers.append(describe)

    def forget_buffer(self, describe: Callable[[], dict[str, Any]]) -> None:
        """Tell of a buffer no more."""
        self._buffers.remove(describe)

    def describe(self) -> dict[str, Any]:
        """What the node tells those who ask for it: who, where, and its interfaces."""
        return {
            "name": self.full_name,
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "version": installed_version(),
            "session": self.session.id,
            "started_ns": self.started_ns,
            "streams": sorted(self._streams),
            "unread": sorted(name for name, stream in self._streams.items() if stream.unread),
            "buffers": [describe() for describe in self._buffers],
            "parameters": [parameter.describe() for parameter in self._parameters],
            **{
                kind: {each.name: each.type_name for each in interfaces if not each.closed}
                for kind, interfaces in self._interfaces.items()
            },
        }

    def _keep(self, kind: str, interface: Kept) -> Kept:
        """Remember the interface for `describe`, and forget those that have been closed."""
        with self._lock:
            living = [each for each in self._interfaces[kind] if not each.closed]
            self._interfaces[kind] = [*living, interface]
        return interface

    def _resolve(self, name: str) -> str:
        return self.settings.remappings.get(name, check_topic(name))

    def _on_clock_query(self, query: Query) -> None:
        received_ns = time.time_ns()
        times = {"received": received_ns, "now": time.time_ns()}
        query.answer(clock_key(self.name), encode_map(times))
        query.close()

    def _on_info_query(self, query: Query) -> None:
        query.answer(node_key(self.name), encode_map(self.describe()))
        query.close()
