"""A client of the simulator: the poses of its turtles, the picture of its field, its services."""

import math
import threading
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tfbus import GoalResult, Node, RightsError, ServiceError, SystemClock
from tfbus.messages import (
    Color,
    Empty,
    Field,
    Kill,
    Pose,
    RotateAbsolute,
    Spawn,
    TeleportAbsolute,
    Twist,
    Vector3,
)

from ...teleop import CANCEL, DRIVES, HEADINGS_RAD

# The defaults of the teleop's parameters scale_linear and scale_angular.
_LINEAR_M_S = 2.0
_ANGULAR_RAD_S = 2.0

# How often the field is fetched while a browser watches, and looked for while there is none.
_LOOK_EVERY_S = 0.1
_SEARCH_EVERY_S = 1.0

KEYS = (*DRIVES, *HEADINGS_RAD, CANCEL)


@dataclass(frozen=True, eq=False)
class Picture:
    """The field with its ink: (size, size, 3) bytes, rows from the top."""

    version: str
    pixels: NDArray[np.uint8]


class Turtles:
    """Follows the turtles of the simulator on this bus, and calls its services.

    `reply` is the result of the last call, in one sentence. The field is fetched only while
    `is_watched()`.
    """

    def __init__(self, node: Node, is_watched: Callable[[], bool]) -> None:
        self.reply = ""
        self.picture: Picture | None = None
        self._node = node
        self._is_watched = is_watched
        self._names: tuple[str, ...] = ()
        self._are_known = False
        self._drivers: dict[str, _Driver] = {}
        self._field = _client(node, Field, "field")
        self._clients = {
            name: _client(node, service, name)
            for name, service in (
                ("spawn", Spawn),
                ("kill", Kill),
                ("clear", Empty),
                ("reset", Empty),
            )
        }
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._look_again, name="field", daemon=True)
        self._thread.start()

    @property
    def are_known(self) -> bool:
        """Whether there is a simulator that has said which turtles it has, maybe none."""
        return self._field.served and self._are_known

    @property
    def are_there(self) -> bool:
        """Whether there is a simulator with turtles."""
        return self._field.served and bool(self._names)

    @property
    def names(self) -> tuple[str, ...]:
        """The turtles on the field."""
        return self._names

    # Requests

    def press(self, turtle: str, key: str) -> None:
        """Follow a key as the teleop does; ignores unknown ones."""
        driver = self._driver(turtle)
        if driver is None:
            self.reply = f"no turtle {turtle!r}"
        elif key in DRIVES:
            driver.drive(*DRIVES[key])
        elif key in HEADINGS_RAD:
            self._ask(f"rotate {turtle}", lambda: driver.rotate(HEADINGS_RAD[key], self._say))
        elif key == CANCEL:
            driver.cancel()

    def spawn(self, x: float, y: float, theta: float, name: str) -> None:
        """Spawn a turtle, in m and rad; without a name it becomes the next turtleN."""
        request = Spawn.Request(x, y, theta, name)
        self._call("spawn", request, lambda response: f"spawned {response.name}")

    def kill(self, turtle: str) -> None:
        """Take a turtle off the field."""
        self._call("kill", Kill.Request(turtle), lambda response: f"killed {turtle}")

    def clear(self) -> None:
        """Wipe the field."""
        self._call("clear", Empty.Request(), lambda response: "cleared the field")

    def reset(self) -> None:
        """Reset the field to turtle1 in its middle."""
        self._call("reset", Empty.Request(), lambda response: "reset the field")

    def teleport(self, turtle: str, x: float, y: float, theta: float) -> None:
        """Teleport a turtle, in m and rad."""
        driver = self._driver(turtle)
        if driver is None:
            self.reply = f"no turtle {turtle!r}"
            return
        request = TeleportAbsolute.Request(x, y, theta)
        done = f"teleported {turtle} to ({x:g}, {y:g}), {math.degrees(theta):g}°"

        def teleport() -> None:
            driver.teleport.call(request)
            self._say(done)

        self._ask(f"teleport {turtle}", teleport)

    def _call(self, service: str, request: Any, done: Callable[[Any], str]) -> None:
        client = self._clients[service]
        self._ask(service, lambda: self._say(done(client.call(request))))

    def _ask(self, what: str, ask: Callable[[], object]) -> None:
        try:
            ask()
        except (ServiceError, ValueError) as error:
            self._say(f"{what}: {error}")

    def _say(self, reply: str) -> None:
        self.reply = reply

    # The field and the poses

    def _look_again(self) -> None:
        failing = False
        clock = SystemClock()
        while self._node.wait(
            _LOOK_EVERY_S if self._field.served else _SEARCH_EVERY_S, clock=clock
        ):
            if self._field.served and self._is_watched():
                try:
                    self._look()
                    failing = False
                except (ServiceError, RightsError, zlib.error, ValueError) as error:
                    if not failing and self._field.served:
                        self._node.log.warning("Cannot fetch the turtles' field: %s", error)
                    failing = True
                    self._node.wait(_SEARCH_EVERY_S, clock=clock)
            elif not self._field.served:
                self._are_known = False
                self._follow(())

    def _look(self) -> None:
        known = self.picture.version if self.picture else ""
        seen = self._field.call(Field.Request(known), timeout_s=2.0)
        self._follow(tuple(seen.turtles))
        self._are_known = True
        if seen.version != known:
            self.picture = Picture(seen.version, _pixels(seen.ink, seen.size, seen.background))

    def _follow(self, names: tuple[str, ...]) -> None:
        """Follow these turtles and no others."""
        with self._lock:
            for name in self._drivers.keys() - set(names):
                self._drivers.pop(name).close()
            for name in names:
                if name not in self._drivers:
                    self._drivers[name] = _Driver(self._node, name)
            self._names = names

    def pose(self, turtle: str) -> Pose | None:
        """The last pose of a turtle on the field; None before the first."""
        driver = self._drivers.get(turtle)
        return driver.pose if driver else None

    def _driver(self, turtle: str) -> "_Driver | None":
        with self._lock:
            return self._drivers.get(turtle)


@dataclass(frozen=True)
class _Denied:
    """Stands in for the client of a service that this identity may not call on a closed bus."""

    reason: str
    served = False

    def call(self, request: object, timeout_s: float = 0.0) -> Any:
        """Raises ServiceError with the reason."""
        raise ServiceError(self.reason)


def _client(node: Node, service: type, name: str) -> Any:
    try:
        return node.create_client(service, name)
    except RightsError as error:
        return _Denied(str(error))


class _Driver:
    """The topics, services and actions of one turtle."""

    def __init__(self, node: Node, name: str) -> None:
        self.pose: Pose | None = None
        self._name = name
        self._velocities = node.create_publisher(Twist, f"{name}/cmd_vel")
        self._rotations = node.create_goal_client(RotateAbsolute, f"{name}/rotate_absolute")
        self.teleport = node.create_client(TeleportAbsolute, f"{name}/teleport_absolute")
        self._poses = node.create_subscription(Pose, f"{name}/pose", self._on_pose)
        self._cancel: Callable[[], object] = lambda: None

    def _on_pose(self, pose: Pose) -> None:
        self.pose = pose

    def drive(self, forward: int, left: int) -> None:
        linear, angular = Vector3(x=forward * _LINEAR_M_S), Vector3(z=left * _ANGULAR_RAD_S)
        self._velocities.publish(Twist(linear, angular))

    def rotate(self, theta_rad: float, say: Callable[[str], object]) -> None:
        def ended(result: GoalResult) -> None:
            turned = math.degrees(-result.result.delta)
            reason = f" ({result.reason})" if result.reason else ""
            say(f"rotation of {self._name} {result.status}: turned by {turned:.1f}°{reason}")

        say(f"rotating {self._name} to {math.degrees(theta_rad):.0f}°")
        goal = self._rotations.send(RotateAbsolute.Goal(theta_rad), on_result=ended)
        self._cancel = goal.cancel

    def cancel(self) -> None:
        self._cancel()

    def close(self) -> None:
        for part in (self._velocities, self._rotations, self.teleport, self._poses):
            part.close()


def _pixels(ink: bytes, size: int, background: Color) -> NDArray[np.uint8]:
    """The ink on its background. Raises ValueError or zlib.error if it is no picture."""
    # Unpacks at most the bytes of a picture of this size.
    raw = zlib.decompressobj().decompress(ink, size * size * 4)
    layer = np.frombuffer(raw, np.uint8).reshape(size, size, 4)
    paper = np.array([background.r, background.g, background.b], np.float32)
    weight = layer[..., 3:].astype(np.float32) / 255.0
    mixed: NDArray[np.uint8] = (paper + (layer[..., :3] - paper) * weight).astype(np.uint8)
    return mixed
