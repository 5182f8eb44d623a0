"""`tfbus share`: show frames of one robot to others, without all the rest of its frames.

Try it: tfbus share robot7 base_link --to robot1
"""

from collections.abc import Iterable
from dataclasses import replace

import click

from tfbus import (
    Buffer,
    BusError,
    Fleet,
    FrameName,
    InvalidNameError,
    Node,
    NodeSettings,
    Number,
    TransformListener,
    node_options,
)
from tfbus.command import own_name

from .shared_view import SHARED, Recipient, View, look

ALL = "all"
# How often it is looked who is there, and tried again to join whom nothing could be shown to.
_LOOK_ROUND_S = 1.0
# What is not to be seen after this time is told.
_PATIENCE_S = 2.0


@click.command(
    epilog="Example: tfbus share robot7 base_link gripper --to robot1 --to robot2 --rate 5"
)
@click.argument("robot")
@click.argument("frames", type=FrameName(), nargs=-1, required=True)
@click.option(
    "--to",
    "recipients",
    metavar="ROBOT",
    multiple=True,
    required=True,
    help="Who is to see them: a robot, repeatable; or all.",
)
@click.option(
    "--relative-to",
    type=FrameName(),
    default="map",
    help="The frame that the robots have in common; map.",
)
@click.option(
    "--rate",
    "rate_hz",
    type=Number(least=0.01, most=1000.0),
    default=10.0,
    help="How often they are sent at most, in Hz; 10.",
)
@node_options(own_name("share"))
def main(
    settings: NodeSettings,
    robot: str,
    frames: tuple[str, ...],
    recipients: tuple[str, ...],
    relative_to: str,
    rate_hz: float,
) -> None:
    """Show frames of one robot to others.

    ROBOT is the namespace of the robot whose FRAMES are shown. The others see base_link of robot7
    as robot7/base_link, in the frame that all of them have in common.
    """
    robot = _namespace(settings, robot, "ROBOT")
    named = [_namespace(settings, to, "--to") for to in recipients if to != ALL]
    if robot in named:
        raise click.UsageError(f"--to: {robot!r} sees its own frames anyway; name another robot")
    if relative_to in frames:
        raise click.UsageError(
            f"--relative-to: {relative_to!r} is one of the frames; name the frame to show it in"
        )
    with Node.from_settings(settings) as node:
        fleet = Fleet(shared_frames=(relative_to,))
        with TransformListener(Buffer(), node, fleet=fleet, reads="needed") as listener:
            shown = [f"{robot}/{frame}" for frame in dict.fromkeys(frames)]
            sharing = Sharing(node, listener, shown, relative_to, rate_hz)
            sharing.go_on(named, Others(robot, node, listener) if ALL in recipients else None)


def _namespace(settings: NodeSettings, name: str, what: str) -> str:
    """The name of a robot as a namespace; a usage error where it can be none."""
    try:
        namespace = replace(settings, namespace=name).namespace
    except InvalidNameError as error:
        raise click.UsageError(f"{what}: {error}") from error
    if not namespace:
        raise click.UsageError(f"{what}: the name of a robot is not empty")
    return namespace


class Others:
    """All robots that publish transforms, but the one whose frames are shown.

    What is shown to a robot, here or by another process, is not the robot.
    """

    def __init__(self, robot: str, node: Node, listener: TransformListener) -> None:
        self._robot = robot
        self._namespace = node.namespace
        self._listener = listener

    def robots(self) -> set[str]:
        """Those that are there now."""
        robots = set()
        for info in self._listener.streams():
            if info.alive and not info.name.endswith(SHARED):
                above, _, _ = info.node.strip("/").rpartition("/")
                robots.add(above.removeprefix(self._namespace).strip("/"))
        return robots - {"", self._robot}


class Sharing:
    """Shows frames, as the listener sees them, to robots, for as long as the node lives."""

    def __init__(
        self,
        node: Node,
        listener: TransformListener,
        frames: list[str],
        relative_to: str,
        rate_hz: float,
    ) -> None:
        self._node = node
        self._buffer = listener.buffer
        self._frames = frames
        self._relative_to = relative_to
        self._rate_hz = rate_hz
        self._recipients: dict[str, Recipient] = {}
        self._failed: set[str] = set()
        self._views: dict[str, View] = {}
        for frame in frames:
            listener.need(relative_to, frame)

    def go_on(self, named: Iterable[str], others: Others | None) -> None:
        """Show them to the robots that are named, and to all others if wanted."""
        self._show_to(named)
        self._node.ready()
        try:
            turn = 0
            while self._node.wait(1.0 / self._rate_hz):
                if self._is_every(_LOOK_ROUND_S, turn):
                    self._show_to({*named, *(others.robots() if others is not None else ())})
                self._look(is_told=turn == self._turns(_PATIENCE_S))
                for recipient in self._recipients.values():
                    recipient.show(self._views)
                turn += 1
        finally:
            self._show_to(())

    def _turns(self, seconds: float) -> int:
        return max(round(seconds * self._rate_hz), 1)

    def _is_every(self, seconds: float, turn: int) -> bool:
        return turn % self._turns(seconds) == 0

    def _look(self, *, is_told: bool) -> None:
        """Take in what is to be seen now; say what has come or gone, and, where that is to be
        told, what is still not there.
        """
        for frame in self._frames:
            view = look(self._buffer, self._relative_to, frame)
            if view is None:
                continue
            former, self._views[frame] = self._views.get(frame), view
            was_seen = former is not None and former.transform is not None
            if view.transform is not None and not was_seen:
                self._node.log.info("%r is to be seen in %r", frame, self._relative_to)
            elif view.transform is None and (was_seen or is_told):
                self._node.log.warning("%r is not to be seen: %s", frame, view.reason)

    def _show_to(self, robots: Iterable[str]) -> None:
        """Show them to these robots from now on, and to no others. One whose place on the bus
        cannot be had is told of once, and holds up none of the others.
        """
        for robot in self._recipients.keys() - set(robots):
            self._recipients.pop(robot).close()
        self._failed &= set(robots)
        for robot in sorted(set(robots) - self._recipients.keys()):
            try:
                self._recipients[robot] = Recipient(self._node.settings, robot)
            except BusError as error:
                if robot not in self._failed:
                    self._failed.add(robot)
                    self._node.log.warning(
                        "Nothing is shown to %s so far; it is tried again: %s", robot, error
                    )
            else:
                self._failed.discard(robot)
                self._node.log.info("Showing %s to %s", ", ".join(self._frames), robot)


if __name__ == "__main__":
    main()
