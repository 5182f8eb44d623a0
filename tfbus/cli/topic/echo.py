"""`tfbus topic echo`: print the messages of a topic."""

import queue
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from tfbus.base.errors import BusError, DecodeError
from tfbus.base.json_text import json_text
from tfbus.base.wording import counted, stamp_text
from tfbus.bus.graph import TRANSFORMS_TYPE
from tfbus.bus.settings import NodeSettings
from tfbus.cli import Answering
from tfbus.cli.bus import look
from tfbus.cli.message import (
    TRANSFORMS_TYPES,
    bare,
    find_type,
    is_of_type,
    supplied_names,
)
from tfbus.cli.output import is_terminal, json_option, paint, print_text, say, warn, yaml_text
from tfbus.cli.topic.message_view import MessageFilter, Shortening, csv_row, part_of, summarized
from tfbus.cli.topic.source import (
    SAY_AFTER_S,
    Reader,
    full_topic,
    may_be_retained,
    messages_of,
    reader_of,
    subscribe,
    type_of,
    visiting,
    why_silent,
)
from tfbus.command.options import bus_options
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import POSITIVE, TopicName, matching
from tfbus.wire.codec import type_name as type_name_of
from tfbus.wire.keys import relative

if TYPE_CHECKING:
    from tfbus.node.node import Node

# The most messages that wait to be printed; beyond that the oldest are skipped.
_PENDING = 1000
# A signal just before the wait begins is seen after this time.
_LOOK_UP_S = 0.5


@dataclass(frozen=True, slots=True)
class Arrival:
    """The bytes of a message, and when they arrived, by the listening node's clock."""

    payload: bytes
    received_ns: int


class Inbox:
    """Iterates over the messages of a topic until the node is shut down; closed by `with`.

    Prints that it waits if nothing comes for 2 s. Raises BusError if nothing comes for `timeout_s`
    (None: never).
    """

    def __init__(
        self,
        node: "Node",
        topic: str,
        type_name: str,
        *,
        timeout_s: float | None = None,
        retained: bool = False,
    ):
        self._node = node
        self._topic = topic
        self._timeout_s = timeout_s
        self._pending: queue.Queue[Arrival] = queue.Queue(_PENDING)
        self._skipped = 0
        self._subscription = subscribe(
            node, topic, type_name, self._enqueue, retained=retained, named=True
        )

    def __enter__(self) -> "Inbox":
        return self

    def __exit__(self, *_: object) -> None:
        self._subscription.close()
        if self._skipped:
            skipped = counted(self._skipped, "message")
            warn(f"skipped {skipped}, which arrived faster than they can be printed")

    def __iter__(self) -> Iterator[Arrival]:
        if (first := self._first()) is not None:
            yield first
        while (arrival := self._next()) is not None:
            yield arrival

    def _first(self) -> Arrival | None:
        timeout_s = self._timeout_s
        started_s = time.monotonic()
        soon_s = SAY_AFTER_S if timeout_s is None else min(SAY_AFTER_S, timeout_s)
        first = self._next(started_s + soon_s)
        if first is None and self._node.ok:
            say(why_silent(self._node, self._topic))
            first = self._next(None if timeout_s is None else started_s + timeout_s)
        if first is None and self._node.ok:
            raise BusError(f"no message on {self._topic!r} after {timeout_s:g} s")
        return first

    def _next(self, until_s: float | None = None) -> Arrival | None:
        """The next message; None if none comes by then, or the node is shut down."""
        while self._node.ok:
            left_s = _LOOK_UP_S if until_s is None else until_s - time.monotonic()
            with suppress(queue.Empty):
                return self._pending.get(timeout=min(max(left_s, 0.001), _LOOK_UP_S))
            if left_s <= 0.0:
                break
        return None

    def _enqueue(self, payload: bytes) -> None:
        arrival = Arrival(payload, self._node.now_ns())
        while True:
            try:
                self._pending.put_nowait(arrival)
                break
            except queue.Full:
                self._skipped += 1
                with suppress(queue.Empty):
                    self._pending.get_nowait()


@dataclass(frozen=True)
class _Form:
    """How to print a message: as "yaml", "csv" or "json", all of it or one part."""

    kind: str
    part: str | None
    shortening: Shortening
    with_info: bool

    def text(self, arrival: Arrival, message: dict[str, Any]) -> str:
        try:
            return self._text(arrival, message)
        except RecursionError:
            return "# a message that is nested too deeply to be printed: --raw has its bytes"

    def _text(self, arrival: Arrival, message: dict[str, Any]) -> str:
        shown = part_of(message, self.part) if self.part else message
        if self.kind == "json":
            return json_text(shown)
        if self.kind == "yaml" and not self.part and self.shortening.summarizes:
            shown = summarized(message)
        short = self.shortening.shorten(shown)
        if self.kind == "csv":
            return csv_row(short)
        info = f"{paint(_info(arrival), 'faint')}\n" if self.with_info else ""
        return f"{info}{yaml_text(short)}\n{paint('---', 'faint')}"


def _complete_type(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    return matching(supplied_names(), incomplete)


def _type_name(announced: str, topic: str, typed: str) -> str:
    """The name of the topic's type, as announced or typed in. Raises click.UsageError if these
    differ.
    """
    if not typed:
        return announced
    name = type_name_of(find_type(typed)) if ":" in typed else typed
    if bare(name) in TRANSFORMS_TYPES and announced == TRANSFORMS_TYPE:
        return announced
    if announced and not is_of_type(announced, name):
        raise click.UsageError(f"{topic!r} is of type {announced}, not {typed}")
    return announced or bare(name)


def _info(arrival: Arrival) -> str:
    if not arrival.payload:  # of a recording, which has its values
        return f"# arrived at {stamp_text(arrival.received_ns)}"
    size = counted(len(arrival.payload), "byte")
    return f"# arrived at {stamp_text(arrival.received_ns)}, {size}"


_NO_LOSSES = "not needed: messages that are skipped are counted in a warning at the end"

# Options of `ros2 topic echo`.
_CALLED_IN_ROS = {
    "--flow-style": "use --json, one line a message",
    "--lost-messages": _NO_LOSSES,
    "--no-lost-messages": _NO_LOSSES,
}


@click.command(
    "echo",
    cls=Answering,
    hints=_CALLED_IN_ROS,
    epilog="Example: tfbus topic echo turtle1/pose --field x --once",
)
@click.argument("topic", type=TopicName())
@click.argument("type_text", metavar="[TYPE]", default="", shell_complete=_complete_type)
@click.option("--once", is_flag=True, help="Print one message and exit.")
@click.option(
    "--timeout",
    "timeout_s",
    type=POSITIVE,
    metavar="S",
    help="Fail if no message comes within S seconds.",
)
@click.option("--field", metavar="PATH", help="Print only this field: linear.x, or transforms[0].")
@click.option(
    "--filter",
    "expression",
    metavar="EXPR",
    help="Print only messages m for which this is true: 'm.x > 5'.",
)
@click.option("--csv", "as_csv", is_flag=True, help="Print the values of each message as one line.")
@json_option("Print each message as one line of JSON, in full.")
@click.option("--raw", is_flag=True, help="Print the bytes of each message in hexadecimal.")
@click.option(
    "-i",
    "--include-message-info",
    "with_info",
    is_flag=True,
    help="Print the time of arrival and the size before each message.",
)
@click.option("--no-arr", is_flag=True, help="Print only the lengths of lists.")
@click.option("--no-str", is_flag=True, help="Print only the lengths of strings.")
@click.option(
    "-l",
    "--truncate-length",
    metavar="N",
    type=click.IntRange(min=1),
    default=128,
    show_default=True,
    help="Truncate strings and lists to this length.",
)
@click.option("-f", "--full-length", is_flag=True, help="Truncate and summarize nothing.")
@click.option("-c", "--clear", is_flag=True, help="Clear the terminal before each message.")
@bag_options("begin", "end")
@bus_options("topic")
def echo_command(
    settings: NodeSettings,
    bag: BagChoice | None,
    topic: str,
    type_text: str,
    once: bool,
    timeout_s: float | None,
    field: str | None,
    expression: str | None,
    as_csv: bool,
    as_json: bool,
    raw: bool,
    with_info: bool,
    no_arr: bool,
    no_str: bool,
    truncate_length: int,
    full_length: bool,
    clear: bool,
) -> None:
    """Print the messages of TOPIC in YAML.

    TYPE, such as Pose or package.module:Name, is optional; it is an error if other nodes announce
    another type. Messages of the types in tfbus.messages are checked. The transforms of one stream
    are on the topics tf/STREAM and tf_static/STREAM, those of all streams on tf and tf_static.
    With --bag, print those of a recording. Of a cloud, an image or a map the data are a summary,
    unless in CSV or JSON, or with --field.
    """
    if as_csv + as_json + raw > 1:
        raise click.UsageError("--csv, --json and --raw are mutually exclusive: give one")
    if raw and (field or expression):
        raise click.UsageError("--raw has bytes, without fields: omit --field and --filter")
    if with_info and (as_csv or as_json or raw):
        raise click.UsageError("-i is a comment in YAML: omit --csv, --json and --raw")
    shortening = Shortening(None if full_length else truncate_length, not no_arr, not no_str)
    form = _Form("csv" if as_csv else "json" if as_json else "yaml", field, shortening, with_info)
    wanted = MessageFilter(expression) if expression else None
    if bag is not None:
        if raw or timeout_s is not None:
            raise click.UsageError("--raw and --timeout are of a bus: omit them with --bag")
        _echo_recorded(bag, full_topic(topic, settings), form, wanted, once=once)
        return
    topic = relative(topic, settings.namespace)
    with visiting(settings, "echo", goes_on=not once) as node:
        graph = look(node.session)
        type_name = _type_name(type_of(graph, topic), topic, type_text)
        retained = may_be_retained(graph, topic)
        with Inbox(node, topic, type_name, timeout_s=timeout_s, retained=retained) as inbox:
            if raw:
                texts: Iterable[str] = (arrival.payload.hex() for arrival in inbox)
            else:
                read = _read(node, topic, type_name, inbox)
                texts = (form.text(a, m) for a, m in read if wanted is None or wanted.takes(m))
            for text in texts:
                if clear and is_terminal():
                    click.clear()
                print_text(text)
                if once:
                    return
        if once:
            raise KeyboardInterrupt


def _echo_recorded(
    bag: BagChoice, topic: str, form: _Form, wanted: MessageFilter | None, *, once: bool
) -> None:
    with bag.opened() as recording:
        printed = 0
        for message in messages_of(recording, topic):
            if wanted is None or wanted.takes(message.values):
                printed += 1
                print_text(form.text(Arrival(b"", message.received_ns), message.values))
                if once:
                    return
        if not printed:
            raise click.ClickException(
                f"no such message of {topic!r} in the recording, or in that span of it"
            )


def _read(
    node: "Node", topic: str, type_name: str, arrivals: Iterable[Arrival]
) -> Iterator[tuple[Arrival, dict[str, Any]]]:
    """The messages as maps; invalid ones are skipped, with one warning."""
    read: Reader | None = None
    rejected = 0
    for arrival in arrivals:
        if read is None:  # its publisher is known by now, and announces the type
            read = reader_of(type_of(look(node.session), topic) or type_name)
        try:
            yield arrival, read(arrival.payload)
        except DecodeError as error:
            rejected += 1
            if rejected == 1:
                warn(f"skipped a message of {topic!r}: {error} (warned once)")
