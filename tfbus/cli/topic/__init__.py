"""`tfbus topic`: the topics on the bus, their publishers and subscribers, and their messages."""

from dataclasses import asdict

import click
from click.shell_completion import CompletionItem

from tfbus.bus.settings import NodeSettings
from tfbus.cli.bus import look, look_once, open_bus, say_if_empty
from tfbus.cli.message import (
    TRANSFORMS_TYPES,
    TransformMessage,
    bare,
    find_type,
    names_of_type,
    supplied_names,
    supplied_type,
    type_of_ros,
)
from tfbus.cli.message_fields import print_type, print_types
from tfbus.cli.output import json_option, paint, print_json, print_lines, print_text, table
from tfbus.cli.topic.echo import echo_command
from tfbus.cli.topic.measure import bw_command, delay_command, hz_command
from tfbus.cli.topic.pub import pub_command
from tfbus.cli.topic.source import find_topic, full_topic, recorded_topic, type_of
from tfbus.cli.verbs import Verbs
from tfbus.command.options import bus_options
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import TopicName, matching
from tfbus.discover.graph import TRANSFORMS_TYPE, Endpoint, Graph, TopicInfo
from tfbus.errors import BusError
from tfbus.recording.reader import RecordedTopic, topics_of
from tfbus.wire.keys import relative
from tfbus.wording import counted, did_you_mean


@click.group(cls=Verbs)
def command() -> None:
    """List, show, print, measure and publish topics."""


for _each in (echo_command, hz_command, bw_command, delay_command, pub_command):
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
        rows = [[topic.name, topic.type or "unknown", str(topic.messages)] for topic in topics]
        print_lines(table(("topic", "type", "messages"), rows, right=(2,)))
    else:
        print_lines(
            f"{each.name} {paint(f'[{_type_of_recorded(each)}]', 'type')}"
            if show_types
            else each.name
            for each in topics
        )


def _type_of_recorded(topic: RecordedTopic) -> str:
    return topic.type or "unknown"


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
            print_text(f"Type: {paint(found.type or 'unknown', 'type')}")
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
        print_text(_type_of_recorded(found))
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
    return ", ".join(topic.types) or "unknown"


def _named(topic: TopicInfo) -> str:
    return f"{topic.name} {paint(f'[{_types(topic)}]', 'type')}"


def _line(topic: TopicInfo, count: int, side: str) -> str:
    return f" * {_named(topic)} {counted(count, side)}"


def _end_lines(end: Endpoint) -> list[str]:
    return [
        f"  Node name: {paint(end.node, 'name')}",
        f"    Type: {end.type or 'unknown'}",
        f"    Host: {end.host}",
        f"    Pid: {end.pid}",
        *(["    Retained: its last message reaches late subscribers"] if end.retained else ()),
    ]
