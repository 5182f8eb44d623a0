"""The leg over ROS's own rclpy, by any middleware that the ROS around uses."""

import logging
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

from tfbus.base.bounded import Bounded
from tfbus.base.errors import SettingsError, TfbusError
from tfbus.base.log import LogOnce
from tfbus.base.wording import printable
from tfbus.ros.bridge.legs import (
    LEAST_READER_DEPTH,
    Calls,
    Endable,
    LegSettings,
    LostMessages,
    Offer,
    OnMessage,
    RosPublisher,
    RosSender,
    RosTopic,
    unheard,
)

try:
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
    from rclpy.signals import SignalHandlerOptions
except ImportError as error:
    _VERSION = f"{sys.version_info.major}.{sys.version_info.minor}"
    raise TfbusError(
        f"rclpy cannot be imported by this Python {_VERSION}: run `source "
        "/opt/ros/DISTRO/setup.bash` first, and install tfbus in an environment of ROS's own "
        "Python, made with `python3 -m venv --system-site-packages`; ROS 2 Humble and earlier have "
        f"a Python before 3.11: use --via zenoh or --via dds ({printable(str(error), 100)})"
    ) from error

# In the place of the name of a node.
_NOT_YET_KNOWN = "_NODE_NAME_UNKNOWN_"
_OF_NO_NODE = "_CREATED_BY_BARE_DDS_APP_"

# Own messages that have not come back yet, if only their bytes can tell them.
_MOST_OWN = 1000

# In the place of the number of a message, where the middleware does not tell.
_UNNUMBERED = 2**64 - 1


def open_leg(settings: LegSettings, log: logging.Logger) -> "RclpyLeg":
    """Join ROS 2 as a node of rclpy. Raises TfbusError if it cannot be joined."""
    if settings.connect:
        raise TfbusError(
            "rclpy has no --ros-connect: ROS's own variables say where ROS is, such as "
            "ROS_STATIC_PEERS, or ZENOH_CONFIG_OVERRIDE"
        )
    if settings.distro:
        raise SettingsError("rclpy has no --distro: it is that of the ROS that is sourced")
    return RclpyLeg(settings, log)


class _OwnMessages:
    """Messages of the leg that have not come back to a subscription yet: each comes back once.
    Thread-safe.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # Messages that never come back go first.
        self._waiting: Bounded[int, int] = Bounded(_MOST_OWN)

    def add(self, key: int) -> None:
        """A message is sent whose bytes have this hash."""
        with self._lock:
            self._waiting[key] = self._waiting.get(key, 0) + 1

    def remove(self, key: int) -> bool:
        """Whether one that came is one of them."""
        with self._lock:
            count = self._waiting.pop(key, 0)
            if count > 1:
                self._waiting[key] = count - 1
        return count > 0


class RclpySender:
    """A publisher of rclpy."""

    def __init__(self, leg: "RclpyLeg", topic: RosTopic, publisher: Any, gid: str) -> None:
        self.gid = gid
        self.topic = topic.name
        # The hashes of messages that later subscriptions get, too; if ROS tells no publishers.
        self.kept: deque[int] = deque(maxlen=topic.depth if topic.retained else 0)
        self._leg = leg
        self._publisher = publisher

    @property
    def heard(self) -> bool:
        """Whether a subscription of another node matches."""
        publisher = self._publisher
        if publisher is None:
            return False
        own = self._leg.own_subscriptions(self.topic)
        return bool(publisher.get_subscription_count() > own)

    def send(self, payload: bytes) -> None:
        """Publish one message."""
        publisher = self._publisher
        if publisher is None:
            raise TfbusError(f"the publisher of {self.topic} is closed")
        if not self._leg.tells_publishers:
            self._leg.sends(self, payload)
        publisher.publish(payload)

    def close(self) -> None:
        """It is gone, with its kept messages."""
        publisher, self._publisher = self._publisher, None
        if publisher is not None:
            self._leg.drop_sender(self, publisher)


class RclpySubscription:
    """A subscription of rclpy."""

    def __init__(self, leg: "RclpyLeg", topic: RosTopic, on_message: OnMessage) -> None:
        self.topic = topic
        self.made: Any = None
        self.own = _OwnMessages()
        self._leg = leg
        self._calls = Calls(on_message)

    def receive(self, payload: bytes, info: dict[str, Any]) -> None:
        """A message for it."""
        # Only distributions since Kilted have it.
        gid = _gid(told["data"]) if (told := info.get("publisher_gid")) else ""
        if self._leg.has_sent(gid) if gid else self.own.remove(hash(payload)):
            return
        number = info.get("publication_sequence_number", _UNNUMBERED)
        if gid and number != _UNNUMBERED:
            self._leg.lost_messages.came(self.topic.name, gid, number)
        self._leg.safely(self._calls.call, payload, gid)

    def close(self) -> None:
        """It takes no message after this."""
        if self._calls.close():
            self._leg.drop_subscription(self)


class RclpyLeg:
    """A node of rclpy, in a context of its own."""

    def __init__(self, settings: LegSettings, log: logging.Logger) -> None:
        self.lost_messages = LostMessages()
        self._log_once = LogOnce(log)
        self._lock = threading.RLock()
        self._senders: list[RclpySender] = []
        self._subscriptions: list[RclpySubscription] = []
        self._closing = False
        self._context = Context()
        try:
            rclpy.init(
                args=[],
                context=self._context,
                domain_id=settings.domain,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            self._node = Node(
                settings.node,
                namespace=settings.namespace or None,
                context=self._context,
                use_global_arguments=False,
                enable_rosout=False,
                start_parameter_services=False,
            )
        except Exception as error:
            self._context.try_shutdown()
            raise TfbusError(f"rclpy cannot join ROS: {printable(str(error), 300)}") from error
        self.name = f"rclpy ({_middleware()})"
        self.tells_publishers = _tells_publishers()
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._run, name="tfbus-rclpy", daemon=True)
        self._thread.start()

    def publisher(self, topic: RosTopic) -> RosSender:
        """Begin to publish a topic."""
        message = _message_class(topic.definition.name)
        with self._lock:
            known = {_gid(each.endpoint_gid) for each in self._endpoints(topic.name)}
            made = self._node.create_publisher(message, topic.name, _qos(topic, topic.depth))
            # rclpy does not tell the gid of a publisher: it is that which the graph has since.
            found = [
                gid
                for each in self._endpoints(topic.name)
                if self._is_own_node(each) and (gid := _gid(each.endpoint_gid)) not in known
            ]
            sender = RclpySender(self, topic, made, found[0] if len(found) == 1 else "")
            self._senders.append(sender)
        return sender

    def subscribe(self, topic: RosTopic, on_message: OnMessage) -> Endable:
        """Call `on_message(payload, gid)` for each message of others on a topic."""
        message = _message_class(topic.definition.name)
        subscription = RclpySubscription(self, topic, on_message)
        qos = _qos(topic, max(topic.depth, LEAST_READER_DEPTH))

        # rclpy counts the arguments of a function, to know whether it wants the info.
        def take(payload: bytes, info: dict[str, Any]) -> None:
            subscription.receive(payload, info)

        with self._lock:
            if topic.retained:
                for key in self._kept(topic.name):
                    subscription.own.add(key)
            subscription.made = self._node.create_subscription(
                message, topic.name, take, qos, raw=True
            )
            self._subscriptions.append(subscription)
        return subscription

    def publishers(self, topic: str) -> Sequence[RosPublisher]:
        """The publishers of a topic that are there now, each once ROS knows its node."""
        return [
            RosPublisher(_gid(each.endpoint_gid), _node_name(each))
            for each in self._endpoints(topic)
            if not self._is_own_node(each) and each.node_name != _NOT_YET_KNOWN
        ]

    def lost(self) -> Mapping[str, int]:
        """How many messages of each topic were lost, by their numbers; none before Kilted."""
        return self.lost_messages.counts

    def warnings(self) -> Sequence[str]:
        """Sentences: that there is no ROS, and publishers that are not heard."""
        own = (self._node.get_name(), self._node.get_namespace())
        if all(each == own for each in self._node.get_node_names_and_namespaces()):
            return [
                f"No ROS 2 node is seen by {self.name} in domain {self._context.get_domain_id()}: "
                "ROS_DOMAIN_ID and RMW_IMPLEMENTATION must be those of the other nodes"
            ]
        with self._lock:
            topics = [each.topic for each in self._subscriptions]
        return [said for topic in topics for said in self._unheard(topic)]

    def has_sent(self, gid: str) -> bool:
        """Whether a message by this gid is of a publisher of this leg."""
        return any(each.gid == gid for each in self._senders)

    def sends(self, sender: RclpySender, payload: bytes) -> None:
        """A publisher of this leg is about to send: it comes back to each subscription."""
        key = hash(payload)
        with self._lock:
            sender.kept.append(key)
            for each in self._subscriptions:
                if each.topic.name == sender.topic:
                    each.own.add(key)

    def _kept(self, topic: str) -> list[int]:
        return [key for each in self._senders if each.topic == topic for key in each.kept]

    def own_subscriptions(self, topic: str) -> int:
        """How many subscriptions of a topic are of this leg."""
        with self._lock:
            return sum(each.topic.name == topic for each in self._subscriptions)

    def drop_sender(self, sender: RclpySender, publisher: Any) -> None:
        """It is closed."""
        with self._lock:
            self._senders.remove(sender)
            self._node.destroy_publisher(publisher)

    def drop_subscription(self, subscription: RclpySubscription) -> None:
        """It is closed."""
        with self._lock:
            self._subscriptions.remove(subscription)
            self._node.destroy_subscription(subscription.made)

    def safely(self, call: Callable[..., None], *values: Any) -> None:
        """A failure of one message does not end the others."""
        try:
            call(*values)
        except Exception as error:
            self._log_once.warning("taking", "A message from ROS was not taken: %s", error)

    def close(self) -> None:
        """Leave ROS."""
        with self._lock:
            if self._closing:
                return
            self._closing = True
        # The executor ends first, so that nothing is destroyed while it waits for it.
        self._executor.shutdown(timeout_sec=0)
        if threading.current_thread() is not self._thread:
            self._thread.join()
        for sender in tuple(self._senders):
            sender.close()
        for subscription in tuple(self._subscriptions):
            subscription.close()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _run(self) -> None:
        while not self._closing and self._context.ok():
            try:
                self._executor.spin_once()
            except ExternalShutdownException:
                return
            except Exception as error:
                self._log_once.warning("spinning", "rclpy: %s", error)

    def _endpoints(self, topic: str) -> Sequence[Any]:
        endpoints: Sequence[Any] = self._node.get_publishers_info_by_topic(topic)
        return endpoints

    def _is_own_node(self, endpoint: Any) -> bool:
        return bool(
            endpoint.node_name == self._node.get_name()
            and endpoint.node_namespace == self._node.get_namespace()
        )

    def _unheard(self, topic: RosTopic) -> Sequence[str]:
        """Publishers of a topic that does not come here."""
        offers = [
            Offer(
                _node_name(each),
                each.topic_type,
                each.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT,
                each.qos_profile.durability != DurabilityPolicy.VOLATILE,
            )
            for each in self._endpoints(topic.name)
        ]
        return unheard(topic, topic.definition.name, offers)


def _message_class(name: str) -> Any:
    package, _, leaf = name.rpartition("/")
    try:
        return getattr(import_module(package.replace("/", ".")), leaf)
    except (ImportError, AttributeError) as error:
        debian = f"ros-{os.environ.get('ROS_DISTRO') or 'DISTRO'}-{package.partition('/')[0]}"
        raise TfbusError(
            f"ROS has no Python class of {printable(name, 100)} here: apt-get install "
            f"{debian.replace('_', '-')}, or source the workspace that has it"
        ) from error


def _middleware() -> str:
    return str(rclpy.utilities.get_rmw_implementation_identifier())


def _tells_publishers() -> bool:
    """Whether rclpy names the publisher of each message: since Kilted."""
    from rclpy import subscription

    told = getattr(subscription, "MessageInfo", None)
    return "publisher_gid" in getattr(told, "__annotations__", ())


def _node_name(endpoint: Any) -> str:
    """The full name of a node, "" of one that ROS has no name of."""
    if endpoint.node_name in ("", _NOT_YET_KNOWN, _OF_NO_NODE):
        return ""
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def _gid(gid: Sequence[int] | bytes) -> str:
    """In hexadecimal: 16 bytes, if it was longer with zeros behind."""
    return bytes(gid)[:16].hex()


def _qos(topic: RosTopic, depth: int) -> QoSProfile:
    retained = DurabilityPolicy.TRANSIENT_LOCAL
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=retained if topic.retained else DurabilityPolicy.VOLATILE,
    )
