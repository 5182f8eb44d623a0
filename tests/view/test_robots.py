"""Robots in the scene of the page, without a browser."""

import logging
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.buses import eventually
from tests.live_bus import free_port
from tfbus import Buffer, InvalidArgumentException, Robot, Transform, TransformStamped

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.frames.moment import BusMoment
from tfbus.frames.snapshot import frame_tree
from tfbus.view import View
from tfbus.view.data.layer import PlacedItem
from tfbus.view.data.shapes import Item, MeshFromFile
from tfbus.view.frames import Frames, Placed, frames_of, place
from tfbus.view.local import ShownBuffer
from tfbus.view.page import Page, Serving
from tfbus.view.panels.robots import JointSliders, shown_position, slider_joints, state_of
from tfbus.view.robots import GivenRobots, ShownRobot
from tfbus.view.scene.items import DrawnItems
from tfbus.view.scene.robots import RobotScenes
from tfbus.view.server import serve
from tfbus.view.settings import ViewSettings
from tfbus.wire.fleet import Fleet

ARM = """<robot name="arm">
<material name="red"><color rgba="1 0 0 0.5"/></material>
<link name="base">
  <visual><geometry><box size="1 1 2"/></geometry><material name="red"/></visual>
  <collision><geometry><sphere radius="1"/></geometry></collision>
</link>
<link name="hand">
  <visual><geometry><mesh filename="hand.stl" scale="2 2 2"/></geometry></visual>
</link>
<link name="tool"/>
<joint name="lift" type="prismatic"><parent link="base"/><child link="hand"/>
  <axis xyz="0 0 1"/><limit lower="0.5" upper="1.5" effort="1" velocity="1"/></joint>
<joint name="fix" type="fixed"><parent link="hand"/><child link="tool"/></joint>
</robot>"""

TRIANGLE = b"""solid
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 2 0
endloop
endfacet
endsolid
"""


@pytest.fixture(scope="module")
def server(real: None) -> Iterator[Any]:
    """A server of viser, with no browser."""
    server = serve("127.0.0.1", free_port())
    yield server
    server.stop()


@pytest.fixture
def arm(tmp_path: Path) -> Robot:
    """An arm with a mesh that is there."""
    (tmp_path / "hand.stl").write_bytes(TRIANGLE)
    return Robot.from_text(ARM, folder=tmp_path)


@pytest.fixture
def scenes_of(server: Any) -> Iterator[Callable[..., RobotScenes]]:
    """Make the scenes of robots; they end with the test."""
    made: list[RobotScenes] = []

    def make(*robots: ShownRobot) -> RobotScenes:
        made.append(
            RobotScenes(server.scene, GivenRobots(robots), logging.getLogger("test_robots"))
        )
        return made[-1]

    yield make
    for scenes in made:
        scenes.source.robots = list
        scenes.look(ViewSettings())
        scenes.close()


def seen(*edges: tuple[str, str, float], fixed: str = "base") -> tuple[Placed, Frames]:
    """Frames one above the other, and where they are."""
    buffer = Buffer()
    for parent, child, z in edges:
        stamped = TransformStamped(0, parent, child, Transform((0.0, 0.0, z)))
        buffer.set_transform(stamped, static=True)
    names = sorted({name for edge in edges for name in edge[:2]})
    frames = frames_of(BusMoment(at_ns=0, tree=frame_tree(buffer, (), 0)), buffer, fixed)
    return place(buffer, fixed, names, None), frames


NOTHING = (Placed((), np.zeros((0, 3)), np.zeros((0, 4)), {}), Frames())
ALL = (("base", "hand", 1.0), ("hand", "tool", 0.0))


def load(scenes: RobotScenes) -> None:
    """Wait until all meshes are there."""

    def loaded() -> bool:
        scenes.take_meshes()
        return scenes.progress[0] == scenes.progress[1]

    eventually(loaded)


def nodes(scenes: RobotScenes) -> Sequence[Any]:
    """What a scene has of its only robot."""
    [scene] = scenes.by_robot.values()
    return scene.nodes


def test_meshes_come_while_the_rest_is_shown(
    arm: Robot, scenes_of: Callable[..., RobotScenes]
) -> None:
    """They are counted, and then as large as their scale says."""
    scenes = scenes_of(ShownRobot(arm))
    scenes.look(ViewSettings())
    assert (scenes.progress, len(nodes(scenes))) == ((0, 1), 1)
    load(scenes)
    assert (scenes.progress, len(nodes(scenes))) == ((1, 1), 2)
    points = scenes.points(*seen(*ALL))
    assert points.max(axis=0).tolist() == [2.0, 4.0, 1.0]


def test_what_cannot_be_loaded_is_named_and_the_rest_is_shown(
    scenes_of: Callable[..., RobotScenes], tmp_path: Path
) -> None:
    """With the link, the mesh and the reason."""
    scenes = scenes_of(ShownRobot(Robot.from_text(ARM, folder=tmp_path)))
    scenes.look(ViewSettings())
    [mistake] = scenes.mistakes()
    assert "of link 'hand'" in mistake and "mesh hand.stl: no file " in mistake
    assert len(nodes(scenes)) == 1


def test_collisions_are_shown_on_request_through_the_visuals(
    arm: Robot, scenes_of: Callable[..., RobotScenes]
) -> None:
    """Alone they are solid; nothing of them is made before."""
    scenes = scenes_of(ShownRobot(arm))

    def shown(**settings: Any) -> list[tuple[bool, float]]:
        scenes.look(ViewSettings(**settings))
        load(scenes)
        return [
            (node.is_collision, node.handle.opacity or 1.0)
            for node in nodes(scenes)
            if node.handle.visible
        ]

    assert shown() == [(False, 0.5), (False, 1.0)]
    assert shown(shapes="collision") == [(True, 1.0)]
    assert shown(shapes="both", robot_opacity=0.5) == [(False, 0.25), (False, 0.5), (True, 0.175)]


def test_links_are_where_their_frames_are_and_hidden_without_a_place(
    arm: Robot, scenes_of: Callable[..., RobotScenes]
) -> None:
    """A frame that is gone fades its link too."""
    scenes = scenes_of(ShownRobot(arm, is_described=True))
    scenes.look(ViewSettings())
    placed, frames = seen(("base", "other", 1.0))
    scenes.draw(placed, frames)
    [scene] = scenes.by_robot.values()
    base, hand = scene.links["base"], scene.links["hand"]
    assert (base.frame.visible, hand.frame.visible) == (True, False)
    faded = Frames(replace(frame, opacity=0.25) for frame in seen(*ALL)[1])
    scenes.draw(seen(*ALL)[0], faded)
    assert hand.frame.position.tolist() == [0.0, 0.0, 1.0]
    assert nodes(scenes)[0].handle.opacity == 0.125


def test_a_robot_of_a_file_stands_by_itself_where_its_frames_are_not_on_the_bus(
    arm: Robot, scenes_of: Callable[..., RobotScenes]
) -> None:
    """At rest, or as its sliders say; once it has frames these count."""
    scenes = scenes_of(ShownRobot(arm))
    scenes.look(ViewSettings())
    [scene] = scenes.by_robot.values()
    hand = scene.links["hand"].frame
    scenes.draw(*NOTHING)
    assert hand.position.tolist() == [0.0, 0.0, 1.0]
    scenes.move({"lift": 1.5})
    scenes.draw(*NOTHING)
    assert hand.position.tolist() == [0.0, 0.0, 1.5]
    scenes.draw(*seen(("base", "hand", 0.7)))
    assert hand.position.tolist() == [0.0, 0.0, 0.7]


def test_axes_do_not_hide_a_robot_that_is_drawn(
    arm: Robot, scenes_of: Callable[..., RobotScenes]
) -> None:
    """The axes are there on request, and while the robot is hidden."""
    scenes = scenes_of(ShownRobot(arm, prefix="left_"))
    scenes.look(ViewSettings())
    assert scenes.covered == {"left_base", "left_hand", "left_tool"}
    assert scenes.frames == {"left_base", "left_hand"}
    for settings in (ViewSettings(link_axes=True), ViewSettings(hidden_robots=("left/arm",))):
        scenes.look(settings)
        assert scenes.covered == frozenset()


def test_a_robot_that_changes_is_drawn_again_and_the_other_stays(
    arm: Robot, server: Any, scenes_of: Callable[..., RobotScenes]
) -> None:
    """By what the source has now."""
    scenes = scenes_of(ShownRobot(arm, prefix="a_"), ShownRobot(arm, prefix="b_"))
    scenes.look(ViewSettings())
    kept = list(scenes.by_robot.values())
    assert isinstance(scenes.source, GivenRobots)
    scenes.source.add(ShownRobot(arm, prefix="b_"))
    assert scenes.look(ViewSettings())
    assert [scene in kept for scene in scenes.by_robot.values()] == [True, False]


def test_a_robot_of_a_fleet_has_the_frames_and_the_title_of_its_namespace(arm: Robot) -> None:
    """Shared frames keep their names."""
    names = Fleet(("base",)).names("robot7")
    robot = ShownRobot(arm, "", names, is_described=True)
    assert list(robot.frames.values()) == ["base", "robot7/hand", "robot7/tool"]
    assert (robot.title, robot.origin) == ("robot7/arm", "robot7")


def test_the_state_of_a_robot_is_said_in_a_few_words(arm: Robot) -> None:
    """Which links have no frame yet, and how many have one."""
    robot = ShownRobot(arm, is_described=True)
    assert state_of(robot, Frames(), is_still=False) == "no frames yet"
    assert state_of(robot, seen(("base", "hand", 1.0))[1], is_still=False) == "without tool"
    frames = seen(*ALL)[1]
    assert state_of(robot, frames, is_still=False) == "3 links"
    partly = Frames(
        replace(frame, state="gone") if frame.name == "tool" else frame for frame in frames
    )
    assert state_of(robot, partly, is_still=False).endswith(" 1 of 3 gone")
    wholly = Frames(replace(frame, state="gone") if frame.depth else frame for frame in frames)
    assert state_of(robot, wholly, is_still=False).endswith("> gone")


def test_a_slider_shows_where_its_joint_is(arm: Robot) -> None:
    """Of a joint that turns for ever within one turn, of another within its limits."""
    [lift] = slider_joints(ShownRobot(arm))
    assert (shown_position(lift, 0.2), shown_position(lift, 0.7)) == (0.5, 0.7)
    free = replace(lift, type="continuous", limits=None)
    assert shown_position(free, 7.0) == pytest.approx(7.0 - 2 * np.pi)


@pytest.mark.parametrize("limits", [(0.5, 1.5), (0.5, 0.5), (0.0001, 0.0004), (1.0, np.inf)])
def test_every_joint_gets_a_slider(server: Any, arm: Robot, limits: tuple[float, float]) -> None:
    """Also one that hardly moves; its ends are apart, and it begins between them."""
    ends = f'lower="{limits[0]}" upper="{limits[1]}"'
    robot = ShownRobot(Robot.from_text(arm.text.replace('lower="0.5" upper="1.5"', ends)))
    scenes = RobotScenes(server.scene, GivenRobots([robot]), logging.getLogger("test_robots"))
    sliders = JointSliders(server.gui, robot, None, scenes)
    handle = sliders.sliders[0].handle
    assert handle.min < handle.max
    assert handle.min <= handle.value <= handle.max


@pytest.mark.real
def test_a_program_shows_a_robot_in_its_view(arm: Robot) -> None:
    """Without any frame of its own; again it replaces the former."""
    program, robots = ShownBuffer(Buffer()), GivenRobots()
    page = Page(program, program, Serving(port=free_port()), robots)
    with View(page, program, robots) as view:
        view.add_robot(arm)
        view.add_robot(arm)
        view.add_robot(arm, prefix="left_")
        eventually(lambda: [each.title for each in page.robots.robots] == ["arm", "left/arm"])
        with pytest.raises(InvalidArgumentException):
            view.add_robot(arm, prefix="/left")


def test_markers_have_meshes_of_packages_without_a_robot(server: Any, tmp_path: Path) -> None:
    """Files in a folder that the user names are drawn."""
    (tmp_path / "things/meshes").mkdir(parents=True)
    (tmp_path / "things/meshes/cup.stl").write_bytes(TRIANGLE)
    log = logging.getLogger("view")
    scenes = RobotScenes(server.scene, GivenRobots(), log, package_path=[tmp_path])
    try:
        found = eventually(lambda: scenes.mesh_named("package://things/meshes/cup.stl"))
        assert not isinstance(found, str), found
        assert "--package-path" in str(scenes.mesh_named("package://things/meshes/jug.stl"))
        (tmp_path / "things/meshes/link.stl").symlink_to(tmp_path / "other.stl")
        (tmp_path / "other.stl").write_bytes(TRIANGLE)
        assert "no mesh" in str(scenes.mesh_named("package://things/meshes/link.stl"))
    finally:
        scenes.close()


def test_meshes_that_no_marker_has_any_more_make_room(
    server: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If there are as many as there may be, one that is not drawn is freed; else it is said."""
    for name in ("cup", "jug"):
        (tmp_path / f"{name}.stl").write_bytes(TRIANGLE)
    cup, jug = (str(tmp_path / f"{name}.stl") for name in ("cup", "jug"))
    monkeypatch.setattr("tfbus.view.scene.robots._MOST_FOREIGN", 1)
    log = logging.getLogger("view")
    scenes = RobotScenes(server.scene, GivenRobots(), log, package_path=[tmp_path])
    try:
        eventually(lambda: scenes.mesh_named(cup))
        assert "more than 1 " in str(scenes.mesh_named(jug, lambda: {cup, jug}))
        assert not isinstance(eventually(lambda: scenes.mesh_named(jug, lambda: {jug})), str)
        scenes.look(ViewSettings())
        assert not isinstance(scenes.mesh_named(jug, lambda: {jug}), str | None)
    finally:
        scenes.close()


def test_the_meshes_of_all_items_in_the_scene_are_known(server: Any) -> None:
    """By their names, also once an item has another mesh, or is removed."""
    told: list[set[str]] = []

    def mesh_named(name: str, drawn: Callable[[], Collection[str]]) -> None:
        told.append({*drawn()})

    items = DrawnItems(server, mesh_named)

    def draw(key: str, name: str) -> set[str]:
        item = Item(key, "map", 0, (MeshFromFile(name, (1.0, 1.0, 1.0), None),))
        items.draw(("markers", key), PlacedItem(item, Transform.identity()), 1.0, is_shown=True)
        return told[-1]

    assert draw("a", "cup") == draw("b", "cup") == {"cup"}
    draw("b", "jug")
    assert draw("c", "pot") == {"cup", "jug", "pot"}
    items.remove(("markers", "a"))
    assert draw("c", "pot") == {"jug", "pot"}
    items.remove(("markers", "b"))
    assert draw("c", "pot") == {"pot"}


def test_markers_name_files_by_paths_below_the_folders_of_the_user(
    tmp_path: Path, server: Any
) -> None:
    """No other file is opened, by whatever name or link, and none but meshes."""
    mine = tmp_path / "my meshes"
    (mine / "in").mkdir(parents=True)
    for file in (mine / "in/cup.stl", tmp_path / "other.stl", mine / "notes.txt"):
        file.write_bytes(TRIANGLE)
    (mine / "link.stl").symlink_to(tmp_path / "other.stl")
    (mine / "text.stl").symlink_to(mine / "notes.txt")
    log = logging.getLogger("view")
    allowing = RobotScenes(server.scene, GivenRobots(), log, package_path=[mine])
    refusing = RobotScenes(server.scene, GivenRobots(), log)
    try:
        cup = mine / "in/cup.stl"
        for name in (cup.as_uri(), f"file://{cup}", str(cup)):
            found = eventually(lambda name=name: allowing.mesh_named(name))
            assert not isinstance(found, str), found
            assert "--package-path" in str(refusing.mesh_named(name))
        for name in (
            f"file://{mine}/../other.stl",
            f"file://{mine}/%2e%2e/other.stl",
            f"file://{mine}/link.stl",
            f"file://{mine}/text.stl",
            f"file://{mine}/notes.txt",
            f"file://{mine}/no.stl",
            f"file://{tmp_path}/other.stl",
            f"file://{mine}",
            f"file://{cup}\0",
            "file://in/cup.stl",
            "in/cup.stl",
            f"http://{cup}",
        ):
            assert "no mesh" in str(allowing.mesh_named(name))
    finally:
        allowing.close()
        refusing.close()


def test_markers_have_the_meshes_of_robots_and_of_their_packages(
    tmp_path: Path, scenes_of: Callable[..., RobotScenes]
) -> None:
    """A file of anything else is not opened, whatever its name says."""
    package = tmp_path / "arms"
    (package / "meshes").mkdir(parents=True)
    for file in (package / "meshes/hand.stl", package / "meshes/cup.stl", tmp_path / "other.stl"):
        file.write_bytes(TRIANGLE)
    text = ARM.replace("hand.stl", "package://arms/meshes/hand.stl")
    scenes = scenes_of(ShownRobot(Robot.from_text(text, folder=tmp_path, package_path=[tmp_path])))
    scenes.look(ViewSettings())
    for name in ("hand", "cup"):
        found = eventually(lambda name=name: scenes.mesh_named(f"package://arms/meshes/{name}.stl"))
        assert not isinstance(found, str), found
        assert len(found.parts) == 1
    for name in (
        "package://arms/../other.stl",
        "package://strangers/meshes/cup.stl",
        "package://arms/meshes/cup\0.stl",
        f"package://arms/meshes/{'cup' * 100}.stl",
        f"file://{tmp_path}/other.stl",
        str(tmp_path / "other.stl"),
    ):
        assert "no mesh" in str(scenes.mesh_named(name))
