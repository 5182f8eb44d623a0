"""`tfbus topic`: the topics on the bus, their publishers and subscribers, and their messages."""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from tfbus.base.clock import SYSTEM_CLOCK
from tfbus.base.errors import BusError, InvalidArgumentException
from tfbus.base.json_text import json_text
from tfbus.base.wording import counted, did_you_mean
from tfbus.bus.graph import TRANSFORMS_TYPE, Endpoint, Graph, TopicInfo
from tfbus.bus.settings import NodeSettings
from tfbus.cli import Verbs
from tfbus.cli.bus import look, look_once, open_bus, say_if_empty
from tfbus.cli.message import (
    TRANSFORMS_TYPES,
    TransformMessage,
    bare,
    checked_map,
    complete_message,
    complete_values,
    encode_values,
    find_type,
    names_of_type,
    print_type,
    print_types,
    read_map,
    shown_type,
    supplied_names,
    supplied_type,
    type_of_ros,
)
from tfbus.cli.output import (
    json_option,
    paint,
    print_json,
    print_lines,
    print_text,
    say,
    table,
    warn,
    with_type,
)
from tfbus.cli.topic.echo import echo_command
from tfbus.cli.topic.measure import bw_command, delay_command, hz_command
from tfbus.cli.topic.source import (
    SAY_AFTER_S,
    find_topic,
    full_topic,
    recorded_topic,
    type_of,
    visiting,
)
from tfbus.command.options import bus_options
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import IN_FILE, NOT_NEGATIVE, POSITIVE, Number, TopicName, matching
from tfbus.recording.reader import topics_of
from tfbus.wire.codec import encode_message, type_name
from tfbus.wire.keys import relative

if TYPE_CHECKING:
    from tfbus.bus.network_session import HeardWatch
    from tfbus.node.node import Node
    from tfbus.node.topic import RawPublisher


@click.group(cls=Verbs)
def command() -> None:
    """List, show, print, measure and publish topics."""


for _each in (echo_command, hz_command, bw_command, delay_command):
    command.add_command(_each)


@command.command("list", epilog="Example: tfbus topic list -t")
@click.option("-t", "--show-types", is_flag=True, help="Print their types too.")
@click.option("-c", "--count", "only_count", is_flag=True, help="Print only the count.")
@click.option(
    "-v", "--verbose", is_flag=True, help="Print the number of publishers and subscribers."
)
@json_option("Print a JSON list of objects, with all publishers and subscribers.")
@bag_options()
@bus_options("topic")
def list_command(
    settings: NodeSettings,
    bag: BagChoice | None,
    show_types: bool,
    only_count: bool,
    verbose: bool,
    as_json: bool,
) -> None:
    """Print the names of all topics, one per line.

    `tf/NAME` and `tf_static/NAME` are the transforms of the stream NAME. With --bag, -v prints the
    number of messages.
    """
    if bag is not None:
        _list_recorded(bag, show_types, only_count, verbose, as_json)
        return
    with open_bus(settings) as session:
        graph = look(session)
        topics = list(graph.topics.values())
        say_if_empty(session, topics, "topic", is_all=not graph.services)
    if only_count:
        click.echo(len(topics))
    elif as_json:
        print_json([_as_map(topic) for topic in topics])
    elif verbose:
        published = [(topic, topic.publishers) for topic in topics if topic.publishers]
        subscribed = [(topic, topic.subscribers) for topic in topics if topic.subscribers]
        click.echo("Published topics:")
        print_lines(_line(topic, len(ends), "publisher") for topic, ends in published)
        click.echo("\nSubscribed topics:")
        print_lines(_line(topic, len(ends), "subscriber") for topic, ends in subscribed)
    else:
        print_lines(_named(topic) if show_types else topic.name for topic in topics)


def _list_recorded(
    bag: BagChoice, show_types: bool, only_count: bool, verbose: bool, as_json: bool
) -> None:
    with bag.opened() as recording:
        topics = list(topics_of(recording.reader).values())
    if only_count:
        click.echo(len(topics))
    elif as_json:
        print_json([asdict(topic) for topic in topics])
    elif verbose:
        rows = [[topic.name, shown_type(topic.type), str(topic.messages)] for topic in topics]
        print_lines(table(("topic", "type", "messages"), rows, right=(2,)))
    else:
        print_lines(
            with_type(each.name, shown_type(each.type)) if show_types else each.name
            for each in topics
        )


@command.command("info", epilog="Example: tfbus topic info turtle1/pose -v")
@click.argument("topic", type=TopicName())
@click.option(
    "-v", "--verbose", is_flag=True, help="Print the nodes that publish and subscribe too."
)
@json_option("Print a JSON object.")
@bag_options()
@bus_options("topic")
def info_command(
    settings: NodeSettings, bag: BagChoice | None, topic: str, verbose: bool, as_json: bool
) -> None:
    """Print the type of TOPIC, and the number of its publishers and subscribers; with --bag, the
    number of its messages.
    """
    if bag is not None:
        with bag.opened() as recording:
            found = recorded_topic(recording.reader, full_topic(topic, settings))
        if as_json:
            print_json(asdict(found))
        else:
            print_text(f"Type: {paint(shown_type(found.type), 'type')}")
            print_text(f"Messages: {found.messages}")
        return
    with open_bus(settings) as session:
        info = find_topic(look_once(session), relative(topic, settings.namespace))
    if as_json:
        print_json(_as_map(info))
        return
    print_text(f"Type: {paint(_types(info), 'type')}")
    for side, ends in (("Publisher", info.publishers), ("Subscription", info.subscribers)):
        count = "unknown, listeners do not announce it" if ends is None else len(ends)
        print_text(f"{side} count: {count}")
        if verbose:
            print_lines(line for end in ends or () for line in _end_lines(end))
        else:
            print_lines(f"  {end.node}: {end.filtered}" for end in ends or () if end.filtered)


def _complete_show(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    names = TopicName().shell_complete(ctx, param, incomplete)
    return [*names, *matching(supplied_names(), incomplete)]


@command.command(
    "show",
    epilog="Examples: tfbus topic show; tfbus topic show turtle1/pose; tfbus topic show Twist",
)
@click.argument("topic", metavar="[TOPIC|TYPE]", required=False, shell_complete=_complete_show)
@json_option("Print a JSON object.")
@bus_options("topic")
def show_command(settings: NodeSettings, topic: str | None, as_json: bool) -> None:
    """Print the fields of the messages of TOPIC, or of the type TYPE, with their defaults.

    TYPE is a message of tfbus.messages or package.module:Name. Without an argument, list those of
    tfbus.messages.
    """
    if topic is None:
        print_types(filter(None, map(supplied_type, supplied_names())))
        return
    type_ = (
        type_of_ros(topic)
        or supplied_type(bare(topic))
        or (find_type(topic) if ":" in topic else None)
    )
    if bare(topic) in TRANSFORMS_TYPES or type_of(Graph(), topic) == TRANSFORMS_TYPE:
        type_ = TransformMessage
    if type_ is None:
        topic = relative(topic, settings.namespace)
        with open_bus(settings) as session:
            topics = look_once(session).topics
        if topic not in topics:
            hint = did_you_mean(topic, {*topics, *supplied_names()})
            raise BusError(f"there is no topic or type {topic!r}{hint}")
        type_ = _type_of(topics[topic])
    print_type(type_, as_json=as_json)


def _type_of(info: TopicInfo) -> type:
    if TRANSFORMS_TYPE in info.types:
        return TransformMessage
    known = [type_ for name in info.types if (type_ := supplied_type(name) or type_of_ros(name))]
    if not known:
        raise BusError(
            f"{info.name!r} is of type {_types(info)}, whose fields only its nodes know: name it "
            "by its place in Python, as in: tfbus topic show my_robot.messages:Battery; or print "
            f"a message: tfbus topic echo {info.name} --once"
        )
    return known[0]


@command.command("type", epilog="Example: tfbus topic type turtle1/pose")
@click.argument("topic", type=TopicName())
@bag_options()
@bus_options("topic")
def type_command(settings: NodeSettings, bag: BagChoice | None, topic: str) -> None:
    """Print the type of TOPIC."""
    if bag is not None:
        with bag.opened() as recording:
            found = recorded_topic(recording.reader, full_topic(topic, settings))
        print_text(shown_type(found.type))
        return
    with open_bus(settings) as session:
        print_text(_types(find_topic(look_once(session), relative(topic, settings.namespace))))


@command.command("find", epilog="Example: tfbus topic find Pose")
@click.argument("type_name", metavar="TYPE")
@click.option("-c", "--count", "only_count", is_flag=True, help="Print only the count.")
@bus_options("topic")
def find_command(settings: NodeSettings, type_name: str, only_count: bool) -> None:
    """Print the names of the topics of TYPE, one per line."""
    with open_bus(settings) as session:
        found = names_of_type(look_once(session).topics, type_name, "topic")
    click.echo(len(found)) if only_count else print_lines(found)


def _as_map(topic: TopicInfo) -> dict[str, object]:
    return {**asdict(topic), "types": list(topic.types)}


def _types(topic: TopicInfo) -> str:
    return ", ".join(map(shown_type, topic.types)) or shown_type("")


def _named(topic: TopicInfo) -> str:
    return with_type(topic.name, _types(topic))


def _line(topic: TopicInfo, count: int, side: str) -> str:
    return f" * {_named(topic)} {counted(count, side)}"


def _end_lines(end: Endpoint) -> list[str]:
    return [
        f"  Node name: {paint(end.node, 'name')}",
        f"    Type: {shown_type(end.type)}",
        f"    Host: {end.host}",
        f"    Pid: {end.pid}",
        *(["    Retained: its last message reaches late subscribers"] if end.retained else ()),
        *([f"    Poses: {end.poses}"] if end.poses else ()),
        *([f"    Filter: {end.filtered}"] if end.filtered else ()),
    ]


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


@command.command(
    "pub",
    hints=_CALLED_IN_ROS,
    epilog="Examples: tfbus topic pub --once turtle1/cmd_vel Twist '{linear: {x: 2.0}}'; "
    "tfbus topic pub points PointCloud '{frame_id: lidar}' --file scan.pcd",
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
@click.option(
    "--file",
    "path",
    type=IN_FILE,
    help="Publish the cloud (.ply, .pcd, .npy, .npz) or image (.png, .jpg, .npy) in a file; VALUES "
    "are its frame_id and stamp_ns, which is else the time of each message.",
)
@bus_options("topic")
def pub_command(
    settings: NodeSettings,
    topic: str,
    message: tuple[str, ...],
    path: Path | None,
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
        if path is not None:
            payload_of, shown = _from_file(path, message_type, values, node)
        else:
            if message_type:
                values = complete_values(values, message_type)
            payload, shown = encode_values(values, "VALUES"), json_text(values)
            payload_of = partial(bytes, payload)
        name = type_name(message_type) if message_type else announced
        if given_type and announced and announced != name:
            warn(f"other nodes announce {topic!r} as {announced}, not {name}")
        publisher = node.create_raw_publisher(topic, type_name=name)
        _wait_for_subscribers(node, topic, subscribers, wait_s)
        shown = f"{name or 'message'} {shown}"
        _publish(node, publisher, payload_of, rate, times, shown, 0 if quiet else every)
        if node.ok:
            node.wait(keep_alive_s, clock=SYSTEM_CLOCK)


def _from_file(
    path: Path, message_type: type | None, values: dict[str, Any], node: "Node"
) -> tuple[Callable[[], bytes], str]:
    """The bytes of the next message with the content of a file, and how it is printed.

    Raises click.UsageError for a type that no file has, and for other values than a stamp and a
    frame, and a file that has no such message; BusError for one that cannot be read.
    """
    from tfbus.sensor_files import READERS  # numpy, which other messages do not need

    reader = READERS.get(message_type) if message_type else None
    if reader is None:
        names = " or ".join(each.__name__ for each in READERS)
        raise click.UsageError(f"--file has a message of type {names}: name it before VALUES")
    if not values.keys() <= {"stamp_ns", "frame_id"}:
        raise click.UsageError("VALUES beside --file must be frame_id and stamp_ns, or left out")
    try:
        read = reader(path)
    except InvalidArgumentException as error:
        raise click.UsageError(f"--file: {error}") from error
    except OSError as error:
        raise BusError(f"{path} cannot be read: {error.strerror or error}") from error
    try:
        content = replace(read, **values)
        encode_message(content)
    except (TypeError, ValueError, OverflowError) as error:
        raise click.UsageError(f"VALUES beside --file: {error}") from error

    def payload() -> bytes:
        has_stamp = "stamp_ns" in values
        return encode_message(content if has_stamp else replace(content, stamp_ns=node.now_ns()))

    return payload, json_text({"frame_id": content.frame_id, "file": str(path)})


def _publish(
    node: "Node",
    publisher: "RawPublisher",
    payload_of: Callable[[], bytes],
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
        publisher.publish(payload_of())
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
