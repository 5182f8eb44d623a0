"""`tfbus topic pub`: publish messages from the command line."""

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from tfbus.bus.settings import NodeSettings
from tfbus.cli.bus import look
from tfbus.cli.message import (
    TRANSFORMS_TYPES,
    bare,
    checked_map,
    complete_message,
    complete_values,
    encode_values,
    find_type,
    read_map,
    supplied_type,
    type_of_ros,
)
from tfbus.cli.output import as_json, print_text, say, warn
from tfbus.cli.topic.source import SAY_AFTER_S, type_of, visiting
from tfbus.cli.verbs import Answering
from tfbus.command.options import bus_options
from tfbus.command.types import NOT_NEGATIVE, POSITIVE, Number, TopicName
from tfbus.discover.graph import TRANSFORMS_TYPE
from tfbus.errors import BusError
from tfbus.runtime.clock import SYSTEM_CLOCK
from tfbus.wire.codec import type_name
from tfbus.wire.keys import relative

if TYPE_CHECKING:
    from tfbus.bus.handles import HeardWatch
    from tfbus.node.node import Node
    from tfbus.node.topic import RawPublisher

# How often nodes are asked for their subscriptions while it waits for several.
_ASK_AGAIN_S = 0.2

_NO_TRANSFORMS = (
    "{!r} carries transforms: publish one with `tfbus static`, or many from a program with a "
    "TransformBroadcaster"
)
_WITHOUT_TYPE = ", or leave the type out: any map of fields can be published"

_FROM_A_SHELL = 'leave it out, and take the values from the shell: "$(cat values.yaml)"'
_NAME = "not needed: its node is not in the lists of nodes"

# Options of `ros2 topic pub`.
_CALLED_IN_ROS = {
    "--stdin": _FROM_A_SHELL,
    "--yaml-file": _FROM_A_SHELL,
    "-n": _NAME,
    "--node-name": _NAME,
}


@click.command(
    "pub",
    cls=Answering,
    hints=_CALLED_IN_ROS,
    epilog="Example: tfbus topic pub --once turtle1/cmd_vel Twist '{linear: {x: 2.0}}'",
)
@click.argument("topic", type=TopicName())
@click.argument("message", nargs=-1, metavar="[TYPE] [VALUES]", shell_complete=complete_message)
@click.option(
    "-r",
    "--rate",
    type=Number(least=1e-6, most=1e6),
    default=1.0,
    show_default=True,
    help="Messages per second.",
)
@click.option("-1", "--once", is_flag=True, help="Publish one message and exit.")
@click.option(
    "-t", "--times", type=click.IntRange(min=1), metavar="N", help="Publish N messages and exit."
)
@click.option(
    "-w",
    "--wait-matching",
    type=click.IntRange(min=0),
    metavar="N",
    help="First wait for N subscribers (default 1 with --once or --times, else 0).",
)
@click.option(
    "--max-wait-time",
    "wait_s",
    type=POSITIVE,
    metavar="S",
    help="Fail if there are fewer subscribers after S seconds.",
)
@click.option(
    "--keep-alive",
    "keep_alive_s",
    type=NOT_NEGATIVE,
    default=0.1,
    metavar="S",
    show_default=True,
    help="Wait S seconds after the last message before exiting.",
)
@click.option(
    "-p",
    "--print",
    "every",
    type=click.IntRange(min=1),
    default=1,
    metavar="N",
    show_default=True,
    help="Print every Nth message.",
)
@click.option("-q", "--quiet", is_flag=True, help="Do not print messages.")
@bus_options("topic")
def pub_command(
    settings: NodeSettings,
    topic: str,
    message: tuple[str, ...],
    rate: float,
    once: bool,
    times: int | None,
    wait_matching: int | None,
    wait_s: float | None,
    keep_alive_s: float,
    every: int,
    quiet: bool,
) -> None:
    """Publish the message VALUES, a YAML map of fields, on TOPIC.

    TYPE is a message of tfbus.messages, one of ROS by its full name (sensor_msgs/msg/LaserScan) or
    package.module:Name; the default is the type that other nodes announce for the topic. Fields
    are checked against it, and missing ones get their defaults.
    """
    if once and times is not None:
        raise click.UsageError("--once and --times are mutually exclusive: give one")
    times = 1 if once else times
    given_type, values = _split(message)
    subscribers = (0 if times is None else 1) if wait_matching is None else wait_matching
    topic = relative(topic, settings.namespace)
    with visiting(settings, "pub", goes_on=times is None) as node:
        announced = type_of(look(node.session), topic)
        if announced == TRANSFORMS_TYPE:
            raise click.UsageError(_NO_TRANSFORMS.format(topic))
        message_type = given_type or supplied_type(announced) or type_of_ros(announced)
        if message_type:
            values = complete_values(values, message_type)
        payload = encode_values(values, "VALUES")
        name = type_name(message_type) if message_type else announced
        if given_type and announced and announced != name:
            warn(f"other nodes announce {topic!r} as {announced}, not {name}")
        publisher = node.create_raw_publisher(topic, type_name=name)
        _wait_for_subscribers(node, topic, subscribers, wait_s)
        shown = f"{name or 'message'} {as_json(values)}"
        _publish(node, publisher, payload, rate, times, shown, 0 if quiet else every)
        if node.ok:
            node.wait(keep_alive_s, clock=SYSTEM_CLOCK)


def _publish(
    node: "Node",
    publisher: "RawPublisher",
    payload: bytes,
    rate: float,
    times: int | None,
    shown: str,
    every: int,
) -> None:
    """Publish at the rate, without drift, `times` times (None: until the node is shut down).

    Raises KeyboardInterrupt if the node is shut down before all are published.
    """
    started_s = time.monotonic()
    sent = 0
    while node.ok:
        publisher.publish(payload)
        sent += 1
        if every and (sent - 1) % every == 0:
            print_text(f"publishing #{sent}: {shown}")
        if sent == times:
            return
        node.wait(max(started_s + sent / rate - time.monotonic(), 0.0), clock=SYSTEM_CLOCK)
    if times is not None:
        raise KeyboardInterrupt


def _wait_for_subscribers(node: "Node", topic: str, wanted: int, wait_s: float | None) -> None:
    """Wait for `wanted` subscribers. Raises BusError if they do not come within `wait_s`."""
    if not wanted:
        return
    watch = node.session.watch_heard(topic)
    started_s = time.monotonic()
    has_said = False
    while node.ok and _heard(node, topic, wanted, watch) < wanted:
        waited_s = time.monotonic() - started_s
        if wait_s is not None and waited_s >= wait_s:
            raise BusError(f"{topic!r} has fewer than {wanted} subscribers after {wait_s:g} s")
        if not has_said and waited_s >= SAY_AFTER_S:
            has_said = True
            say(f"Waiting for {_subscribers(wanted)} of {topic!r}")
    watch.close()


def _heard(node: "Node", topic: str, wanted: int, watch: "HeardWatch") -> int:
    """How many subscribe: Zenoh knows whether any does, nodes are asked for the number."""
    if not watch.wait(_ASK_AGAIN_S):
        return 0
    if wanted == 1:
        return 1
    node.wait(_ASK_AGAIN_S, clock=SYSTEM_CLOCK)
    info = look(node.session, warns=False).topics.get(topic)
    return len(info.subscribers or ()) if info else 0


def _subscribers(count: int) -> str:
    return "a subscriber" if count == 1 else f"{count} subscribers"


def _split(words: Sequence[str]) -> tuple[type | None, dict[str, Any]]:
    """The type, None if it is omitted, and the fields."""
    if len(words) > 2:
        raise click.UsageError(
            f"expected a type and a map of fields, got {len(words)} words: quote the map"
        )
    if words and bare(words[0]) in TRANSFORMS_TYPES:
        raise click.UsageError(_NO_TRANSFORMS.format(words[0]))
    if len(words) == 2:
        return find_type(words[0], _WITHOUT_TYPE), checked_map(words[1], "VALUES")
    values = read_map(words[0]) if words else {}
    return (find_type(words[0], _WITHOUT_TYPE), {}) if values is None else (None, values)
