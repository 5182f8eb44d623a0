"""The graph of ROS over Zenoh: publishers, subscribers and nodes, as their tokens say."""

import threading
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tfbus.bridge.legs import RosPublisher
from tfbus.ros.rmw_zenoh import NO_TYPE_HASH, RosToken, gid_of, read_token, ros_type_name
from tfbus.runtime import scheduler
from tfbus.runtime.bounded import Bounded
from tfbus.wording import listed, printable

# Tokens are strangers' to make up.
_MOST = 20_000
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

    def __init__(
        self, domain: int, own: str, clock_s: Callable[[], float] = lambda: scheduler.monotonic()
    ) -> None:
        # Tokens that are not of that form, or beyond what is kept.
        self.dropped = 0
        self._domain = domain
        self._own = own
        self.clock_s = clock_s
        self._lock = threading.Lock()
        self._elsewhere: Counter[int] = Counter()
        self._tokens: dict[str, RosToken] = {}
        self._publishers: dict[str, dict[str, RosPublisher]] = {}
        # Those of all publishers.
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
                if token is None or len(self._tokens) >= _MOST:
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
                self._untold[topic, gid] = _Untold(session(), self.clock_s())

    def publishers(self, topic: str) -> list[RosPublisher]:
        """The publishers of a topic, in order of their gids. A publisher that puts other
        gids into its messages than that of its token, as zenoh-ros2-sdk does, is there with these
        too, if its session has no other publisher of the topic.
        """
        with self._lock:
            there = self._publishers.get(topic, {})
            found = list(there.values())
            for (name, gid), untold in self._untold.items():
                if name == topic and (token := self._token_of(untold, there)):
                    found.append(RosPublisher(gid, there[token].node))
        return sorted(found, key=lambda each: each.gid)

    def _token_of(self, untold: _Untold, there: dict[str, RosPublisher]) -> str:
        """The token of a gid that has none of its own, "" if that is not known."""
        if untold.token not in there:
            untold.token = ""
            of_session = [each for each in there if self._tokens[each].session == untold.session]
            is_late = self.clock_s() >= untold.since_s + _MADE_UP_AFTER_S
            if is_late and len(of_session) == 1:
                untold.token = of_session[0]
        return untold.token

    def other_domains(self) -> list[int]:
        """The domains that have nodes, if that of this graph has none."""
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
        for topic, dds_type, type_hash in wanted:
            others = [
                each
                for each in tokens
                if each.kind in ("MP", "MS")
                and each.topic == topic
                and (each.dds_type, each.type_hash) != (dds_type, type_hash)
            ]
            if others:
                found.append(_mismatch(topic, dds_type, type_hash, others))
        return found


def _mismatch(topic: str, dds_type: str, type_hash: str, others: list[RosToken]) -> str:
    nodes = listed(sorted({printable(each.full_node_name, 60) for each in others}), most=3)
    alone = len({each.full_node_name for each in others}) == 1
    have, run = ("has", "runs") if alone else ("have", "run")
    first = others[0]
    if first.dds_type != dds_type:
        theirs = ros_type_name(first.dds_type) or printable(first.dds_type, 60)
        return f"{topic} does not cross: in ROS {nodes} {have} it as {theirs}"
    if first.type_hash == NO_TYPE_HASH:
        return f"{topic} does not cross: {nodes} {run} in ROS 2 Humble: give --distro humble"
    if type_hash == NO_TYPE_HASH:
        return (
            f"{topic} does not cross: {nodes} {run} in a later ROS 2 than Humble: give no --distro"
        )
    return (
        f"{topic} does not cross: in ROS {nodes} {have} another definition of "
        f"{ros_type_name(dds_type)}, of hash {printable(first.type_hash, 80)}"
    )
