"""The frames at a moment of a recording, as a listener would have known them.

Messages, tokens and descriptions are judged by the same code as on a bus, so that frames are gone,
stale or in conflict as they were then. A moment is a log time. The delays, and so the stale frames,
are by the log times too: it makes no difference when the recording is looked at.
"""

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from heapq import merge
from operator import attrgetter
from typing import TYPE_CHECKING

from tfbus.base.errors import DecodeError
from tfbus.base.wording import is_printable, printable
from tfbus.buffer.buffer import Buffer
from tfbus.bus.graph import where_to_look
from tfbus.frames.clocks import (
    NOT_SIMULATED,
    RecordedClock,
    SimulatedTime,
    clock_topic,
    follows_clock,
    simulated_time,
)
from tfbus.frames.moment import BusMoment, key_of_stream
from tfbus.frames.snapshot import FrameTree, frame_tree
from tfbus.geometry.sampling import TF2, Sampling
from tfbus.recording.items import (
    ALL,
    EventItem,
    Item,
    Pause,
    RecordedStream,
    Selection,
    TopicItem,
    TransformItem,
    Viewpoint,
)
from tfbus.recording.state import BusState, LastingStatics, Statics
from tfbus.streams.conflicts import Conflicts
from tfbus.streams.info import StreamInfo, StreamState
from tfbus.streams.reception import DynamicReception, StreamReception
from tfbus.streams.stream_facts import ReceptionHooks
from tfbus.wire.codec import from_map
from tfbus.wire.descriptions import NodeDescription, StreamDescription
from tfbus.wire.fleet import Fleet, FrameNames
from tfbus.wire.transforms import TransformMessage, TransformReader

if TYPE_CHECKING:
    from tfbus.recording.reader import RecordingReader

S = 1_000_000_000

# The next sample of a frame is looked for in this time.
_MOST_AHEAD_S = 1200


@dataclass(frozen=True)
class Tick:
    """A log time between the items of a recording that is played."""

    log_ns: int


class RecordedFrames:
    """The frames of a recording as a listener in `namespace`, or with a `fleet`, had them.

    `seek` goes to a moment, `advance` on to a later one; before the first there is nothing.
    `sim_time` is whether ages are by the simulated time that was recorded; None: if all
    publishers followed it. With `statics` "always" static transforms are there before they came.
    `view` is in the place of a namespace and fleet; `buffer` in that of a new one for each `seek`.
    """

    def __init__(
        self,
        source: "RecordingReader",
        *,
        namespace: str = "",
        fleet: Fleet | None = None,
        cache_time_s: float = 10.0,
        sim_time: bool | None = None,
        statics: "Statics" = "then",
        sampling: Sampling = TF2,
        view: Viewpoint | None = None,
        buffer: Buffer | None = None,
    ) -> None:
        self.dropped = 0
        self._source = source
        self._statics: Statics = statics
        self._events = source.events
        self.pauses = source.pauses
        self._view = view or Viewpoint(namespace or _only_namespace(source, fleet), fleet)
        self._cache_time_s = cache_time_s
        self._sampling: Sampling = sampling
        self._given_buffer = buffer
        self._described = {each.name for each in self._events if each.kind == "stream"}
        nodes = map(_node_of, self._events)
        follows = follows_clock(filter(None, nodes)) if sim_time is None else sim_time
        self._follows_clock = follows
        self._selection = self._make_selection()
        self._at_ns = source.start_ns
        # The moment that `advance` reached, the next item, and the iterator of later ones.
        self._ahead: tuple[int, Item | None, Iterator[Item]] | None = None
        self._start()

    @cached_property
    def _lasting(self) -> "LastingStatics | None":
        return LastingStatics(self._source.first_statics()) if self._statics == "always" else None

    @property
    def namespace(self) -> str:
        """The namespace that they are seen from, "" for none."""
        return self._view.namespace

    def _make_selection(self) -> Selection:
        """The streams, and the clock if that is followed; no other topics."""
        names = {channel.stream.name for channel in self._source.streams} | self._described
        topics = (clock_topic(self._view.namespace),) if self._follows_clock else ()
        # Without streams and topics it would take everything.
        return Selection(topics=topics, streams=tuple(sorted(names)) or ("",))

    def _start(self) -> None:
        given = self._given_buffer
        self.buffer = given or Buffer(self._cache_time_s, sampling=self._sampling)
        self.buffer.clock = self._clock = RecordedClock(follows=self._follows_clock)
        self._streams: dict[str, _HeardStream] = {}
        self._conflicts = Conflicts("latest", self.buffer, self._described_reception, _SILENT)
        self._around = _RecordedHooks(self._conflicts, self._described_reception)
        self._full_names: dict[str, _HeardStream] = {}
        # The static sets in force, which files repeat.
        self._in_force = BusState()
        # The recorder was: what does not come may have been sent.
        self._pause: Pause | None = None
        self._nodes: dict[str, NodeDescription] = {}
        # The streams that are not seen from here, by the keys of their descriptions.
        self._elsewhere: dict[str, StreamDescription] = {}

    # Moments

    def seek(self, at_ns: int) -> None:
        """Go to a log time. `buffer` is another one from then on."""
        from_ns = at_ns - int(self._cache_time_s * S)
        before: list[Item] = [event for event in self._events if event.log_ns < from_ns]
        statics = self._source.state_at(from_ns - 1, self._selection).statics
        if self._lasting is not None:
            before += self._lasting.with_later(statics, from_ns - 1)
        else:
            before += statics
        before.sort(key=_log_ns)
        span = list(self._items(from_ns, at_ns))
        self._go_through(before, span, at_ns)
        if past := self._last_of_the_silent(from_ns):
            self._go_through(sorted([*before, *past], key=_log_ns), span, at_ns)

    def _go_through(self, before: Iterable[Item], span: Iterable[Item], at_ns: int) -> None:
        self._start()
        for item in before:
            self.apply(item)
        # Of the time before only the last messages were read: between them none is missing.
        for stream in self._streams.values():
            stream.expect_any_number()
            stream.reception.counts.missed = 0
        for item in span:
            self.apply(item)
        self.pass_time(at_ns)

    def hear(self, from_ns: int | None, to_ns: int | None, selection: Selection = ALL) -> None:
        """Be a listener that began at one log time and ended after another. `buffer` is another one
        from then on, with the transforms that were in force at the beginning.
        """
        before = [] if from_ns is None else self._source.state_at(from_ns, selection).items(from_ns)
        self._go_through(before, self._source.items(from_ns, to_ns, selection), self.end_ns)

    def count_from_now(self) -> None:
        """Count messages of streams, and missed ones, from now on only."""
        for stream in self._streams.values():
            counts = stream.reception.counts
            counts.messages = counts.transforms = counts.missed = counts.outdated = 0

    def advance(self, to_ns: int) -> None:
        """Go on to a later log time; to an earlier one as `seek`."""
        if to_ns < self._at_ns:
            self.seek(to_ns)
            return
        ahead, self._ahead = self._ahead, None
        if ahead is None or ahead[0] != self._at_ns:
            items = self._source.items(self._at_ns + 1, None, self._selection)
            item = next(items, None)
        else:
            _, item, items = ahead
        while item is not None and item.log_ns <= to_ns:
            self.apply(item)
            item = next(items, None)
        self.pass_time(to_ns)
        # To begin again costs a chunk each time.
        self._ahead = to_ns, item, items

    def play(self, to_ns: int, every_ns: int | None = None) -> Iterator[Item | Tick]:
        """Go on to a later log time; yields each item when it has been taken. Streams and frames in
        it are called as here, and left out if they are not seen from here. With `every_ns`
        it yields a Tick whenever so much time has passed, with the frames as they are then.
        """
        ticks = range(self._at_ns + every_ns, to_ns, every_ns) if every_ns else ()
        items: Iterable[Item | Tick] = self._items(self._at_ns + 1, to_ns)
        # At the same time an item comes before a tick.
        for each in merge(items, map(Tick, ticks), key=attrgetter("log_ns")):
            if isinstance(each, Tick):
                self.pass_time(each.log_ns)
                yield each
            elif (taken := self.apply(each)) is not None:
                yield taken
        self.pass_time(to_ns)

    def pass_time(self, at_ns: int) -> None:
        """Go on to a later log time, before which there is no item."""
        self._at_ns = self._clock.log_ns = at_ns

    def _items(self, from_ns: int, to_ns: int) -> Iterator[Item]:
        """The items from one log time to another, both included."""
        return self._source.items(from_ns, to_ns, self._selection)

    def _last_of_the_silent(self, before_ns: int) -> list[Item]:
        """The last messages of frames that are listed, or were, and of which there is none, or none
        of this stream where several list one: the last to send counts, and may have removed it.
        """
        found: list[Item] = []
        sought: set[str] = set()
        claims = Counter(child for each in self._streams.values() for _, child, _ in each.claims)
        for name, stream in self._streams.items():
            missing = stream.listed - self._placed()
            contested = {
                child for _, child, static in stream.claims if claims[child] > 1 and not static
            }
            missing |= contested - self.buffer.sent_by(name).keys()
            if missing:
                end_ns = before_ns if stream.gone_ns is None else min(before_ns, stream.gone_ns + S)
                found += self._last_messages(stream.full_name or name, missing, end_ns)
                sought |= missing
        for stream in self._streams.values():
            for frame in sought & stream.removed_ns.keys():
                found += self._last_before_removal(stream, frame, before_ns)
        return found

    def _last_before_removal(
        self, stream: "_HeardStream", frame: str, before_ns: int
    ) -> Iterator[Item]:
        """The last messages of a stream about a frame that it has removed: if they are newer than
        the ones of others, it had taken the frame over.
        """
        removed_ns = stream.removed_ns[frame]
        yield from self._last_messages(stream.full_name, {frame}, min(before_ns, removed_ns + S))
        if removed_ns < before_ns:
            chosen, at_ns = Selection(streams=(stream.full_name,)), removed_ns
            while sets := self._source.state_at(at_ns, chosen).statics:
                for item in sets:
                    if frame in self._children(item):
                        yield item
                        return
                at_ns = max(item.log_ns for item in sets) - 1

    def _placed(self) -> set[str]:
        """The frames that have a place in another one: a parent is known before it has one."""
        return {frame.name for frame in self.buffer.all_frames() if frame.parent is not None}

    def _last_messages(self, name: str, missing: set[str], end_ns: int) -> list[Item]:
        """The last messages of a stream before a time that have these frames, of each a cache's
        time of them.
        """
        keeps_ns = int(self._cache_time_s * S)
        chosen = Selection(streams=(name,))
        found: dict[int, Item] = {}
        seeking = [(missing, end_ns)]
        while seeking:
            sought, before_ns = seeking.pop()
            chunks: dict[tuple[int, int], set[str]] = {}
            last = self._source.last_chunks(name, self._outside_of(name), sought, before_ns)
            for frame, span in last.items():
                chunks.setdefault(span, set()).add(frame)
            for (from_ns, to_ns), frames in sorted(chunks.items()):
                last_ns = min(to_ns, before_ns - 1)
                part = [
                    (item, frames & self._children(item))
                    for item in self._source.items(from_ns - keeps_ns, last_ns, chosen)
                    if isinstance(item, TransformItem)
                ]
                newest_ns = {frame: item.log_ns for item, those in part for frame in those}
                found |= {
                    id(item): item
                    for item, those in part
                    if any(item.log_ns > newest_ns[frame] - keeps_ns for frame in those)
                }
                if later := frames - newest_ns.keys():  # the chunk has theirs after that time
                    seeking.append((later, from_ns))
        return list(found.values())

    def _outside_of(self, name: str) -> Callable[[str], str]:
        """How the frames of a stream are called here."""
        namespaces = [
            channel.stream.namespace
            for channel in self._source.streams
            if channel.stream.name == name
        ]
        return self._view.names(namespaces[0] if namespaces else "").outside

    # Items

    def apply(self, item: Item) -> Item | None:
        """Apply the next item; it, as it is called here, None if it is not seen from here."""
        self._clock.log_ns = item.log_ns
        if isinstance(item, TransformItem):
            return self._apply_transforms(item)
        if isinstance(item, EventItem):
            self._apply_event(item)
        elif isinstance(item, TopicItem) and self._clock.set_by(item, self._view.namespace):
            # The clock was set back: transforms in its future have not happened.
            self.buffer.clear(after_ns=self._clock.now_ns())
        return item

    def _apply_transforms(self, item: TransformItem) -> TransformItem | None:
        name = self._view.called(item.stream.name, item.stream.namespace)
        if name is None or not is_printable(name):
            return None  # no listener takes a stream whose name cannot be shown
        if item.static:
            if self._in_force.says(item):
                return None
            self._in_force.apply(item)
        if item.static and self._lasting is not None:
            item = self._lasting.widened(item)
        stream = self._streams.get(name) or self._meet(name, item.stream.name)
        names = self._names(item.stream)
        called = names.all_outside(item.rows.frames)
        rows = item.rows if called is item.rows.frames else item.rows.with_frames(called)
        message = TransformMessage(rows, item.stream.epoch_ns, item.seq)
        if item.stream.name not in self._described:
            stream.describe_by(item, rows.pairs(), rows.frames)
        if item.static:
            stream.reception.statics.accept(message, item.log_ns)
        else:
            key = rows.frames[rows.pairs()[0][1]] if item.stream.split and rows.count else ""
            stream.key(key).take_recorded(message, item.log_ns)
        if rows is item.rows and name == item.stream.name:
            return item
        return replace(item, stream=replace(item.stream, name=name), rows=rows)

    def _apply_event(self, event: EventItem) -> None:
        if event.kind == "node":
            node = _node_of(event)
            if node is not None:
                self._nodes[event.name] = node
        elif event.kind == "node gone":
            self._nodes.pop(event.name, None)
        elif event.kind in ("stream", "stream gone"):
            namespace = _namespace_of(event)
            known = self._full_names.get(event.name)
            name = self._view.called(event.name, namespace)
            if known is None and event.kind == "stream" and name and is_printable(name):
                known = self._meet(name, event.name)
            description = None if name else _description_of(event)
            key = key_of_stream(event.name, namespace)
            if description is not None and event.kind == "stream":
                self._elsewhere[key] = description
            else:
                self._elsewhere.pop(key, None)
            if known is not None:
                known.take_event(event, self._view.names(namespace))
                description = known.state.description if known.state.alive else None
                self._conflicts.judge(known.state.name, description)
        elif event.kind == "paused":
            self._pause = self._pause or self._pause_at(event.log_ns)
        elif event.kind == "resumed" and self._pause is not None:
            self.buffer.interrupt(self.said(self._pause))
            self._pause = None
            for stream in self._streams.values():
                stream.expect_any_number()

    def _pause_at(self, log_ns: int) -> Pause | None:
        return next((each for each in self.pauses if each.from_ns == log_ns), None)

    def _meet(self, name: str, full_name: str) -> "_HeardStream":
        reception = StreamReception(
            *(name, self.buffer, _SILENT, self._clock.now_ns, _READER),
            around=self._around,
            now_s=self._clock.log_s,
        )
        stream = _HeardStream(reception, StreamState(name), full_name)
        self._streams[name] = self._full_names[full_name] = stream
        return stream

    def _described_reception(self, name: str) -> StreamReception | None:
        """The reception of a stream whose lists of frames were recorded: only such a stream can be
        right or wrong to have a frame.
        """
        stream = self._streams.get(name)
        known = stream is not None and stream.full_name in self._described
        return stream.reception if stream is not None and known else None

    def _names(self, stream: RecordedStream) -> FrameNames:
        return self._view.names(stream.namespace)

    def _children(self, item: TransformItem) -> frozenset[str]:
        return frozenset(map(self._names(item.stream).outside, item.rows.children()))

    # The state at the moment

    def now_ns(self) -> int:
        """The moment; by the simulated clock if that is followed."""
        return self._clock.now_ns()

    @property
    def follows_clock(self) -> bool:
        """Whether the time is the simulated one that was recorded, if there is one."""
        return self._follows_clock

    def epoch_ns(self, stream: str) -> int | None:
        """The epoch that counts of a stream, by its full name; None before its first message."""
        known = self._full_names.get(stream)
        return None if known is None else known.reception.epoch_ns

    @property
    def source(self) -> "RecordingReader":
        """The files."""
        return self._source

    @property
    def statics(self) -> "Statics":
        """The static transforms that are known at a moment."""
        return self._statics

    @property
    def viewpoint(self) -> Viewpoint:
        """The seen streams, and the names of their frames."""
        return self._view

    @property
    def at_ns(self) -> int:
        """The moment as a log time."""
        return self._at_ns

    @property
    def start_ns(self) -> int:
        """The beginning of the recording."""
        return self._source.start_ns

    @property
    def end_ns(self) -> int:
        """The end of the recording."""
        return self._source.end_ns

    @property
    def pause(self) -> Pause | None:
        """The pause of the recorder at the moment, None while it recorded."""
        return self._pause

    def gone_ns(self, stream: str) -> int | None:
        """When the publisher of a stream was lost, as a log time; None while it is there."""
        known = self._streams.get(stream)
        return None if known is None else known.gone_ns

    def described(self, stream: str, before_ns: int) -> dict[int, StreamDescription]:
        """The last description of a stream before a log time, in each of its epochs."""
        known = self._streams.get(stream)
        name = "" if known is None else known.full_name
        found = {}
        for event in self._events:
            if event.kind == "stream" and event.name == name and event.log_ns < before_ns:
                description = _description_of(event)
                if description is not None:
                    found[description.epoch] = description
        return found

    def said_gone(self, stream: str) -> str:
        """A clause that says since when the publisher of a stream was gone, "" if it is not."""
        gone_ns = self.gone_ns(stream)
        if gone_ns is None:
            return ""
        described = self._streams[stream].state.description
        name = stream if described is None else described.node
        from_s = (gone_ns - self._source.start_ns) / S
        return f"its publisher {printable(name)} was gone from +{from_s:.1f} s on"

    def said(self, pause: Pause) -> str:
        """A clause that says why nothing came, and when."""
        return pause.said(self._source.start_ns)

    def pause_since(self, frame: str) -> Pause | None:
        """The last pause that was, or began, after the newest sample of a frame, as the times went
        on then; None if there is none.
        """
        if not self.pauses or frame not in self.buffer.frames():
            return None
        newest_ns = self.buffer.frame(frame).newest_ns
        silent_ns = 0 if newest_ns is None else self.now_ns() - newest_ns
        since_ns = self._at_ns - silent_ns
        past = [
            each for each in self.pauses if each.from_ns <= self._at_ns and since_ns < each.to_ns
        ]
        return past[-1] if past else None

    @property
    def is_simulated(self) -> bool:
        """Whether `now_ns` is a simulated time."""
        return self._clock.is_simulated

    @property
    def nodes(self) -> tuple[NodeDescription, ...]:
        """The nodes that are there, by name."""
        return tuple(node for _, node in sorted(self._nodes.items()))

    def streams(self) -> list[StreamInfo]:
        """All streams that are or were there, sorted by name."""
        return [
            stream.reception.report(stream.state) for _, stream in sorted(self._streams.items())
        ]

    def tree(self) -> FrameTree:
        """The tree of frames."""
        simulated: SimulatedTime = NOT_SIMULATED
        if not self._clock.is_simulated:
            simulated = simulated_time(self._nodes.values())
        now_ns = self.now_ns()
        if self._pause is not None and not self._clock.is_simulated:
            # Frames are as old as they were when the recorder was paused: they may have been sent.
            now_ns = self._pause.from_ns
        return frame_tree(self.buffer, self.streams(), now_ns, simulated)

    def moment(self) -> BusMoment:
        """The bus at the moment."""
        return BusMoment(
            at_ns=self._at_ns,
            tree=self.tree(),
            nodes=self.nodes,
            rejected=dict(self.buffer.rejected),
            namespace=self.namespace,
            elsewhere=dict(self._elsewhere),
            start_ns=self.start_ns,
        )

    def next_sample_ns(self, frame: str) -> int | None:
        """When the next sample of a dynamic frame comes, from the publisher of its last, as a log
        time; None if none does for 20 minutes.
        """
        if frame not in self.buffer.frames():
            return None
        stream = self._streams.get(self.buffer.frame(frame).authority)
        if stream is None:
            return None
        to_ns = self._at_ns + _MOST_AHEAD_S * S
        chosen = Selection(streams=(stream.full_name,))
        for item in self._source.items(self._at_ns + 1, to_ns, chosen):
            if (
                isinstance(item, TransformItem)
                and not item.static
                and frame in self._children(item)
            ):
                return item.log_ns
        return None

    def last_heard_ns(self, frame: str) -> int | None:
        """When the last sample of a frame up to the moment came from its publisher, be it before a
        restart, as a log time; None if none has come.
        """
        stream = self._streams.get(self.buffer.frame(frame).authority)
        if stream is None:
            return None
        last = self._last_messages(stream.full_name, {frame}, self._at_ns + 1)
        return max(map(_log_ns, last), default=None)

    def hint(self, frame: str = "") -> str:
        """A sentence on where in the recording a frame is: later, or in another namespace."""
        first_ns: dict[str, int] = {}
        elsewhere = set()
        for event in self._events:
            if event.kind != "stream":
                continue
            namespace = _namespace_of(event)
            description = _description_of(event)
            rows = () if description is None else description.frames
            frames = {name for parent, child, _ in rows for name in (parent, child)}
            if self._view.called(event.name, namespace) is None:
                elsewhere |= {(namespace, each) for each in frames}
                continue
            for each in map(self._view.names(namespace).outside, frames):
                first_ns.setdefault(each, event.log_ns)
        if frame in first_ns and first_ns[frame] > self._at_ns:
            later_s = (first_ns[frame] - self._source.start_ns) / S
            return f"{frame!r} comes at +{later_s:.3f}s of the recording"
        if not frame and first_ns and min(first_ns.values()) > self._at_ns:
            later_s = (min(first_ns.values()) - self._source.start_ns) / S
            return f"the first frames come at +{later_s:.3f}s"
        return where_to_look(elsewhere, frame)


class _RecordedHooks(ReceptionHooks):
    """The listener that there was: a frame that two streams sent was judged as on a bus."""

    def __init__(
        self, conflicts: Conflicts, reception: Callable[[str], StreamReception | None]
    ) -> None:
        super().__init__(_SILENT)
        self._conflicts = conflicts
        self._reception = reception

    def claimed_by_others(self, stream: str, children: frozenset[str]) -> frozenset[str]:
        if self._reception(stream) is None:
            return frozenset()
        return self._conflicts.claimed_by_others(stream, children)

    def on_overlap(self, stream: str, frames: frozenset[str]) -> None:
        self._conflicts.restore(stream, frames)


@dataclass
class _HeardStream:
    """A stream, the state of its token and description, and the receptions of its keys.

    `gone_ns` is when its publisher was lost. `listed` are all frames that it ever listed and has
    not removed, `removed_ns` the times at which it removed the others.
    """

    reception: StreamReception
    state: StreamState
    full_name: str
    gone_ns: int | None = None
    removed_ns: dict[str, int] = field(default_factory=dict)
    _keys: dict[str, DynamicReception] = field(default_factory=dict)
    _seen: dict[str, tuple[str, bool]] = field(default_factory=dict)
    _left: set[str] = field(default_factory=set)

    @property
    def listed(self) -> set[str]:
        description = self.state.description
        rows = () if description is None else description.frames
        return self._left.union(child for _, child, _ in rows)

    @property
    def claims(self) -> tuple[tuple[str, str, bool], ...]:
        """The rows of frames that it lists now, none if its publisher is gone."""
        description = self.state.description if self.state.alive else None
        return () if description is None else description.frames

    def key(self, child: str) -> DynamicReception:
        """The reception of the key of a frame, "" for the whole stream's."""
        reception = self._keys.get(child)
        if reception is None:
            reception = self._keys[child] = DynamicReception(self.reception)
        return reception

    def expect_any_number(self) -> None:
        """The recorder was paused: messages that came meanwhile are not missing."""
        self._keys.clear()

    def take_event(self, event: EventItem, names: FrameNames) -> None:
        """Its token came or was lost, or it has another description."""
        if event.kind == "stream gone":
            self.gone_ns = event.log_ns
            self._left |= self.listed  # they stay as gone, if it comes back without them
            self.state = replace(self.state, alive=False)
            self.reception.vanish()
            return
        self.gone_ns = None
        was_alive = self.state.alive
        if not was_alive:
            self.reception.arrive()
        description = _description_of(event)
        if description is not None:
            description = names.description_outside(description)
            former, now = (
                {child for _, child, _ in rows} for rows in (self.claims, description.frames)
            )
            self.removed_ns |= dict.fromkeys(former - now, event.log_ns)
            for child in now & self.removed_ns.keys():
                del self.removed_ns[child]
            self.reception.take_description(description)
        if not was_alive:
            self.reception.marks.update()
        self.state = replace(
            self.state, alive=True, description=description or self.state.description
        )

    def describe_by(
        self, item: TransformItem, pairs: list[tuple[int, int]], frames: tuple[str, ...]
    ) -> None:
        """Describe a stream, of which no description was recorded, by the frames that it sends."""
        rows = {frames[child]: (frames[parent], item.static) for parent, child in pairs}
        if self.state.alive and rows.items() <= self._seen.items():
            return
        self._seen |= rows
        listed = tuple((parent, child, static) for child, (parent, static) in self._seen.items())
        stream = item.stream
        description = StreamDescription(1, stream.node, stream.epoch_ns, listed)
        self.state = replace(self.state, alive=True, description=description)


_READER = TransformReader()

# The listener of then has logged it.
_SILENT = logging.Logger("recorded", level=logging.CRITICAL + 1)


def _log_ns(item: Item) -> int:
    return item.log_ns


def _description_of(event: EventItem) -> StreamDescription | None:
    try:
        return from_map(StreamDescription, event.facts) if event.facts else None
    except (DecodeError, ValueError):
        return None


def _node_of(event: EventItem) -> NodeDescription | None:
    if event.kind != "node" or not event.facts:
        return None
    try:
        return from_map(NodeDescription, event.facts)
    except (DecodeError, ValueError):
        return None


def _namespace_of(event: EventItem) -> str:
    """The namespace of a stream: its node's, or its name without the last part."""
    node = str(event.facts.get("node") or "").strip("/")
    namespace = node.rpartition("/")[0]
    if node and (not namespace or event.name.startswith(f"{namespace}/")):
        return namespace
    return event.name.rpartition("/")[0]


def _only_namespace(source: "RecordingReader", fleet: Fleet | None) -> str:
    """The namespace of all streams, if none is in ours and there is one other."""
    if fleet is not None:
        return ""
    namespaces = {_namespace_of(event) for event in source.events if event.kind == "stream"}
    namespaces |= {channel.stream.namespace for channel in source.streams}
    return namespaces.pop() if len(namespaces) == 1 else ""
