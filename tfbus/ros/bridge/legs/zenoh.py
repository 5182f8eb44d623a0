"""The leg by rmw_zenoh's wire: ROS 2 over Zenoh, without ROS on the machine.

Its graph of publishers, subscribers and nodes is made of their tokens.
"""

import itertools
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

from tfbus.base import scheduler
from tfbus.base.bounded import Bounded
from tfbus.base.errors import TfbusError
from tfbus.base.installation import install_command
from tfbus.base.log import LogOnce
from tfbus.base.wording import listed, printable
from tfbus.bus.ros_session import Publication, RosSession, sender_of
from tfbus.ros.bridge.legs import (
    Calls,
    Endable,
    LegSettings,
    LostMessages,
    OnMessage,
    RosPublisher,
    RosSender,
    RosTopic,
)
from tfbus.ros.rmw import domain_of, type_hash

try:
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
        read_token,
        ros_type_name,
        source_in,
        wire_of,
    )
except ModuleNotFoundError as error:
    if error.name != "xxhash":
        raise
    raise TfbusError(
        f"ROS 2 over Zenoh needs xxhash, which is not installed: {install_command('ros2')}"
    ) from error

# Tokens are strangers' to make up.
_MOST_TOKENS = 20_000
# So are gids.
_MOST_UNTOLD = 1000

# A message may be faster than the token of its publisher; a gid without one after this time is made
# up.
_MADE_UP_AFTER_S = 1.0


@dataclass
class _Untold:
    """A gid of messages that no token has: from which session they are, and since when."""

    session: str
    since_s: float
    # The token of the publisher that it is another gid of.
    token: str = ""


class RosGraph:
    """The tokens of others that are alive: tokens of the session `own` are left out."""

    def __init__(self, domain: int, own: str) -> None:
        # Tokens that are not of that form, or beyond the bound.
        self.dropped = 0
        self._domain = domain
        self._own = own
        self._lock = threading.Lock()
        self._elsewhere: Counter[int] = Counter()
        self._tokens: dict[str, RosToken] = {}
        self._publishers: dict[str, dict[str, RosPublisher]] = {}
        # The gids of all publishers.
        self.gids: set[str] = set()
        # By topic and gid.
        self._untold: Bounded[tuple[str, str], _Untold] = Bounded(_MOST_UNTOLD)

    def on_token(self, text: str, alive: bool) -> None:
        """A token has come, or is gone."""
        with self._lock:
            if not alive:
                self._forget(text)
            elif text not in self._tokens:
                token = read_token(text)
                if token is None or len(self._tokens) >= _MOST_TOKENS:
                    self.dropped += 1
                elif token.session != self._own:
                    self._add(text, token)

    def _add(self, text: str, token: RosToken) -> None:
        self._tokens[text] = token
        if token.domain != self._domain:
            self._elsewhere[token.domain] += 1
        elif token.kind == "MP":
            publisher = RosPublisher(gid_of(text).hex(), token.full_node_name)
            self._publishers.setdefault(token.topic, {})[text] = publisher
            self.gids.add(publisher.gid)
            self._untold.pop((token.topic, publisher.gid), None)

    def _forget(self, text: str) -> None:
        token = self._tokens.pop(text, None)
        if token is None:
            return
        if token.domain != self._domain:
            self._elsewhere[token.domain] -= 1
        elif publishers := self._publishers.get(token.topic):
            if publisher := publishers.pop(text, None):
                self.gids.discard(publisher.gid)
            if not publishers:
                del self._publishers[token.topic]

    def heard(self, topic: str, gid: str, session: Callable[[], str]) -> None:
        """A message has come by a gid that may have no token, from a session."""
        if gid in self.gids or (topic, gid) in self._untold:
            return
        with self._lock:
            if gid not in self.gids:
                self._untold[topic, gid] = _Untold(session(), scheduler.monotonic())

    def publishers(self, topic: str) -> list[RosPublisher]:
        """The publishers of a topic, in order of their gids. A publisher that puts other
        gids into its messages than its token's, as zenoh-ros2-sdk does, is there with these
        too, if its session has no other publisher of the topic.
        """
        with self._lock:
            there = self._publishers.get(topic, {})
            found = list(there.values())
            for (name, gid), untold in self._untold.items():
                if name == topic and (token := self._token_of(untold, there)):
                    found.append(RosPublisher(gid, there[token].node))
        return sorted(found, key=attrgetter("gid"))

    def _token_of(self, untold: _Untold, there: dict[str, RosPublisher]) -> str:
        """The token of a gid that has none of its own, "" if that is not known."""
        if untold.token not in there:
            untold.token = ""
            of_session = [each for each in there if self._tokens[each].session == untold.session]
            is_late = scheduler.monotonic() >= untold.since_s + _MADE_UP_AFTER_S
            if is_late and len(of_session) == 1:
                untold.token = of_session[0]
        return untold.token

    def other_domains(self) -> list[int]:
        """The domains that have nodes, if this graph's has none."""
        with self._lock:
            if sum(self._elsewhere.values()) < len(self._tokens):
                return []
            return sorted(+self._elsewhere)

    def mismatches(self, wanted: Sequence[tuple[str, str, str]]) -> list[str]:
        """A sentence for each topic of which nodes have another type than `wanted`: topics, each
        with its type on the wire and the hash of that.
        """
        with self._lock:
            tokens = [each for each in self._tokens.values() if each.domain == self._domain]
        found = []
        for topic, dds_type, hashed in wanted:
            others = [
                each
                for each in tokens
                if each.kind in ("MP", "MS")
                and each.topic == topic
                and (each.dds_type, each.type_hash) != (dds_type, hashed)
            ]
            if others:
                found.append(_mismatch(topic, dds_type, hashed, others))
        return found


def _mismatch(topic: str, dds_type: str, hashed: str, others: list[RosToken]) -> str:
    nodes = listed(sorted({printable(each.full_node_name, 60) for each in others}), most=3)
    alone = len({each.full_node_name for each in others}) == 1
    have, run = ("has", "runs") if alone else ("have", "run")
    first = others[0]
    if first.dds_type != dds_type:
        theirs = ros_type_name(first.dds_type) or printable(first.dds_type, 60)
        return f"{topic} does not cross: in ROS {nodes} {have} it as {theirs}"
    if first.type_hash == NO_TYPE_HASH:
        return f"{topic} does not cross: {nodes} {run} in ROS 2 Humble: give --distro humble"
    if hashed == NO_TYPE_HASH:
        return (
            f"{topic} does not cross: {nodes} {run} in a later ROS 2 than Humble: give no --distro"
        )
    return (
        f"{topic} does not cross: in ROS {nodes} {have} another definition of "
        f"{ros_type_name(dds_type)}, of hash {printable(first.type_hash, 80)}"
    )


# Of publishers that are gone, too: beyond this many all are looked up again.
_MOST_SOURCES = 10_000


def open_leg(settings: LegSettings, log: logging.Logger) -> "ZenohLeg":
    """Join ROS through its Zenoh router, which may start later.

    Raises SettingsError for an unknown distribution, a domain or an endpoint that is none, and
    InvalidNameError for the name of a node that ROS does not take.
    """
    return ZenohLeg(settings, log)


class ZenohLeg:
    """A node in ROS over Zenoh, until `close()`; see `tfbus.ros.bridge.legs.Leg`.

    If no router answers it keeps trying, and then makes the declarations asked for meanwhile.
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
    """Calls back for each message, which come on as many threads as there are links."""

    def __init__(self, on_message: OnMessage) -> None:
        self._calls = Calls(on_message)
        self.call = self._calls.call
        self.undeclare: Callable[[], None] = lambda: None

    def close(self) -> None:
        """End it. Twice is fine."""
        self._calls.close()
        self.undeclare()
