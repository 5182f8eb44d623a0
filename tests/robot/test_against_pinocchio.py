"""Every link of robots that others published has Pinocchio's pose."""

import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.robot import robots
from tfbus import Robot, UrdfError

pytestmark = pytest.mark.real

CONFIGURATIONS = 1000
WITHIN = 1e-9

# What we refuse and urdfdom does not: the end of the sentence that says why.
STRICTER = {
    "alex_psyonic_hands.urdf": "mimics no joint 'index_q1'; did you mean 'Left_index_q1'?",
}


class Pinocchio:
    """A process that answers with the poses of all links."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process = subprocess.Popen(
            [robots.python_of_pinocchio(), str(Path(__file__).with_name("pinocchio_poses.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # What urdfdom says of a file goes there.
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def poses(
        self, urdf: Path, positions: dict[str, NDArray[Any]], count: int
    ) -> dict[str, NDArray[Any]] | str:
        """The matrices (N, 4, 4) of each link, or why there are none."""
        given, poses = self._folder / "positions.npz", self._folder / "poses.npz"
        np.savez(given, **positions)
        request = {"urdf": str(urdf), "positions": str(given), "poses": str(poses), "count": count}
        to, answers = self._pipes()
        to.write(json.dumps(request) + "\n")
        to.flush()
        answer = answers.readline().strip()
        return dict(np.load(poses)) if answer == "done" else answer

    def _pipes(self) -> tuple[IO[str], IO[str]]:
        assert self._process.stdin and self._process.stdout
        return self._process.stdin, self._process.stdout

    def close(self) -> None:
        """End the process."""
        for pipe in self._pipes():
            pipe.close()
        self._process.wait()


@pytest.fixture(scope="module")
def pinocchio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pinocchio]:
    process = Pinocchio(tmp_path_factory.mktemp("pinocchio"))
    yield process
    process.close()


@pytest.mark.parametrize(
    "urdf", robots.published() or [None], ids=lambda path: getattr(path, "name", "none")
)
def test_every_link_is_where_pinocchio_has_it(pinocchio: Pinocchio, urdf: Path | None) -> None:
    """In 1,000 random configurations, to the nanometre; what we cannot read, urdfdom cannot."""
    if urdf is None:
        robots.skip_without_published()
        return
    try:
        robot = Robot.from_urdf(urdf)
    except UrdfError as error:
        refused = isinstance(pinocchio.poses(urdf, {}, 1), str)
        assert refused or str(error).endswith(STRICTER.get(urdf.name, "?")), error
        return
    check_poses(pinocchio, urdf, robot)


@pytest.mark.parametrize("urdf", [robots.HOVERCRAFT, robots.ARM], ids=["hovercraft", "arm"])
def test_planar_floating_and_mimic_joints_move_as_in_pinocchio(
    pinocchio: Pinocchio, urdf: str, tmp_path: Path
) -> None:
    """In 1,000 random configurations, also where they follow each other."""
    path = tmp_path / "robot.urdf"
    # urdfdom wants both in each limit.
    path.write_text(re.sub(r'(upper="[\d.]+")/>', r'\1 effort="1" velocity="1"/>', urdf))
    check_poses(pinocchio, path, Robot.from_urdf(path))


def check_poses(pinocchio: Pinocchio, urdf: Path, robot: Robot) -> None:
    """Raise AssertionError where a link is elsewhere than Pinocchio has it."""
    positions = robots.random_positions(robot, CONFIGURATIONS)
    theirs = pinocchio.poses(urdf, positions, CONFIGURATIONS)
    assert not isinstance(theirs, str), theirs
    array = [positions[joint.name].reshape(CONFIGURATIONS, -1) for joint in robot.free_joints]
    ours = robot.fk_many(np.hstack(array) if array else np.empty((CONFIGURATIONS, 0)))
    assert theirs.keys() == ours.keys()
    for link, poses in ours.items():
        assert np.abs(poses.as_matrix() - theirs[link]).max() < WITHIN, link
    for number in range(5):
        one = robot.fk(robots.row(positions, number))
        assert all(one[link].is_close(ours[link][number], WITHIN) for link in ours)


def test_there_are_many_published_robots() -> None:
    """An empty folder would make the test above mean nothing."""
    if not robots.published():
        robots.skip_without_published()
    assert len(robots.published()) > 50
