"""DDS by cyclonedds: types whose samples are bytes, and publishers with their nodes in ROS."""

import threading
import time
from dataclasses import dataclass
from functools import cache
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import InstanceState, Policy, ReadCondition, SampleState, ViewState
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.sub import DataReader

from tfbus.base.bounded import Bounded
from tfbus.base.errors import DecodeError
from tfbus.ros.definitions import Definition
from tfbus.ros.message_type import (
    PLACEHOLDER,
    MessageType,
    Scalar,
    Sequence,
    Text,
    Type,
    message_of,
)
from tfbus.ros.rmw import dds_type, decode_nodes

# Before the names of types in cyclonedds's descriptions, so that no type there is one of ROS.
# Cyclone answers each question about types, also one meant for others, with the types it knows. For
# a type of ROS that has some of the same parts, Fast DDS 3 (ROS 2 Kilted) takes such an answer as
# the last, finds it inconsistent, and does not match the publishers of that type. If Cyclone knows
# nothing of it, Fast DDS goes by the name of the type.
_OWN = "tfbus."

# As cyclonedds has them, by the names in ROS.
_SCALARS: dict[str, Any] = {
    "bool": bool,
    "byte": types.byte,
    "char": types.uint8,
    "int8": types.int8,
    "uint8": types.uint8,
    "int16": types.int16,
    "uint16": types.uint16,
    "int32": types.int32,
    "uint32": types.uint32,
    "int64": types.int64,
    "uint64": types.uint64,
    "float32": types.float32,
    "float64": types.float64,
}


class RawSample:
    """A message as its bytes; a class made by `raw_type` says of which type.

    To cyclonedds it looks like one of its structs, which it asks for bytes and makes of bytes.
    """

    __slots__ = ("data", "sample_info")

    def __init__(self, data: bytes) -> None:
        self.data = data
        # Set by the reader that it comes from.
        self.sample_info: Any = None

    def serialize(self, **_: object) -> bytes:
        """The bytes to send."""
        return self.data

    @classmethod
    def deserialize(cls, data: bytes) -> "RawSample":
        """A message that came."""
        return cls(data)

    @classmethod
    def deserialize_key(cls, data: bytes) -> "RawSample":
        """No message: a writer is gone."""
        return cls(data)


@cache
def raw_type(definition: Definition) -> type[RawSample]:
    """The type in DDS of messages of this definition. Raises DecodeError if that is not valid,
    or has a wstring.
    """
    idl = _struct(message_of(definition)).__idl__
    # The name of the type in DDS.
    idl.idl_transformed_typename = dds_type(definition.name)
    return type("RawMessage", (RawSample,), {"__slots__": (), "__idl__": idl})


def _struct(message: MessageType) -> Any:
    fields = {field.name: _type(field.type) for field in message.fields}
    dotted = _OWN + dds_type(message.name).replace("::", ".")
    leaf = dotted.rpartition(".")[2]
    return make_idl_struct(leaf, dotted, fields or {PLACEHOLDER: types.uint8})


def _type(type_: Type) -> Any:
    if isinstance(type_, Scalar):
        return _SCALARS[type_.name]
    if isinstance(type_, Text):
        return types.bounded_str[type_.most] if type_.most else str
    if isinstance(type_, Sequence):
        item = _type(type_.item)
        if type_.size is not None:
            return types.array[item, type_.size]
        return types.sequence[item, type_.most] if type_.most else types.sequence[item]
    return _struct(type_)


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
        """Take new publications and nodes. From one thread at a time."""
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

    def writers(self, topic: str) -> list[Writer]:
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
