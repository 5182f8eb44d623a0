"""Types of messages as ROS 1 has them."""

import pytest

from tfbus import TfbusError
from tfbus.ros.counterparts import LIVE_COUNTERPARTS, fitted
from tfbus.ros.definitions import (
    JOINT_STATE,
    ODOMETRY,
    POSE_STAMPED,
    STRING,
    TF_MESSAGE,
    TURTLE_POSE,
    TWIST,
    Definition,
)
from tfbus.ros.message_type import message_of
from tfbus.ros.ros1 import ros1_type
from tfbus.ros.schema import MessageCodec


@pytest.mark.parametrize(
    ("definition", "md5"),
    [
        # As `rosmsg md5` of ROS Noetic has them.
        (TF_MESSAGE, "94810edda583a504dfda3829e70d7eec"),
        (TWIST, "9f195f881246fdfa2798d1d3eebca84a"),
        (POSE_STAMPED, "d3812c3cbc69362b77dc0b19b345f8f5"),
        (ODOMETRY, "cd5e73d190d741a2f92e81eda573aca7"),
        (JOINT_STATE, "3066dcd76a6cfaef579bd0f34173e9fd"),
        (STRING, "992ce8a1687cec8c8bd883ec73ca41d1"),
        (TURTLE_POSE, "863b248d5016ca62ea2e895ae5265cf9"),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_publishers_and_subscribers_agree_by_these(definition: Definition, md5: str) -> None:
    """Each type has the name and the digest that nodes of ROS 1 expect."""
    found = ros1_type(definition)
    assert (found.name, found.md5) == (definition.name.replace("/msg/", "/"), md5)


@pytest.mark.parametrize(
    "definition",
    [each.definition for each in LIVE_COUNTERPARTS.values()],
    ids=lambda definition: definition.name,
)
def test_a_message_comes_back(definition: Definition) -> None:
    """From CDR to the bytes of ROS 1, and to CDR again."""
    codec = MessageCodec.of_definition(definition)
    payload = codec.encode(fitted({}, message_of(definition)))
    assert payload is not None
    found = ros1_type(definition)
    again = found.to_cdr(found.of_cdr(payload))
    assert codec.decode(again) == codec.decode(payload)


def test_a_type_that_is_another_one_in_ros_1_is_refused() -> None:
    """Its digest would be that of no node."""
    definition = Definition("sensor_msgs/msg/Range", "float32 range\n")
    with pytest.raises(TfbusError, match="other fields"):
        ros1_type(definition)
