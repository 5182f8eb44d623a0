"""`tfbus joints`: publish joint states without a robot, as joint_state_publisher does.

    tfbus joints arm.urdf
    tfbus joints --sweep

In a terminal it shows sliders. It follows the topic joint_targets, from the sliders of tfbus view.
Parameters: rate, zeros.JOINT.
"""

import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import click

from tfbus import (
    Node,
    NodeSettings,
    Number,
    Robot,
    SystemClock,
    TfbusError,
    TopicName,
    UrdfError,
    node_options,
)
from tfbus.base.wording import counted, did_you_mean, listed, printable
from tfbus.command.parameters import Declared, NodeCommand
from tfbus.command.terminal import RawTerminal
from tfbus.messages import JointState, RobotDescription

from .robot.board import Board
from .robot.description import xacro_arguments
from .robot.motions import (
    Motion,
    RandomPlaces,
    Row,
    Sweep,
    Table,
    check_loop,
    rows_of_csv,
    rows_of_recording,
)
from .robot.sliders import run_sliders

_STANDARD_INPUT = 0

# How often the rows of a table that are due are published.
_TABLE_TICK_S = 0.005

# After this long without a description, the log says that it waits for one.
_SAY_AFTER_S = 2.0

RATE = Declared("rate", 30.0, "Messages a second.", minimum=0.01, maximum=10_000.0)
ZEROS = Declared("zeros.JOINT", 0.0, "Where a joint rests, in rad or m, as --set.")

# The parameter `zeros.elbow` is where joint elbow rests, as in joint_state_publisher.
_ZEROS = "zeros."

# Substitutes for parameters of joint_state_publisher that are none here.
_IN_ROS = {
    "source_list": "give each topic by --source",
    "delta": "--sweep moves the joints, at the speeds of the URDF",
    "use_gui": "in a terminal the joints have sliders, as on the page of tfbus view",
}

# Makes the motion of the joints of a board.
MakeMotion = Callable[[Board], Motion | Table | None]


class Joints:
    """Publishes the positions on a board, which a motion or table may move, on a node's thread."""

    def __init__(
        self, node: Node, board: Board, make_motion: MakeMotion, *, rate: float, velocities: bool
    ) -> None:
        self._node = node
        self._board = board
        self._make_motion = make_motion
        self._with_velocities = velocities
        self._motion: Motion | Table | None = None
        # Joints that a target has taken out of the motion.
        self._held: set[str] = set()
        self._last: tuple[int, dict[str, float]] | None = None
        self._said: set[str] = set()
        self._publisher = node.create_publisher(JointState, "joint_states")
        self._rate = replace(RATE, default=rate).on(node, on_change=self._change_rate)
        self._timer = node.create_timer(1.0 / self._rate.value, self._tick)
        # When the motion began, by the node's clock; not before that runs.
        self._began_ns: int | None = None
        self._elapsed_ns = 0
        self._plays = False
        self._is_waiting = False

    def begin(self, robot: Robot) -> None:
        """Publish the joints of this robot from now on."""
        self._board.take_robot(robot)
        self._motion = self._make_motion(self._board)
        self._began_ns = None
        self._elapsed_ns = 0
        self._held.clear()
        self._last = None
        if isinstance(self._motion, Table) and not self._plays:
            self._plays = True
            self._node.create_timer(_TABLE_TICK_S, self._play)
        joints, name = counted(len(self._board.posture.ranges), "joint"), printable(robot.name, 60)
        if self._is_waiting:
            self._node.log.info("Publishing %s of %s", joints, name)
        else:
            self._node.ready(f"Publishing {joints} of {name}")

    def wait_for_robot(self) -> None:
        """Say that it has no robot yet."""
        self._is_waiting = True
        self._node.ready("Waiting for a robot on topic robot_description")

    def follow(self, targets: JointState) -> None:
        """Move joints to where a target says; a motion leaves them there from now on."""
        if isinstance(self._motion, Table):
            self.say_once("table", "Ignored joint_targets: the joints move as the file says")
            return
        self._merge(targets)
        self._held.update(name for name in targets.name if name in self._board.posture.ranges)

    def merge(self, state: JointState) -> None:
        """Take positions of another publisher."""
        self._merge(state)

    def _merge(self, state: JointState) -> None:
        unknown = self._board.set(dict(zip(state.name, state.position, strict=False)))
        if unknown:
            names = listed([f"'{printable(name, 60)}'" for name in unknown])
            self.say_once("unknown", "Ignored names that are of no free joint: %s", names)

    def _tick(self) -> None:
        motion, board = self._motion, self._board
        if board.posture.robot is None or (isinstance(motion, Table) and not motion.has_ended):
            return
        now_ns = self._node.now_ns()
        if motion is not None and not isinstance(motion, Table):
            places = motion.at(self._seconds(now_ns))
            board.set({name: at for name, at in places.items() if name not in self._held})
        self._publish(now_ns, dict(board.posture.positions))

    def _play(self) -> None:
        table = self._motion
        if not isinstance(table, Table):
            return
        now_ns = self._node.now_ns()
        elapsed_s = self._seconds(now_ns)
        for seconds, row in table.due(elapsed_s):
            # Several rows may be due at once: each has the stamp of its own time.
            self._publish_row(row, now_ns - round((elapsed_s - seconds) * 1e9))
        if table.has_ended and "ended" not in self._said:
            self._said.add("ended")
            self._node.log.info("The last row is published; its positions stay")

    def _seconds(self, now_ns: int) -> float:
        """How long ago the motion began; if the time goes back, it goes on as it was."""
        if self._began_ns is None or now_ns < self._began_ns + self._elapsed_ns:
            self._began_ns = now_ns - self._elapsed_ns
        self._elapsed_ns = now_ns - self._began_ns
        return self._elapsed_ns / 1e9

    def _publish_row(self, row: Row, stamp_ns: int) -> None:
        known = {
            name: at for name, at in row.positions.items() if name in self._board.posture.ranges
        }
        self._board.set(known)
        beyond = [name for name in known if self._board.posture.positions[name] != known[name]]
        if beyond:
            self.say_once(
                "limits", "Kept joints within their limits: %s", listed(list(map(repr, beyond)))
            )
        self._publish(stamp_ns, dict(self._board.posture.positions), row)

    def _publish(self, stamp_ns: int, positions: dict[str, float], row: Row | None = None) -> None:
        names = tuple(positions)
        velocities: Mapping[str, float] = row.velocities if row else {}
        if self._with_velocities and not velocities:
            velocities = self._velocities(stamp_ns, positions)
        efforts: Mapping[str, float] = row.efforts if row else {}
        self._last = stamp_ns, positions
        self._publisher.publish(
            JointState(
                stamp_ns,
                names,
                tuple(positions.values()),
                _in_order(names, velocities),
                _in_order(names, efforts),
            )
        )

    def _velocities(self, stamp_ns: int, positions: dict[str, float]) -> dict[str, float]:
        if self._last is None or stamp_ns <= self._last[0]:
            return dict.fromkeys(positions, 0.0)
        before_ns, before = self._last
        seconds = (stamp_ns - before_ns) / 1e9
        return {name: (at - before.get(name, at)) / seconds for name, at in positions.items()}

    def _change_rate(self, rate: float) -> None:
        self._timer.cancel()
        self._timer = self._node.create_timer(1.0 / rate, self._tick)

    def say_once(self, kind: str, text: str, *values: object) -> None:
        """Log a warning, unless one of this kind was logged."""
        if kind not in self._said:
            self._said.add(kind)
            self._node.log.warning(text, *values)


def _in_order(names: tuple[str, ...], numbers: Mapping[str, float]) -> tuple[float, ...]:
    """The numbers in the order of names, NaN if one is missing; empty if there is none."""
    return tuple(numbers.get(name, float("nan")) for name in names) if numbers else ()


class _Described:
    """Begins with the robot that is on the topic robot_description, and with each new one.

    `failure` is why it cannot, and has shut the node down.
    """

    def __init__(
        self, node: Node, begin: Callable[[Robot], None], rests: Mapping[str, float]
    ) -> None:
        self._node = node
        self._begin = begin
        self._rests = rests
        self._has_begun = False
        self._urdf = ""
        self.failure: TfbusError | None = None
        node.create_subscription(RobotDescription, "robot_description", self._take, retained=True)
        self._timer = node.create_timer(_SAY_AFTER_S, self._say, clock=SystemClock())

    def _say(self) -> None:
        self._timer.cancel()
        if not self._urdf:
            self._node.log.info(
                "No robot on topic robot_description so far: start tfbus robot_state, or name the "
                "robot's file"
            )

    def _take(self, description: RobotDescription) -> None:
        if description.urdf == self._urdf:
            return
        self._urdf = description.urdf
        try:
            robot = Robot.from_text(description.urdf, name_of_source="robot_description")
        except UrdfError as error:
            self._node.log.warning("Ignored a description: %s", error)
            return
        try:
            if mistake := _mistake_in(self._rests, robot):
                if not self._has_begun:
                    raise TfbusError(mistake)
                self._node.log.warning("%s", mistake)
            self._begin(robot)
            self._has_begun = True
        except TfbusError as error:
            # A table, or positions of rest, that are not of this robot.
            self.failure = error
            self._node.shutdown()


@click.command(
    cls=NodeCommand,
    declared=(RATE, ZEROS),
    epilog="Examples: tfbus joints arm.urdf; tfbus joints --sweep; tfbus joints --csv waves.csv",
)
@click.argument(
    "path",
    metavar="[FILE]",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    required=False,
)
@click.argument("more_arguments", metavar="[NAME:=VALUE]...", nargs=-1)
@click.option("--zero", is_flag=True, help="Stay at rest: 0, or the middle of the limits.")
@click.option("--sweep", is_flag=True, help="Move each joint from limit to limit.")
@click.option("--random", "is_random", is_flag=True, help="Move to random places.")
@click.option("--seed", metavar="N", type=int, help="The same places with --random each time.")
@click.option(
    "--csv",
    "csv_path",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    metavar="TABLE",
    help="Play a CSV file: a column for each joint, and one named time, in seconds.",
)
@click.option(
    "--bag",
    "bags",
    multiple=True,
    type=click.Path(path_type=Path, exists=True),
    metavar="RECORDING",
    help="Play the joint states of a recording; repeatable.",
)
@click.option(
    "--bag-topic",
    default="joint_states",
    metavar="TOPIC",
    show_default=True,
    help="The topic of the recording.",
)
@click.option("--loop", is_flag=True, help="Begin a file or recording again at its end.")
@click.option(
    "--set",
    "given",
    multiple=True,
    metavar="JOINT=POSITION",
    help="Where a joint rests, in rad or m; repeatable.",
)
@click.option(
    "--source",
    "sources",
    type=TopicName(),
    multiple=True,
    metavar="TOPIC",
    help="Take positions from another topic of joint states; repeatable.",
)
@click.option(
    "--rate",
    type=Number(least=0.01, most=10_000.0),
    default=RATE.default,
    show_default=True,
    metavar="HZ",
    help="Messages a second; of a CSV file without times its rows.",
)
@click.option("--velocities", is_flag=True, help="Publish velocities too.")
@click.option(
    "--package-path",
    "package_path",
    multiple=True,
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    metavar="FOLDER",
    help="Where packages of $(find ...) in xacro are; repeatable.",
)
@node_options("joints")
def main(
    settings: NodeSettings,
    path: Path | None,
    more_arguments: tuple[str, ...],
    zero: bool,
    sweep: bool,
    is_random: bool,
    seed: int | None,
    csv_path: Path | None,
    bags: tuple[Path, ...],
    bag_topic: str,
    loop: bool,
    given: tuple[str, ...],
    sources: tuple[str, ...],
    rate: float,
    velocities: bool,
    package_path: tuple[Path, ...],
) -> None:
    """Publish joint states without a robot: by sliders, sweeps, random places, files.

    The robot is that of FILE, a URDF or xacro file, by default that on topic robot_description. In
    a terminal its joints have sliders; else they rest, or move as an option says. They stay within
    their limits.
    """
    chosen = [zero, sweep, is_random, csv_path is not None, bool(bags)]
    if sum(chosen) > 1:
        raise click.UsageError("give one of --zero, --sweep, --random, --csv and --bag")
    if loop and not (csv_path or bags):
        raise click.UsageError("--loop needs --csv or --bag")
    if seed is not None and not is_random:
        raise click.UsageError("--seed needs --random")
    try:
        arguments = xacro_arguments(more_arguments)
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    settings, of_ros = _without_ros_parameters(settings)
    settings, rests = _rests(settings, given)
    robot = None
    if path is not None:
        robot = Robot.from_urdf(path, package_path=package_path, xacro_args=arguments)
        if mistake := _mistake_in(rests, robot):
            raise click.UsageError(mistake)
    rows_of = _table(csv_path, bags, bag_topic, rate, loops=loop)
    if robot is not None and rows_of is not None:
        rows = rows_of(robot)  # before it joins the bus: a mistake in the file ends it

        def rows_of(_: Robot) -> list[Row]:
            return rows

    def make_motion(board: Board) -> Motion | Table | None:
        assert board.posture.robot is not None
        if sweep:
            return Sweep(board.posture.ranges.values())
        if is_random:
            return RandomPlaces(board.posture.ranges.values(), seed)
        return Table(rows_of(board.posture.robot), loops=loop) if rows_of is not None else None

    has_sliders = not any(chosen) and not sources and os.isatty(_STANDARD_INPUT)
    has_sliders = has_sliders and sys.stdout.isatty()
    terminal = RawTerminal(_STANDARD_INPUT) if has_sliders else None
    with Node.from_settings(settings) as node:
        board = Board(rests)
        joints = Joints(node, board, make_motion, rate=rate, velocities=velocities)
        node.create_subscription(JointState, "joint_targets", joints.follow)
        for topic in sources:
            node.create_subscription(JointState, topic, joints.merge)
        for name in of_ros:
            node.log.warning(
                "Ignored parameter %s of joint_state_publisher: %s", name, _IN_ROS[name]
            )

        def begin(robot: Robot) -> None:
            joints.begin(robot)
            for name, each in board.posture.ranges.items():
                if name in rests and rests[name] != each.rest:
                    joints.say_once(
                        f"rest of {name}",
                        "Position %g of joint %r is not within its limits, %g to %g: it rests at "
                        "%g",
                        *(rests[name], name, each.lower, each.upper, each.rest),
                    )

        described = None
        if robot is not None:
            begin(robot)
        else:
            joints.wait_for_robot()
            described = _Described(node, begin, rests)
        if terminal is None:
            node.spin()
        else:
            with terminal:
                run_sliders(node, terminal, board)
    if described is not None and described.failure is not None:
        raise described.failure


def _table(
    csv_path: Path | None, bags: tuple[Path, ...], topic: str, rate: float, *, loops: bool
) -> Callable[[Robot], list[Row]] | None:
    """The reader of the rows to play, for a robot."""
    check = check_loop if loops else list
    if csv_path is not None:
        return lambda robot: check(rows_of_csv(csv_path, robot, rate))
    if bags:
        rows = check(rows_of_recording(bags, topic))
        return lambda robot: rows
    return None


def _rests(settings: NodeSettings, given: tuple[str, ...]) -> tuple[NodeSettings, dict[str, float]]:
    """The positions of rest by joint: of --set, and of ROS's parameters `zeros.JOINT`."""
    parameters = dict(settings.parameters)
    texts = {
        name.removeprefix(_ZEROS): str(parameters.pop(name))
        for name in list(parameters)
        if name.startswith(_ZEROS)
    }
    for text in given:
        name, found, value = text.rpartition("=")
        if not found or not name:
            raise click.UsageError(
                f"--set '{printable(text, 60)}' is not of the form JOINT=POSITION"
            )
        texts[name] = value
    rests = {}
    for name, value in texts.items():
        try:
            rests[name] = Number()(value)
        except click.BadParameter as error:
            raise click.UsageError(f"the position of '{printable(name, 60)}': {error}") from error
    return replace(settings, parameters=parameters), rests


def _without_ros_parameters(settings: NodeSettings) -> tuple[NodeSettings, list[str]]:
    """The settings without parameters that only joint_state_publisher has, and their names."""
    found = [name for name in _IN_ROS if name in settings.parameters]
    others = {name: each for name, each in settings.parameters.items() if name not in found}
    return replace(settings, parameters=others), found


def _mistake_in(rests: Mapping[str, float], robot: Robot) -> str:
    """The mistake of a position of rest that is of no free joint of the robot, "" for none."""
    known = [joint.name for joint in robot.free_joints]
    for name in rests:
        if name not in known:
            shown = printable(name, 60)
            joint = robot.joints.get(name)
            if joint is None:
                return f"the robot has no free joint '{shown}'{did_you_mean(name, known)}"
            how = "mimics another" if joint.mimic else "is fixed"
            return f"joint '{shown}' {how}, so it cannot be set{did_you_mean(name, known)}"
    return ""


if __name__ == "__main__":
    main()
