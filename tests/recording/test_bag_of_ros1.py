"""A bag that ROS 1's own rosbag wrote."""

import os
import subprocess
from pathlib import Path

import pytest

from tests import needs
from tfbus.recording.foreign_files import opened
from tfbus.recording.imported import Imported, imported
from tfbus.recording.items import TopicItem, TransformItem

# Runs in Debian's Python, without anything of tfbus.
WRITE = """
import sys
import genpy, rosbag
from geometry_msgs.msg import TransformStamped, Twist
from tf2_msgs.msg import TFMessage

with rosbag.Bag(sys.argv[1], "w", compression=sys.argv[2]) as bag:
    for at in range(300):
        ts = TransformStamped()
        ts.header.seq = at
        ts.header.stamp = genpy.Time(1700000000, at)
        ts.header.frame_id, ts.child_frame_id = "/odom", "base_link"
        ts.transform.translation.x = at / 7.0
        ts.transform.rotation.w = 1.0
        topic = "/tf" if at else "/tf_static"
        bag.write(topic, TFMessage([ts]), genpy.Time(1700000001, at))
    twist = Twist()
    twist.linear.x = 0.5
    bag.write("/cmd_vel", twist, genpy.Time(1700000002, 0))
"""


@pytest.mark.parametrize("compression", ["none", "bz2"])
@pytest.mark.real
def test_a_bag_of_ros_1_is_imported(tmp_path: Path, compression: str) -> None:
    """Every message of it, with its stamps and numbers."""
    python = needs.python_of_rosbag()
    env = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    bag = tmp_path / "r.bag"
    subprocess.run([python, "-c", WRITE, str(bag), compression], env=env, check=True)
    counts = Imported()
    with opened(bag) as files:
        items = list(imported(files.messages(), counts))
    transforms = [item for item in items if isinstance(item, TransformItem)]
    assert [item.static for item in transforms] == [True] + [False] * 299
    for at, item in enumerate(transforms):
        [row] = item.rows
        assert (row.stamp_ns, row.frame_id) == (1_700_000_000 * 10**9 + at, "odom")
        assert row.transform.xyz[0] == at / 7.0
        assert item.log_ns == 1_700_000_001 * 10**9 + at
    [twist] = [item for item in items if isinstance(item, TopicItem)]
    assert (twist.topic, twist.type_name) == ("cmd_vel", "geometry_msgs/msg/Twist")
    assert twist.values["linear"] == {"x": 0.5, "y": 0.0, "z": 0.0}
    assert not counts.left_out and not counts.failed
