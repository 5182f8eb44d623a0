"""`tfbus teleop`: drive a turtle with the keys of turtlesim's turtle_teleop_key.

Try it, with `tfbus simulator` running: tfbus teleop
"""

from collections.abc import Callable

import click

from tfbus import Node, NodeSettings, node_options
from tfbus.base.wording import listed
from tfbus.command.names import namespaces_serving
from tfbus.command.parameters import Declared, NodeCommand
from tfbus.command.terminal import KeyReader, RawTerminal
from tfbus.messages import RotateAbsolute, Twist, Vector3

BANNER = """\
Reading from keyboard
---------------------------
Use arrow keys to move the turtle.
Use G|B|V|C|D|E|R|T keys to rotate to absolute orientations. 'F' to cancel a rotation.
'Q' to quit."""

# Forward and left, in parts of scale_linear and scale_angular.
DRIVES = {"up": (1, 0), "down": (-1, 0), "left": (0, 1), "right": (0, -1)}

# The keys lie around F as the headings lie around the turtle; the numbers are turtlesim's.
HEADINGS_RAD = {
    "g": 0.0,
    "t": 0.7854,
    "r": 1.5708,
    "e": 2.3562,
    "d": 3.1416,
    "c": -2.3562,
    "v": -1.5708,
    "b": -0.7854,
}
CANCEL = "f"
ROTATE = "rotate_absolute"
QUIT = ("q", "Q", "\x03")

_STANDARD_INPUT = 0

# By then the rest of an escape sequence that came in pieces has arrived.
_PAUSE_S = 0.5

# The first key waits this long for the turtle to be discovered.
_FIRST_LOOK_S = 1.0

LINEAR = Declared("scale_linear", 2.0, "Speed of the keys Up and Down, in m/s.")
ANGULAR = Declared("scale_angular", 2.0, "Speed of the keys Left and Right, in rad/s.")


class Driver:
    """Turns keys into velocities and rotations of one turtle."""

    def __init__(self, node: Node, turtle: str):
        self._log = node.log
        self._session = node.session
        self._turtle = turtle
        self._linear, self._angular = LINEAR.on(node), ANGULAR.on(node)
        self._velocities = node.create_publisher(Twist, f"{turtle}/cmd_vel")
        self._rotations = node.create_goal_client(RotateAbsolute, f"{turtle}/{ROTATE}")
        self._cancel_rotation: Callable[[], object] = lambda: None
        self._was_missed = False
        self._patience_s = _FIRST_LOOK_S

    def press(self, key: str) -> None:
        """Follow a key, in upper or lower case; ignores unknown ones."""
        key = key.lower()
        if key in DRIVES:
            self._drive(*DRIVES[key])
        elif key in HEADINGS_RAD:
            self._rotate(HEADINGS_RAD[key])
        elif key == CANCEL:
            self._cancel_rotation()

    def _drive(self, forward: int, left: int) -> None:
        self._sees_turtle()
        self._velocities.publish(
            Twist(
                linear=Vector3(x=forward * self._linear.value),
                angular=Vector3(z=left * self._angular.value),
            )
        )

    def _rotate(self, theta_rad: float) -> None:
        if not self._sees_turtle():
            return
        goal = self._rotations.send(RotateAbsolute.Goal(theta_rad))
        self._cancel_rotation = goal.cancel

    def _sees_turtle(self) -> bool:
        """Whether the turtle is on the bus; warns once if not."""
        is_there = self._rotations.wait_for_server(self._patience_s)
        self._patience_s = 0.0
        if not is_there and not self._was_missed:
            self._log.warning("No turtle %r: %s", self._turtle, self._remedy())
        self._was_missed = not is_there
        return is_there

    def _remedy(self) -> str:
        robots = namespaces_serving(self._session, f"{self._turtle}/{ROTATE}")
        if robots:
            return (
                f"it is in namespace{'s' * (len(robots) > 1)} {listed(robots)}; drive it with "
                f"--namespace {robots[0]}"
            )
        return "start the simulator (tfbus simulator), or name another turtle (--turtle)"


def drive(node: Node, terminal: RawTerminal, driver: Driver) -> None:
    """Follow the keys until one of them quits, or the node is shut down."""
    reader = KeyReader()
    while node.ok:
        data = terminal.read(_PAUSE_S)
        for key in reader.feed(data) if data else reader.flush():
            if key in QUIT:
                return
            driver.press(key)


@click.command(
    cls=NodeCommand,
    declared=(LINEAR, ANGULAR),
    epilog="Example: tfbus teleop --turtle turtle2",
)
@click.option(
    "--turtle", default="turtle1", metavar="NAME", help="The turtle to drive (default turtle1)."
)
@node_options("teleop_turtle")
def main(settings: NodeSettings, turtle: str) -> None:
    """Drive a turtle with the keyboard."""
    terminal = RawTerminal(_STANDARD_INPUT)
    with Node.from_settings(settings) as node:
        driver = Driver(node, turtle)
        with terminal:
            click.echo(BANNER)
            node.ready(f"Driving {turtle}")
            drive(node, terminal, driver)


if __name__ == "__main__":
    main()
