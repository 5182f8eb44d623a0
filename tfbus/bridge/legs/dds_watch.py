"""Publishers in DDS: writers as they come and go, and the nodes of ROS that they are of."""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import InstanceState, Policy, ReadCondition, SampleState, ViewState
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader

from tfbus.errors import DecodeError
from tfbus.ros.rmw import decode_nodes
from tfbus.runtime.bounded import Bounded

# Taken at once.
MOST_TAKEN = 256
ANY = ViewState.Any | InstanceState.Any | SampleState.Any

# A message may come after its writer is gone. The gids of at most this many such writers are known.
_MOST_GONE = 1000

# A participant may tell of nodes of any other one, which then never leaves.
_MOST_PARTICIPANTS = 1000

# In the place of a gid: all writers of a participant are of its only node.
_ALL_WRITERS = ""

# The name of a node comes after its writer, together with its first messages, if it comes: from
# Fast DDS in 3 s.
_NAMELESS_S = 10.0


@dataclass(frozen=True)
class Writer:
    """A writer of another participant."""

    gid: str
    participant: str
    topic: str
    type: str
    is_reliable: bool
    is_retained: bool
    since_s: float


class DdsWatch:
    """Knows the writers of other participants, and the names of their nodes. Thread-safe.

    `conditions` tell when there is something new, for `update`.
    """

    def __init__(
        self, participant: DomainParticipant, nodes: "DataReader[Any]", gid_size: int
    ) -> None:
        self._own = participant.guid.hex
        self._publications = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
        self._nodes = nodes
        self._gid_size = gid_size
        self.conditions = [ReadCondition(each, ANY) for each in (self._publications, nodes)]
        self._lock = threading.Lock()
        self._writers: dict[int, Writer] = {}
        self._gone: Bounded[int, str] = Bounded(_MOST_GONE)
        # The full names of nodes by the gids of their writers, for each participant.
        self._names: dict[str, dict[str, str]] = {}

    def update(self) -> None:
        """Take in what is new. From one thread at a time."""
        while taken := self._publications.take(MOST_TAKEN):
            with self._lock:
                for each in taken:
                    self._take_publication(each)
        while taken := self._nodes.take(MOST_TAKEN):
            with self._lock:
                for each in taken:
                    if each.sample_info.valid_data:
                        self._take_nodes(each.data)

    def gid_of(self, handle: int) -> str:
        """The gid of the writer of a message, by the handle in its info; "" if it is unknown.
        From the thread of `update`.
        """
        if not (gid := self._known_gid(handle)):
            # Its writer has come since the last update.
            self.update()
            gid = self._known_gid(handle)
        return gid

    def writers(self, topic: str) -> Sequence[Writer]:
        """The writers of a topic."""
        with self._lock:
            return [each for each in self._writers.values() if each.topic == topic]

    def node_of(self, writer: Writer) -> str:
        """The full name of the node of a writer, "" if it has told none."""
        with self._lock:
            names = self._names.get(writer.participant, {})
            return names.get(writer.gid) or names.get(_ALL_WRITERS, "")

    def is_nameless(self, writer: Writer) -> bool:
        """Whether a writer has told no name for 10 s, so that none will come."""
        return time.monotonic() > writer.since_s + _NAMELESS_S

    @property
    def sees_ros(self) -> bool:
        """Whether another participant has told of its nodes."""
        with self._lock:
            return bool(self._names)

    def _known_gid(self, handle: int) -> str:
        with self._lock:
            writer = self._writers.get(handle)
            return self._gone.get(handle, "") if writer is None else writer.gid

    def _take_publication(self, sample: Any) -> None:
        handle = sample.sample_info.instance_handle
        participant = sample.participant_key.hex
        if participant == self._own:
            return
        if sample.sample_info.instance_state != InstanceState.Alive:
            self._drop(handle)
        elif sample.sample_info.valid_data:
            qos = sample.qos
            self._writers[handle] = Writer(
                sample.key.hex,
                participant,
                sample.topic_name,
                sample.type_name,
                qos[Policy.Reliability] != Policy.Reliability.BestEffort,
                qos[Policy.Durability] != Policy.Durability.Volatile,
                time.monotonic(),
            )

    def _drop(self, handle: int) -> None:
        gone = self._writers.pop(handle, None)
        if gone is None:
            return
        self._gone[handle] = gone.gid
        if all(each.participant != gone.participant for each in self._writers.values()):
            self._names.pop(gone.participant, None)

    def _take_nodes(self, payload: bytes) -> None:
        try:
            info = decode_nodes(payload, self._gid_size)
        except DecodeError:
            # Of a ROS with gids of another size.
            return
        participant = info.participant.hex()
        self._names.pop(participant, None)
        if len(self._names) >= _MOST_PARTICIPANTS:
            self._forget_one()
        names = {gid.hex(): node.name for node in info.nodes for gid in node.writers}
        if not names and len(info.nodes) == 1:
            # As roswell tells its node: without its writers.
            names[_ALL_WRITERS] = info.nodes[0].name
        self._names[participant] = names

    def _forget_one(self) -> None:
        """Forget the names of the participant that told them longest ago, best of one without
        writers.
        """
        writing = {each.participant for each in self._writers.values()}
        silent = (each for each in self._names if each not in writing)
        del self._names[next(silent, next(iter(self._names)))]
