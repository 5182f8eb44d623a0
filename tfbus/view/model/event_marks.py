"""The marks of a timeline that the events of a recording give."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from tfbus.recording.items import EventItem
from tfbus.view.model.timeline import Mark
from tfbus.wording import counted, duration, listed, printable

_MOST_NAMED = 3


@dataclass
class _Stream:
    """A stream as its events described it last; `gone_ns` is since when it is gone."""

    epoch: int
    publisher: str
    children: frozenset[str]
    gone_ns: int | None = None


@dataclass
class _Sweep:
    """The open events while they pass by."""

    streams: dict[str, _Stream] = field(default_factory=dict)
    # By frame, the living streams that list it.
    claims: dict[str, set[str]] = field(default_factory=dict)
    # By pair of streams: since when, and the frames that both list.
    conflicts: dict[tuple[str, str], tuple[int, frozenset[str]]] = field(default_factory=dict)
    paused_ns: int | None = None


def marks_of_events(events: Iterable[EventItem], end_ns: int) -> Iterator[Mark]:
    """The marks of events, which come by their times; what lasts at the end lasts to `end_ns`."""
    sweep = _Sweep()
    for event in events:
        yield from _of_event(sweep, event)
    yield from _still_open(sweep, end_ns)


def _of_event(sweep: _Sweep, event: EventItem) -> Iterator[Mark]:
    at_ns = event.log_ns
    match event.kind:
        case "stream":
            yield from _described(sweep, event)
        case "stream gone":
            stream = sweep.streams.get(event.name)
            if stream is not None and stream.gone_ns is None:
                stream.gone_ns = at_ns
                yield from _claim(sweep, event.name, stream.children, frozenset(), at_ns)
        case "paused":
            sweep.paused_ns = at_ns if sweep.paused_ns is None else sweep.paused_ns
        case "resumed" if sweep.paused_ns is not None:
            yield _paused(sweep.paused_ns, at_ns)
            sweep.paused_ns = None
        case "dropped":
            lost = counted(event.dropped, "message") if event.dropped else "messages"
            yield Mark("dropped", at_ns, at_ns, f"{lost} not recorded: the recorder was too slow")


def _described(sweep: _Sweep, event: EventItem) -> Iterator[Mark]:
    at_ns, name = event.log_ns, event.name
    now = _Stream(_epoch(event.facts), _publisher(event.facts), _children(event.facts))
    former = sweep.streams.get(name)
    if former is not None:
        restarted = bool(former.epoch and now.epoch > former.epoch)
        if former.gone_ns is not None:
            yield _gone(name, former, former.gone_ns, at_ns)
            ago = duration((at_ns - former.gone_ns) / 1e9)
            how = ", restarted" if restarted else ""
            yield Mark("back", at_ns, at_ns, f"back after {ago}{how}", (name,))
        elif restarted:
            yield Mark("restart", at_ns, at_ns, "restarted", (name,), now.publisher)
    sweep.streams[name] = now
    listed_before = former.children if former else frozenset()
    yield from _claim(sweep, name, listed_before, now.children, at_ns)


def _claim(
    sweep: _Sweep, name: str, former: frozenset[str], children: frozenset[str], at_ns: int
) -> Iterator[Mark]:
    """The stream lists these frames from now on in the place of the former, none if it is gone.

    Yields the conflicts that end with that.
    """
    for child in former:
        sweep.claims.get(child, set()).discard(name)
    shared: dict[str, set[str]] = {}
    for child in children:
        names = sweep.claims.setdefault(child, set())
        for other in names:
            shared.setdefault(other, set()).add(child)
        names.add(name)
    open_now = {_pair(name, other): frozenset(frames) for other, frames in shared.items()}
    for pair in [pair for pair in sweep.conflicts if name in pair]:
        since_ns, frames = sweep.conflicts[pair]
        if open_now.get(pair) != frames:
            del sweep.conflicts[pair]
            yield _conflict(pair, frames, since_ns, at_ns)
    for pair, frames in open_now.items():
        sweep.conflicts.setdefault(pair, (at_ns, frames))


def _still_open(sweep: _Sweep, end_ns: int) -> Iterator[Mark]:
    for name, stream in sweep.streams.items():
        if stream.gone_ns is not None:
            yield _gone(name, stream, stream.gone_ns, end_ns)
    for pair, (since_ns, frames) in sweep.conflicts.items():
        yield _conflict(pair, frames, since_ns, end_ns)
    if sweep.paused_ns is not None:
        yield _paused(sweep.paused_ns, end_ns)


def _gone(name: str, stream: _Stream, since_ns: int, until_ns: int) -> Mark:
    return Mark("gone", since_ns, until_ns, "gone", (name,), stream.publisher)


def _conflict(pair: tuple[str, str], frames: frozenset[str], since_ns: int, until_ns: int) -> Mark:
    what = listed([_quoted(frame) for frame in sorted(frames)], most=_MOST_NAMED)
    text = f"{what} published by {_quoted(pair[0])} and {_quoted(pair[1])}"
    return Mark("conflict", since_ns, until_ns, text)


def _paused(since_ns: int, until_ns: int) -> Mark:
    text = f"recording paused for {duration((until_ns - since_ns) / 1e9)}"
    return Mark("paused", since_ns, until_ns, text)


def _pair(one: str, other: str) -> tuple[str, str]:
    return (one, other) if one < other else (other, one)


def _quoted(name: str) -> str:
    return f"'{printable(name)}'"


# Facts come from a file: nothing of them is as it should be until it was looked at.


def _epoch(facts: Mapping[str, Any]) -> int:
    epoch = facts.get("epoch")
    return epoch if isinstance(epoch, int) else 0


def _publisher(facts: Mapping[str, Any]) -> str:
    node, host, pid = (facts.get(name) for name in ("node", "host", "pid"))
    if not node:
        return ""
    return f": {printable(str(node))} on {printable(str(host or '?'))}, pid {printable(str(pid))}"


def _children(facts: Mapping[str, Any]) -> frozenset[str]:
    rows = facts.get("frames")
    if not isinstance(rows, list | tuple):
        return frozenset()
    return frozenset(
        row[1]
        for row in rows
        if isinstance(row, list | tuple) and len(row) > 1 and isinstance(row[1], str)
    )
