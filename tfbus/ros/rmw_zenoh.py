"""The wire of rmw_zenoh, ROS 2 over Zenoh: keys, tokens of the graph, QoS, attachments and gids.

After docs/design.md of https://github.com/ros2/rmw_zenoh and its versions' bytes. All functions
that read take bytes of strangers, and return None for bytes that are not of that form.
"""

import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

from xxhash import xxh3_128_digest

from tfbus.base.errors import InvalidNameError, SettingsError
from tfbus.base.wording import did_you_mean, printable
from tfbus.ros.rmw import dds_type

# Distributions


@dataclass(frozen=True)
class Wire:
    """The wire of a distribution of ROS, as far as they differ.

    Humble knows no hashes of types. The fields of an attachment have names before rmw_zenoh 0.2.4.
    """

    has_type_hashes: bool = True
    has_named_fields: bool = False


# In versions before, as Humble's 0.1.1 and Jazzy's 0.2.1, publishers keep their messages for late
# subscribers in another way, which Zenoh has deprecated.
WIRES: Mapping[str, Wire] = {
    "humble": Wire(has_type_hashes=False),
    "jazzy-0.2.3": Wire(has_named_fields=True),
    "jazzy": Wire(),
    "kilted": Wire(),
    "lyrical": Wire(),
    "rolling": Wire(),
}


def wire_of(distro: str) -> Wire:
    """The wire of a distribution; "" is any with the present wire.

    `jazzy-0.2.3` is Jazzy with rmw_zenoh 0.2.2 or 0.2.3, of early 2025. Raises SettingsError for an
    unknown one.
    """
    if not distro:
        return Wire()
    if distro in WIRES:
        return WIRES[distro]
    raise SettingsError(
        f"unknown distribution of ROS 2 over Zenoh {printable(distro, 40)!r}"
        f"{did_you_mean(distro, WIRES)}"
    )


# Names and keys

_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_NODE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_TYPE = re.compile(r"([A-Za-z]\w*)/(msg|srv|action)/([A-Za-z]\w*)", re.ASCII)
_DDS_TYPE = re.compile(r"([A-Za-z]\w*)::(msg|srv|action)::dds_::([A-Za-z]\w*)_", re.ASCII)

# Instead of the hash, from a ROS that has none.
NO_TYPE_HASH = "TypeHashNotSupported"


def check_topic_name(name: str) -> None:
    """Raise InvalidNameError unless it is the full name of a topic in ROS, as "/robot1/tf"."""
    if not _TOPIC.fullmatch(name):
        raise InvalidNameError(
            f"{printable(name, 60)!r} is no full name of a topic in ROS: words of letters, digits "
            "and underscores, each after a slash, as /robot1/tf"
        )


def check_node_name(name: str, namespace: str) -> None:
    """Raise InvalidNameError if ROS takes no node of this name in this namespace, "" or as
    "robot1/arm".
    """
    for word in [name, *namespace.split("/")] if namespace else [name]:
        if not _NODE.fullmatch(word):
            raise InvalidNameError(
                f"{printable(word, 60)!r} is no name in ROS: it may have letters, digits and "
                "underscores, and does not begin with a digit"
            )


def dds_type_name(name: str) -> str:
    """The name of a type on the wire, `std_msgs::msg::dds_::String_` of `std_msgs/msg/String`."""
    if not _TYPE.fullmatch(name):
        raise InvalidNameError(f"{printable(name, 60)!r} is no type of ROS, as std_msgs/msg/String")
    return dds_type(name)


def ros_type_name(name: str) -> str:
    """The name of a type in ROS by its name on the wire; "" for any other text."""
    found = _DDS_TYPE.fullmatch(name)
    return f"{found[1]}/{found[2]}/{found[3]}" if found else ""


def data_key(domain: int, topic: str, dds_type: str, type_hash: str) -> str:
    """The key of a topic's messages, `0/tf/tf2_msgs::msg::dds_::TFMessage_/RIHS01_e369...`."""
    return f"{domain}/{topic.strip('/')}/{dds_type}/{type_hash}"


# QoS

# Fields with rmw_zenoh's own defaults are left empty.
_DEFAULT_DEPTH = 42
_DURATIONS = ":,:,:,,"


@dataclass(frozen=True)
class Qos:
    """How a publisher or subscriber handles messages: `retained` is transient local. It keeps the
    last `depth`; None for all.
    """

    retained: bool = False
    depth: int | None = _DEFAULT_DEPTH
    reliable: bool = True

    @property
    def text(self) -> str:
        """As it stands in a token."""
        reliability = "" if self.reliable else "2"
        durability = "1" if self.retained else ""
        history = "2," if self.depth is None else f",{self.depth}"
        if self.depth == _DEFAULT_DEPTH:
            history = ","
        return f"{reliability}:{durability}:{history}{_DURATIONS}"


# The graph of ROS: each node, publisher and so on has a token

GRAPH = "@ros2_lv"
_LONGEST_TOKEN = 4000
_OF_NODE, _OF_ENDPOINT = 9, 13

Kind = Literal["NN", "MP", "MS", "SS", "SC"]
_KINDS: dict[str, Kind] = {kind: kind for kind in get_args(Kind)}


@dataclass(frozen=True)
class RosToken:
    """The token of a node (`kind` NN), publisher (MP), subscriber (MS), service (SS) or client
    (SC): its session's id in Zenoh, the numbers of its node and itself within that, and its
    name. Nodes have no more than these.
    """

    domain: int
    session: str
    node_number: str
    number: str
    kind: Kind
    node: str
    namespace: str = "/"
    enclave: str = "/"
    topic: str = ""
    dds_type: str = ""
    type_hash: str = ""
    qos: str = ""

    @property
    def full_node_name(self) -> str:
        """The full name of its node: "/robot1/camera"."""
        return f"{self.namespace.rstrip('/')}/{self.node}"

    @property
    def text(self) -> str:
        """The key of the token."""
        parts = [GRAPH, str(self.domain), self.session, self.node_number, self.number, self.kind]
        parts += [_mangled(self.enclave), _mangled(self.namespace), self.node]
        if self.kind != "NN":
            parts += [_mangled(self.topic), self.dds_type, self.type_hash, self.qos]
        return "/".join(parts)


def read_token(text: str) -> RosToken | None:
    """The token in a text. Parts that later versions append are passed over."""
    if len(text) > _LONGEST_TOKEN or not text.isprintable():
        return None
    parts = text.split("/")
    if len(parts) < _OF_NODE or parts[0] != GRAPH or not all(parts):
        return None
    _, domain, session, node_number, number, kind, enclave, namespace, node = parts[:_OF_NODE]
    if kind not in _KINDS or not (domain.isascii() and domain.isdigit() and len(domain) < 10):
        return None
    rest = [""] * 4
    if kind != "NN":
        rest = parts[_OF_NODE:_OF_ENDPOINT]
        if len(rest) < _OF_ENDPOINT - _OF_NODE:
            return None
    topic, dds_type, type_hash, qos = rest
    return RosToken(
        int(domain),
        session,
        node_number,
        number,
        _KINDS[kind],
        _demangled(node),
        _demangled(namespace),
        _demangled(enclave),
        _demangled(topic),
        dds_type,
        type_hash,
        qos,
    )


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def _demangled(name: str) -> str:
    return name.replace("%", "/")


def gid_of(token: str) -> bytes:
    """The gid of a publisher, by the text of its token: 16 bytes.

    Other bytes would do for rmw_zenoh, as long as they are unique. But messages name their
    publisher by gid alone, so only who makes the same of a token knows whose they are.
    """
    return xxh3_128_digest(token.encode())[::-1]


# Attachments: each message has one


class Attachment(NamedTuple):
    """Which message of its publisher it is, when it was sent, and the gid of the publisher."""

    sequence: int
    stamp_ns: int
    gid: bytes


_GID_SIZE = 16
_PLAIN = struct.Struct(f"<qqB{_GID_SIZE}s")
_NAMED = struct.Struct(f"<16sq17sq11sB{_GID_SIZE}s")
_NAMES = (b"\x0fsequence_number", b"\x10source_timestamp", b"\x0asource_gid")
_WITH_NAMES = _NAMES[0]
_NUMBER = struct.Struct("<q")
_NUMBER_OF_NAMED = 16
_SOURCE_OF_PLAIN = 8 + 8
_SOURCE_OF_NAMED = 16 + 8 + 17 + 8


def attachment_bytes(attachment: Attachment, *, named: bool = False) -> bytes:
    """An attachment of a message, its fields with or without their names."""
    sequence, stamp_ns, gid = attachment
    return attachment_writer(gid, named=named)(sequence, stamp_ns)


def attachment_writer(gid: bytes, *, named: bool = False) -> Callable[[int, int], bytes]:
    """The writer of a publisher's attachments, `write(sequence, stamp_ns)`."""
    if not named:
        return lambda sequence, stamp_ns: _PLAIN.pack(sequence, stamp_ns, _GID_SIZE, gid)
    first, second, third = _NAMES
    return lambda sequence, stamp_ns: _NAMED.pack(
        first, sequence, second, stamp_ns, third, _GID_SIZE, gid
    )


def read_attachment(data: bytes) -> Attachment | None:
    """An attachment, with names or without. Bytes that later versions append are passed over."""
    if data.startswith(_WITH_NAMES):
        if len(data) < _NAMED.size:
            return None
        first, sequence, second, stamp_ns, third, size, gid = _NAMED.unpack_from(data)
        if (first, second, third) != _NAMES:
            return None
    else:
        if len(data) < _PLAIN.size:
            return None
        sequence, stamp_ns, size, gid = _PLAIN.unpack_from(data)
    return Attachment(sequence, stamp_ns, gid) if size == _GID_SIZE else None


def source_in(data: bytes) -> bytes:
    """The bytes of an attachment from its publisher's on: the same in all of its messages."""
    return data[_SOURCE_OF_NAMED:] if data.startswith(_WITH_NAMES) else data[_SOURCE_OF_PLAIN:]


def number_in(data: bytes) -> int:
    """The number of the message in the bytes of an attachment that can be read."""
    found: int = _NUMBER.unpack_from(data, _NUMBER_OF_NAMED if data.startswith(_WITH_NAMES) else 0)[
        0
    ]
    return found


def has_named_fields(data: bytes) -> bool:
    """Whether the fields of an attachment have names, as before rmw_zenoh 0.2.4."""
    return data.startswith(_WITH_NAMES)
