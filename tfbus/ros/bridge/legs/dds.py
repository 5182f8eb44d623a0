"""The leg over DDS, with Cyclone DDS from PyPI, and its configuration; the machine needs no ROS."""

import logging
import os
import re
import socket
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from tfbus.base.errors import SettingsError, TfbusError
from tfbus.base.installation import install_command
from tfbus.base.log import LogOnce
from tfbus.base.wording import did_you_mean, listed, printable
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
from tfbus.ros.definitions import Definition
from tfbus.ros.rmw import (
    GID_SIZE,
    GRAPH_TOPIC,
    HUMBLE_GID_SIZE,
    NodeEntities,
    ParticipantNodes,
    dds_topic,
    dds_type,
    domain_of,
    encode_nodes,
    graph_definition,
    type_hash,
)

try:
    from cyclonedds.core import (
        DDSException,
        Entity,
        GuardCondition,
        Policy,
        Qos,
        ReadCondition,
        WaitSet,
    )
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.internal import DDS
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    from tfbus.ros.bridge.legs.dds_watch import ANY, MOST_TAKEN, DdsWatch, RawSample, raw_type
except ImportError as error:
    raise TfbusError(
        "ROS 2 by DDS needs cyclonedds, which is not installed, and has no wheel for Python 3.14 "
        f"and later: {install_command('ros2')}"
    ) from error

# Nodes of ROS may be found as late as this: they announce themselves every 3 s, and on Wi-Fi some
# of that is lost.
_DISCOVERY_S = 10.0

# The levels that Cyclone prints, as in its dds/ddsrt/log.h. A trace by CYCLONEDDS_URI has all.
_FATAL, _ERROR, _WARNING = 1, 2, 4

_HUMBLE_AND_BEFORE = ("foxy", "galactic", "humble")
_DISTROS = (*_HUMBLE_AND_BEFORE, "iron", "jazzy", "kilted", "lyrical", "rolling")


def open_leg(settings: LegSettings, log: logging.Logger) -> "DdsLeg":
    """Join ROS 2 by DDS. Raises TfbusError if it cannot be joined."""
    if settings.distro and settings.distro not in _DISTROS:
        raise SettingsError(
            f"unknown distribution of ROS 2 over DDS {printable(settings.distro, 40)!r}"
            f"{did_you_mean(settings.distro, _DISTROS)}"
        )
    return DdsLeg(settings, log)


class _Domains:
    """The domains of this process, each with its configuration, for as long as a leg is there."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._domains: dict[int, tuple[Domain, int]] = {}

    def acquire(self, number: int, config: str) -> None:
        """Make it, or use that which is there. Raises DDSException if it cannot be made."""
        with self._lock:
            domain, users = self._domains.get(number) or (_domain(number, config), 0)
            self._domains[number] = domain, users + 1

    def release(self, number: int) -> None:
        """End it with its last user."""
        with self._lock:
            domain, users = self._domains.pop(number)
            if users > 1:
                self._domains[number] = domain, users - 1


_DOMAINS = _Domains()


def _domain(number: int, config: str) -> Domain:
    """A domain. Cyclone prints why there is none; later it would print, for each message, that a
    host is not reached.
    """
    say = DDS._dll_handle.dds_set_log_mask
    say(_FATAL | _ERROR | _WARNING)
    domain = Domain(number, config)
    say(_FATAL)
    return domain


class DdsSender:
    """A writer."""

    def __init__(self, leg: "DdsLeg", topic: RosTopic, writer: DataWriter[RawSample]) -> None:
        self.gid = writer.guid.hex
        self._leg = leg
        self._topic = topic.name
        self._sample = writer.data_type
        self.writer: DataWriter[RawSample] | None = writer

    @property
    def heard(self) -> bool:
        """Whether a reader matches."""
        writer = self.writer
        try:
            return writer is not None and bool(writer.get_matched_subscriptions())
        except DDSException:
            return False  # it has been closed meanwhile

    def send(self, payload: bytes) -> None:
        """Publish one message. Raises TfbusError if it is none of the topic's type."""
        writer = self.writer
        if writer is None:
            raise TfbusError(f"the publisher of {self._topic} is closed")
        try:
            writer.write(self._sample(payload))
        except DDSException as error:
            raise TfbusError(f"DDS does not take the message for {self._topic}: {error}") from error

    def close(self) -> None:
        """It is gone, with its kept messages."""
        writer, self.writer = self.writer, None
        if writer is not None:
            self._leg.drop_sender(self, writer)


class DdsSubscription:
    """A reader."""

    def __init__(
        self, leg: "DdsLeg", topic: RosTopic, reader: DataReader[RawSample], on_message: OnMessage
    ) -> None:
        self.gid = reader.guid.hex
        self.topic = topic
        self.condition = ReadCondition(reader, ANY)
        self._depth = max(topic.depth, LEAST_READER_DEPTH)
        self._leg = leg
        self._reader: DataReader[RawSample] | None = reader
        self._calls = Calls(on_message)
        # Held while it takes messages from the reader.
        self._lock = threading.Lock()

    def receive(self, watch: "DdsWatch") -> None:
        """Hand on all that is there."""
        while taken := self._taken():
            for sample in taken:
                if sample.sample_info.valid_data:
                    gid = watch.gid_of(sample.sample_info.publication_handle)
                    self._leg.safely(self._calls.call, sample.data, gid)

    def close(self) -> None:
        """It takes no message after this."""
        reader, self._reader = self._reader, None
        if reader is not None:
            with self._lock:
                pass  # none is being taken
            self._calls.close()
            self._leg.drop_subscription(self, reader)

    def _taken(self) -> Sequence[RawSample]:
        with self._lock:
            reader = self._reader
            if reader is None:
                return []
            taken = list(reader.take(min(MOST_TAKEN, self._depth)))
            if MOST_TAKEN <= len(taken) < self._depth:
                taken += reader.take(self._depth - MOST_TAKEN)
        if len(taken) >= self._depth:
            # Cyclone does not count the messages that give way in a full history.
            self._leg.lost_messages.was_full(self.topic.name)
        return taken


class DdsLeg:
    """A participant with one node."""

    name = "DDS"
    tells_publishers = True

    def __init__(self, settings: LegSettings, log: logging.Logger) -> None:
        self._settings = settings
        self.lost_messages = LostMessages()
        self._log_once = LogOnce(log)
        self._number = domain_of(settings.domain)
        self._gid_size = HUMBLE_GID_SIZE if settings.distro in _HUMBLE_AND_BEFORE else GID_SIZE
        others = udp_sockets()
        try:
            _DOMAINS.acquire(self._number, configuration(settings.connect, log))
        except DDSException as error:
            raise TfbusError(
                f"DDS cannot join domain {self._number}{_by(settings.connect)}; Cyclone DDS says "
                f"why above: {error}"
            ) from error
        try:
            self._join()
        except DDSException as error:
            _DOMAINS.release(self._number)
            raise TfbusError(f"DDS cannot join domain {self._number}: {error}") from error
        self.sockets = udp_sockets() - others

    def _join(self) -> None:
        # This makes a participant one of ROS, and names its enclave.
        enclave = Policy.Userdata(b"enclave=/;")
        self._participant = DomainParticipant(self._number, qos=Qos(enclave))
        self.gid = self._participant.guid
        self._joined_s = time.monotonic()
        # Of the fields below, and of their announcement to ROS.
        self._lock = threading.RLock()
        self._closing = False
        self._topics: dict[tuple[str, type[RawSample]], Topic[RawSample]] = {}
        self._senders: list[DdsSender] = []
        self._subscriptions: list[DdsSubscription] = []
        graph = RosTopic(GRAPH_TOPIC, graph_definition(self._gid_size), retained=True, depth=1)
        topic = self._topic(GRAPH_TOPIC, graph.definition)
        others = Qos(Policy.History.KeepAll, base=_qos(graph) + _IGNORING_OWN)
        self.graph = DataWriter(self._participant, topic, qos=_qos(graph))
        nodes = DataReader(self._participant, topic, qos=others)
        self.watch = DdsWatch(self._participant, nodes, self._gid_size)
        self._tell_nodes()
        self._waits = WaitSet(self._participant)
        self._end = GuardCondition(self._participant)
        for condition in (self._end, *self.watch.conditions):
            self._waits.attach(condition)
        self._thread = threading.Thread(target=self._run, name="tfbus-dds", daemon=True)
        self._thread.start()

    def publisher(self, topic: RosTopic) -> RosSender:
        """Begin to publish a topic."""
        with self._lock:
            hashed = f"typehash={type_hash(topic.definition)};".encode()
            qos = Qos(Policy.Userdata(hashed), base=_qos(topic))
            writer = DataWriter(self._participant, self._ros_topic(topic), qos=qos)
            sender = DdsSender(self, topic, writer)
            self._senders.append(sender)
            self._tell_nodes()
        return sender

    def subscribe(self, topic: RosTopic, on_message: OnMessage) -> Endable:
        """Call `on_message(payload, gid)` for each message of others on a topic."""
        with self._lock:
            hashed = f"typehash={type_hash(topic.definition)};".encode()
            qos = Qos(
                Policy.Userdata(hashed),
                Policy.History.KeepLast(max(topic.depth, LEAST_READER_DEPTH)),
                base=_qos(topic) + _IGNORING_OWN,
            )
            reader = DataReader(self._participant, self._ros_topic(topic), qos=qos)
            subscription = DdsSubscription(self, topic, reader, on_message)
            self._subscriptions.append(subscription)
            self._waits.attach(subscription.condition)
            self._tell_nodes()
        return subscription

    def publishers(self, topic: str) -> Sequence[RosPublisher]:
        """The publishers of a topic that are there now, each once its node is known."""
        return [
            RosPublisher(each.gid, node)
            for each in self.watch.writers(dds_topic(topic))
            if (node := self.watch.node_of(each)) or self.watch.is_nameless(each)
        ]

    def lost(self) -> Mapping[str, int]:
        """How many messages of each topic were lost, one if there may be many."""
        return self.lost_messages.counts

    def warnings(self) -> Sequence[str]:
        """Sentences: that there is no ROS, publishers that are not heard, drops of the system."""
        with self._lock:
            topics = [each.topic for each in self._subscriptions]
        # Some programs speak ROS's DDS and tell no node.
        if not self.watch.sees_ros and not self._has_writers(topics):
            if time.monotonic() < self._joined_s + _DISCOVERY_S:
                return []
            return [
                f"No ROS 2 node is seen by DDS in domain {self._number}: the domain, and the "
                "network interface or hosts that --ros-connect names, must be those of ROS"
            ]
        return [*self._dropped(), *(said for topic in topics for said in self._unheard(topic))]

    def _dropped(self) -> Sequence[str]:
        if not dropped_datagrams(self.sockets):
            return []
        return [
            "This process was too slow for what came by DDS, and the system has dropped some of "
            "it: messages that their publishers did not keep until it caught up are lost, and DDS "
            "does not tell how many; give it more CPU, or raise net.core.rmem_max"
        ]

    def _has_writers(self, topics: Sequence[RosTopic]) -> bool:
        return any(self.watch.writers(dds_topic(each.name)) for each in topics)

    def drop_sender(self, sender: DdsSender, writer: DataWriter[RawSample]) -> None:
        """It is closed."""
        with self._lock:
            if sender in self._senders:
                self._senders.remove(sender)
                self._tell_nodes()
                _end(writer)

    def drop_subscription(
        self, subscription: DdsSubscription, reader: DataReader[RawSample]
    ) -> None:
        """It is closed."""
        with self._lock:
            if subscription in self._subscriptions:
                self._subscriptions.remove(subscription)
                self._waits.detach(subscription.condition)
                self._tell_nodes()
                _end(subscription.condition)
                _end(reader)

    def close(self) -> None:
        """Leave ROS."""
        with self._lock:
            if self._closing:
                return
            self._closing = True
        self._end.set(True)
        if threading.current_thread() is not self._thread:
            self._thread.join()
        with self._lock:
            ends: list[Endable] = [*self._senders, *self._subscriptions]
        for each in ends:
            each.close()
        for condition in (self._end, *self.watch.conditions):
            self._waits.detach(condition)
        # With all that it has.
        _end(self._participant)
        _DOMAINS.release(self._number)

    def _run(self) -> None:
        while True:
            self._waits.wait(duration(infinite=True))
            if self._closing:
                return
            # Publishers come before their messages.
            self.safely(self.watch.update)
            with self._lock:
                subscriptions = list(self._subscriptions)
            for each in subscriptions:
                self.safely(each.receive, self.watch)

    def safely(self, call: Any, *values: Any) -> None:
        """Call it; an exception is logged, the first time, and costs only this call."""
        try:
            call(*values)
        except Exception as error:
            self._log_once.warning("taking", "A message from ROS was not taken: %s", error)

    def _ros_topic(self, topic: RosTopic) -> "Topic[RawSample]":
        return self._topic(dds_topic(topic.name), topic.definition)

    def _topic(self, name: str, definition: Definition) -> "Topic[RawSample]":
        key = name, raw_type(definition)
        if key not in self._topics:
            self._topics[key] = Topic(self._participant, *key)
        return self._topics[key]

    def _tell_nodes(self) -> None:
        """Tell ROS this node's endpoints; at the end the participant is gone with all of them."""
        if self._closing:
            return
        node = NodeEntities(
            self._settings.full_name,
            [bytes.fromhex(each.gid) for each in self._subscriptions],
            [bytes.fromhex(each.gid) for each in self._senders],
        )
        info = encode_nodes(ParticipantNodes(self.gid.bytes, [node]), self._gid_size)
        self.graph.write(self.graph.data_type(info))

    def _unheard(self, topic: RosTopic) -> Sequence[str]:
        """Publishers of a topic that does not come here."""
        offers = [
            Offer(self.watch.node_of(each), each.type, each.is_reliable, each.is_retained)
            for each in self.watch.writers(dds_topic(topic.name))
        ]
        return unheard(topic, dds_type(topic.definition.name), offers)


def _end(entity: Entity) -> None:
    """End it now: cyclonedds would wait for the last reference, and ROS then for the end of the
    lease.
    """
    entity.__del__()


def _by(connect: Sequence[str]) -> str:
    return f" by {listed([printable(each, 60) for each in connect])}" if connect else ""


def _qos(topic: RosTopic) -> Qos:
    return Qos(
        Policy.Reliability.Reliable(duration(milliseconds=100)),
        Policy.Durability.TransientLocal if topic.retained else Policy.Durability.Volatile,
        Policy.History.KeepLast(topic.depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


_IGNORING_OWN = Qos(Policy.IgnoreLocal.Participant)


# Cyclone refuses Fast DDS 3's descriptions of types, and then matches nothing of it: for these
# vendors (Connext, Fast DDS, Cyclone itself) the name of a type decides, as everywhere in ROS.
_VENDORS = "1.1,1.15,1.16"

# At most the messages of the history are not confirmed by a reader; more than this many bytes of
# them would make a writer wait, and all of Python with it.
_MOST_WAITING = "256 MB"

# A host, in brackets where it is an address of IPv6, and a port.
_PEER = re.compile(r"(?:udp6?/)?(?:\[([^]]*)\]|([^:]*|[^:]*:[^:]*:.*?))(?::(\d{1,5}))?")
_MOST_PORT = 65535


def configuration(
    connect: Sequence[str], log: logging.Logger, environ: Mapping[str, str] = os.environ
) -> str:
    """The configuration of Cyclone DDS, as XML.

    `connect` are names of network interfaces to use, and hosts to ask if multicast does not
    reach them. Without any, it is as ROS's variables say: ROS_LOCALHOST_ONLY,
    ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_STATIC_PEERS. The settings of CYCLONEDDS_URI hold as well.

    Raises SettingsError if one of `connect` is neither; a host of ROS_STATIC_PEERS that is not
    found is left out, and logged.
    """
    here = {name for _, name in socket.if_nameindex()}
    interfaces = [each for each in connect if each in here]
    peers = [each for each in connect if each not in here]
    for each in peers:
        if mistake := _mistake_in_peer(each, environ):
            raise SettingsError(
                f"--ros-connect {printable(each, 60)!r}: {mistake}; by DDS it is a network "
                f"interface of this host ({listed(sorted(here))}), or the name or address of a "
                "host, as 192.168.1.7"
            )
    if not connect:
        peers = _static_peers(log, environ)
        if _is_local(environ):
            # ROS finds others on this host by their ports, not by multicast.
            interfaces, peers = ["127.0.0.1"], ["127.0.0.1", *peers]
    asked = _domain_xml(_general(interfaces) + _discovery(peers))
    return ",".join(filter(None, (_ALWAYS, environ.get("CYCLONEDDS_URI", "").strip(), asked)))


def _static_peers(log: logging.Logger, environ: Mapping[str, str]) -> list[str]:
    """The hosts of ROS_STATIC_PEERS that are found."""
    found = []
    for each in filter(None, map(str.strip, environ.get("ROS_STATIC_PEERS", "").split(";"))):
        if mistake := _mistake_in_peer(each, environ):
            shown = printable(each, 60)
            log.warning("ROS_STATIC_PEERS has %r, which is left out: %s", shown, mistake)
        else:
            found.append(each)
    return found


def _mistake_in_peer(peer: str, environ: Mapping[str, str]) -> str:
    """Why Cyclone cannot use a peer, "" if it can: it would abort the process."""
    parts = _PEER.fullmatch(peer)
    if parts is None or (parts[3] and not 0 < int(parts[3]) <= _MOST_PORT):
        return f"its port is not a number from 1 to {_MOST_PORT}"
    try:
        found = socket.getaddrinfo(parts[1] or parts[2] or "", None, _family(environ))
    except (OSError, ValueError) as error:
        # ValueError: a label of more than 63 letters, for example.
        reason = error.strerror if isinstance(error, OSError) else None
        return f"no host of this name is found ({printable(reason or str(error), 80)})"
    return "" if found else "no host of this name is found"


def _family(environ: Mapping[str, str]) -> socket.AddressFamily:
    """The kind of addresses that Cyclone uses: IPv4's, unless its configuration says otherwise."""
    uri = environ.get("CYCLONEDDS_URI", "")
    if "udp6" in uri:
        return socket.AF_INET6
    # A file may say so, too.
    return socket.AF_INET if "<" in uri or not uri.strip() else socket.AF_UNSPEC


def _is_local(environ: Mapping[str, str]) -> bool:
    reach = environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    return reach == "LOCALHOST" or (not reach and environ.get("ROS_LOCALHOST_ONLY") == "1")


def _domain_xml(text: str) -> str:
    return f'<CycloneDDS><Domain Id="any">{text}</Domain></CycloneDDS>' if text else ""


def _general(interfaces: Sequence[str]) -> str:
    if not interfaces:
        return ""
    listed = "".join(
        f"<NetworkInterface {'address' if each[0].isdigit() else 'name'}={quoteattr(each)}/>"
        for each in interfaces
    )
    return f"<General><Interfaces>{listed}</Interfaces></General>"


def _discovery(peers: Sequence[str]) -> str:
    if not peers:
        return ""
    listed = "".join(f"<Peer Address={quoteattr(each)}/>" for each in peers)
    # At a port that others try when they ask this host. Hosts are asked for as long as there is no
    # ROS on them: Cyclone would give up after 30 s.
    settings = (
        "<ParticipantIndex>auto</ParticipantIndex>"
        "<SPDPInterval>2 s</SPDPInterval>"
        "<InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay>"
    )
    return f"<Discovery>{settings}<Peers>{listed}</Peers></Discovery>"


_ALWAYS = _domain_xml(
    # A datagram has 14,720 bytes by default, and ten fragments of a large message in it, each with
    # a header and a step of its own.
    "<General><FragmentSize>14000 B</FragmentSize></General>"
    "<Compatibility>"
    f"<IgnoreTypeInformation>{_VENDORS}</IgnoreTypeInformation>"
    "</Compatibility>"
    # Without a hash of the key Fast DDS does not understand that a writer or a whole participant
    # ends: ROS would show it until its lease ends, for 10 s.
    "<Internal>"
    "<GenerateKeyhash>true</GenerateKeyhash>"
    # As much of this as the system allows (net.core.rmem_max) waits while the process gets no CPU;
    # the rest is lost if its publishers do not keep it. Only waiting bytes take memory.
    '<SocketReceiveBufferSize max="16 MiB"/>'
    f"<Watermarks><WhcHigh>{_MOST_WAITING}</WhcHigh></Watermarks>"
    "</Internal>"
)


_TABLES = ("/proc/self/net/udp", "/proc/self/net/udp6")
_OPEN_FILES = "/proc/self/fd"

# Columns of the tables.
_INODE, _DROPS = 9, 12


def udp_sockets() -> frozenset[str]:
    """The sockets for datagrams that this process has open, by their inodes."""
    own = set()
    with suppress(OSError):
        for name in os.listdir(_OPEN_FILES):
            with suppress(OSError):  # closed meanwhile
                own.add(os.readlink(f"{_OPEN_FILES}/{name}").removeprefix("socket:[")[:-1])
    return frozenset(own.intersection(row[_INODE] for row in _rows()))


def dropped_datagrams(sockets: frozenset[str]) -> int:
    """How many datagrams came to these sockets while so many waited that there was no room."""
    return sum(int(row[_DROPS]) for row in _rows() if row[_INODE] in sockets)


def _rows() -> Iterable[list[str]]:
    for table in _TABLES:
        with suppress(OSError):
            for line in Path(table).read_text(encoding="ascii").splitlines()[1:]:
                yield line.split()
