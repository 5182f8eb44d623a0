"""ROS's rclpy.node: a node with ROS's methods, which is a node of tfbus underneath."""

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from tfbus.base.callbacks import join
from tfbus.base.structs import replace
from tfbus.bus.graph import TRANSFORMS_TYPE, Graph, TopicInfo
from tfbus.bus.presence import ask_graph, ask_nodes
from tfbus.compat import bus_types as of
from tfbus.compat.rclpy import context as contexts
from tfbus.compat.rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from tfbus.compat.rclpy.clock import Clock
from tfbus.compat.rclpy.endpoints import Client, Publisher, Rate, Service, Subscription, Timer
from tfbus.compat.rclpy.logging import RosLogger
from tfbus.compat.rclpy.parameter import (
    OnSet,
    Parameter,
    ParameterDescriptor,
    RclpyParameters,
    SetParametersResult,
    names_in,
)
from tfbus.compat.rclpy.qos import applied
from tfbus.compat.rclpy.task import Work
from tfbus.compat.rclpy.time import ClockType
from tfbus.node.action import CancelGoal
from tfbus.node.node import Node as TfbusNode
from tfbus.ros.counterparts import LIVE_COUNTERPARTS
from tfbus.ros.definitions import TF_MESSAGE, interfaces_of
from tfbus.ros.message_classes import message_class
from tfbus.ros.transforms import TFMessage

NamesAndTypes = list[tuple[str, list[str]]]

# Of these packages tfbus has services of its own, under the names in ROS.
_OURS = ("turtlesim", "std_srvs")


class NodeGraph:
    """The nodes, topics and services on the bus; each call asks all nodes."""

    def __init__(self, node: TfbusNode) -> None:
        self._node = node

    def nodes(self) -> list[tuple[str, str]]:
        """The names of nodes, each with its namespace, `/` for none."""
        names = sorted({each.name for each in ask_nodes(self._node.session).nodes})
        parts = (each.strip("/").rpartition("/") for each in names)
        return [(name, f"/{above}") for above, _, name in parts]

    def topics(self) -> NamesAndTypes:
        """The full names of topics, sorted, each with its types."""
        found: dict[str, set[str]] = {}
        for name, topic in self._graph().topics.items():
            if TRANSFORMS_TYPE in topic.types:
                # Each stream is a topic on the bus; in ROS they are one.
                name, _, _ = name.rpartition("/")
            found.setdefault(self._full(name), set()).update(map(_message_in_ros, topic.types))
        return _sorted(found)

    def services(self) -> NamesAndTypes:
        """The full names of services, sorted, each with its types; an action has none."""
        found = {
            self._full(name): {_service_in_ros(each) for each in service.types}
            for name, service in self._graph().services.items()
            if service.servers and not any(map(_is_of_action, service.types))
        }
        return _sorted(found)

    def publishers(self, topic: str) -> int:
        """How many publish a topic."""
        found = self._topic(topic)
        return len(found.publishers) if found else 0

    def subscribers(self, topic: str) -> int:
        """How many subscribe to a topic."""
        found = self._topic(topic)
        return len(found.subscribers or ()) if found else 0

    def _graph(self) -> Graph:
        return ask_graph(self._node.session).graph(self._node.namespace)

    def _topic(self, name: str) -> TopicInfo | None:
        wanted = self._full(name)
        topics = self._graph().topics.items()
        return next((each for at, each in topics if self._full(at) == wanted), None)

    def _full(self, name: str) -> str:
        above = self._node.namespace
        return name if name.startswith("/") else f"/{above}/{name}" if above else f"/{name}"


def _sorted(found: Mapping[str, Iterable[str]]) -> NamesAndTypes:
    return [(name, sorted(types)) for name, types in sorted(found.items())]


def _message_in_ros(type_name: str) -> str:
    if type_name == TRANSFORMS_TYPE:
        return TF_MESSAGE.name
    ours = LIVE_COUNTERPARTS.get(type_name)
    return type_name if ours is None else ours.definition.name


def _service_in_ros(type_name: str) -> str:
    packages = [each for each in _OURS if type_name in interfaces_of(each).get("srv", ())]
    return f"{packages[0]}/srv/{type_name}" if packages else type_name


def _is_of_action(type_name: str) -> bool:
    return "/action/" in type_name or type_name == CancelGoal.__name__


__all__ = [
    "Client",
    "Node",
    "Parameter",
    "ParameterDescriptor",
    "ParameterType",
    "Publisher",
    "Service",
    "SetParametersResult",
    "Subscription",
    "Timer",
]

ParameterType: Any = message_class("rcl_interfaces/msg/ParameterType")

# Names of a node of rclpy that are not here, and their substitutes.
_INSTEAD = {
    "create_guard_condition": "node.work.submit(callback)",
    "get_publishers_info_by_topic": "count_publishers(topic), `tfbus topic info -v`",
    "get_subscriptions_info_by_topic": "count_subscribers(topic), `tfbus topic info -v`",
}


class Node:
    """A node with ROS's methods.

    `tfbus_node` is the node of tfbus that it is. Its callbacks run while it is spun, as in ROS: in
    the thread that spins it, or the threads of a MultiThreadedExecutor, where callbacks of
    `default_callback_group` run one at a time. Of the arguments of the process the ones after
    `--ros-args` count, and the options of `tfbus launch`; and the environment (`TFBUS_...`).

    Raises NotInitializedException before `rclpy.init()`; ends the process with the reason if the
    bus cannot be joined, or an argument is wrong.
    """

    def __init__(
        self,
        node_name: str,
        *,
        context: "contexts.Context | None" = None,
        cli_args: list[str] | None = None,
        namespace: str | None = None,
        use_global_arguments: bool = True,
        enable_rosout: bool = True,
        start_parameter_services: bool = True,
        parameter_overrides: list[Parameter] | None = None,
        allow_undeclared_parameters: bool = False,
        automatically_declare_parameters_from_overrides: bool = False,
        enable_logger_service: bool = False,
        **unknown: Any,
    ) -> None:
        if unknown:
            raise TypeError(f"a Node of tfbus.compat does not take {', '.join(unknown)}")
        self._context = context or contexts.current()
        given = self._context.node_arguments if use_global_arguments else []
        given = [*given, *contexts.split_arguments(cli_args or ())[1]]
        arguments: list[str] = []
        # The command line counts more than the program.
        if namespace is not None and not any(arg.startswith("__ns:=") for arg in given):
            arguments += ["--namespace", namespace.strip("/")]
        for each in parameter_overrides or ():
            arguments += ["--param", f"{each.name}={each.value}"]
        arguments += given
        self.tfbus_node = TfbusNode.from_args(node_name, arguments)
        self.work = Work(self.tfbus_node.executor.delays)
        self.default_callback_group: CallbackGroup = MutuallyExclusiveCallbackGroup()
        self._graph = NodeGraph(self.tfbus_node)
        self._said: set[str] = set()
        self._elsewhere: dict[str, TfbusNode] = {}
        self._logger = RosLogger(self.tfbus_node.name, self.tfbus_node.log)
        self._clock = Clock(clock_type=ClockType.ROS_TIME, tfbus_clock=self.tfbus_node.clock)
        self._parameters = RclpyParameters(
            self.tfbus_node, self.work, allow_undeclared=allow_undeclared_parameters
        )
        if automatically_declare_parameters_from_overrides:
            for name in self.tfbus_node.settings.parameters:
                self.declare_parameter(name)
        self._context.nodes.append(self)

    def __enter__(self) -> "Node":
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy_node()

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """No attribute; the error names a substitute."""
            instead = _INSTEAD.get(name)
            hint = f": use {instead}" if instead else "; node.tfbus_node is a tfbus.Node"
            raise AttributeError(
                f"a Node of tfbus.compat has no attribute {name!r}{hint}", name=name, obj=self
            )

    # Names and clock

    @property
    def context(self) -> "contexts.Context":
        """The context that `rclpy.init()` returned."""
        return self._context

    def get_name(self) -> str:
        """Its name, without its namespace."""
        return self.tfbus_node.name

    def get_namespace(self) -> str:
        """Its namespace, `/` for none."""
        return f"/{self.tfbus_node.namespace}"

    def get_fully_qualified_name(self) -> str:
        """Its namespace and name."""
        return self.tfbus_node.full_name

    def get_logger(self) -> RosLogger:
        """Its log."""
        return self._logger

    def get_clock(self) -> Clock:
        """Its clock, which follows the topic `clock` if time is simulated."""
        return self._clock

    def say_once(self, text: str) -> None:
        """Log a warning, unless this one was logged before."""
        if text not in self._said:
            self._said.add(text)
            self.tfbus_node.log.warning("%s", text)

    def node_in(self, namespace: str) -> TfbusNode:
        """The node of tfbus in a namespace: for another than its own, one of the same name there.

        A process that sends or listens to the transforms of a namespace is a node in it.
        """
        if namespace == self.tfbus_node.namespace:
            return self.tfbus_node
        if namespace not in self._elsewhere:
            settings = replace(
                self.tfbus_node.settings,
                namespace=namespace,
                listen=(),
                parameters={},
                remappings={},
            )
            self._elsewhere[namespace] = TfbusNode(settings.name, settings=settings)
        return self._elsewhere[namespace]

    def destroy_node(self) -> None:
        """End it and all that it has created; twice is fine."""
        if self in self._context.nodes:
            self._context.nodes.remove(self)
        for each in (*self._elsewhere.values(), self.tfbus_node):
            each.close()

    # Its publishers, subscriptions and services

    def create_publisher(self, msg_type: type, topic: str, qos_profile: Any, **_: Any) -> Publisher:
        """A publisher; of the QoS counts whether it is TRANSIENT_LOCAL."""
        retained = applied(qos_profile, topic, self.say_once)[1]
        if msg_type is TFMessage and (found := of.transforms_topic(self.tfbus_node, topic)):
            sender = of.TransformsPublisher(self.node_in(found.namespace), found.kind)
            return Publisher(sender, of.ON_TRANSFORM_TOPICS, msg_type)
        on_bus = of.bus_type_of(msg_type, topic, self.tfbus_node.clock)
        publisher = self.tfbus_node.create_publisher(on_bus.type, topic, retained=retained)
        return Publisher(publisher, on_bus, msg_type)

    def create_subscription(
        self,
        msg_type: type,
        topic: str,
        callback: Callable[[Any], Any],
        qos_profile: Any,
        *,
        callback_group: CallbackGroup | None = None,
        raw: bool = False,
        **_: Any,
    ) -> Subscription:
        """Call `callback(message)` for each message; of the QoS count the depth and whether it is
        TRANSIENT_LOCAL.
        """
        if raw:
            raise TypeError(
                "raw=True is not in tfbus.compat: node.tfbus_node.create_raw_subscription gives "
                "the bytes of the bus"
            )
        depth, retained = applied(qos_profile, topic, self.say_once)
        if msg_type is TFMessage and (found := of.transforms_topic(self.tfbus_node, topic)):
            on_bus, group = of.ON_TRANSFORM_TOPICS, self.group_of(callback_group)
            subscription = Subscription(self.work, on_bus, callback, depth, group, topic)
            subscription.endpoint = of.TransformsSubscription(
                self.tfbus_node, found, subscription.receive
            )
            return subscription
        on_bus = of.bus_type_of(msg_type, topic, self.tfbus_node.clock)
        group = self.group_of(callback_group)
        subscription = Subscription(self.work, on_bus, callback, depth, group, topic)
        subscription.endpoint = self.tfbus_node.create_subscription(
            on_bus.type, topic, subscription.receive, retained=retained
        )
        return subscription

    def create_timer(
        self,
        timer_period_sec: float,
        callback: Callable[[], Any],
        callback_group: CallbackGroup | None = None,
        clock: Clock | None = None,
        autostart: bool = True,
    ) -> Timer:
        """Call `callback()` every `timer_period_sec` seconds of a clock, the node's if
        none is given, the first time after one period; without `autostart`, after its `reset()`.
        """
        group = self.group_of(callback_group)
        timer_clock = (clock or self._clock).tfbus_clock
        work, period_s = self.work, timer_period_sec
        timer = Timer(self.tfbus_node, work, period_s, callback, group, clock=timer_clock)
        if not autostart:
            timer.cancel()
        return timer

    def create_rate(self, frequency: float, clock: Clock | None = None) -> Rate:
        """A rate whose `sleep()` makes a loop of `frequency` Hz of a clock, the node's if none is
        given.
        """
        return Rate(self.tfbus_node, 1.0 / frequency, (clock or self._clock).tfbus_clock)

    def create_service(
        self,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        *,
        callback_group: CallbackGroup | None = None,
        **_: Any,
    ) -> Service:
        """Serve requests: `callback(request, response)` returns the response."""
        group = self.group_of(callback_group)
        service = Service(self.work, srv_type, callback, group, srv_name)
        service.endpoint = self.tfbus_node.create_service(srv_type, srv_name, service.handle)
        return service

    def create_client(
        self,
        srv_type: Any,
        srv_name: str,
        *,
        callback_group: CallbackGroup | None = None,
        **_: Any,
    ) -> Client:
        """A client of a service; answers come whatever runs, so that a callback of any group may
        wait for one.
        """
        self.group_of(callback_group)
        return Client(self.tfbus_node.create_client(srv_type, srv_name), self.work)

    def group_of(self, given: CallbackGroup | None) -> CallbackGroup:
        """The group itself, or the node's; it is of the node then."""
        group = self.default_callback_group if given is None else given
        join(group, self.get_fully_qualified_name())
        return group

    def destroy_publisher(self, publisher: Publisher) -> bool:
        """End it."""
        publisher.destroy()
        return True

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """End it."""
        subscription.destroy()
        return True

    def destroy_timer(self, timer: Timer) -> bool:
        """End it."""
        timer.destroy()
        return True

    def destroy_service(self, service: Service) -> bool:
        """End it."""
        service.destroy()
        return True

    def destroy_client(self, client: Client) -> bool:
        """End it."""
        client.destroy()
        return True

    # Who is there

    def get_node_names(self) -> list[str]:
        """The names of all nodes, without their namespaces."""
        return [name for name, _ in self._graph.nodes()]

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        """The names of all nodes, each with its namespace."""
        return self._graph.nodes()

    def get_topic_names_and_types(self, no_demangle: bool = False) -> NamesAndTypes:
        """The full names of all topics, each with its types; asks all nodes."""
        return self._graph.topics()

    def get_service_names_and_types(self) -> NamesAndTypes:
        """The full names of all services, each with its types; asks all nodes."""
        return self._graph.services()

    def count_publishers(self, topic_name: str) -> int:
        """How many publish a topic; asks all nodes."""
        return self._graph.publishers(topic_name)

    def count_subscribers(self, topic_name: str) -> int:
        """How many subscribe to a topic, of transforms 0; asks all nodes."""
        return self._graph.subscribers(topic_name)

    # Its parameters

    def declare_parameter(
        self, name: str, value: Any = None, descriptor: Any = None, ignore_override: bool = False
    ) -> Parameter:
        """A parameter with a default, or with a `Parameter.Type` only; returns it as it is now.

        Raises ParameterAlreadyDeclaredException.
        """
        return self._parameters.declare(name, value, descriptor, ignore_override=ignore_override)

    def declare_parameters(
        self, namespace: str, parameters: Iterable[tuple[Any, ...]], ignore_override: bool = False
    ) -> list[Parameter]:
        """Several parameters, each a tuple of its name, and maybe a default and a descriptor."""
        return [self.declare_parameter(*each) for each in names_in(parameters, namespace)]

    def undeclare_parameter(self, name: str) -> None:
        """Forget it. Raises ParameterNotDeclaredException."""
        self._parameters.undeclare(name)

    def has_parameter(self, name: str) -> bool:
        """Whether it is declared."""
        return self._parameters.has(name)

    def get_parameter(self, name: str) -> Parameter:
        """The parameter as it is now. Raises ParameterNotDeclaredException, or
        ParameterUninitializedException if it has no value.
        """
        return self._parameters.get(name)

    def get_parameters(self, names: Iterable[str]) -> list[Parameter]:
        """The parameters as they are now."""
        return [self.get_parameter(name) for name in names]

    def get_parameters_by_prefix(self, prefix: str) -> dict[str, Parameter]:
        """The parameters whose names begin with the prefix and a dot, by the rest of the name."""
        return self._parameters.with_prefix(prefix)

    def get_parameter_or(self, name: str, alternative_value: Any = None) -> Any:
        """The parameter as it is now, or the alternative if it is not declared."""
        return self.get_parameter(name) if self.has_parameter(name) else alternative_value

    def get_parameter_type(self, name: str) -> Any:
        """Its type. Raises ParameterNotDeclaredException."""
        return self.get_parameter(name).type_

    def describe_parameter(self, name: str) -> Any:
        """Its descriptor. Raises ParameterNotDeclaredException."""
        return self._parameters.describe(name)

    def set_parameters(self, parameter_list: Iterable[Parameter]) -> list[Any]:
        """Change parameters: of each a SetParametersResult, whether it was and why not."""
        return [self._parameters.set(each) for each in parameter_list]

    def set_parameters_atomically(self, parameter_list: Iterable[Parameter]) -> Any:
        """The same, up to the first that is refused."""
        result: Any = None
        for each in parameter_list:
            result = self._parameters.set(each)
            if not result.successful:
                break
        return result

    def add_on_set_parameters_callback(self, callback: OnSet) -> None:
        """Call `callback(parameters)` before they change; it returns a SetParametersResult."""
        self._parameters.callbacks.insert(0, callback)

    def remove_on_set_parameters_callback(self, callback: OnSet) -> None:
        """Call it no longer."""
        self._parameters.callbacks.remove(callback)


def tfbus_node_of(node: Any) -> TfbusNode:
    """tfbus's node of a node of either kind. Raises TypeError for anything else."""
    if isinstance(node, TfbusNode):
        return node
    if isinstance(node, Node):
        return node.tfbus_node
    raise TypeError(
        "node must be a Node of tfbus.compat.rclpy.node or a tfbus.Node, not a "
        f"{type(node).__name__}: a node of ROS itself is not on the bus"
    )


def node_of_transforms(node: Any, topic: str) -> TfbusNode:
    """tfbus's node in the namespace whose transforms a topic is, `/tf` after remapping.

    Raises TypeError for a topic of another name.
    """
    own = tfbus_node_of(node)
    found = of.transforms_topic(own, topic)
    if found is None:
        raise TypeError(
            f"{topic!r} is no topic of transforms: they are on the topics /tf and /tf_static, and "
            "those of another namespace on /robot7/tf and /robot7/tf_static"
        )
    return node.node_in(found.namespace) if isinstance(node, Node) else own
