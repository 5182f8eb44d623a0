"""`tfbus robot_state` as a process: its messages, and its answers to bad input."""

import math
from pathlib import Path
from typing import Any

import msgpack
import pytest

from tests.buses import eventually, send_until
from tests.nodes.robots import ARM, FREE
from tests.simulated_bus import Bus
from tfbus import Buffer, Node, ServiceError, Transform, TransformListener
from tfbus.messages import Empty, JointState, RobotDescription, RobotMesh, SetDescription
from tfbus.testing.programs import Program

S = 1_000_000_000


class Asker:
    """A node that drives a robot and listens to its frames."""

    def __init__(self, bus: Bus, namespace: str = "") -> None:
        self.node: Node = bus.node("asker", namespace=namespace)
        self.buffer = Buffer()
        self.listener = TransformListener(self.buffer, self.node)
        self._states = self.node.create_publisher(JointState, "joint_states")
        self.descriptions: list[RobotDescription] = []
        self.node.create_subscription(
            RobotDescription, "robot_description", self.descriptions.append, retained=True
        )

    def move(self, **positions: float) -> int:
        """Publish a joint state; its stamp."""
        stamp_ns = self.node.now_ns()
        self._states.publish(JointState(stamp_ns, tuple(positions), tuple(positions.values())))
        return stamp_ns

    def move_until_seen(self, target: str, source: str, **positions: float) -> Transform:
        """Move until the frame can be seen; its pose then."""
        send_until(lambda: self.move(**positions), lambda: self.sees(target, source))
        return self.buffer.lookup_transform(target, source).transform

    def sees(self, target: str, source: str) -> bool:
        """Whether the pose of a frame is known."""
        return self.buffer.can_transform(target, source)

    def frames(self) -> set[str]:
        """All child frames of the listener's streams."""
        streams = self.listener.streams()
        return {child for stream in streams for _, child, *_ in stream.frames}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of the arm."""
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    return path


def start(bus: Bus, *arguments: str | Path) -> Program:
    """Start it, and wait until it publishes."""
    process = bus.start("robot_state", *map(str, arguments))
    process.wait_for_line("Publishing ")
    return process


def test_the_robot_stands_up(bus: Bus, path: Path) -> None:
    """Fixed joints are static, others follow the joint states, with their stamps; the description
    reaches a node that came later.
    """
    process = start(bus, path)
    process.wait_for_line("Publishing arm: 6 links, 5 joints, 4 of them moving")
    asker = Asker(bus)
    eventually(lambda: asker.sees("lower", "tool"))
    assert not asker.sees("base", "upper")
    pose = asker.move_until_seen("base", "left", shoulder=0.0, elbow=0.0, grip=0.2)
    assert pose.xyz == pytest.approx((1, 0.2, 0))
    assert asker.buffer.lookup_transform("lower", "right").transform.xyz == pytest.approx(
        (0, 0.3, 0)
    )
    [description] = eventually(lambda: asker.descriptions)[:1]
    assert description == RobotDescription(ARM, "", str(path))
    assert process.stop() == 0


def test_stamps_are_those_of_the_joints(bus: Bus, path: Path) -> None:
    """All transforms of one joint state have its stamp, to the nanosecond."""
    start(bus, path)
    asker = Asker(bus)
    positions = dict.fromkeys(FREE, 0.2)
    asker.move_until_seen("base", "right", **positions)
    stamp_ns = asker.move(**positions)
    eventually(lambda: asker.buffer.can_transform("base", "right", stamp_ns))
    assert asker.buffer.lookup_transform("base", "right").stamp_ns == stamp_ns


def test_a_prefix_is_before_all_frames(bus: Bus, path: Path) -> None:
    """`--prefix` and the parameter name the frames; the former are taken out."""
    start(bus, path, "--prefix", "left_")
    asker = Asker(bus)
    eventually(lambda: asker.sees("left_lower", "left_tool"))
    asker.move_until_seen("left_base", "left_upper", shoulder=1.0)
    assert bus.run("param", "set", "robot_state", "frame_prefix", "r_").returncode == 0
    asker.move_until_seen("r_base", "r_upper", shoulder=1.0)
    eventually(lambda: asker.sees("r_lower", "r_tool"))
    eventually(lambda: not any(frame.startswith("left_") for frame in asker.frames()))
    refused = bus.run("param", "set", "robot_state", "frame_prefix", "/r")
    assert refused.returncode == 1
    assert "begins with a slash" in refused.stderr
    assert eventually(lambda: asker.descriptions[-1].prefix == "r_")


def test_ros_parameters_do_the_same(bus: Bus) -> None:
    """robot_description, frame_prefix and publish_frequency as robot_state_publisher takes them."""
    start(bus, "--ros-args", "-p", f"robot_description:={ARM}", "-p", "frame_prefix:=a/")
    asker = Asker(bus)
    eventually(lambda: asker.sees("a/lower", "a/tool"))
    listed = bus.run("param", "list", "robot_state").stdout.split()
    assert {"frame_prefix", "ignore_timestamp", "publish_frequency"} <= set(listed)
    assert "robot_description" not in listed


def test_messages_that_are_no_joint_states_are_dropped(bus: Bus, path: Path) -> None:
    """NaN, unequal lengths, names twice, names of no joint and no positions: said once each, and
    the robot goes on.
    """
    path.write_text(ARM.replace('multiplier="-1"', 'multiplier="-10"'))
    process = start(bus, path)
    asker = Asker(bus)
    asker.move_until_seen("base", "upper", shoulder=1.0)
    raw = asker.node.create_raw_publisher("joint_states", type_name="JointState")
    now_ns = asker.node.now_ns()

    def send(names: list[str], positions: list[float], **more: Any) -> None:
        values = {"stamp_ns": now_ns, "name": names, "position": positions, **more}
        raw.publish(msgpack.packb(values))

    def all_sent() -> bool:
        send(["elbow"], [float("nan")])
        send(["elbow", "grip"], [1.0])
        send(["elbow", "elbow"], [1.0, 1.0])
        send(["elbow"], [1.0], velocity=[1.0, 2.0])
        send(["nose\x1b[31m"], [1.0])
        send(["elbow"], [])
        send(["grip"], [1.7e308])
        raw.publish(b"nothing")
        text = "\n".join(process.err)
        return all(
            part in text
            for part in (
                "the position of joint 'elbow' must be finite, not nan",
                r"Ignored 1 joint that the robot does not have: 'nose\x1b[31m'",
                "Ignored a JointState without positions",
                "Ignored a JointState: joint 'grip_right' mimics 'grip' to a position that is not",
            )
        )

    eventually(all_sent)
    assert not asker.sees("upper", "lower")
    asker.move_until_seen("base", "lower", shoulder=1.0, elbow=1.0)
    assert sum("Dropped a message" in line for line in process.err) == 1
    assert "Traceback" not in "\n".join(process.err)


def test_missing_joints_are_named(bus: Bus, path: Path) -> None:
    """Joints that no joint state has named are named after 5 s."""
    process = start(bus, path)
    Asker(bus).move_until_seen("upper", "lower", elbow=1.0)
    missing = "No joint state has named 2 joints so far: shoulder, grip"
    process.wait_for_line(missing)


def test_without_joint_states_it_says_what_to_start(bus: Bus, path: Path) -> None:
    """With no publisher of joint_states the log says so, and how many frames are missing."""
    process = start(bus, path)
    nothing = "No joint state has come on topic 'joint_states': start the robot's driver, or"
    process.wait_for_line(nothing)


def test_a_time_that_goes_back_is_followed(bus: Bus, path: Path) -> None:
    """After a reset of the time the frames follow the new one."""
    process = start(bus, path)
    asker = Asker(bus)
    asker.move_until_seen("base", "upper", shoulder=1.0)
    states = asker.node.create_publisher(JointState, "joint_states")
    back_ns = asker.node.now_ns() - 100 * S
    send_until(
        lambda: states.publish(JointState(back_ns, ("shoulder",), (2.0,))),
        lambda: asker.buffer.can_transform("base", "upper", back_ns),
    )
    process.wait_for_line("The stamps of joint states went back by more than 1 s")


class TestNewDescriptions:
    """Another robot while it runs."""

    def test_by_service(self, bus: Bus, path: Path) -> None:
        """The frames of the former robot are taken out, those of the new one come."""
        start(bus, path)
        asker = Asker(bus)
        asker.move_until_seen("base", "lower", shoulder=1.0, elbow=1.0)
        client = asker.node.create_client(SetDescription, "set_description")
        other = ARM.replace('"tool"', '"hook"').replace('"lower"', '"fore"')
        response = client.call(SetDescription.Request(other))
        assert response == SetDescription.Response("arm", 6, 5)
        eventually(lambda: asker.sees("fore", "hook"))
        eventually(lambda: not asker.frames() & {"tool", "lower"})
        eventually(lambda: asker.descriptions[-1].urdf == other)
        asker.move_until_seen("base", "fore", shoulder=1.0, elbow=1.0)

    def test_a_joint_that_is_fixed_now_is_static(self, bus: Bus, path: Path) -> None:
        """A joint changes from moving to fixed and back, and its frame with it."""
        start(bus, path)
        asker = Asker(bus)
        asker.move_until_seen("base", "upper", shoulder=1.0)
        client = asker.node.create_client(SetDescription, "set_description")
        client.call(SetDescription.Request(ARM.replace('"revolute"', '"fixed"')))

        def is_turned(how_far: float) -> bool:
            if not asker.sees("base", "upper"):
                return False
            pose = asker.buffer.lookup_transform("base", "upper").transform
            return pose.quat_xyzw[2] == pytest.approx(how_far)

        eventually(lambda: is_turned(0.0))
        client.call(SetDescription.Request(ARM))
        send_until(lambda: asker.move(shoulder=1.0), lambda: is_turned(math.sin(0.5)))

    def test_a_bad_one_is_refused(self, bus: Bus, path: Path) -> None:
        """A description that is none is refused with its line, and the old one stays."""
        process = start(bus, path)
        asker = Asker(bus)
        eventually(lambda: asker.sees("lower", "tool"))
        client = asker.node.create_client(SetDescription, "set_description")
        with pytest.raises(ServiceError, match="the description:2: "):
            client.call(SetDescription.Request("<robot name='x'>\n<link/></robot>"))
        assert bus.run("topic", "echo", "robot_description", "--once").stdout.count("arm")
        assert process.stop() == 0

    def test_from_its_file_when_asked(self, bus: Bus, path: Path) -> None:
        """The service reload reads the file again; a mistake in it is refused."""
        start(bus, path)
        asker = Asker(bus)
        reload = asker.node.create_client(Empty, "reload")
        path.write_text(ARM.replace('"tool"', '"hook"'))
        reload.call(Empty.Request())
        eventually(lambda: asker.sees("lower", "hook"))
        path.write_text(ARM[:300])
        with pytest.raises(ServiceError, match=r"arm\.urdf:\d+: not XML"):
            reload.call(Empty.Request())
        assert asker.sees("lower", "hook")

    def test_when_the_file_changes(self, bus: Bus, path: Path) -> None:
        """With --watch a changed file is read; one that is half written leaves all as it was."""
        process = start(bus, path, "--watch")
        asker = Asker(bus)
        eventually(lambda: asker.sees("lower", "tool"))
        path.write_text(ARM[:300])
        process.wait_for_line(r"Kept the description as it was: .*arm\.urdf:\d+: not XML")
        assert asker.sees("lower", "tool")
        path.write_text(ARM.replace('"tool"', '"hook"'))
        eventually(lambda: asker.sees("lower", "hook"))
        process.wait_for_line("Read .*arm.urdf again: arm: 6 links")

    def test_one_that_the_prefix_makes_too_long_changes_nothing(self, bus: Bus, path: Path) -> None:
        """A link whose frame is too long with the prefix refuses the file, by service and watch,
        and nothing of it is published.
        """
        process = start(bus, path, "--watch", "--prefix", "p" * 100)
        asker = Asker(bus)
        prefix = "p" * 100
        eventually(lambda: asker.sees(f"{prefix}lower", f"{prefix}tool"))
        path.write_text(ARM.replace('"tool"', f'"{"t" * 200}"'))
        process.wait_for_line("Kept the description as it was: link 'ttt")
        with pytest.raises(ServiceError, match=r"link 'ttt.* prefix 'ppp"):
            asker.node.create_client(Empty, "reload").call(Empty.Request())
        path.write_text(ARM.replace('"tool"', '"hook"'))
        eventually(lambda: asker.sees(f"{prefix}lower", f"{prefix}hook"))
        assert not any("tttt" in each.urdf for each in asker.descriptions)


def test_meshes_come_from_its_machine(bus: Bus, tmp_path: Path) -> None:
    """A viewer elsewhere reads a mesh by its name in the description."""
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes/a.stl").write_bytes(b"solid")
    path = tmp_path / "robot.urdf"
    path.write_text(
        '<robot name="r"><link name="a"><visual><geometry><mesh filename="meshes/a.stl"/>'
        "</geometry></visual></link></robot>"
    )
    start(bus, path)
    client = bus.node("viewer").create_client(RobotMesh, "robot_mesh")
    response = client.call(RobotMesh.Request("meshes/a.stl"))
    assert (response.data, response.size) == (b"solid", 5)
    with pytest.raises(ServiceError, match=r"no mesh 'meshes/b\.stl'"):
        client.call(RobotMesh.Request("meshes/b.stl"))


def test_meshes_that_are_not_there_are_named_at_the_start(bus: Bus, tmp_path: Path) -> None:
    """With what to do, also in the answer to those who ask for one."""
    path = tmp_path / "arm.urdf"
    mesh = "package://gone/meshes/arm.stl"
    look = f"<visual><geometry><mesh filename='{mesh}'/></geometry></visual>"
    path.write_text(f"<robot name='arm'><link name='base'>{look}{look}</link></robot>")
    process = start(bus, path)
    remedy = "; .* --package-path .* 'gone'"
    process.wait_for_line(f"1 mesh file: '{mesh}'{remedy}")
    client = bus.node("asker").create_client(RobotMesh, "robot_mesh")
    with pytest.raises(ServiceError, match=f"mesh '{mesh}'{remedy}"):
        client.call(RobotMesh.Request(mesh, 0), timeout_s=20.0)


def test_robots_in_namespaces_are_apart(bus: Bus, path: Path) -> None:
    """Two robots, each in its namespace, have their own states, frames and descriptions."""
    for name in ("one", "two"):
        start(bus, path, "--namespace", name)
    one, two = Asker(bus, "one"), Asker(bus, "two")
    one.move_until_seen("base", "upper", shoulder=1.0)
    eventually(lambda: two.sees("lower", "tool") and two.descriptions)
    assert not two.sees("base", "upper")


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ([], 2, "name the file of the robot: tfbus robot_state arm.urdf"),
        (["none.urdf"], 2, "File 'none.urdf' does not exist"),
        (["PATH", "x"], 2, "'x' is not of the form name:=value"),
        (["PATH", "a:=1"], 1, "takes no arguments"),
        (["PATH", "--prefix", "/"], 1, "link 'base' with the prefix '/'"),
        (["PATH", "--rate", "-1"], 2, "must be at least 0, not -1"),
        (["PATH", "__ns:=r"], 2, "write --namespace r"),
        (["--watch", "--param", "robot_description=<robot/>"], 2, "--watch needs a file"),
        (["--param", "robot_description=g.urdf"], 2, "write tfbus robot_state g.urdf"),
        (["PATH", "--publish-frequency", "10"], 2, "write --rate 10"),
        (["--param", "robot_description=<robot name='r'"], 1, "robot_description:1: not XML"),
    ],
)
def test_a_mistake_is_one_sentence(
    bus: Bus, path: Path, arguments: list[str], code: int, said: str
) -> None:
    """A mistake on the command line or in the file ends it with one sentence."""
    done = bus.run("robot_state", *[str(path) if each == "PATH" else each for each in arguments])
    assert done.returncode == code
    assert said in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
