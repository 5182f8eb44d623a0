"""A node: one process's name on the bus, and all that it publishes, subscribes to and serves."""

import atexit
import math
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar

from tfbus.base import scheduler
from tfbus.base.arguments import called_as, check_callback, check_plain, seconds_to_wait
from tfbus.base.callbacks import CallbackGroup
from tfbus.base.clock import SYSTEM_CLOCK, Clock, SimulatedClock, Timer
from tfbus.base.errors import BusError, ParameterError, SettingsError, TfbusError
from tfbus.base.lazy_exports import imported
from tfbus.base.log import open_log
from tfbus.base.signals import StopSignals, Wakeup, forget_interrupt
from tfbus.bus import zenoh_library
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.node.endpoint import (
    CALLBACK_THREADS,
    Lane,
    Lanes,
    check_message_type,
    check_parts,
    check_seconds,
)
from tfbus.node.parameters import Bounds, Parameter, Parameters, Value
from tfbus.node.service import Client, Service, ServiceType
from tfbus.node.surroundings import (
    Describer,
    DuplicateNameWatch,
    NodeInfo,
    OpenFilesWatch,
    check_id_is_free,
    watch_endpoints,
    watch_members,
    watch_router,
)
from tfbus.node.topic import Publisher, RawPublisher, RawSubscription, Subscription
from tfbus.wire.keys import CLOCK_TOPIC, check_no_transforms, node_key, resolve

if TYPE_CHECKING:
    # They take long to load, and most nodes do not need them.
    from tfbus.buffer.buffer import Buffer
    from tfbus.node.action import GoalClient, GoalHandle, GoalServer, GoalType
    from tfbus.node.clock_topic import ClockPublisher, ClockStart

M = TypeVar("M")


class Node:
    """A named member of the bus, from its construction until `close()` or the end of its `with`.

    All callbacks (topics, services, actions, timers, parameters) run one at a time on its own
    thread: they need no locks, and there is nothing to spin. A callback that waits, for
    a lookup or a service, holds up the others, also a callback that sends the transform that it
    waits for. So let it be an `async def`, or give it a `callback_group`, whose callbacks run on
    further threads, at most `callback_threads` at once.

    Ctrl-C ends the `spin()` or `wait()` that the main thread is in, and the script goes on;
    elsewhere in the main thread it raises KeyboardInterrupt, which the node's `with` ends quietly.
    SIGTERM ends all later waits too. In a notebook or at Python's prompt Ctrl-C raises
    KeyboardInterrupt from any call. The node works until it is closed.

    `log` is its `logging.Logger`. With `sim_time` in its settings the topic `clock` gives its time,
    and the seconds of timers, `wait` and lookups.

    `settings`, or `name`, `namespace`, `parameters` and the environment, say how to join the bus. A
    client waits for its router for at most `patience_s`. Raises BusError if it cannot join.
    """

    def __init__(
        self,
        name: str = "",
        *,
        namespace: str | None = None,
        parameters: Mapping[str, Any] | None = None,
        settings: NodeSettings | None = None,
        patience_s: float = math.inf,
        callback_threads: int = CALLBACK_THREADS,
    ):
        if isinstance(name, NodeSettings):
            raise SettingsError(
                "the first argument of a Node is its name, which settings have already: "
                "Node(settings=NodeSettings(...))"
            )
        if settings is None:
            given: dict[str, Any] = {"namespace": namespace, "parameters": parameters}
            settings = NodeSettings(
                name, **{key: value for key, value in given.items() if value is not None}
            )
        elif not isinstance(settings, NodeSettings):
            raise SettingsError(
                f"settings: expected a tfbus.NodeSettings, got {type(settings).__name__}"
            )
        settings.check_right("nodes", settings.name)
        self.settings = settings
        self.name = settings.name
        self.namespace = settings.namespace
        self.full_name = settings.full_name
        self.log = open_log(self.full_name, self.name, settings.log_level)
        self.started_ns = scheduler.time_ns()
        self.clock: Clock = SimulatedClock() if settings.sim_time else SYSTEM_CLOCK
        self._lanes = Lanes(self.full_name, self.log, callback_threads)
        self.executor = self._lanes.own
        self._closed = False
        self._is_ready = False
        self._parameters_are_typed_in = False
        self._signals = StopSignals()
        # The buffers that listeners of this node fill, the first first.
        self.buffers: list[Buffer] = []
        try:
            check_id_is_free(settings, self.log, patience_s)
            self.session = Session(settings, self.log, patience_s=patience_s)
        except BaseException:
            self._signals.uninstall()
            raise
        with self._signals.held():
            self._declare_itself()
            # Before its session, so that no timer sends on one that has ended.
            if not scheduler.is_simulated:  # a simulated process ends by itself
                atexit.register(self.close)
            is_stopped = self._is_stopped()
        if is_stopped:
            self.close()
            raise KeyboardInterrupt

    def _is_stopped(self) -> bool:
        """Whether a signal came while it was made."""
        try:
            return self._signals.consume()
        except KeyboardInterrupt:
            return True

    def _declare_itself(self) -> None:
        session, settings = self.session, self.settings
        own = Lane(self.executor)
        self._parameters = Parameters(self.name, settings.parameters, session, own, self.log)
        self._info = NodeInfo(self.name, self.full_name, self.started_ns, session, self._parameters)
        self._info.describers.append(self._lanes.describe)
        self._clock_start: ClockStart | None = None
        if isinstance(self.clock, SimulatedClock):
            from tfbus.node import clock_topic

            topic = self._resolve(CLOCK_TOPIC)
            self._clock_start = clock_topic.ClockStart(self.clock, topic, self.executor, self.log)
            subscription = clock_topic.ClockSubscription(session, self.log, topic, self.clock)
            self._info.add("subscribes", subscription)
        self._token = session.token(node_key(self.name))
        session.watch_links(OpenFilesWatch(self.log).check)
        watch_members(session, self.log)
        watch_endpoints(session, self.executor, self.log)
        watch_router(session, self.executor, self.log)
        self._duplicates = DuplicateNameWatch(
            self.name, self.full_name, self.started_ns, session, self.executor, self.log
        )

    @classmethod
    def from_settings(cls, settings: NodeSettings) -> "Node":
        """The node of these settings."""
        return cls(settings=settings)

    @classmethod
    def from_args(
        cls,
        name: str,
        argv: Sequence[str] | None = None,
        *,
        callback_threads: int = CALLBACK_THREADS,
    ) -> "Node":
        """The node of a command line, by the options that every process takes.

        `name` counts if the command line has no `--name`; `argv` is `sys.argv[1:]` if it is
        None. A mistake in it exits with 2; a bus that it cannot join, or an invalid value of a
        parameter, exits with 1, each with the reason on stderr.
        """
        from tfbus.command.options import settings_from_args

        try:
            settings = settings_from_args(name, argv)
            node = cls(settings=settings, callback_threads=callback_threads)
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
        if error is not None:
            imported("tfbus.base.ros_names").add_note(error)
        stopped_by_signal = kind is KeyboardInterrupt and not self.ok
        if stopped_by_signal:
            forget_interrupt()
        self.close()
        if self._parameters_are_typed_in and isinstance(error, ParameterError):
            raise SystemExit(f"Error: {error}") from None
        return stopped_by_signal

    def __repr__(self) -> str:
        return f"<Node {self.full_name}{', closed' if self._closed else ''}>"

    if not TYPE_CHECKING:  # type checkers find missing names themselves

        def __getattr__(self, name: str) -> Any:
            """No attribute; the error names what stands for one of rclpy."""
            hint = imported("tfbus.base.ros_names").hint("Node", name)
            raise AttributeError(
                f"'Node' object has no attribute {name!r}{hint}", name=name, obj=self
            )

    # How long it lives

    @property
    def ok(self) -> bool:
        """Whether to go on: False after Ctrl-C, SIGTERM, `shutdown()` or `close()`.

        In a notebook or at Python's prompt Ctrl-C leaves it True.
        """
        return not self._signals.stopped

    def shutdown(self) -> None:
        """Make `spin()` and `wait()` return; from any thread, twice is fine."""
        self._signals.stop()

    def ready(self, text: str = "ready") -> None:
        """Log that the node works now, and whether it listens (`--listen`); only the first call
        does.
        """
        if not self._is_ready:
            self._is_ready = True
            self._parameters.warn_of_undeclared()
            is_open = " (the bus is open; --secure closes it)" if self.session.open_to else ""
            self.log.info("%s%s", text, is_open)
            self._expect_clock()

    def spin(self) -> None:
        """Log that the node is ready and wait until it is shut down."""
        with self._signals.held():  # so that a signal between the two ends it quietly
            self.ready()
            self.wait(None)

    def wait(self, timeout_s: float | None, *, clock: Clock | None = None) -> bool:
        """Wait for `timeout_s` seconds (None: for ever), or until Ctrl-C or the node's shutdown.

        Returns whether the time has passed without these: `while node.wait(1.0):` is a loop that
        Ctrl-C ends. `create_timer` keeps a rate. Seconds are the node's clock's, unless another is
        given.
        """
        zenoh_library.check_not_forked()
        clock = clock or self.clock
        timeout_s = seconds_to_wait(timeout_s)
        if timeout_s is None or not clock.is_simulated:
            return not self._signals.wait(timeout_s)
        with Wakeup() as wakeup, clock.limit(timeout_s, wakeup.wake) as limit:
            return not self._signals.wait(0.0 if limit.passed else None, wakeup)

    def close(self) -> None:
        """Leave the bus; everything that was created from the node ends. Twice is fine.

        In a forked child it does nothing: the node is its parent's.
        """
        if not self._closed and not zenoh_library.is_lost_by_fork():
            self._closed = True
            atexit.unregister(self.close)
            self.shutdown()
            with self._signals.held():
                self.clock.close()
                self._lanes.close()
                self.session.close()
            self._signals.uninstall()

    # Its clock

    def now_ns(self) -> int:
        """The time now, in nanoseconds since the Unix epoch.

        With simulated time it is 0 until the first message on the topic `clock`.
        """
        return self.clock.now_ns()

    def _expect_clock(self) -> None:
        """Log it unless a simulated clock starts soon."""
        if self._clock_start is not None:
            self._clock_start.expect()

    def wait_for_clock(self, timeout_s: float | None = None) -> bool:
        """Wait until the clock runs, at most `timeout_s` real seconds (None: for ever).

        Returns whether it runs: the system's clock always does, a simulated one from its first
        message on. Returns early if the node is shut down.
        """
        timeout_s = seconds_to_wait(timeout_s)
        if not self.clock.is_running:
            self._expect_clock()
            with Wakeup() as wakeup:
                self.clock.call_when_running(wakeup.wake)
                self._signals.wait(timeout_s, wakeup)
        return self.clock.is_running

    # Its publishers, subscriptions and services

    @called_as("node.create_publisher(message_type, topic), without QoS: retained=True, or nothing")
    def create_publisher(
        self, message_type: type[M], topic: str, *, retained: bool = False
    ) -> Publisher[M]:
        """A publisher of messages of this type, a dataclass.

        If it is `retained`, its last message is kept for as long as the node lives, for
        subscriptions that are `retained` and begin later: "transient local" in ROS.
        """
        check_message_type("create_publisher(message_type, topic)", message_type)
        topic = check_no_transforms(self._resolve(topic))
        self.settings.check_right("topics", topic)
        publisher = Publisher(self.session, message_type, topic, retained=retained)
        return self._info.add("publishes", publisher)

    @called_as(
        "node.create_subscription(message_type, topic, callback), without QoS: retained=True, or "
        "nothing"
    )
    def create_subscription(
        self,
        message_type: type[M],
        topic: str,
        callback: Callable[..., Any] | None = None,
        *,
        retained: bool = False,
        callback_group: CallbackGroup | None = None,
        in_frame: str | None = None,
        buffer: "Buffer | None" = None,
        tolerance_s: float = 0.0,
        timeout_s: float = 5.0,
        queue: int = 100,
    ) -> Subscription[M]:
        """Call `callback(message)` for each message on the topic; it may be an `async def`. Without
        a callback iterate over the subscription, by `for` or `async for`.

        With `retained` it is called first for the last message of each retained publisher. A
        message may come again after a link was lost.

        With `in_frame` it is `callback(message, transform)`, as soon as the buffer has the
        transform from the message's frame at its stamp, and until `tolerance_s` later too: a
        TransformStamped; of a scan or cloud whose points have times a TransformArray, one for each
        point. Nothing blocks meanwhile: at most `queue` messages wait, each for at most
        `timeout_s`, and messages of one frame are passed on in order. The subscription counts in
        `drops` why others were dropped. The buffer is the node's TransformListener's, unless
        another is given. Raises ValueError without one, and for a bound out of range.
        """
        call = "create_subscription(message_type, topic, callback)"
        check_message_type(call, message_type)
        if callback is not None:
            check_callback(call, callback)
        lane = self._lanes.lane(call, callback_group, callback)
        topic = self._resolve(topic)
        if in_frame is not None:
            from tfbus.node.framed_topic import FramedSubscription, into_frame

            into = into_frame(
                call, message_type, in_frame, buffer, self.buffers, tolerance_s, timeout_s, queue
            )
            framed = FramedSubscription(
                self.session,
                lane,
                self.executor,
                self.log,
                message_type,
                topic,
                callback,
                into,
                self._signals,
                self._info.describers,
                retained=retained,
            )
            return self._info.add("subscribes", framed)
        return self._info.add(
            "subscribes",
            Subscription(
                self.session,
                lane,
                self.log,
                message_type,
                topic,
                callback,
                signals=self._signals,
                retained=retained,
            ),
        )

    def create_raw_publisher(
        self, topic: str, *, type_name: str = "", retained: bool = False, definition: str = ""
    ) -> RawPublisher:
        """A publisher of messages that are bytes already, of a type known by its name only;
        `retained` as of `create_publisher`.

        A type of ROS has its full name, `sensor_msgs/msg/Imu`, and its fields. A `definition`, as
        `ros2msg` of MCAP, lets others record one that is not standard.
        """
        topic = self._resolve(topic)
        self.settings.check_right("topics", topic)
        publisher = RawPublisher(
            self.session, topic, type_name, retained=retained, definition=definition
        )
        return self._info.add("publishes", publisher)

    def create_raw_subscription(
        self,
        topic: str,
        callback: Callable[[bytes], object],
        *,
        type_name: str = "",
        retained: bool = False,
        others: bool = False,
    ) -> RawSubscription:
        """Call `callback(payload)` with the bytes of each message, of any type; `retained` as of
        `create_subscription`. With `others` messages of this node are left out.

        It runs on a thread of Zenoh's, before the next message is taken: return soon.
        """
        check_plain("create_raw_subscription(topic, callback)", callback)
        topic = self._resolve(topic)
        return self._info.add(
            "subscribes",
            RawSubscription(
                self.session, topic, callback, type_name, retained=retained, others=others
            ),
        )

    def create_service(
        self,
        service_type: type[ServiceType],
        name: str,
        handler: Callable[[Any], Any],
        *,
        callback_group: CallbackGroup | None = None,
    ) -> Service:
        """Serve requests: `handler(request)` returns a Response or raises ServiceError.

        It may be an `async def`.
        """
        call = "create_service(service_type, name, handler)"
        check_parts(call, service_type, ("Request", "Response"))
        check_callback(call, handler)
        lane = self._lanes.lane(call, callback_group, handler)
        name = self._resolve(name)
        self.settings.check_right("serves", name)
        return self._info.add("serves", Service(self.session, lane, service_type, name, handler))

    def create_client(self, service_type: type[ServiceType], name: str) -> Client:
        """A client that calls a service."""
        check_parts("create_client(service_type, name)", service_type, ("Request", "Response"))
        name = self._resolve(name)
        self.settings.check_right("calls", name)
        return self._info.add("calls", Client(self.session, service_type, name))

    def create_goal_server(
        self,
        goal_type: "type[GoalType]",
        name: str,
        handler: "Callable[[GoalHandle], Any]",
        *,
        callback_group: CallbackGroup | None = None,
        decides: bool = False,
    ) -> "GoalServer":
        """Serve an action: `handler(handle)` is called once a goal and ends the handle later.

        The goal is accepted before that; if the handler `decides`, by `handle.accept()`.

        It may be an `async def`; one that blocks is to be in a ReentrantCallbackGroup, as the
        cancellations come in the same group.
        """
        from tfbus.node.action import GoalServer

        call = "create_goal_server(goal_type, name, handler)"
        check_parts(call, goal_type, ("Goal", "Feedback", "Result"))
        check_callback(call, handler)
        lane = self._lanes.lane(call, callback_group, handler)
        name = self._resolve(name)
        self.settings.check_right("serves", name)
        return self._info.add(
            "serves",
            GoalServer(self.session, lane, goal_type, name, handler, decides=decides),
        )

    def create_goal_client(self, goal_type: "type[GoalType]", name: str) -> "GoalClient":
        """A client that sends goals to an action server."""
        from tfbus.node.action import GoalClient

        call = "create_goal_client(goal_type, name)"
        check_parts(call, goal_type, ("Goal", "Feedback", "Result"))
        name = self._resolve(name)
        self.settings.check_right("calls", name)
        return self._info.add("calls", GoalClient(self.session, goal_type, name))

    def create_timer(
        self,
        period_s: float,
        callback: Callable[[], Any],
        *,
        clock: Clock | None = None,
        callback_group: CallbackGroup | None = None,
    ) -> Timer:
        """Call `callback()` every `period_s` seconds, the first time after one period; it may be an
        `async def`.

        The rate does not drift; periods that a call or an `async def` takes longer than are left
        out. Seconds are the node's clock's, unless another is given. Raises ValueError for a period
        of 0 or less, BusError on a closed node.
        """
        zenoh_library.check_not_forked()
        if self._closed:
            raise BusError(f"could not create a timer: node {self.settings.name!r} is closed")
        call = "create_timer(period_s, callback)"
        check_seconds(call, period_s)
        check_callback(call, callback)
        lane = self._lanes.lane(call, callback_group, callback)
        return lane.every(clock or self.clock, period_s, callback)

    def create_clock_publisher(self) -> "ClockPublisher":
        """A publisher of the simulated time, for the node's namespace and all below."""
        from tfbus.node.clock_topic import ClockPublisher

        topic = self._resolve(CLOCK_TOPIC)
        self.settings.check_right("topics", topic)
        publisher = ClockPublisher(self.session, self.log, self.executor, topic)
        return self._info.add("publishes", publisher)

    def declare_parameter(
        self,
        name: str,
        default: Value,
        *,
        description: str = "",
        minimum: float | None = None,
        maximum: float | None = None,
        on_change: Callable[[Any], object] = lambda value: None,
        callback_group: CallbackGroup | None = None,
    ) -> Parameter:
        """A parameter of the type of its default; `.value` is its value now.

        `on_change(value)` is called before a value from the bus is taken, and may raise
        ParameterError to refuse it. Raises ParameterError for an invalid value at the node's start.
        """
        call = "declare_parameter(name, default, on_change=...)"
        check_plain(call, on_change)
        lane = self._lanes.lane(call, callback_group)
        bounds = Bounds(minimum, maximum)
        parameter = Parameter(name, default, description, bounds, on_change)
        return self._parameters.declare(parameter, lane)

    def read_parameter(self, node: str, name: str) -> Any:
        """The value of another node's parameter; `node` is its name, relative or full.

        Raises BusError if there is no such node, ParameterError if it has no such parameter.
        """
        from tfbus.bus.remote_parameters import parameter_of  # few nodes need it

        return parameter_of(self.session, node, name, self.log.warning).value

    def set_parameter(self, node: str, name: str, value: Value) -> Any:
        """Set another node's parameter; returns its value then, in the parameter's type.

        Raises as `read_parameter`, ParameterError for a refusal, RightsError without the right on a
        closed bus.
        """
        from tfbus.bus.remote_parameters import set_parameter

        return set_parameter(self.session, node, name, value, self.log.warning).value

    # How it describes itself

    @property
    def describers(self) -> list[Describer]:
        """Functions whose entries the node adds to its description: append and remove freely."""
        return self._info.describers

    def describe(self) -> dict[str, Any]:
        """The node's answer to an info query, the fields of a NodeDescription."""
        return self._info.describe()

    def _resolve(self, name: str) -> str:
        """The name as the session uses it, after remapping."""
        given = self._expanded(name)
        for source, target in self.settings.remappings.items():
            if self._expanded(source) == given:
                return self._expanded(target)
        return given

    def _expanded(self, name: str) -> str:
        return resolve(name, self.name, self.namespace)
