"""Robots as Foxglove's 3D panel gets them: descriptions, and the files of their meshes."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import pytest

pytest.importorskip("websockets", reason="needs websockets: pip install websockets")

from tests import needs
from tests.builders import S
from tests.buses import DEADLINE_S, eventually
from tests.foxglove.client import Client
from tests.simulated_bus import Bus
from tfbus import Fleet, Node, Robot, ServiceError
from tfbus.foxglove.front import Serving
from tfbus.foxglove.live import LiveBridge
from tfbus.messages import RobotDescription, RobotMesh
from tfbus.ros.schema import MessageCodec

DESCRIBED = MessageCodec.of_type(RobotDescription)

# Meshes in a package, beside the URDF, above it, and on the network.
URDF = """<robot name="arm">
<link name="base"><visual><geometry><mesh filename="package://arm/meshes/my base.dae"/></geometry>
  <material name="red"><color rgba="1 0 0 1"/></material></visual></link>
<link name="hand"><visual><geometry><mesh filename="hand.stl"/></geometry></visual>
  <collision><geometry><mesh filename="../shared/nail.obj"/></geometry></collision></link>
<link name="tip"><visual><geometry><mesh filename="https://a.example/tip.stl"/></geometry>
  </visual></link>
<joint name="wrist" type="fixed"><parent link="base"/><child link="hand"/></joint>
<joint name="end" type="fixed"><parent link="hand"/><child link="tip"/></joint>
<transmission name="t"><actuator name="motor"/></transmission>
</robot>"""


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """The robot with the files of its meshes, in the folder `urdf` of package `arm`."""
    package = tmp_path / "arm"
    for folder in ("urdf", "meshes", "shared", "textures"):
        (package / folder).mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>arm</name></package>")
    (package / "meshes" / "my base.dae").write_bytes(b"base")
    (package / "textures" / "wood.png").write_bytes(b"wood")
    (package / "textures" / "notes.txt").write_bytes(b"secret")
    (package / "urdf" / "hand.stl").write_bytes(b"hand")
    (package / "shared" / "nail.obj").write_bytes(b"nail")
    (package / "shared" / "nail.mtl").write_bytes(b"look")
    (tmp_path / "elsewhere.png").write_bytes(b"secret")
    file = package / "urdf" / "arm.urdf"
    file.write_text(URDF)
    return file


@contextmanager
def watching(bridge: LiveBridge) -> Iterator[Client]:
    """A client of a bridge, which ends with it."""
    try:
        with Client(bridge.front.port) as client:
            yield client
    finally:
        bridge.close()


def describe(node: Node, urdf: str, prefix: str = "", source: str = "") -> None:
    """Publish a robot for late joiners."""
    publisher = node.create_publisher(RobotDescription, "robot_description", retained=True)
    publisher.publish(RobotDescription(urdf, prefix, source))


def described(client: Client, topic: str = "/robot_description") -> ElementTree.Element:
    """The root element of the last URDF that came, once there is one."""
    data = eventually(lambda: client.of(topic))[-1]
    return ElementTree.fromstring(DESCRIBED.decode(data)["urdf"])


def names(robot: ElementTree.Element, path: str, attribute: str) -> list[str]:
    """An attribute of all elements of a path."""
    return [each.attrib[attribute] for each in robot.findall(path)]


def test_a_robot_of_the_bus_is_a_string_with_a_urdf(bus: Bus, urdf: Path) -> None:
    """Its links are called as its frames, and its meshes can be asked for."""
    describe(bus.node("arm"), URDF, "left_", str(urdf))
    with watching(LiveBridge(bus.node("foxglove"), Serving(port=0))) as client:
        channel = client.subscribe("/robot_description")
        assert (channel["encoding"], channel["schemaName"]) == ("cdr", "std_msgs/msg/String")
        robot = described(client)
        assert names(robot, "link", "name") == ["left_base", "left_hand", "left_tip"]
        assert names(robot, "joint/parent", "link") == ["left_base", "left_hand"]
        assert names(robot, "joint/child", "link") == ["left_hand", "left_tip"]
        assert names(robot, ".//mesh", "filename") == [
            "package://arm/meshes/my%20base.dae",
            "package://arm/hand.stl",
            "package://arm/up/shared/nail.obj",
        ]
        assert names(robot, ".//color", "rgba") == ["1 0 0 1"]


def test_a_late_client_gets_the_robot_too(bus: Bus) -> None:
    """Though it was published before all clients, and is sent once."""
    describe(bus.node("arm"), URDF)
    with watching(LiveBridge(bus.node("foxglove"), Serving(port=0))) as client:
        client.subscribe("/robot_description")
        described(client)
        port = client.port
        with Client(port) as late:
            late.subscribe("/robot_description")
            assert described(late).attrib["name"] == "arm"


def test_only_the_files_of_robots_can_be_asked_for(bus: Bus, urdf: Path) -> None:
    """Meshes, and the pictures and materials beside them in their package."""
    robot = Robot.from_urdf(urdf)
    with watching(LiveBridge(bus.node("foxglove"), Serving(port=0), robot=robot)) as client:
        client.subscribe("/robot_description")
        described(client)
        assert "assets" in client.texts_of("serverInfo")[0]["capabilities"]
        for uri, content in {
            "package://arm/meshes/my%20base.dae": b"base",
            "package://arm/hand.stl": b"hand",
            "package://arm/up/shared/nail.obj": b"nail",
            "package://arm/up/shared/nail.mtl": b"look",
            "package://arm/textures/wood.png": b"wood",
        }.items():
            assert client.fetch(uri) == content
        for uri in (
            "package://arm/textures/notes.txt",
            "package://arm/package.xml",
            "package://arm/../elsewhere.png",
            "package://arm/%2e%2e/elsewhere.png",
            "package://elsewhere.png",
            "file:///etc/passwd",
            "/etc/passwd",
            "",
        ):
            refused = client.fetch(uri)
            assert isinstance(refused, str), uri


@pytest.mark.parametrize("folder", ["", "arm"])
def test_files_of_this_machine_are_not_for_a_stranger_to_name(
    bus: Bus, urdf: Path, folder: str
) -> None:
    """A description counts for the folders that the command line has; its `source` for none, and
    the meshes beside it come from the machine that it is from.
    """
    arm = bus.node("arm")
    arm.create_service(RobotMesh, "robot_mesh", lambda request: RobotMesh.Response(b"far", 3, "1"))
    describe(arm, URDF, "", str(urdf))
    given = [urdf.parents[2] / folder] if folder else []
    here = {"package://arm/meshes/my%20base.dae": b"base", "package://arm/hand.stl": b"hand"}
    bridge = LiveBridge(bus.node("foxglove"), Serving(port=0), package_path=given)
    with watching(bridge) as client:
        client.subscribe("/robot_description")
        described(client)
        assert {uri: client.fetch(uri) for uri in here} == (
            here if folder else dict.fromkeys(here, b"far")
        )


def test_a_mesh_that_cannot_be_had_names_the_remedy(bus: Bus, urdf: Path) -> None:
    """Where the robot's machine does not serve it, by the option that names a folder here."""
    describe(bus.node("arm"), URDF, "", str(urdf))
    with watching(LiveBridge(bus.node("foxglove"), Serving(port=0))) as client:
        client.subscribe("/robot_description")
        described(client)
        refused = client.fetch("package://arm/hand.stl")
        assert isinstance(refused, str) and "--package-path" in refused and "--urdf" in refused


@pytest.mark.parametrize(
    "text",
    [
        URDF,
        URDF.replace("<mesh", "<x:mesh xmlns:x='a'"),
        URDF.replace('<color rgba="1 0 0 1"/>', '<texture filename="https://a.example/a.png"/>'),
        # No robot for us: one of two roots.
        URDF.replace('<joint name="end"', '<other name="end"').replace("/hand.stl", "//a.example/"),
        '<!DOCTYPE robot [<!ENTITY a "https://a.example/">]>' + URDF,
        "https://a.example/",
    ],
)
def test_clients_are_sent_to_no_address_of_a_stranger(bus: Bus, text: str) -> None:
    """Neither by a mesh nor by a texture, nor by the text of what is no robot; it is said once."""
    describe(bus.node("arm"), text, "", f"--><robot>{URDF}</robot>")
    with watching(LiveBridge(bus.node("foxglove"), Serving(port=0))) as client:
        client.subscribe("/robot_description")
        data = eventually(lambda: client.of("/robot_description"))[-1]
        assert "a.example" not in DESCRIBED.decode(data)["urdf"] and b"a.example" not in data


def test_a_robot_of_a_file_takes_the_place_of_those_described(bus: Bus, urdf: Path) -> None:
    """As in the view; clients that come later have it, too."""
    describe(bus.node("other"), "<robot name='other'><link name='base'/></robot>")
    bridge = LiveBridge(bus.node("foxglove"), Serving(port=0), robot=Robot.from_urdf(urdf))
    with watching(bridge) as client:
        for _ in range(2):
            with Client(client.port) as late:
                late.subscribe("/robot_description")
                assert described(late).attrib["name"] == "arm"


def test_a_robot_of_a_fleet_has_its_frames_and_meshes_in_its_namespace(bus: Bus) -> None:
    """The meshes come from the machine that describes it."""

    def part(request: RobotMesh.Request) -> RobotMesh.Response:
        if request.mesh not in ("package://arm/meshes/my base.dae", "package://arm/wood.png"):
            raise ServiceError("no such mesh")
        return RobotMesh.Response(request.mesh.encode(), len(request.mesh), "1")

    robot7 = bus.node("arm", namespace="robot7")
    robot7.create_service(RobotMesh, "robot_mesh", part)
    describe(robot7, URDF)
    bridge = LiveBridge(bus.node("foxglove"), Serving(port=0), fleet=Fleet())
    with watching(bridge) as client:
        client.subscribe("/robot7/robot_description")
        robot = described(client, "/robot7/robot_description")
        assert names(robot, "link", "name")[0] == "robot7/base"
        uri = "package://robot7/arm/meshes/my%20base.dae"
        assert names(robot, ".//mesh", "filename")[0] == uri
        assert client.fetch(uri) == b"package://arm/meshes/my base.dae"
        assert client.fetch("package://robot7/arm/wood.png") == b"package://arm/wood.png"
        refused = client.fetch("package://robot7/arm/hand.stl")
        assert isinstance(refused, str) and "no such mesh" in refused


def test_what_is_no_robot_is_passed_on(bus: Bus) -> None:
    """Without its meshes: a client may know more. The log says what is wrong."""
    describe(bus.node("arm"), "<robot name='arm'/>")
    with watching(LiveBridge(bus.node("foxglove"), Serving(port=0))) as client:
        client.subscribe("/robot_description")
        assert described(client).tag == "robot"


def test_a_recording_has_the_robots_that_were_described(tmp_path: Path, urdf: Path) -> None:
    """Also before the description, and for a client that comes while it stands elsewhere."""
    needs.module("mcap")
    from tfbus.foxglove.playback import PlaybackBridge
    from tfbus.recording.items import TopicItem
    from tfbus.recording.writer import RecordingWriter

    path = tmp_path / "run.mcap"
    values = {"urdf": URDF, "prefix": "left_", "source": str(urdf)}
    with RecordingWriter(path) as writer:
        writer.write(TopicItem(S, "battery", "Battery", {"volts": 1.0}))
        writer.write(
            TopicItem(2 * S, "robot_description", "RobotDescription", values, retained=True)
        )
        writer.write(TopicItem(3 * S, "battery", "Battery", {"volts": 1.0}))
    given = [urdf.parents[1]]
    bridge = PlaybackBridge([path], (S, 3 * S), Serving(port=0), package_path=given)
    player = threading.Thread(target=bridge.run, daemon=True)
    player.start()
    try:
        for _ in range(2):
            with Client(bridge.front.port) as client:
                client.subscribe("/robot_description")
                assert names(described(client), "link", "name")[0] == "left_base"
                assert client.fetch("package://arm/hand.stl") == b"hand"
                client.control(play=False, seek_ns=2 * S + 1)
    finally:
        bridge.stop()
        player.join(DEADLINE_S)
        bridge.close()
