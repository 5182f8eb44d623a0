"""Facts of ROS 2 beside its messages: domains, bridges, names and hashes of types, nodes over DDS.

A hash, RIHS01, is `RIHS01_` and 64 hexadecimal digits: SHA-256 of the description of a type in
JSON, with the messages in it: https://www.ros.org/reps/rep-2016.html. Constants, defaults
and comments are not part of it. The nodes of a participant are a message of
rmw_dds_common/msg/ParticipantEntitiesInfo.
"""

import json
import os
import re
from collections.abc import Mapping
from collections.abc import Sequence as Items
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from typing import Any

from tfbus.base.errors import SettingsError
from tfbus.base.wording import printable
from tfbus.ros.cdr import CdrReader, CdrWriter
from tfbus.ros.definitions import SEPARATOR, Definition
from tfbus.ros.message_type import (
    PACKAGE,
    PLACEHOLDER,
    MessageType,
    Scalar,
    Sequence,
    Text,
    Type,
    message_of,
    messages_in,
)

# The most that the ports of DDS leave room for.
HIGHEST_DOMAIN = 232

# The node of a bridge has a name in ROS that begins so.
BRIDGE_PREFIX = "tfbus_"

_MESSAGE_TYPE = re.compile(r"[A-Za-z]\w{0,99}/msg/[A-Za-z]\w{0,99}", re.ASCII)


def is_domain(text: str) -> bool:
    """Whether this is the number of a domain of ROS 2."""
    return text.isascii() and text.isdecimal() and len(text) <= 3 and int(text) <= HIGHEST_DOMAIN


def domain_of(given: int | None = None, environ: Mapping[str, str] = os.environ) -> int:
    """The number of the domain: the one that is given, else ROS_DOMAIN_ID, else 0. Raises
    SettingsError if it is none.
    """
    text = environ.get("ROS_DOMAIN_ID", "").strip() or "0" if given is None else str(given)
    if not is_domain(text):
        whose = "ROS_DOMAIN_ID" if given is None else "the domain of ROS"
        raise SettingsError(
            f"{whose} is '{printable(text, 40)}': it must be a number from 0 to {HIGHEST_DOMAIN}"
        )
    return int(text)


def is_message_type(name: str) -> bool:
    """Whether this is the full name of a message of ROS, `sensor_msgs/msg/Imu`; ours have none."""
    return _MESSAGE_TYPE.fullmatch(name) is not None and not name.startswith(PACKAGE)


def is_bridge(node: str) -> bool:
    """Whether a node of ROS is a bridge's, by its name or full name."""
    return node.rpartition("/")[2].startswith(BRIDGE_PREFIX)


GRAPH_TOPIC = "ros_discovery_info"

GID_SIZE = 16
# ROS 2 has them of 24 bytes, filled up with zeros, until Humble.
HUMBLE_GID_SIZE = 24


@dataclass(frozen=True)
class NodeEntities:
    """A node by its full name, "/robot1/camera", and the gids of its readers and writers."""

    name: str
    readers: Items[bytes] = ()
    writers: Items[bytes] = ()


@dataclass(frozen=True)
class ParticipantNodes:
    """The nodes of a participant, by its gid."""

    participant: bytes
    nodes: Items[NodeEntities]


def dds_topic(topic: str) -> str:
    """The topic in DDS of one in ROS: `rt/tf` of `/tf`."""
    return f"rt{topic}"


def dds_type(name: str) -> str:
    """The type in DDS of one in ROS: `tf2_msgs::msg::dds_::TFMessage_`."""
    package, _, leaf = name.rpartition("/")
    return f"{package.replace('/', '::')}::dds_::{leaf}_"


def graph_definition(gid_size: int = GID_SIZE) -> Definition:
    """The definition of the message about a participant's nodes."""
    return Definition(
        "rmw_dds_common/msg/ParticipantEntitiesInfo",
        f"""\
Gid gid
NodeEntitiesInfo[] node_entities_info_seq
{SEPARATOR}
MSG: rmw_dds_common/Gid
char[{gid_size}] data
{SEPARATOR}
MSG: rmw_dds_common/NodeEntitiesInfo
string<=256 node_namespace
string<=256 node_name
Gid[] reader_gid_seq
Gid[] writer_gid_seq
""",
    )


def encode_nodes(info: ParticipantNodes, gid_size: int = GID_SIZE) -> bytes:
    """The message, in CDR."""
    writer = CdrWriter()
    writer.data += info.participant.ljust(gid_size, b"\0")
    writer.count(len(info.nodes))
    for node in info.nodes:
        namespace, _, name = node.name.rpartition("/")
        writer.text(namespace or "/")
        writer.text(name)
        for gids in (node.readers, node.writers):
            writer.count(len(gids))
            for gid in gids:
                writer.data += gid.ljust(gid_size, b"\0")
    return writer.message()


def decode_nodes(payload: bytes, gid_size: int = GID_SIZE) -> ParticipantNodes:
    """The message. Raises DecodeError if the bytes are none."""
    reader = CdrReader(payload)
    participant = _gid(reader, gid_size)
    # A node has two texts and two sequences at least.
    nodes = [_node(reader, gid_size) for _ in range(reader.count(18))]
    reader.finish()
    return ParticipantNodes(participant, nodes)


def _node(reader: CdrReader, gid_size: int) -> NodeEntities:
    namespace, name = reader.text(), reader.text()
    readers = [_gid(reader, gid_size) for _ in range(reader.count(gid_size))]
    writers = [_gid(reader, gid_size) for _ in range(reader.count(gid_size))]
    return NodeEntities(f"{namespace.rstrip('/')}/{name}", readers, writers)


def _gid(reader: CdrReader, gid_size: int) -> bytes:
    start = reader.skip(gid_size)
    return reader.data[start : start + GID_SIZE]


# type_description_interfaces/msg/FieldType
_MESSAGE = 1
_SCALARS = {
    "int8": 2,
    "uint8": 3,
    "char": 3,  # of .msg files: a character of IDL is 13
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "byte": 16,
}
_TEXT, _BOUNDED_TEXT = 17, 21
_ARRAY, _BOUNDED_SEQUENCE, _SEQUENCE = 48, 96, 144


@lru_cache
def type_hash(definition: Definition) -> str:
    """The hash of a message type.

    Raises DecodeError for a definition that is not valid, or has a wstring.
    """
    message = message_of(definition)
    first, *others = map(_description, messages_in(message))
    others.sort(key=lambda each: str(each["type_name"]))
    described = {"type_description": first, "referenced_type_descriptions": others}
    return f"RIHS01_{sha256(json.dumps(described).encode()).hexdigest()}"


def _description(message: MessageType) -> dict[str, Any]:
    fields = [{"name": field.name, "type": _type(field.type)} for field in message.fields]
    if not fields:
        fields = [{"name": PLACEHOLDER, "type": _type(Scalar("uint8"))}]
    return {"type_name": message.name, "fields": fields}


def _type(type_: Type) -> dict[str, Any]:
    kind, capacity = 0, 0
    if isinstance(type_, Sequence):
        kind = _BOUNDED_SEQUENCE if type_.most else _SEQUENCE if type_.size is None else _ARRAY
        capacity = type_.most or type_.size or 0
        type_ = type_.item
    most = type_.most if isinstance(type_, Text) else 0
    return {
        "type_id": kind + _type_id(type_),
        "capacity": capacity,
        "string_capacity": most,
        "nested_type_name": type_.name if isinstance(type_, MessageType) else "",
    }


def _type_id(type_: Type) -> int:
    if isinstance(type_, Scalar):
        return _SCALARS[type_.name]
    if isinstance(type_, Text):
        return _BOUNDED_TEXT if type_.most else _TEXT
    return _MESSAGE
