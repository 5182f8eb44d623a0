"""The facts that ROS 2 tells over DDS beside the messages: the names of topics and types there, and
which nodes a participant has, `rmw_dds_common/msg/ParticipantEntitiesInfo`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from tfbus.ros.cdr import CdrReader, CdrWriter
from tfbus.ros.definitions import SEPARATOR, Definition

GRAPH_TOPIC = "ros_discovery_info"

GID_SIZE = 16
# ROS 2 has them of 24 bytes, filled up with zeros, until Humble.
HUMBLE_GID_SIZE = 24


@dataclass(frozen=True)
class NodeEntities:
    """A node by its full name, "/robot1/camera", and the gids of its readers and writers."""

    name: str
    readers: Sequence[bytes] = ()
    writers: Sequence[bytes] = ()


@dataclass(frozen=True)
class ParticipantNodes:
    """The nodes of a participant, by its gid."""

    participant: bytes
    nodes: Sequence[NodeEntities]


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
    return bytes(writer.data)


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
