"""`tfbus ros1` beside real nodes of ROS 1: rosmaster, tf2_ros, robot_state_publisher."""

import logging
import os
import subprocess
import sys
import xmlrpc.client
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests import needs
from tests.buses import eventually, keep_sending, send_until
from tests.live_bus import Bus, Process, free_port
from tfbus import (
    Buffer,
    StaticTransformBroadcaster,
    TfbusError,
    Transform,
    TransformListener,
    TransformStamped,
)
from tfbus.messages import JointState, Twist, Vector3
from tfbus.ros.bridge.legs import LegSettings
from tfbus.ros.bridge.legs.rospy import open_leg

pytestmark = pytest.mark.real

NODE = Path(__file__).parent / "ros1_node.py"
PUBLISHER = "/usr/lib/robot_state_publisher/robot_state_publisher"

ARM = """
<robot name="arm">
  <link name="base"/><link name="link1"/><link name="camera"/>
  <joint name="joint1" type="revolute">
    <parent link="base"/><child link="link1"/>
    <origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="bolted" type="fixed">
    <parent link="base"/><child link="camera"/><origin xyz="0.25 0 0"/>
  </joint>
</robot>
"""


class Ros1:
    """A ROS 1 of the test's own, with its master on a free port of loopback."""

    def __init__(self, bus: Bus, folder: Path) -> None:
        self._python = needs.python_of_tf2()
        self._rosmaster = needs.program("rosmaster")
        self._bus = bus
        self._port = free_port()
        self.uri = f"http://127.0.0.1:{self._port}"
        self.env = {
            "ROS_MASTER_URI": self.uri,
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(folder / "ros"),
        }
        self.master = self.start_master()

    def start_master(self) -> Process:
        """Start the master, again where it has ended."""
        port = str(self._port)
        self.master = self._start([self._python, self._rosmaster, "--core", "-p", port])
        eventually(self._answers)
        return self.master

    def bridge(self, *options: str) -> Process:
        """`tfbus ros1`, once it is ready."""
        process = self._bus.start("ros1", *options, env=self.env)
        process.wait_for_line("Bridges /tf and /tf_static by rospy")
        return process

    def node(self, name: str, *arguments: str) -> Process:
        """A node as `ros1_node` has them."""
        return self._start([self._python, str(NODE), name, *arguments])

    def state_publisher(self, urdf: str) -> Process:
        """ROS's robot_state_publisher."""
        if not Path(PUBLISHER).exists():
            needs.skip("robot_state_publisher", "apt-get install ros-robot-state-publisher")
        xmlrpc.client.ServerProxy(self.uri).setParam("/test", "/robot_description", urdf)
        return self._start([PUBLISHER])

    def _answers(self) -> bool:
        try:
            return bool(xmlrpc.client.ServerProxy(self.uri).getPid("/test"))
        except OSError:
            return False

    def _start(self, command: list[str]) -> Process:
        # Without what makes this Python find its own modules.
        unset = [f"--unset={name}" for name in os.environ if name.startswith("PYTHON")]
        return self._bus.start_command(["env", *unset, *command], env=self.env)


@pytest.fixture
def ros(bus: Bus, tmp_path: Path) -> Iterator[Ros1]:
    yield Ros1(bus, tmp_path)


def test_without_what_rospy_needs_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """rospy would find it missing later, in threads of its own, which die of it."""

    def look() -> None:
        raise ImportError("No module named 'netifaces'")

    network = SimpleNamespace(get_host_name=look)
    monkeypatch.setitem(sys.modules, "rospy", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "rosgraph", SimpleNamespace(network=network))
    monkeypatch.setitem(sys.modules, "rosgraph.network", network)
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:9")
    monkeypatch.setenv("ROS_NAMESPACE", "")
    with pytest.raises(TfbusError, match="python3-netifaces"):
        open_leg(LegSettings("tfbus_ros1"), logging.getLogger(__name__))


def test_tf2_reads_the_frames_of_the_bus(bus: Bus, ros: Ros1) -> None:
    """Static ones though it comes late; and after the master was started again."""
    sender = bus.node("sender")
    StaticTransformBroadcaster(sender).send_transform(
        TransformStamped(sender.now_ns(), "map", "odom", Transform((1.0, 2.0, 0.0)))
    )
    keep_sending(sender, "odom", "base_link")
    bridge = ros.bridge()
    ros.node("early", "lookup", "map", "base_link").wait_for_line("found 1.0 2.0")
    ros.master.stop()
    bridge.wait_for_line("The ROS master at .* is gone")
    ros.start_master()
    bridge.wait_for_line("The ROS master at .* is back")
    ros.node("late", "lookup", "map", "base_link").wait_for_line("found 1.0 2.0")
    ros.node("robot", "broadcast", "base_link", "tool")
    buffer = Buffer()
    with TransformListener(buffer, bus.node("listener")):
        eventually(lambda: buffer.can_transform("map", "tool"))
    assert bridge.stop() == 0


def test_a_robot_of_ros_is_on_the_bus(bus: Bus, ros: Ros1) -> None:
    """Its joint states come from the bus, its frames by a stream with the name of its node."""
    buffer = Buffer()
    node = bus.node("here")
    TransformListener(buffer, node)
    publisher = node.create_publisher(JointState, "joint_states")
    robot = ros.state_publisher(ARM)
    bridge = ros.bridge()

    def has_moved() -> bool:
        publisher.publish(JointState(node.now_ns(), ("joint1",), (0.5,)))
        return buffer.can_transform("camera", "link1")

    eventually(has_moved)
    assert list(buffer.lookup_transform("base", "camera", 0).transform.xyz) == [0.25, 0.0, 0.0]
    streams = {buffer.frame(frame).authority for frame in ("camera", "link1")}
    assert streams == {"ros1/robot_state_publisher"}
    assert not [line for line in bridge.err if "[WARN]" in line or "[ERROR]" in line]
    robot.kill()
    eventually(lambda: buffer.frame("camera").gone)


def test_topics_cross_without_an_echo(bus: Bus, ros: Ros1) -> None:
    """Both sides publish one topic; each gets the other's messages alone. A second bridge of the
    same name does not push the first out.
    """
    node = bus.node("here")
    heard: set[float] = set()
    publisher = node.create_publisher(Twist, "cmd_vel")
    other = bus.node("other")
    other.create_subscription(Twist, "cmd_vel", lambda twist: heard.add(twist.linear.x))
    ros.bridge()
    second = bus.run("ros1", env=ros.env)
    assert second.returncode == 1
    assert "/tfbus_ros1 already" in second.stderr
    there = ros.node("there", "twist", "2.0")
    line = "heard 1.0 from /tfbus_ros1"
    send_until(
        lambda: publisher.publish(Twist(Vector3(x=1.0))),
        lambda: heard == {1.0, 2.0} and line in there.out,
    )
    for number in range(10, 20):
        publisher.publish(Twist(Vector3(x=float(number))))
    there.wait_for_line("heard 19.0 from /tfbus_ros1")
    assert not [line for line in there.out if "heard 2.0" in line]


def test_without_rospy_it_says_what_to_install(bus: Bus) -> None:
    """In one sentence."""
    hide = "import sys; sys.modules['rospy'] = None; from tfbus.__main__ import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", hide, "ros1"],
        env=bus.env,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1
    assert "Error: rospy is not" in done.stderr
    assert "python3-rospy" in done.stderr


def test_a_uri_that_is_none_is_said(bus: Bus) -> None:
    """Without a traceback, whether rospy is there or not."""
    done = bus.run("ros1", "--master", "http://localhost:abc")
    assert done.returncode in (1, 2) and "Traceback" not in done.stderr
    assert "abc' is no URI" in done.stderr
