"""The announcements of nodes of ROS 2 over DDS."""

import pytest

from tests import needs
from tfbus.base.errors import DecodeError
from tfbus.ros.definitions import TF_MESSAGE
from tfbus.ros.rmw import (
    HUMBLE_GID_SIZE,
    NodeEntities,
    ParticipantNodes,
    dds_topic,
    dds_type,
    decode_nodes,
    encode_nodes,
)

GID = bytes(range(16))
OTHER = bytes(range(16, 32))
INFO = ParticipantNodes(
    GID,
    [
        NodeEntities("/tfbus_ros2", [GID], [GID, OTHER]),
        NodeEntities("/robot1/arm/camera", [], []),
    ],
)


@pytest.mark.parametrize("gid_size", [16, HUMBLE_GID_SIZE])
def test_nodes_come_back(gid_size: int) -> None:
    """What is written is read."""
    assert decode_nodes(encode_nodes(INFO, gid_size), gid_size) == INFO


def test_others_read_the_same() -> None:
    """rosbags, which has ROS's own definition, reads the same fields."""
    typestore = needs.module("rosbags.typesys")
    store = typestore.get_typestore(typestore.Stores.ROS2_JAZZY)
    read = store.deserialize_cdr(encode_nodes(INFO), "rmw_dds_common/msg/ParticipantEntitiesInfo")
    assert bytes(read.gid.data) == GID
    first, second = read.node_entities_info_seq
    assert (first.node_namespace, first.node_name) == ("/", "tfbus_ros2")
    assert (second.node_namespace, second.node_name) == ("/robot1/arm", "camera")
    assert [bytes(each.data) for each in first.writer_gid_seq] == [GID, OTHER]


def test_a_spoilt_message_is_refused() -> None:
    """No length of a cut message makes anything but a DecodeError."""
    whole = encode_nodes(INFO)
    for size in range(len(whole)):
        with pytest.raises(DecodeError):
            decode_nodes(whole[:size])


def test_names_in_dds() -> None:
    """Topics and types have the names of ROS with what tells DDS that they are of ROS."""
    assert dds_topic("/robot1/tf") == "rt/robot1/tf"
    assert dds_type(TF_MESSAGE.name) == "tf2_msgs::msg::dds_::TFMessage_"
