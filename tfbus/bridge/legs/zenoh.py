"""The leg by rmw_zenoh's wire: ROS 2 over Zenoh, without ROS on the machine."""

import itertools
import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from tfbus.bridge.legs import (
    Endable,
    LegSettings,
    LostMessages,
    OnMessage,
    RosPublisher,
    RosSender,
    RosTopic,
)
from tfbus.bus.ros_session import Publication, RosSession, sender_of
from tfbus.errors import TfbusError
from tfbus.ros.rmw import type_hash
from tfbus.ros.ros_names import domain_of
from tfbus.runtime.installation import install_command
from tfbus.runtime.log_once import LogOnce
from tfbus.wording import printable

try:
    from tfbus.bridge.legs.zenoh_graph import RosGraph
    from tfbus.ros.rmw_zenoh import (
        GRAPH,
        NO_TYPE_HASH,
        Kind,
        Qos,
        RosToken,
        attachment_writer,
        check_node_name,
        check_topic_name,
        data_key,
        dds_type_name,
        gid_of,
        has_named_fields,
        number_in,
        read_attachment,
        source_in,
        wire_of,
    )
except ModuleNotFoundError as error:
    if error.name != "xxhash":
        raise
    raise TfbusError(
        f"ROS 2 over Zenoh needs xxhash, which is not installed: {install_command('ros2')}"
    ) from error

# Of publishers that are gone, too: beyond this many all are looked up again.
_MOST_SOURCES = 10_000


def open_leg(settings: LegSettings, log: logging.Logger) -> "ZenohLeg":
    """Join ROS through its Zenoh router, which may start later.

    Raises SettingsError for an unknown distribution, a domain or an endpoint that is none, and
    InvalidNameError for the name of a node that ROS does not take.
    """
    return ZenohLeg(settings, log)


class ZenohLeg:
    """A node in ROS over Zenoh, until `close()`; see `tfbus.bridge.legs.Leg`.

    If no router answers it keeps trying, and declares then what was asked for meanwhile.
    """

    name = "rmw_zenoh"
    tells_publishers = True

    def __init__(self, settings: LegSettings, log: logging.Logger) -> None:
        check_node_name(settings.node, settings.namespace)
        self._wire = wire_of(settings.distro)
        self._settings = settings
        self.domain = domain_of(settings.domain)
        self.lost_messages = LostMessages()
        self._once = LogOnce(log)
        self._session = RosSession(settings.connect, log)
        self.graph = RosGraph(self.domain, self._session.id)
        self._numbers = itertools.count(1)
        self._own_gids: set[bytes] = set()
        # The gids of publishers by how their messages name them.
        self._by_source: dict[bytes, str] = {}
        self._topics: dict[str, tuple[str, str, str]] = {}
        self._has_seen_named_fields = False
        # Messages without an attachment of rmw_zenoh's.
        self.dropped = 0
        # The graph first, so that messages come from known publishers.
        self._session.watch_living_when_open(f"{GRAPH}/**", self.graph.on_token)
        self._session.token_when_open(self._token("NN"))

    def publisher(self, topic: RosTopic) -> RosSender:
        """Begin to publish a topic. Raises InvalidNameError for a name that ROS does not take."""
        key = self._key(topic)
        token = self._token("MP", topic)
        gid = gid_of(token)
        self._own_gids.add(gid)
        retained = topic.depth if topic.retained else 0
        publication = self._session.publication(key, retained=retained)
        declared = self._session.token_when_open(token)

        def close() -> None:
            # The token first: ROS forgets the publisher before its messages end.
            self._session.end(declared)
            self._session.end(publication)

        return ZenohSender(publication, gid, named=self._wire.has_named_fields, close=close)

    def subscribe(self, topic: RosTopic, on_message: OnMessage) -> Endable:
        """Call `on_message(payload, gid)` for each message of others on a topic. Errors as of
        `publisher`.
        """
        key = self._key(topic)
        subscription = ZenohSubscription(on_message)

        def on_sample(payload: bytes, attachment: bytes | None, sample: Any) -> None:
            gid = attachment and self._by_source.get(source_in(attachment))
            if not gid or gid not in self.graph.gids:
                gid = self._publisher_of(topic.name, attachment, sample)
            if gid and attachment:
                self.lost_messages.came(topic.name, gid, number_in(attachment))
                subscription.call(payload, gid)

        token = self._token("MS", topic)
        declared = self._session.token_when_open(token)
        heard = self._session.subscription(key, on_sample, retained=topic.retained)

        def undeclare() -> None:
            self._session.end(declared)
            self._session.end(heard)

        subscription.undeclare = undeclare
        return subscription

    def publishers(self, topic: str) -> Sequence[RosPublisher]:
        """The publishers of a topic that are there now, its own ones left out."""
        return self.graph.publishers(topic)

    def lost(self) -> Mapping[str, int]:
        """How many messages of each topic were lost, by their numbers."""
        return self.lost_messages.counts

    def warnings(self) -> Sequence[str]:
        """Notes on the ROS around, for the user."""
        if trouble := self._session.trouble:
            return [trouble]
        found = self.graph.mismatches(list(self._topics.values()))
        if others := self.graph.other_domains():
            found.append(
                f"ROS has no nodes in domain {self.domain}, but in domain "
                f"{', '.join(map(str, others[:5]))}: give --domain {others[0]} to reach them"
            )
        if self._has_seen_named_fields and not self._wire.has_named_fields:
            found.append(
                "ROS has an rmw_zenoh before 0.2.4, which does not read what later ones write: "
                "update it, or give --distro jazzy-0.2.3"
            )
        return found

    def close(self) -> None:
        """Leave ROS. Twice is fine."""
        self._session.close()

    def _key(self, topic: RosTopic) -> str:
        check_topic_name(topic.name)
        dds_type = dds_type_name(topic.definition.name)
        hashed = self._hash(topic)
        self._topics[topic.name] = (topic.name, dds_type, hashed)
        return data_key(self.domain, topic.name, dds_type, hashed)

    def _hash(self, topic: RosTopic) -> str:
        return type_hash(topic.definition) if self._wire.has_type_hashes else NO_TYPE_HASH

    def _token(self, kind: Kind, topic: RosTopic | None = None) -> str:
        number = "0" if topic is None else str(next(self._numbers))
        namespace = f"/{self._settings.namespace}"
        node = self._settings.node
        token = RosToken(self.domain, self._session.id, "0", number, kind, node, namespace)
        if topic is not None:
            token = replace(
                token,
                topic=topic.name,
                dds_type=dds_type_name(topic.definition.name),
                type_hash=self._hash(topic),
                qos=Qos(topic.retained, topic.depth).text,
            )
        return token.text

    def _publisher_of(self, topic: str, attachment: bytes | None, sample: Any) -> str:
        """The gid of the publisher of a message; "" if this session has sent it, or the message
        has none.
        """
        read = None if attachment is None else read_attachment(attachment)
        if attachment is None or read is None:
            self._drop(topic, attachment)
            return ""
        if read.gid in self._own_gids:
            return ""
        self._has_seen_named_fields |= has_named_fields(attachment)
        gid = read.gid.hex()
        self.graph.heard(topic, gid, lambda: sender_of(sample))
        if gid in self.graph.gids:
            if len(self._by_source) >= _MOST_SOURCES:
                self._by_source.clear()
            self._by_source[source_in(attachment)] = gid
        return gid

    def _drop(self, topic: str, attachment: bytes | None) -> None:
        self.dropped += 1
        what = "no attachment" if attachment is None else "an attachment that is not rmw_zenoh's"
        self._once.warning(
            ("attachment", topic),
            "Dropped a message on %s in ROS: it has %s, so that no ROS node takes it either",
            printable(topic),
            what,
        )


class ZenohSender:
    """Publishes one topic."""

    def __init__(
        self, publication: Publication, gid: bytes, *, named: bool, close: Callable[[], None]
    ) -> None:
        self.gid = gid.hex()
        self._attachment = attachment_writer(gid, named=named)
        self._publication = publication
        self._close = close
        self._lock = threading.Lock()
        self._sequence = 0

    @property
    def heard(self) -> bool:
        """Whether another process subscribes to the topic."""
        return self._publication.heard

    def send(self, payload: bytes) -> None:
        """Publish one message in CDR, with its header. Safe from any thread. Raises BusError if it
        is closed.
        """
        with self._lock:
            # From 1, as rmw_zenoh counts.
            self._sequence += 1
            self._publication.put(payload, self._attachment(self._sequence, time.time_ns()))

    def close(self) -> None:
        """End it. Twice is fine."""
        self._close()


class ZenohSubscription:
    """Calls back for one message after the other, until it ends."""

    def __init__(self, on_message: OnMessage) -> None:
        self._on_message: OnMessage | None = on_message
        # Messages of several links come on as many threads. A call may close it.
        self._lock = threading.RLock()
        self.undeclare: Callable[[], None] = lambda: None

    def call(self, payload: bytes, gid: str) -> None:
        """A message has come."""
        with self._lock:
            on_message = self._on_message
            if on_message is not None:
                on_message(payload, gid)

    def close(self) -> None:
        """End it: no call begins after that. Twice is fine."""
        self._on_message = None
        with self._lock:
            pass  # a call under way has ended
        self.undeclare()
