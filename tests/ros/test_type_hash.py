"""Hashes of message types, against ROS's own and rosbags'."""

import pytest
from rosbags.typesys import Stores, get_typestore

from tfbus import DecodeError
from tfbus.ros import definitions
from tfbus.ros.definitions import STRING, TF_MESSAGE, Definition
from tfbus.ros.rmw import type_hash

STORE = get_typestore(Stores.ROS2_JAZZY)

# rosbags takes `char` of a .msg file for that of IDL, so that its hashes of these are not those
# that ROS 2 Jazzy and Kilted have in their own files.
WITH_CHAR = {
    "rmw_dds_common/msg/Gid",
    "rmw_dds_common/msg/NodeEntitiesInfo",
    "rmw_dds_common/msg/ParticipantEntitiesInfo",
    "service_msgs/msg/ServiceEventInfo",
    "std_msgs/msg/Char",
}
NAMES = sorted(name for name in STORE.types if "/msg/" in name and name not in WITH_CHAR)


def definition(name: str) -> Definition:
    """A standard definition, as rosbags has it."""
    return Definition(name, STORE.generate_msgdef(name, ros_version=2)[0])


def test_the_hash_of_transforms_is_that_of_ros() -> None:
    """`ros2 topic info -v /tf` shows it."""
    assert type_hash(TF_MESSAGE) == (
        "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
    )
    assert type_hash(STRING) == (
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    )
    # std_msgs/msg/Char.json of ROS 2 Kilted.
    assert type_hash(definition("std_msgs/msg/Char")) == (
        "RIHS01_3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9"
    )


def test_standard_messages_have_the_hashes_that_rosbags_computes() -> None:
    """All of Jazzy but those with `char`: arrays, bounds, constants, defaults, no fields at all."""
    assert len(NAMES) > 150
    assert {name: type_hash(definition(name)) for name in NAMES} == {
        name: STORE.hash_rihs01(name) for name in NAMES
    }


def test_our_definitions_have_the_hashes_of_their_types() -> None:
    """Whatever they leave out of the text of the standard."""
    ours = [each for each in vars(definitions).values() if isinstance(each, Definition)]
    assert TF_MESSAGE in ours
    for each in ours:
        name = each.name
        assert name not in STORE.types or type_hash(each) == STORE.hash_rihs01(name)


def test_bounds_are_part_of_it() -> None:
    """Of texts and of sequences, alone and together."""
    texts = ("string a", "string<=5 a", "string[] a", "string[<=3] a", "string[3] a")
    texts += ("string<=5[<=3] a", "string<=6[<=3] a")
    hashes = {type_hash(Definition("a_msgs/msg/A", f"{text}\n")) for text in texts}
    assert len(hashes) == len(texts)


def test_a_wstring_is_refused() -> None:
    """It is not read in messages either."""
    with pytest.raises(DecodeError, match="wstring"):
        type_hash(Definition("a_msgs/msg/A", "wstring a\n"))
