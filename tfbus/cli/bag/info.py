"""`tfbus bag info`: the contents of a recording."""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from tfbus.base.wording import and_more, columns, counted, cut, duration, natural_order, printable
from tfbus.cli.bag.files import RECORDING
from tfbus.cli.output import (
    json_option,
    many,
    paint,
    print_json,
    print_lines,
    table,
    width,
    with_transforms,
)
from tfbus.command.recordings import open_recording
from tfbus.frames.track import least_gap_s
from tfbus.recording.items import EventItem, EventKind
from tfbus.recording.layout import CUSTOM
from tfbus.recording.reader import topics_of
from tfbus.recording.summary import Flow, RecordedStreamFacts, Summary, TopicFacts, summary_of
from tfbus.wire.limits import size_text

_S = 1_000_000_000
_LABEL = 10

# All messages of a recording are read, to find damaged parts, if they have at most this number of
# bytes: that takes some seconds.
_CHECKED_BYTES = 2 * 10**9

# Of the damaged parts at most this number is listed.
_MOST_DAMAGE = 10

# Of the nodes at most this number is named.
_MOST_NODES = 30

# The names of the kinds of events.
_EVENTS: dict[EventKind, str] = {
    "stream": "stream description",
    "stream gone": "lost stream",
    "node": "node description",
    "node gone": "lost node",
    "paused": "pause",
    "resumed": "resumption",
    "dropped": "overload",
    "filled": "filled gap",
}

# How streams and topics are sorted, by the names of `ros2 bag info --sort`.
_ORDERS: dict[str, tuple[Callable[[RecordedStreamFacts], Any], Callable[[TopicFacts], Any]]] = {
    "name": (lambda it: natural_order(it.name), lambda it: natural_order(it.name)),
    "type": (lambda it: natural_order(it.node), lambda it: (_type_of(it), natural_order(it.name))),
    "count": (lambda it: -it.flow.messages, lambda it: -it.flow.messages),
}

# Of the pauses at most this number is listed.
_MOST_PAUSES = 10

# Of the events at most this number is listed.
_MOST_EVENTS = 200


@click.command(
    epilog="Examples: tfbus bag info run.mcap; tfbus bag info -v run.mcap; "
    "tfbus bag info --json run.mcap | jq .streams"
)
@click.argument(
    "files",
    metavar="FILE...",
    nargs=-1,
    required=True,
    type=RECORDING,
)
@click.option(
    "-v", "--verbose", is_flag=True, help="Add the frames of each stream, tools, and all events."
)
@click.option(
    "-t", "--topic-name", "names_only", is_flag=True, help="Print only the names of the topics."
)
@click.option(
    "--sort",
    "order",
    type=click.Choice(list(_ORDERS)),
    default="name",
    show_default=True,
    help="The order of streams and topics.",
)
@click.option(
    "--check/--no-check",
    default=None,
    help="Read all messages, to find what is damaged (default: of up to 2 GB of messages).",
)
@json_option("Print one JSON object: times in nanoseconds, all frames and events.")
def command(
    files: tuple[Path, ...],
    verbose: bool,
    names_only: bool,
    order: str,
    check: bool | None,
    as_json: bool,
) -> None:
    """Show what is in a recording: streams, rates, gaps, static transforms, topics, events.

    Several files, or a folder of them, are one recording.
    """
    with open_recording(*files, says_damage=False) as reader:
        if names_only:
            print_lines(topics_of(reader))
            return
        if check is None:
            check = sum(chunk.chunk.size for chunk in reader.chunks) <= _CHECKED_BYTES
        if check:
            reader.check()
        summary = replace(_sorted(summary_of(reader), order), is_checked=check)
    if as_json:
        print_json(_as_map(summary))
        return
    print_lines(_head(summary))
    print_lines(_streams(summary))
    if verbose:
        print_lines(_frames(summary))
    print_lines(_topics(summary))
    print_lines(_nodes(summary, has_tools=verbose))
    print_lines(_events(summary, verbose))


def _sorted(summary: Summary, order: str) -> Summary:
    of_stream, of_topic = _ORDERS[order]
    return replace(
        summary,
        streams=tuple(sorted(summary.streams, key=of_stream)),
        topics=tuple(sorted(summary.topics, key=of_topic)),
    )


def _as_map(summary: Summary) -> dict[str, Any]:
    facts = asdict(summary)
    facts["duration_s"] = summary.duration_s
    facts["recorded_s"] = summary.recorded_s
    facts["size"] = summary.size
    facts["is_complete"] = summary.is_complete
    facts["messages"] = summary.messages
    for row, stream in zip(facts["streams"], summary.streams, strict=True):
        row["restarts"] = stream.restarts
    return facts


def _head(summary: Summary) -> Iterator[str]:
    for file in summary.files:
        state = paint("complete", "good") if file.is_complete else paint("cut short", "warning")
        if file.is_growing:
            state = "being written"
        if file.damage and file.is_complete:
            state = paint("damaged", "bad")
        elif file.damage:
            state += f" and {paint('damaged', 'bad')}"
        elif not summary.is_checked:
            state += ", not checked for damage"
        yield _line("File", f"{printable(file.path)} ({size_text(file.size)}, {state})")
        lost = [each.text(summary.start_ns) for each in file.damage[:_MOST_DAMAGE]]
        if len(file.damage) > _MOST_DAMAGE:
            lost.append(and_more(len(file.damage), _MOST_DAMAGE))
        yield from _lines("Damaged", lost) if lost else ()
    if len(summary.files) > 1:
        yield _line("Size", f"{size_text(summary.size)} in {len(summary.files)} files")
    recorded = f" ({duration(summary.recorded_s)} recorded)" if summary.pauses else ""
    yield _line("Duration", f"{duration(summary.duration_s)}{recorded}")
    yield _line("Start", _moment(summary.start_ns))
    yield _line("End", _moment(summary.end_ns))
    transforms = sum(stream.transforms for stream in summary.streams)
    statics = sum(len(stream.static_frames) for stream in summary.streams)
    yield _line("Messages", with_transforms(f"{summary.messages:,}", transforms, statics))
    said = [f"tfbus {summary.about['version']}"] if "version" in summary.about else []
    said += [f"on {summary.about['host']}"] if "host" in summary.about else []
    if said and ("host" in summary.about or "edited" not in summary.about):
        yield _line("Recorder", " ".join(said))
    noted = [
        f"{key.removeprefix(CUSTOM)}={value}"
        for key, value in summary.about.items()
        if key.startswith(CUSTOM)
    ]
    if noted:
        yield from _lines("Noted", [printable(each) for each in noted])
    yield from _pauses(summary)
    for label, name in (("Edited", "edited"), ("Lost", "lost")):
        if name in summary.about:
            yield from _lines(label, summary.about[name].split(", "))
    if summary.dropped:
        what = f"{many(summary.dropped, 'message')} dropped while recording"
        yield _line("Lost", paint(what, "bad"))


def _pauses(summary: Summary) -> Iterator[str]:
    """When nothing was recorded: `+10.000s to +310.000s (5 min, paused)`, one per line."""
    label = "Pauses"
    for pause in summary.pauses[:_MOST_PAUSES]:
        from_s, to_s = ((each - summary.start_ns) / _S for each in (pause.from_ns, pause.to_ns))
        text = f"{from_s:+.3f}s to {to_s:+.3f}s ({duration(to_s - from_s)}, {pause.why})"
        yield _line(label, text) if label else f"{' ' * _LABEL} {text}"
        label = ""
    if len(summary.pauses) > _MOST_PAUSES:
        yield f"{' ' * _LABEL} {and_more(len(summary.pauses), _MOST_PAUSES)} (--json has all)"


def _line(label: str, text: str) -> str:
    return f"{paint(f'{label}:'.ljust(_LABEL), 'heading')} {text}"


def _lines(label: str, words: list[str]) -> Iterator[str]:
    """The words with commas, below each other if a line has no room for more."""
    room = min(width(), 100) - _LABEL - 1
    lines = [""]
    for word in words:
        joined = f"{lines[-1]}, {word}" if lines[-1] else word
        if lines[-1] and columns(click.unstyle(joined)) > room - 1:
            lines[-1] += ","
            lines.append(word)
        else:
            lines[-1] = joined
    yield _line(label, lines[0])
    yield from (f"{' ' * _LABEL} {line}" for line in lines[1:])


def _moment(stamp_ns: int) -> str:
    """Local time and UTC: `2026-11-22 12:03:05.100 (11:03:05 UTC)`."""
    try:
        local = datetime.fromtimestamp(stamp_ns // _S)
        utc = datetime.fromtimestamp(stamp_ns // _S, UTC)
    except (OverflowError, OSError, ValueError):
        return f"{stamp_ns / _S:.3f}"
    day = "" if utc.date() == local.date() else f"{utc:%Y-%m-%d} "
    milliseconds = stamp_ns % _S // 1_000_000
    return f"{local:%Y-%m-%d %H:%M:%S}.{milliseconds:03} ({day}{utc:%H:%M:%S} UTC)"


def _streams(summary: Summary) -> Iterator[str]:
    if not summary.streams:
        return
    yield ""
    # Without restarts that column has nothing to say, and others need the room.
    restarts = any(stream.restarts for stream in summary.streams)
    header = ["STREAM", "NODE", "FRAMES", "STATIC", "MESSAGES", "HZ", "LONGEST GAP"]
    yield from table(
        [*header, "RESTARTS"] if restarts else header,
        [
            [
                paint(stream.name, "name") + (paint(" gone", "bad") if _is_gone(stream) else ""),
                stream.node or "-",
                str(len(stream.frames)),
                str(len(stream.static_frames) or "-"),
                f"{stream.flow.messages:,}",
                _rate(stream.flow),
                _gap(stream.flow, summary),
                *([_restarts(stream)] if restarts else []),
            ]
            for stream in summary.streams
        ],
        right=(2, 3, 4, 5, 7),
    )


def _restarts(stream: RecordedStreamFacts) -> str:
    return paint(str(stream.restarts), "warning") if stream.restarts else "-"


def _is_gone(stream: RecordedStreamFacts) -> bool:
    return stream.gone_ns is not None


def _rate(flow: Flow) -> str:
    if flow.rate is None:
        return "-"
    return f"{flow.rate:.3g}" if flow.rate < 100 else f"{flow.rate:,.0f}"


def _gap(flow: Flow, summary: Summary) -> str:
    """The longest time without a message and, if it is a gap, its begin: `2.3 s at +31.2s`."""
    if flow.longest_gap_s is None or flow.gap_from_ns is None:
        return "-"
    if flow.period_s is None or flow.longest_gap_s <= least_gap_s(flow.period_s):
        return duration(flow.longest_gap_s)
    begins_s = (flow.gap_from_ns - summary.start_ns) * 1e-9
    return f"{duration(flow.longest_gap_s)} at +{begins_s:.1f}s"


def _topics(summary: Summary) -> Iterator[str]:
    if not summary.topics:
        return
    yield ""
    yield from table(
        ["TOPIC", "TYPE", "MESSAGES", "HZ", "LONGEST GAP"],
        [
            [
                paint(topic.name, "name"),
                paint(_type_of(topic) or "?", "type")
                + ("" if topic.is_readable else paint(" (not read by tfbus)", "warning")),
                f"{topic.flow.messages:,}",
                _rate(topic.flow),
                _gap(topic.flow, summary),
            ]
            for topic in summary.topics
        ],
        right=(2, 3),
    )


def _type_of(topic: TopicFacts) -> str:
    """The name of its type as ROS has it, as `ros2 bag info` prints it too; "" if not known."""
    return topic.type_name if "/" in topic.type_name else topic.type_name and topic.ros_type


def _nodes(summary: Summary, *, has_tools: bool) -> Iterator[str]:
    """The nodes; tools, whose names begin with `_`, came for a moment, to look."""
    names = [
        f"{node.name} {paint('gone', 'bad')}" if node.is_gone else node.name
        for node in summary.nodes
        if has_tools or not node.name.rpartition("/")[2].startswith("_")
    ]
    if names:
        yield ""
        yield from _lines("Nodes", names[:_MOST_NODES])
        if len(names) > _MOST_NODES:
            yield f"{' ' * _LABEL} {and_more(len(names), _MOST_NODES)}"


def _frames(summary: Summary) -> Iterator[str]:
    for stream in summary.streams:
        for title, frames in (("frames", stream.frames), ("static", stream.static_frames)):
            if frames:
                yield ""
                yield paint(f"{title.capitalize()} of {stream.name}", "heading")
                yield from _wrapped(frames)


def _wrapped(words: tuple[str, ...]) -> Iterator[str]:
    line = ""
    for word in words:
        word = cut(word, 60)
        if line and len(line) + 2 + len(word) > min(width(), 100) - 2:
            yield f"  {line}"
            line = ""
        line = f"{line}  {word}" if line else word
    yield f"  {line}"


def _events(summary: Summary, verbose: bool) -> Iterator[str]:
    if not summary.events:
        return
    yield ""
    kinds = Counter(event.kind for event in summary.events)
    yield from _lines("Events", [many(kinds[kind], _EVENTS[kind]) for kind in kinds])
    if verbose:
        for event in summary.events[:_MOST_EVENTS]:
            yield f"  {_event(event, summary)}".rstrip()
        if len(summary.events) > _MOST_EVENTS:
            yield f"  … {len(summary.events) - _MOST_EVENTS} more (--json has all)"


def _event(event: EventItem, summary: Summary) -> str:
    at = f"+{(event.log_ns - summary.start_ns) * 1e-9:.3f}s"
    told = ""
    frames = event.facts.get("frames")
    if event.kind == "stream" and isinstance(frames, (list, tuple)):
        told = f"({counted(len(frames), 'frame')})"
    if event.kind in ("dropped", "filled"):
        told = f"{event.facts.get('messages')} messages"
        if isinstance(until_ns := event.facts.get("until"), int):
            told = f"to +{(until_ns - summary.start_ns) * 1e-9:.3f}s, {told}"
        told = f"({told})"
    return f"{at:>12}  {event.kind:<11}  {cut(printable(event.name), 40)}  {told}"
