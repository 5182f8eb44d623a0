"""`tfbus robot_state`: publish the frames of a robot from its URDF, as robot_state_publisher does.

    tfbus robot_state arm.urdf
    tfbus robot_state arm.urdf.xacro gripper:=true

Fixed joints are published once, moving ones from the topic joint_states. The description is
retained on the topic robot_description. Services: set_description, reload, robot_mesh. Parameters:
publish_frequency, ignore_timestamp, frame_prefix.
"""

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from tfbus import (
    InvalidArgumentException,
    Node,
    NodeSettings,
    Number,
    ParameterError,
    Robot,
    ServiceError,
    StaticTransformBroadcaster,
    SystemClock,
    TransformBroadcaster,
    TransformStamped,
    UrdfError,
    node_options,
)
from tfbus.base.wording import counted, did_you_mean, listed, printable
from tfbus.command.parameters import Declared, NodeCommand
from tfbus.messages import Empty, JointState, RobotDescription, RobotMesh, SetDescription

from .robot.description import DescriptionFile, xacro_arguments
from .robot.joint_frames import JointFrames
from .robot.mesh_service import serve_mesh, what_is_missing

# After this long, the log names joints that no joint state has named.
MISSING_AFTER_S = 5.0

# How often the files are looked at; one that stays the same from one look to the next is read.
LOOK_EVERY_S = 0.25

RATE = Declared(
    "publish_frequency",
    0.0,
    "At most this many messages of a joint a second, 0 for all.",
    minimum=0.0,
    maximum=1e6,
)
IGNORE_STAMPS = Declared(
    "ignore_timestamp", False, "Whether to publish joint states whatever their stamp."
)
PREFIX = Declared("frame_prefix", "", "Put before the names of all frames.")

# ROS's parameter with the text of the description.
_DESCRIPTION = "robot_description"


class RobotState:
    """Publishes one robot on a node's thread; a new description replaces it."""

    def __init__(
        self, node: Node, robot: Robot, source: str, declared: dict[Declared, Any]
    ) -> None:
        self._node = node
        self._said: set[str] = set()
        # The parents of frames that were sent as dynamic.
        self._moving: dict[str, str] = {}
        prefix = replace(PREFIX, default=declared[PREFIX]).on(node, on_change=self._rename)
        self._rate = replace(RATE, default=declared[RATE]).on(node)
        self._ignore_stamps = replace(IGNORE_STAMPS, default=declared[IGNORE_STAMPS]).on(node)
        self._frames = JointFrames(robot, prefix.value)
        self._source = source
        self._descriptions = node.create_publisher(RobotDescription, _DESCRIPTION, retained=True)
        self._statics = StaticTransformBroadcaster(node)
        self._broadcaster = TransformBroadcaster(node)
        self._publish_description(self._frames.static(node.now_ns()))
        node.create_service(SetDescription, "set_description", self._set_description)
        node.create_service(RobotMesh, "robot_mesh", self._serve_mesh)
        self._states = node.create_subscription(JointState, "joint_states", self._on_joint_state)

    @property
    def robot(self) -> Robot:
        """The robot as it is described now."""
        return self._frames.robot

    def replace(self, robot: Robot, source: str) -> None:
        """Publish another robot, and take the frames of the former out. Raises UrdfError if its
        links are no frames with the prefix.
        """
        self._change(JointFrames(robot, self._frames.prefix), source)

    # Publishing

    def _publish_description(self, static: list[TransformStamped]) -> None:
        frames = self._frames
        self._descriptions.publish(RobotDescription(frames.robot.text, frames.prefix, self._source))
        self._statics.send_transform(static)
        self._said.clear()
        for warning in frames.robot.warnings:
            self._node.log.warning("%s", warning)
        if missing := what_is_missing(frames.robot):
            self._node.log.warning("%s", missing)
        if frames.unsupported:
            self._node.log.warning(
                "The position of %s %s is no single number, which a JointState has for each joint: "
                "publish %s by a broadcaster of your own",
                "joint" if len(frames.unsupported) == 1 else "joints",
                listed(list(map(repr, frames.unsupported))),
                "its frame" if len(frames.unsupported) == 1 else "their frames",
            )
        self._watch_missing()

    def _change(self, frames: JointFrames, source: str) -> None:
        # Before anything is published: a robot that cannot be sent must not replace the former.
        transforms = frames.static(self._node.now_ns())
        former, self._frames = self._frames, frames
        self._source = source
        self._publish_description(transforms)
        static = {each.child_frame_id for each in transforms}
        before = {each.child_frame_id for each in former.static(0)}
        if gone := before - static:
            self._statics.remove(*gone)
        edges = frames.edges
        # Frames that still move are sent again soon; static ones have taken the place of theirs.
        ended = {child for child, parent in self._moving.items() if edges.get(child) != parent}
        self._moving = {
            child: parent
            for child, parent in self._moving.items()
            if child not in ended and child not in static
        }
        if gone := ended - static:
            self._broadcaster.remove(*gone)

    def _on_joint_state(self, state: JointState) -> None:
        if state.name and not state.position:
            self._say_once("positions", "Ignored a JointState without positions")
            return
        frames = self._frames
        restarts, unknown, came = frames.restarts, len(frames.unknown), len(frames.came)
        rate = self._rate.value
        try:
            transforms = frames.take(
                state,
                state.stamp_ns or self._node.now_ns(),
                period_ns=round(1e9 / rate) if rate else 0,
                ignore_stamps=self._ignore_stamps.value,
            )
        except InvalidArgumentException as error:
            self._say_once("finite", "Ignored a JointState: %s", printable(str(error), 300))
            return
        if transforms:
            self._broadcaster.send_transform(transforms)
            if len(frames.came) != came:
                self._moving |= {each.child_frame_id: each.frame_id for each in transforms}
        if len(frames.unknown) != unknown:
            self._name_unknown()
        if frames.restarts != restarts:
            self._say_once(
                "restart",
                "The stamps of joint states went back by more than 1 s, and the frames with them. "
                "Where that goes on, joint_states has two publishers with different clocks",
            )

    # The log

    def _say_once(self, kind: str, text: str, *values: object) -> None:
        if kind not in self._said:
            self._said.add(kind)
            self._node.log.warning(text, *values)

    def _name_unknown(self) -> None:
        unknown = sorted(self._frames.unknown)
        names = [f"'{printable(name, 60)}'" for name in unknown]
        hint = did_you_mean(unknown[0], self.robot.joints) if len(unknown) == 1 else ""
        self._say_once(
            "unknown",
            "Ignored %s that the robot does not have: %s%s",
            counted(len(names), "joint"),
            listed(names),
            hint,
        )

    def _watch_missing(self) -> None:
        frames = self._frames

        def look() -> None:
            timer.cancel()
            if frames is self._frames and (missing := frames.missing):
                self._name_missing(missing)

        timer = self._node.create_timer(MISSING_AFTER_S, look, clock=SystemClock())

    def _name_missing(self, missing: list[str]) -> None:
        came = self._frames.came
        if not came and not self._states.received:
            self._node.log.warning(
                "No joint state has come on topic %r: start the robot's driver, or tfbus joints. "
                "The frames of %s are missing",
                self._states.name,
                counted(len(missing), "joint"),
            )
        else:
            self._node.log.warning(
                "No joint state has named %s so far: %s. Their frames are missing",
                counted(len(missing), "joint"),
                listed(missing),
            )

    # Requests

    def _set_description(self, request: SetDescription.Request) -> SetDescription.Response:
        try:
            robot = Robot.from_text(request.urdf, name_of_source="the description")
            self.replace(robot, "set_description")
        except UrdfError as error:
            raise ServiceError(str(error)) from error
        self._node.log.info("Another description, by service: %s", summary(robot))
        return SetDescription.Response(robot.name, len(robot.links), len(robot.joints))

    def _serve_mesh(self, request: RobotMesh.Request) -> RobotMesh.Response:
        return serve_mesh(self.robot, request)

    def _rename(self, prefix: str) -> None:
        try:
            frames = JointFrames(self.robot, prefix)
        except UrdfError as error:
            raise ParameterError(str(error)) from error
        self._change(frames, self._source)


class FromFile:
    """Reads the description again from its file, when asked to or once it has changed."""

    def __init__(
        self, node: Node, state: RobotState, file: DescriptionFile, *, watches: bool
    ) -> None:
        self._node = node
        self._state = state
        self._file = file
        node.create_service(Empty, "reload", self._on_reload)
        if watches:
            node.create_timer(LOOK_EVERY_S, self._look, clock=SystemClock())

    def _on_reload(self, request: Empty.Request) -> Empty.Response:
        try:
            self._reload()
        except UrdfError as error:
            raise ServiceError(str(error)) from error
        return Empty.Response()

    def _look(self) -> None:
        if self._file.has_changed():
            try:
                self._reload()
            except UrdfError as error:
                self._node.log.warning("Kept the description as it was: %s", error)

    def _reload(self) -> None:
        robot = self._file.load()
        if robot.text == self._state.robot.text:
            return
        self._state.replace(robot, str(self._file.path))
        self._node.log.info("Read %s again: %s", self._file.path, summary(robot))


def summary(robot: Robot) -> str:
    """`arm: 8 links, 7 joints, 6 of them move`."""
    moving = sum(joint.type != "fixed" for joint in robot.joints.values())
    links, joints = counted(len(robot.links), "link"), counted(len(robot.joints), "joint")
    return f"{printable(robot.name, 60)}: {links}, {joints}, {moving} of them moving"


def _refuse_publish_frequency(ctx: click.Context, param: click.Parameter, text: str | None) -> None:
    # The parameter has this name; as an option it would be a second one of --rate.
    if text is not None:
        raise click.UsageError(f"no such option: --publish-frequency; write --rate {text}")


@click.command(
    cls=NodeCommand,
    declared=(RATE, IGNORE_STAMPS, PREFIX),
    epilog="Examples: tfbus robot_state arm.urdf; "
    "tfbus robot_state arm.urdf.xacro gripper:=true --watch",
)
@click.argument(
    "path",
    metavar="[FILE]",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    required=False,
)
@click.argument("more_arguments", metavar="[NAME:=VALUE]...", nargs=-1)
@click.option(
    "--prefix", default="", metavar="PREFIX", help="Put before all frames, such as left_."
)
@click.option(
    "--rate",
    type=Number(least=0.0, most=1e6),
    default=0.0,
    metavar="HZ",
    help="Publish a joint at most this often (default: with each joint state).",
)
@click.option(
    "--publish-frequency",
    hidden=True,
    expose_value=False,
    callback=_refuse_publish_frequency,
    metavar="HZ",
)
@click.option("--ignore-timestamp", is_flag=True, help="Publish joint states whatever their stamp.")
@click.option("--watch", is_flag=True, help="Read the file again when it changes.")
@click.option(
    "--package-path",
    "package_path",
    multiple=True,
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    metavar="FOLDER",
    help="Where packages of package:// are, before those of ROS; repeatable.",
)
@click.option(
    "--xacro-arg",
    "xacro_args",
    multiple=True,
    metavar="NAME:=VALUE",
    help="An argument of a xacro file, as after FILE; repeatable.",
)
@node_options("robot_state")
def main(
    settings: NodeSettings,
    path: Path | None,
    more_arguments: tuple[str, ...],
    prefix: str,
    rate: float,
    ignore_timestamp: bool,
    watch: bool,
    package_path: tuple[Path, ...],
    xacro_args: tuple[str, ...],
) -> None:
    """Publish the frames of a robot from its URDF and from joint states.

    FILE is a URDF, or a xacro file, whose name ends in .xacro and which takes arguments. It may be
    omitted if the parameter robot_description has the text.
    """
    try:
        arguments = xacro_arguments((*xacro_args, *more_arguments))
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    settings, text = _without_description(settings)
    declared = {PREFIX: prefix, RATE: rate, IGNORE_STAMPS: ignore_timestamp}
    if path is None:
        if text is None:
            raise click.UsageError("name the file of the robot: tfbus robot_state arm.urdf")
        if watch:
            raise click.UsageError("--watch needs a file")
        if text.strip() and "<" not in text:
            raise click.UsageError(
                "robot_description is the text of a URDF, not the name of its file: write "
                f"tfbus robot_state {printable(shlex.quote(text.strip()), 200)}"
            )
        robot = Robot.from_text(
            text, folder=Path(), package_path=package_path, name_of_source="robot_description"
        )
        _run(settings, robot, "robot_description", declared, lambda node, state: None)
        return
    file = DescriptionFile(path, package_path, arguments)
    _run(
        settings,
        file.load(),
        str(path),
        declared,
        lambda node, state: FromFile(node, state, file, watches=watch),
    )


def _run(
    settings: NodeSettings,
    robot: Robot,
    source: str,
    declared: dict[Declared, Any],
    also: Callable[[Node, RobotState], object],
) -> None:
    with Node.from_settings(settings) as node:
        state = RobotState(node, robot, source, declared)
        also(node, state)
        node.ready(f"Publishing {summary(robot)}")
        node.spin()


def _without_description(settings: NodeSettings) -> tuple[NodeSettings, str | None]:
    """The settings without the parameter robot_description, and its text."""
    parameters = dict(settings.parameters)
    text = parameters.pop(_DESCRIPTION, None)
    if text is None:
        return settings, None
    return replace(settings, parameters=parameters), str(text)


if __name__ == "__main__":
    main()
