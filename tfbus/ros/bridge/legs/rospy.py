"""ROS 1 by rospy, as Debian, Ubuntu and ROS Noetic install it for the system's Python."""

import logging
import os
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from tfbus.base.errors import DecodeError, SettingsError, TfbusError
from tfbus.base.log import LogOnce
from tfbus.ros.bridge.legs import Calls, LegSettings, OnMessage, RosPublisher, RosTopic
from tfbus.ros.ros1 import DEFAULT_MASTER, Ros1Master, Ros1State, Ros1Type, ros1_type

# Where Debian has it, and ROS Noetic.
_FOLDERS = ("/usr/lib/python3/dist-packages", "/opt/ros/noetic/lib/python3/dist-packages")

# How often the master is asked for its state, and how long it may take to answer.
_POLL_EVERY_S = 1.0
_ANSWER_WITHIN_S = 2.0


def open_leg(settings: LegSettings, log: logging.Logger) -> "RospyLeg":
    """Join ROS 1: `connect` has the URI of its master, or is () for the one in ROS_MASTER_URI.

    Waits for the master, and says so. Raises TfbusError if rospy is not there, or if ROS has
    a node of this name.
    """
    if settings.connect:
        os.environ["ROS_MASTER_URI"] = settings.connect[0]
    master = os.environ.setdefault("ROS_MASTER_URI", DEFAULT_MASTER)
    try:
        client = Ros1Master(master, settings.full_name)
    except OSError as error:
        raise SettingsError(str(error)) from error
    # Read by rospy when it is imported.
    os.environ["ROS_NAMESPACE"] = f"/{settings.namespace}"
    rospy = _imported_rospy()
    _check_addresses()
    _wait_for_master(client, master, log)
    _check_name_is_free(client, settings.full_name)
    level, handlers = log.level, list(logging.getLogger().handlers)
    # Signals and time are the node's affair; rospy's log goes to its own file.
    rospy.init_node(
        settings.node,
        argv=[],
        disable_signals=True,
        disable_rostime=True,
        disable_rosout=True,
    )
    # ROS's configuration gives the root logger handlers of its own.
    logging.getLogger().handlers[:] = handlers
    log.setLevel(level)
    return RospyLeg(rospy, master, settings.full_name, log)


def _imported_rospy() -> Any:
    try:
        return import_module("rospy")
    except ImportError as error:
        # It is Python alone, so that the system's works in a virtual environment, too. Behind all
        # other folders, since the system's further packages may be older.
        sys.path += [folder for folder in _FOLDERS if Path(folder, "rospy").is_dir()]
        try:
            return import_module("rospy")
        except ImportError:
            raise TfbusError(
                f"rospy is not installed ({error}): 'apt-get install python3-rospy' in Debian and "
                "Ubuntu, or source the setup.bash of ROS Noetic"
            ) from error


def _check_addresses() -> None:
    """rospy looks for the addresses of this host late, and its threads die if it cannot."""
    network = import_module("rosgraph.network")
    try:
        network.get_host_name()
        if os.environ.get("ROS_HOSTNAME") == "localhost":
            network.get_local_addresses()
    except ImportError as error:
        raise TfbusError(
            f"rospy does not find the addresses of this host ({error}): 'apt-get install "
            f"python3-netifaces', '{sys.executable} -m pip install netifaces' in a virtual "
            "environment, or set ROS_IP to the address of this host"
        ) from error


def _wait_for_master(client: Ros1Master, master: str, log: logging.Logger) -> None:
    said = False
    while True:
        try:
            client.call("getPid")
            return
        except OSError as error:
            if not said:
                why = error.strerror or error
                log.warning("Waiting for the ROS master at %s (%s)", master, why)
            said = True
        time.sleep(_POLL_EVERY_S / 2)


def _check_name_is_free(master: Ros1Master, name: str) -> None:
    """ROS would end the node that has the name already."""
    try:
        uri = str(master.call("lookupNode", name))
        pid = Ros1Master(uri, name).call("getPid")
    except OSError:
        return  # it is not there, or was killed
    raise TfbusError(
        f"ROS has a node {name} already (pid {pid} at {uri}): give this one another name by --name"
    )


class RospyLeg:
    """The process as a node of ROS 1; a process can be only one, once.

    ROS 1 does not tell publishers apart within a node: their gid is the name of the node, in
    hexadecimal. Messages that are retained are latched: of each node the last one.
    """

    name = "rospy"
    tells_publishers = True

    def __init__(self, rospy: Any, master: str, full_name: str, log: logging.Logger) -> None:
        self._rospy = rospy
        self._uri = master
        self._full_name = full_name
        self._log = log
        self._once = LogOnce(log)
        self._lock = threading.Lock()
        self._ends: dict[tuple[str, str], list[RospySender | RospySubscription]] = {}
        self._state_lock = threading.Lock()
        self._publishers: Mapping[str, Sequence[str]] = {}
        self._is_simulated = False
        self._is_there = True
        # The master forgets no node that was killed: nodes whose topics are asked for are called.
        self._asked: set[str] = set()
        self._dead: frozenset[str] = frozenset()
        self._closed = threading.Event()
        with suppress(OSError):  # the thread that watches it says so
            self._take_state(self._new_master())
        # A master or node that does not answer holds up its thread alone.
        self._threads = [
            threading.Thread(target=run, name=f"{full_name} {what}", daemon=True)
            for run, what in ((self._watch_master, "master"), (self._watch_nodes, "nodes"))
        ]
        for thread in self._threads:
            thread.start()

    def publisher(self, topic: RosTopic) -> "RospySender":
        """Begin to publish a topic."""
        return RospySender(self, self._rospy, topic, _gid(self._full_name))

    def subscribe(self, topic: RosTopic, on_message: OnMessage) -> "RospySubscription":
        """Call `on_message(payload, gid)` on rospy's threads, one at a time."""
        return RospySubscription(self, self._rospy, topic, on_message, self._full_name, self._once)

    def publishers(self, topic: str) -> Sequence[RosPublisher]:
        """The publishers of others that the master knew when it was last asked, or that have sent
        since, and that answer. While it is gone they are as they were.
        """
        with self._state_lock:
            self._asked.add(topic)
            nodes = self._publishers.get(topic, ())
            away = {self._full_name, *self._dead}
        return [RosPublisher(_gid(node), node) for node in nodes if node not in away]

    def lost(self) -> Mapping[str, int]:
        """Nothing: messages of ROS 1 have no numbers, and its queues do not count their drops."""
        return {}

    def warnings(self) -> Sequence[str]:
        """Notes on the time of ROS 1."""
        if not self._is_simulated:
            return ()
        return ("/use_sim_time is set in ROS: nodes there follow the topic /clock",)

    def close(self) -> None:
        """Leave ROS 1. Twice is fine."""
        self._closed.set()
        with self._lock:
            ends = [end for of_topic in self._ends.values() for end in of_topic]
        for end in ends:
            end.close()
        self._rospy.signal_shutdown("the bridge ends")
        for thread in self._threads:
            if threading.current_thread() is not thread:
                thread.join(_ANSWER_WITHIN_S)

    def began(self, kind: str, name: str, end: "RospySender | RospySubscription") -> None:
        """An end of a connection began."""
        with self._lock:
            self._ends.setdefault((kind, name), []).append(end)

    def ended(self, kind: str, name: str, end: "RospySender | RospySubscription") -> None:
        """It ended."""
        with self._lock:
            ends = self._ends.get((kind, name), [])
            if end in ends:
                ends.remove(end)
            if not ends:
                self._ends.pop((kind, name), None)

    def heard(self, topic: str, node: str) -> None:
        """A node has sent a message on a topic; the master may not have told of it yet."""
        if node in self._publishers.get(topic, ()) and node not in self._dead:
            return
        with self._state_lock:
            nodes = self._publishers.get(topic, ())
            if node not in nodes:
                self._publishers = {**self._publishers, topic: [*nodes, node]}
            self._dead -= {node}

    def _new_master(self) -> Ros1Master:
        return Ros1Master(self._uri, self._full_name, _ANSWER_WITHIN_S)

    def _take_state(self, master: Ros1Master) -> Ros1State:
        state = master.state()
        try:
            is_simulated = master.call("getParam", "/use_sim_time") is True
        except OSError:
            is_simulated = False
        with self._state_lock:
            self._publishers = state.publishers
            self._is_simulated = is_simulated
        return state

    # The master may be started again: then it knows nothing of this node.

    def _watch_master(self) -> None:
        master = self._new_master()
        while not self._closed.wait(_POLL_EVERY_S):
            if self._rospy.is_shutdown():
                self._log.error(
                    "ROS has ended this node: another one took its name, %s; give one of them "
                    "another by --name",
                    self._full_name,
                )
                return
            try:
                state = self._take_state(master)
            except OSError as error:
                if self._is_there:
                    self._log.warning("The ROS master at %s is gone (%s)", self._uri, error)
                self._is_there = False
                continue
            if not self._is_there:
                self._log.info("The ROS master at %s is back", self._uri)
            self._is_there = True
            try:
                self._register_missing(master, state)
            except OSError as error:
                self._once.warning("register", "Could not register in ROS again: %s", error)

    def _watch_nodes(self) -> None:
        master = self._new_master()
        while not self._closed.wait(_POLL_EVERY_S):
            if self._is_there:
                with suppress(OSError):  # the master is gone: then all nodes are as they were
                    self._call_nodes(master)

    def _call_nodes(self, master: Ros1Master) -> None:
        with self._state_lock:
            nodes = {node for topic in self._asked for node in self._publishers.get(topic, ())}
        dead = set()
        for node in nodes - {self._full_name}:
            if self._closed.is_set():
                return
            if not self._answers(master, node):
                dead.add(node)
        if dead:
            master.call("getPid")
        with self._state_lock:
            self._dead = frozenset(dead)

    def _answers(self, master: Ros1Master, node: str) -> bool:
        try:
            uri = str(master.call("lookupNode", node))
            Ros1Master(uri, self._full_name, _ANSWER_WITHIN_S).call("getPid")
        except OSError:
            return False
        return True

    def _register_missing(self, master: Ros1Master, state: Ros1State) -> None:
        with self._lock:
            ends = {key: of_topic[0] for key, of_topic in self._ends.items()}
        uri = self._rospy.get_node_uri()
        for (kind, name), end in ends.items():
            if kind == "pub" and self._full_name not in state.publishers.get(name, ()):
                master.call("registerPublisher", name, end.type_name, uri)
            elif kind == "sub" and self._full_name not in state.subscribers.get(name, ()):
                uris = master.call("registerSubscriber", name, end.type_name, uri)
                # As the master does it when a publisher comes.
                Ros1Master(uri, "/master").call("publisherUpdate", name, uris)


class RospySender:
    """A publisher of rospy's, of messages that are bytes already."""

    def __init__(self, leg: RospyLeg, rospy: Any, topic: RosTopic, gid: str) -> None:
        self._leg = leg
        self._name = topic.name
        self._type = ros1_type(topic.definition)
        self._lock = threading.Lock()
        self._class = _message_class(self._type)
        self.type_name = self._type.name
        self.gid = gid
        # Sent on threads of rospy's: a subscriber that has stopped holds up no other.
        self._publisher = rospy.Publisher(
            topic.name, self._class, latch=topic.retained, queue_size=topic.depth, tcp_nodelay=True
        )
        self._exception = rospy.ROSException
        leg.began("pub", topic.name, self)

    @property
    def heard(self) -> bool:
        """Whether a node is connected to it."""
        return bool(self._publisher.get_num_connections())

    def send(self, payload: bytes) -> None:
        """Publish one message in CDR."""
        with self._lock:
            message = self._class()
            message.payload = self._type.of_cdr(payload)
            try:
                self._publisher.publish(message)
            except self._exception as error:
                raise TfbusError(f"could not publish {self._name} in ROS: {error}") from error

    def close(self) -> None:
        """End it. Twice is fine."""
        self._leg.ended("pub", self._name, self)
        self._publisher.unregister()


class RospySubscription:
    """A subscriber of rospy's, whose messages stay bytes."""

    def __init__(
        self,
        leg: RospyLeg,
        rospy: Any,
        topic: RosTopic,
        on_message: OnMessage,
        own_name: str,
        once: LogOnce,
    ) -> None:
        self._leg = leg
        self._name = topic.name
        self._own_name = own_name
        # Each connection has a thread of its own.
        self._calls = Calls(on_message)
        self._once = once
        self._type = ros1_type(topic.definition)
        self.type_name = self._type.name
        self._subscriber = rospy.Subscriber(
            topic.name,
            _message_class(self._type),
            self._receive,
            # None: of the 64 kB that rospy reads at once it would drop all but so many messages.
            # Unread ones wait at the publisher.
            queue_size=None,
            tcp_nodelay=True,
        )
        leg.began("sub", topic.name, self)

    def close(self) -> None:
        """End it. Twice is fine."""
        self._calls.close()
        self._leg.ended("sub", self._name, self)
        self._subscriber.unregister()

    def _receive(self, message: Any) -> None:
        node = str(message._connection_header.get("callerid", ""))
        if node == self._own_name:
            return
        self._leg.heard(self._name, node)
        try:
            self._calls.call(self._type.to_cdr(message.payload), _gid(node))
        except DecodeError as error:
            self._once.warning(
                ("decode", self._name, node),
                "Dropped a message of %s on %s: %s",
                node,
                self._name,
                error,
            )
        except Exception as error:
            # rospy says so in a file of its own only.
            self._once.warning("taking", "A message from ROS was not taken: %s", error)


def _gid(node: str) -> str:
    return node.encode().hex()


def _message_class(type_: Ros1Type) -> type:
    """A class of messages for rospy, whose content is the bytes."""
    import genpy

    class Payload(genpy.Message):  # type: ignore[misc]  # genpy has no types
        __slots__ = ("payload",)
        _slot_types = ("",)
        _type = type_.name
        _full_text = type_.text
        _md5sum = type_.md5
        _has_header = False

        def __init__(self) -> None:
            self.payload = b""

        def serialize(self, buff: Any) -> None:
            buff.write(self.payload)

        def deserialize(self, data: bytes) -> "Payload":
            self.payload = bytes(data)
            return self

    return Payload
