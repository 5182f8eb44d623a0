"""The robots that the page finds on the bus, and in recordings."""

from collections.abc import Callable
from pathlib import Path
from threading import Event

import msgpack
import pytest

from tests import needs
from tests.buses import eventually
from tests.live_bus import free_port
from tests.simulated_bus import Bus
from tfbus import Buffer, Fleet, Node, Robot
from tfbus.base.errors import ServiceError
from tfbus.bus.presence import ask_nodes
from tfbus.messages import JointState, RobotDescription, RobotMesh

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.recording.items import TopicItem
from tfbus.robot.model import Mesh
from tfbus.view.local import ShownBuffer
from tfbus.view.meshes.mesh import MeshError
from tfbus.view.page import Page, Serving
from tfbus.view.robots import GivenRobots, RobotsOnBus, ShownRobot


def urdf(name: str) -> str:
    """A robot of one link and a joint."""
    return (
        f"<robot name='{name}'><link name='base'/><link name='hand'/>"
        "<joint name='lift' type='continuous'><parent link='base'/><child link='hand'/></joint>"
        "</robot>"
    )


def describe(node: Node, text: str, prefix: str = "") -> None:
    """Publish a robot for late joiners."""
    publisher = node.create_publisher(RobotDescription, "robot_description", retained=True)
    publisher.publish(RobotDescription(text, prefix))


def titles(robots: RobotsOnBus) -> list[str]:
    """What the robots are called."""
    return [robot.title for robot in robots.robots()]


def test_a_robot_that_was_described_before_is_found_and_a_new_one_replaces_it(bus: Bus) -> None:
    """The same description again changes nothing."""
    node = bus.node("arm")
    publisher = node.create_publisher(RobotDescription, "robot_description", retained=True)
    publisher.publish(RobotDescription(urdf("old")))
    robots = RobotsOnBus(bus.node("view"))
    eventually(lambda: titles(robots) == ["old"])
    [old] = robots.robots()
    publisher.publish(RobotDescription(urdf("old")))
    publisher.publish(RobotDescription(urdf("new")))
    eventually(lambda: titles(robots) == ["new"])
    assert robots.robots() != [old]


def test_robots_of_a_fleet_are_told_apart_by_namespace_and_prefix(bus: Bus) -> None:
    """Without a fleet, only the robots of the own namespace are shown."""
    describe(bus.node("a", namespace="robot3"), urdf("arm"))
    describe(bus.node("b", namespace="robot7"), urdf("arm"), "left_")
    describe(bus.node("c"), urdf("gantry"))
    view = bus.node("view")
    fleet, alone = RobotsOnBus(view, Fleet(("base",))), RobotsOnBus(view)
    eventually(lambda: titles(fleet) == ["gantry", "robot3/arm", "robot7/left/arm"])
    eventually(lambda: titles(alone) == ["gantry"])
    frames = list(fleet.robots()[2].frames.values())
    assert frames == ["robot7/left_base", "robot7/left_hand"]


def test_a_description_that_is_none_is_named_and_the_former_robot_stays(bus: Bus) -> None:
    """With the line of the mistake; the text of a stranger is printable."""
    node = bus.node("arm")
    publisher = node.create_publisher(RobotDescription, "robot_description", retained=True)
    robots = RobotsOnBus(bus.node("view"))
    publisher.publish(RobotDescription(urdf("arm")))
    eventually(lambda: titles(robots) == ["arm"])
    publisher.publish(RobotDescription("<robot name='x'>\n<link name='\u202e'/><joint/></robot>"))
    [mistake] = eventually(robots.mistakes)
    assert mistake.startswith("The robot_description ")
    assert "2" in mistake
    assert mistake.isprintable()
    assert titles(robots) == ["arm"]


def test_bytes_that_are_no_description_are_logged_once(
    bus: Bus, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever the reasons are, which the page shows."""
    robots = RobotsOnBus(bus.node("view"))
    publisher = bus.node("noise").create_raw_publisher("robot_description")
    eventually(lambda: publisher.publish(b"\xc1") or robots.mistakes())
    former = robots.mistakes()
    eventually(lambda: publisher.publish(b"\xa1\xff") or robots.mistakes() != former)
    lines = capsys.readouterr().err.splitlines()
    assert len([line for line in lines if "is not shown" in line]) == 1


def mesh_files(robots: RobotsOnBus) -> list[Path | None]:
    """The files of all meshes."""
    shapes = [visual.shape for robot in robots.robots() for visual in robot.visuals]
    return [shape.file for shape in shapes if isinstance(shape, Mesh)]


def test_a_robot_whose_prefix_changes_is_one_robot(bus: Bus) -> None:
    """Another of the same file, by another node, is another; so is one of another file."""
    right = bus.node("right").create_publisher(RobotDescription, "robot_description", retained=True)
    right.publish(RobotDescription(urdf("arm"), "right_", "arm.urdf"))
    left = bus.node("left").create_publisher(RobotDescription, "robot_description", retained=True)
    robots = RobotsOnBus(bus.node("view"))
    for prefix in ("left_", "a_", "b_"):
        left.publish(RobotDescription(urdf("arm"), prefix, "arm.urdf"))
        expected = [f"{prefix.strip('_')}/arm", "right/arm"]
        eventually(lambda: titles(robots) == expected)  # noqa: B023  # called at once
    left.publish(RobotDescription(urdf("hand"), "c_", "hand.urdf"))
    eventually(lambda: titles(robots) == ["b/arm", "c/hand", "right/arm"])


def test_a_mistake_is_forgotten_once_the_robot_is_described_again(bus: Bus) -> None:
    """Also where it is the robot that is shown already."""
    publisher = bus.node("arm").create_publisher(
        RobotDescription, "robot_description", retained=True
    )
    robots = RobotsOnBus(bus.node("view"))
    publisher.publish(RobotDescription(urdf("arm")))
    eventually(lambda: titles(robots) == ["arm"])
    publisher.publish(RobotDescription("<robot/>"))
    eventually(robots.mistakes)
    publisher.publish(RobotDescription(urdf("arm")))
    eventually(lambda: not robots.mistakes())
    assert titles(robots) == ["arm"]


def test_the_source_of_a_description_counts_in_a_given_folder_only(
    bus: Bus, tmp_path: Path
) -> None:
    """Its meshes lie beside that file; elsewhere a stranger would have files of this machine read.
    The same robot of another file is read again.
    """
    text = urdf("arm").replace(
        "<link name='base'/>",
        "<link name='base'><visual><geometry><mesh filename='a.stl'/></geometry></visual></link>",
    )
    given, other = tmp_path / "given", tmp_path / "other"
    for folder in (given, other):
        folder.mkdir()
        (folder / "arm.urdf").write_text(text)
    publisher = bus.node("arm").create_publisher(
        RobotDescription, "robot_description", retained=True
    )
    robots = RobotsOnBus(bus.node("view"), package_path=[given])
    for folder, file in ((other, None), (given, given / "a.stl")):
        publisher.publish(RobotDescription(text, "", str(folder / "arm.urdf")))
        eventually(lambda: mesh_files(robots) == [file])  # noqa: B023  # called at once


def test_mistakes_are_named_of_the_last_namespaces_only(bus: Bus) -> None:
    """There may be as many namespaces as a stranger likes; some of them no service can have."""
    robots = RobotsOnBus(bus.node("view"), Fleet())
    good = msgpack.packb({"urdf": urdf("arm"), "prefix": "", "source": ""})
    for number in range(30):
        robots.take(f"robot{number}/robot_description", b"", "")
    robots.take("my robot/robot_description", good, "")
    robots.take("robot7/robot_description", good, "")
    eventually(lambda: titles(robots) == ["robot7/arm"])
    assert len(robots.mistakes()) == 20
    assert "'my robot' cannot be" in robots.mistakes()[-1]


def test_descriptions_that_come_too_fast_are_left_out(bus: Bus) -> None:
    """What waits to be read takes limited memory; it is said, and those before are read."""
    node = bus.node("view")
    robots = RobotsOnBus(node, Fleet())
    may_read = Event()

    def wait() -> None:
        may_read.wait(30)

    node.executor.submit("a wait", wait)
    for number in range(2000):
        text = urdf(f"arm{number}")
        payload = msgpack.packb({"urdf": text, "prefix": "", "source": ""})
        robots.take("robot_description", payload, "")
    assert any("came too fast" in mistake for mistake in robots.mistakes())
    may_read.set()
    eventually(lambda: titles(robots) == ["arm999"])


def serve_mesh(node: Node, content: Callable[[], bytes], size: int = 4) -> None:
    """A mesh `arm.stl` in parts of this size."""

    def part(request: RobotMesh.Request) -> RobotMesh.Response:
        if request.mesh != "arm.stl":
            raise ServiceError("the description does not name it")
        data = content()
        piece = data[request.offset : request.offset + size]
        return RobotMesh.Response(piece, len(data), data[:1].decode())

    node.create_service(RobotMesh, "robot_mesh", part)


def test_a_mesh_that_is_not_here_is_fetched_in_parts_and_again_where_it_changes(bus: Bus) -> None:
    """From the namespace of its robot."""
    versions = iter([b"1 first", *[b"2 second version"] * 100])
    serve_mesh(bus.node("arm", namespace="robot7"), lambda: next(versions))
    robots = RobotsOnBus(bus.node("view"), Fleet())
    assert robots.fetch("robot7", "arm.stl", 30.0) == b"2 second version"
    with pytest.raises(MeshError, match="does not name it"):
        robots.fetch("robot7", "/etc/passwd", 30.0)


def test_no_client_stays_of_a_robot_whose_meshes_are_here(bus: Bus) -> None:
    """Robots come and go: the node of a page that stays open calls a service while it fetches."""
    view, other = bus.node("view"), bus.node("other")
    robots = RobotsOnBus(view, Fleet())
    for name in ("robot7", "robot8"):
        serve_mesh(bus.node("arm", namespace=name), lambda: b"content")
        robots.fetch(name, "arm.stl", 30.0)
    calls = {node.name: node.calls for node in ask_nodes(other.session).nodes}
    assert calls["/view"] == {}


def test_a_mesh_that_comes_too_slowly_is_given_up(bus: Bus) -> None:
    """However its parts come, one byte at a time among them."""
    served = []

    def one_byte(request: RobotMesh.Request) -> RobotMesh.Response:
        served.append(request.offset)
        return RobotMesh.Response(b"x", 10**8, "1")

    bus.node("arm").create_service(RobotMesh, "robot_mesh", one_byte)
    robots = RobotsOnBus(bus.node("view"))
    with pytest.raises(MeshError, match=r"too slowly|timed out"):
        robots.fetch("", "arm.stl", 0.1)
    assert served


def test_joints_follow_joint_states_and_their_targets_are_sent(bus: Bus) -> None:
    """Several messages may have a part of the joints each."""
    arm = bus.node("arm", namespace="robot7")
    states = arm.create_publisher(JointState, "joint_states")
    got: list[JointState] = []
    robots = RobotsOnBus(bus.node("view"), Fleet())
    shown = ShownRobot(Robot.from_text(urdf("arm")), "", Fleet().names("robot7"))
    joints = robots.joints(shown)
    assert joints is not None
    assert not joints.is_heard
    arm.create_subscription(JointState, "joint_targets", got.append)
    eventually(lambda: joints.is_heard)

    def known() -> bool:
        states.publish(JointState(1, ("lift",), (0.5,)))
        states.publish(JointState(1, ("turn",), (0.7,)))
        return joints.positions == {"lift": 0.5, "turn": 0.7}

    eventually(known)
    joints.send({"lift": 0.25})
    eventually(lambda: got)
    assert (got[0].name, got[0].position) == (("lift",), (0.25,))


def test_a_recording_shows_the_robot_of_its_cursor(tmp_path: Path) -> None:
    """Before its first description by that one; a string as in ROS is a description too."""
    pytest.importorskip("mcap", reason="needs mcap: the extra bag")
    from tests.recordings import at, write
    from tfbus.recording.reader import RecordingReader
    from tfbus.view.replay import Replay
    from tfbus.view.robots import RecordedRobots

    topic = "robot_description"
    path = write(
        tmp_path / "arm.mcap",
        TopicItem(at(0.0), "other", "Other", {"x": 1.0}),
        TopicItem(
            at(2.0), topic, "RobotDescription", {"urdf": urdf("one"), "prefix": "", "source": ""}
        ),
        TopicItem(
            at(4.0), topic, "RobotDescription", {"urdf": urdf("two"), "prefix": "", "source": ""}
        ),
        TopicItem(at(9.0), "other", "Other", {"x": 1.0}),
    )
    with RecordingReader(path) as reader:
        replay = Replay(reader, at_ns=at(0.0))
        robots = RecordedRobots(reader, replay)
        shown = []
        for seconds in (0.0, 3.0, 5.0):
            replay.playhead.seek(at(seconds))
            shown.append([robot.title for robot in robots.robots()])
    assert shown == [["one"], ["one"], ["two"]]


@pytest.mark.real
def test_a_reader_of_a_closed_bus_sees_robots_and_moves_none(tmp_path: Path) -> None:
    """It has no sliders, and its meshes are those on its machine."""
    needs.module("cryptography")
    from tests.closed_bus import ClosedBus
    from tfbus.bus.rights import Identity

    bus = ClosedBus(tmp_path, Identity("arm", "publisher"), Identity("laptop", "reader"))
    bus.open()
    try:
        describe(bus.node("arm"), urdf("arm"))
        robots = RobotsOnBus(bus.node("laptop"))
        eventually(lambda: titles(robots) == ["arm"])
        assert robots.joints(robots.robots()[0]) is None
        with pytest.raises(MeshError, match="may not call"):
            robots.fetch("", "package://arm/hand.stl", 30.0)
    finally:
        bus.close()


@pytest.mark.real
@pytest.mark.parametrize("read_only", [False, True])
def test_a_page_that_is_read_only_has_no_sliders(read_only: bool) -> None:
    """It shows the robot, and lets nothing move it."""
    buffer = Buffer()
    program = ShownBuffer(buffer)
    robots = GivenRobots([ShownRobot(Robot.from_text(urdf("arm")))])
    serving = Serving(port=free_port(), read_only=read_only)
    page = Page(program, program, serving, robots)
    try:
        page.step()
        panel = page.panel.robots_panel
        assert panel is not None and (panel.sliders is None) is read_only
    finally:
        page.close()
