"""All robots in the scene: which of them are drawn, where, and what is still being loaded."""

import logging
from collections.abc import Collection, Mapping
from typing import get_args

import numpy as np
import viser

from tfbus.errors import InvalidArgumentException
from tfbus.view.meshes.loader import MeshLoader
from tfbus.view.model.frames import Floats, Frames, Placed
from tfbus.view.model.robots import RobotSource, ShownRobot
from tfbus.view.model.settings import ViewSettings
from tfbus.view.scene.robot import Look, RobotScene, Shown, all_mistakes
from tfbus.wording import printable

# A picture must not wait for many meshes.
_MESHES_A_STEP = 4


class RobotScenes:
    """Draws the robots of a source at the frames of their links.

    A robot of a file whose frames are not published stands at the origin, at `positions`.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        source: RobotSource,
        log: logging.Logger,
        *,
        heeds_up_axis: bool = False,
    ) -> None:
        self.source = source
        self.positions: dict[str, float] = {}
        self._scene = scene
        self._log = log
        self._loader = MeshLoader(source.fetch, heeds_up_axis=heeds_up_axis)
        self._count = 0
        self.by_robot: dict[ShownRobot, RobotScene] = {}
        self._settings: ViewSettings | None = None
        self._logged: set[str] = set()
        self._still: dict[ShownRobot, Placed] = {}

    @property
    def robots(self) -> Collection[ShownRobot]:
        """The robots in the scene."""
        return self.by_robot.keys()

    def close(self) -> None:
        """End the loading of meshes, and the source."""
        self._loader.close()
        self.source.close()

    # What is drawn

    def look(self, settings: ViewSettings) -> bool:
        """Add robots that have come, and remove those that have left; whether there were any."""
        found = self.source.robots()
        is_new = list(found) != list(self.by_robot)
        if is_new:
            self._replace(found)
            self._log_mistakes()
        if is_new or settings is not self._settings:
            self._settings = settings
            for robot, scene in self.by_robot.items():
                scene.show(_look_of(settings), robot.title not in settings.hidden_robots)
        return is_new

    def _replace(self, found: Collection[ShownRobot]) -> None:
        for robot in [robot for robot in self.by_robot if robot not in found]:
            self.by_robot.pop(robot).remove()
        for robot in found:
            if robot not in self.by_robot:
                self._count += 1
                path = f"/robots/{self._count}"
                self.by_robot[robot] = RobotScene(self._scene, path, robot, self._loader)
        self.by_robot = {robot: self.by_robot[robot] for robot in found}
        used = {source for scene in self.by_robot.values() for source in scene.sources}
        self._loader.keep(used)

    def take_meshes(self) -> bool:
        """Draw meshes that have come; whether there were any."""
        taken = any([scene.take_meshes(_MESHES_A_STEP) for scene in self.by_robot.values()])
        if taken:
            self._log_mistakes()
        return taken

    def _log_mistakes(self) -> None:
        for mistake in self._lacking():
            if mistake not in self._logged and len(self._logged) < 1000:
                self._logged.add(mistake)
                self._log.warning("%s", mistake)

    def draw(self, placed: Placed, frames: Frames) -> None:
        """Move the robots to where their frames are."""
        for robot, scene in self.by_robot.items():
            if self.is_still(robot, frames):
                scene.draw(self._standing(robot), lambda frame: 1.0)
            else:
                self._still.pop(robot, None)
                scene.draw(placed, lambda frame: frames[frame].opacity if frame in frames else 1.0)

    def is_still(self, robot: ShownRobot, frames: Frames) -> bool:
        """Whether it stands by itself: a robot of a file that has no frames."""
        return not robot.is_described and not any(
            frame in frames for frame in robot.frames.values()
        )

    def move(self, positions: Mapping[str, float]) -> None:
        """Let robots without frames stand so."""
        self.positions.update(positions)
        self._still.clear()

    def _standing(self, robot: ShownRobot) -> Placed:
        placed = self._still.get(robot)
        if placed is None:
            known = {
                joint.name: self.positions[joint.name]
                for joint in robot.robot.free_joints
                if joint.name in self.positions
            }
            try:
                poses = robot.robot.fk(known)
            except InvalidArgumentException:
                poses = robot.robot.fk()
            xyz = np.array([pose.xyz for pose in poses.values()])
            quat = np.array([pose.quat_xyzw for pose in poses.values()])[:, [3, 0, 1, 2]]
            names = tuple(robot.frame_of(link) for link in poses)
            placed = self._still[robot] = Placed(names, xyz, quat, {})
        return placed

    # What there is

    @property
    def frames(self) -> frozenset[str]:
        """The frames of all links with shapes, which need a place."""
        return frozenset(
            robot.frame_of(link) for robot in self.by_robot for link in robot.shaped_links
        )

    @property
    def covered(self) -> frozenset[str]:
        """The frames of all links of the robots that are drawn: their axes would hide them."""
        settings = self._settings
        if settings is None or settings.link_axes:
            return frozenset()
        return frozenset(
            frame
            for robot in self.by_robot
            if robot.shaped_links and robot.title not in settings.hidden_robots
            for frame in robot.frames.values()
        )

    @property
    def progress(self) -> tuple[int, int]:
        """How many meshes are loaded, and how many there are."""
        scenes = self.by_robot.values()
        return sum(scene.loaded for scene in scenes), sum(len(scene.sources) for scene in scenes)

    def loaded(self, robot: ShownRobot) -> tuple[int, int]:
        """The same of one robot."""
        scene = self.by_robot[robot]
        return scene.loaded, len(scene.sources)

    def mistakes(self) -> list[str]:
        """The parts that cannot be shown, in sentences that can be printed."""
        return [*self.source.mistakes(), *self._lacking()]

    def _lacking(self) -> list[str]:
        return [printable(each, 400) for each in all_mistakes(self.by_robot.values())]

    def built(self, placed: Placed, frames: Frames) -> tuple[int, int]:
        """How many robots that are shown have frames, and how many of their links have a place and
        of their meshes are loaded: with each there is more to see.
        """
        shown = [scene for robot, scene in self.by_robot.items() if self._is_shown(robot)]
        moving = [scene for scene in shown if not self.is_still(scene.robot, frames)]
        at = [(scene, self._where(scene.robot, placed, frames)) for scene in shown]
        parts = sum(scene.loaded + scene.placed_links(where) for scene, where in at)
        return sum(scene.placed_links(placed) > 0 for scene in moving), parts

    def points(self, placed: Placed, frames: Frames) -> Floats:
        """Points (N, 3) in the fixed frame that robots which are shown lie between."""
        found = [np.zeros((0, 3))]
        for robot, scene in self.by_robot.items():
            if self._is_shown(robot):
                found.append(scene.points(self._where(robot, placed, frames)))
        return np.concatenate(found)

    def _is_shown(self, robot: ShownRobot) -> bool:
        return self._settings is None or robot.title not in self._settings.hidden_robots

    def _where(self, robot: ShownRobot, placed: Placed, frames: Frames) -> Placed:
        return self._standing(robot) if self.is_still(robot, frames) else placed


def _look_of(settings: ViewSettings) -> Look:
    shown: Shown = "visual"
    for each in get_args(Shown):
        if each == settings.shapes:
            shown = each
    return Look(shown, settings.robot_opacity)
