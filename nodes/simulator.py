"""turtlesim on the bus: turtles that follow `<turtle>/cmd_vel` and publish `<turtle>/pose`.

    tfbus simulator
    tfbus call spawn '{x: 2, y: 3, theta: 0, name: turtle2}'

Services: spawn, kill, clear, reset, field; per turtle set_pen, teleport_absolute,
teleport_relative, and the action rotate_absolute. Parameters: background_r, background_g,
background_b, holonomic. Closing the window ends the simulator.
"""

import zlib
from collections import deque
from pathlib import Path

import click

from tfbus import Node, NodeSettings, SystemClock, node_options
from tfbus.command.parameters import Declared, NodeCommand
from tfbus.messages import Color, Empty, Field, Kill, Spawn

from .turtle import field
from .turtle.interface import TurtleInterface
from .turtle.turtle import TICK_S
from .turtle.window import DisplayError, Window, check_picture, save_picture
from .turtle.world import BACKGROUND, Snapshot, World

FRAME_S = 1.0 / 60.0
TICK_NS = round(TICK_S * 1e9)

# A jump of the simulated time moves the turtles by at most 10 s.
MOST_STEPS = round(10.0 / TICK_S)

BACKGROUND_PARTS = tuple(
    Declared(
        f"background_{part}",
        getattr(BACKGROUND, part),
        f"The {name} of the background.",
        minimum=0,
        maximum=255,
    )
    for part, name in (("r", "red"), ("g", "green"), ("b", "blue"))
)
HOLONOMIC = Declared("holonomic", False, "Whether turtles move sideways, by linear.y.")


class Simulator:
    """A world that runs on a node's thread, in steps of 16 ms, with poses stamped by its clock."""

    def __init__(self, node: Node) -> None:
        self._node = node
        node.log.info("Starting turtlesim with node name %s", node.full_name)
        self._background = [part.on(node) for part in BACKGROUND_PARTS]
        self._holonomic = HOLONOMIC.on(node)
        self.world = World(node.log)
        self._take_parameters()
        self._interfaces: dict[str, TurtleInterface] = {}
        self._update_interfaces()
        node.create_service(Spawn, "spawn", self._spawn)
        node.create_service(Kill, "kill", self._kill)
        node.create_service(Empty, "clear", self._clear)
        node.create_service(Empty, "reset", self._reset)
        node.create_service(Field, "field", self._field)
        self._stepped_ns = max(0, node.clock.elapsed_ns())
        node.create_timer(TICK_S, self._tick)

    def _tick(self) -> None:
        stamp_ns = self._node.now_ns()
        steps = self._steps()
        self._take_parameters()
        for _ in range(steps):
            self.world.step()
        for interface in self._interfaces.values():
            interface.publish(stamp_ns)

    def _steps(self) -> int:
        """How many steps are due: simulated time may bring several at once."""
        if not self._node.clock.is_simulated:
            return 1
        elapsed_ns = self._node.clock.elapsed_ns()
        steps = min((elapsed_ns - self._stepped_ns) // TICK_NS, MOST_STEPS)
        self._stepped_ns = elapsed_ns - (elapsed_ns - self._stepped_ns) % TICK_NS
        return steps

    def _take_parameters(self) -> None:
        self.world.background = Color(*(part.value for part in self._background))
        self.world.holonomic = self._holonomic.value

    def _update_interfaces(self) -> None:
        """Give every turtle of the world an interface, and remove the others."""
        for name in set(self._interfaces) - set(self.world.turtles):
            self._interfaces.pop(name).close()
        for name in self.world.turtles:
            if name not in self._interfaces:
                self._interfaces[name] = TurtleInterface(self._node, self.world, name)

    def _spawn(self, request: Spawn.Request) -> Spawn.Response:
        turtle = self.world.spawn(request.x, request.y, request.theta, request.name)
        self._update_interfaces()
        return Spawn.Response(turtle.name)

    def _kill(self, request: Kill.Request) -> Kill.Response:
        self.world.kill(request.name)
        self._update_interfaces()
        return Kill.Response()

    def _clear(self, request: Empty.Request) -> Empty.Response:
        self.world.clear()
        return Empty.Response()

    def _reset(self, request: Empty.Request) -> Empty.Response:
        self.world.reset()
        self._update_interfaces()
        return Empty.Response()

    def _field(self, request: Field.Request) -> Field.Response:
        """The field; without the picture if the client already has this version."""
        snapshot = self.world.snapshot()
        # Not the number alone: a restarted simulator counts from zero again.
        version = f"{self._node.started_ns}-{snapshot.version}"
        is_known = request.version == version
        ink = b"" if is_known else zlib.compress(snapshot.ink.tobytes(), level=1)
        turtles = list(self.world.turtles)
        return Field.Response(version, snapshot.background, turtles, field.SIZE_PX, ink)


@click.command(
    cls=NodeCommand,
    declared=(*BACKGROUND_PARTS, HOLONOMIC),
    epilog="Example: tfbus simulator --headless",
)
@click.option("--headless", is_flag=True, help="Open no window.")
@click.option(
    "--screenshot",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Save a picture of the field, such as turtles.png, when the simulator ends.",
)
@node_options("sim")
def main(settings: NodeSettings, headless: bool, screenshot: Path | None) -> None:
    """Simulate turtles to drive and to watch (turtlesim)."""
    if screenshot:  # to fail now, not after an hour, if the file cannot be written
        check_picture(World().snapshot(), screenshot)
    with Node.from_settings(settings) as node:
        simulator = Simulator(node)
        if headless:
            node.spin()
        else:
            _show(node, simulator.world)
    if screenshot:
        save_picture(simulator.world.snapshot(), screenshot)


def _show(node: Node, world: World) -> None:
    """Show the world in a window until it or the node is closed; without a display, just run."""
    frames: deque[Snapshot] = deque(maxlen=1)
    try:
        with Window(f"{node.full_name} - tfbus simulator") as window:
            # The world belongs to the node's thread, the window to this one. The window is drawn in
            # real time, also while a simulated time stands still.
            clock = SystemClock()
            node.create_timer(FRAME_S, lambda: frames.append(world.snapshot()), clock=clock)
            node.ready()
            while window.is_open and node.wait(FRAME_S, clock=clock):
                if frames:
                    window.show(frames[-1])
    except DisplayError as error:
        node.log.info("No window: %s", error)
        node.spin()


if __name__ == "__main__":
    main()
