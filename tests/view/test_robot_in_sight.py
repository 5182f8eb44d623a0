"""The camera of an open page when a robot comes later, and in parts."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from tests.builders import S
from tests.live_bus import free_port
from tests.view.cameras import Server, camera, distance_m
from tfbus import Buffer, Robot, Transform, TransformStamped

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.view.local import ShownBuffer
from tfbus.view.page import Page, Serving
from tfbus.view.robots import GivenRobots, ShownRobot
from tfbus.view.scene.camera import Cameras

pytestmark = pytest.mark.real

# A column, a metre wide and three high, that a hand is at, whose finger is fixed.
URDF = """<robot name="arm">
<link name="base"><visual><geometry><box size="1 1 3"/></geometry></visual></link>
<link name="hand"><visual><geometry><box size=".1 .1 .1"/></geometry></visual></link>
<link name="finger"><visual><geometry><box size=".1 .1 .1"/></geometry></visual></link>
<link name="nail"><visual><geometry><box size=".1 .1 .1"/></geometry></visual></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="hand"/>
  <axis xyz="0 0 1"/></joint>
<joint name="grip" type="fixed"><parent link="hand"/><child link="finger"/></joint>
<joint name="tip" type="fixed"><parent link="finger"/><child link="nail"/></joint>
</robot>"""

ROBOT = Robot.from_text(URDF)

# Upside down, a metre above the base.
TURNED = Transform((0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0))


@dataclass
class Opened:
    """A page with one browser, whose camera was not touched."""

    buffer: Buffer = field(default_factory=Buffer)
    robots: GivenRobots = field(default_factory=GivenRobots)
    camera: Any = field(default_factory=lambda: camera((3.0, 3.0, 3.0), (0.0, 0.0, 0.0)))

    def __post_init__(self) -> None:
        program = ShownBuffer(self.buffer)
        self.page = Page(program, program, Serving(port=free_port()), self.robots)
        self.page.cameras = Cameras(Server(self.camera))

    def send(self, parent: str, child: str, pose: Transform, *, static: bool = False) -> None:
        """Publish a frame, and look at it."""
        stamped = TransformStamped(0 if static else S, parent, child, pose)
        self.buffer.set_transform(stamped, static=static)

    def step(self) -> None:
        """Bring the page up to date now."""
        self.page.step(at_once=True)

    def sees_the_robot(self) -> bool:
        """Whether the whole robot is before the camera, and not much smaller than the picture."""
        corners = self.page.robots.points(self.page.whole, self.page.frames)
        ahead = self.camera.look_at - self.camera.position
        size_m = distance_m(self.camera)
        depths_m = (corners - self.camera.position) @ ahead / size_m
        extent_m = float(np.ptp(corners, axis=0).max())
        return bool((depths_m > 0.2 * size_m).all()) and 0.5 < size_m / extent_m < 4.0


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Iterator[Opened]:
    """A page that was opened before anything else, on which minutes pass between two looks."""
    opened = Opened()
    now_s = [0.0]

    def later() -> float:
        now_s[0] += 100.0
        return now_s[0]

    monkeypatch.setattr("time.monotonic", later)
    yield opened
    opened.page.close()


def test_a_robot_whose_joints_come_late_is_seen_whole(opened: Opened) -> None:
    """First its hand alone has frames, which become those of a turned link on the column."""
    opened.step()
    opened.robots.add(ShownRobot(ROBOT, is_described=True))
    opened.step()
    opened.send("hand", "finger", Transform.identity(), static=True)
    opened.send("finger", "nail", Transform.identity(), static=True)
    opened.step()
    assert opened.sees_the_robot()
    opened.send("base", "hand", TURNED)
    opened.step()
    assert opened.page.choice.fixed_frame == "base"
    assert opened.sees_the_robot()


def test_a_robot_of_a_file_is_followed_to_where_its_frames_are(opened: Opened) -> None:
    """It stands by itself until they come, far from there."""
    opened.robots.add(ShownRobot(ROBOT))
    opened.step()
    assert opened.sees_the_robot()
    opened.send("hand", "finger", Transform.identity(), static=True)
    opened.send("finger", "nail", Transform.identity(), static=True)
    opened.send("world", "base", Transform((50.0, 0.0, 0.0)))
    opened.send("base", "hand", TURNED)
    opened.step()
    assert opened.page.choice.fixed_frame == "world"
    assert opened.camera.look_at.tolist() == pytest.approx([25.0, 0.0, 0.0], abs=1.0)
    assert distance_m(opened.camera) > 25.0


def test_a_camera_that_was_moved_keeps_what_it_sees_of_a_robot(opened: Opened) -> None:
    """It is carried along with the fixed frame, though all frames are those of links."""
    opened.robots.add(ShownRobot(ROBOT, is_described=True))
    opened.send("hand", "finger", Transform.identity(), static=True)
    opened.send("finger", "nail", Transform.identity(), static=True)
    opened.step()
    opened.camera.position = np.array((2.0, 0.0, 0.5))
    opened.camera.look_at = np.array((0.0, 0.0, 0.5))
    opened.send("base", "hand", Transform((0.0, 0.0, 1.0)))
    opened.step()
    assert opened.camera.position.tolist() == pytest.approx([2.0, 0.0, 1.5])
    assert opened.camera.look_at.tolist() == pytest.approx([0.0, 0.0, 1.5])
