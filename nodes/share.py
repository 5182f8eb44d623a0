"""`tfbus share`: show some frames of one robot to others.

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
from tfbus.command.types import own_name

from .shared_view import SHARED, Recipient, View, look

ALL = "all"
# How often to look for other robots, and to retry the ones whose bus could not be joined.
_LOOK_ROUND_S = 1.0
# A frame without a transform after this time is logged.
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
    help="A robot that sees them, or all; repeatable.",
)
@click.option(
    "--relative-to",
    type=FrameName(),
    default="map",
    show_default=True,
    help="The frame that the robots share.",
)
@click.option(
    "--rate",
    "rate_hz",
    type=Number(least=0.01, most=1000.0),
    default=10.0,
    show_default=True,
    help="Maximum number of updates per second.",
)
@node_options(lambda: own_name("share"))
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
    as robot7/base_link, in the frame that they share.
    """
    robot = _namespace(settings, robot, "ROBOT")
    named = [_namespace(settings, to, "--to") for to in recipients if to != ALL]
    if robot in named:
        raise click.UsageError(f"--to: {robot!r} already sees its own frames; name another robot")
    if relative_to in frames:
        raise click.UsageError(
            f"--relative-to: {relative_to!r} is one of the shown frames; name another"
        )
    with Node.from_settings(settings) as node:
        fleet = Fleet(shared_frames=(relative_to,))
        with TransformListener(Buffer(), node, fleet=fleet, reads="needed") as listener:
            shown = [f"{robot}/{frame}" for frame in dict.fromkeys(frames)]
            sharing = Sharing(node, listener, shown, relative_to, rate_hz)
            sharing.go_on(named, Others(robot, listener) if ALL in recipients else None)


def _namespace(settings: NodeSettings, name: str, what: str) -> str:
    """The name of a robot as a namespace; a usage error if it is not a valid one."""
    try:
        namespace = replace(settings, namespace=name).namespace
    except InvalidNameError as error:
        raise click.UsageError(f"{what}: {error}") from error
    if not namespace:
        raise click.UsageError(f"{what}: the name of a robot must not be empty")
    return namespace


class Others:
    """All robots that publish transforms, except the one whose frames are shown.

    Streams that show frames of others, here or from another process, do not count.
    """

    def __init__(self, robot: str, listener: TransformListener) -> None:
        self._robot = robot
        self._listener = listener

    def robots(self) -> set[str]:
        """The namespaces of the robots now on the bus."""
        streams = self._listener.streams()
        robots = {
            each.namespace for each in streams if each.alive and not each.name.endswith(SHARED)
        }
        return robots - {"", self._robot}


class Sharing:
    """Shows frames to robots, as the listener sees them, until the node is shut down."""

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
        """Show the frames to the named robots, and to all others if `others` is given."""
        self._show_to(named)
        self._node.ready()
        try:
            turn = 0
            while self._node.wait(1.0 / self._rate_hz):
                if self._is_every(_LOOK_ROUND_S, turn):
                    self._show_to({*named, *(others.robots() if others is not None else ())})
                self._look(logs_missing=turn == self._turns(_PATIENCE_S))
                for recipient in self._recipients.values():
                    recipient.show(self._views)
                turn += 1
        finally:
            self._show_to(())

    def _turns(self, seconds: float) -> int:
        return max(round(seconds * self._rate_hz), 1)

    def _is_every(self, seconds: float, turn: int) -> bool:
        return turn % self._turns(seconds) == 0

    def _look(self, *, logs_missing: bool) -> None:
        """Look up all frames; log frames that appear or disappear.

        With `logs_missing` also log frames without a transform.
        """
        for frame in self._frames:
            view = look(self._buffer, self._relative_to, frame)
            if view is None:
                continue
            former, self._views[frame] = self._views.get(frame), view
            was_seen = former is not None and former.transform is not None
            if view.transform is not None and not was_seen:
                self._node.log.info("%r is visible in %r", frame, self._relative_to)
            elif view.transform is None and (was_seen or logs_missing):
                self._node.log.warning("%r is not visible: %s", frame, view.reason)

    def _show_to(self, robots: Iterable[str]) -> None:
        """Show the frames to these robots from now on, and to no others.

        A robot whose bus cannot be joined is logged once, and does not delay the others.
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
                        "Cannot show frames to %s yet; retrying: %s", robot, error
                    )
            else:
                self._failed.discard(robot)
                self._node.log.info("Showing %s to %s", ", ".join(self._frames), robot)


if __name__ == "__main__":
    main()
