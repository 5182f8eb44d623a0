"""A recording as the page shows it: the frames as they were at the cursor."""

import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from tfbus import messages
from tfbus.base.clock import Clock, SystemClock
from tfbus.base.errors import DecodeError
from tfbus.base.signals import StopSignals
from tfbus.buffer.buffer import Buffer
from tfbus.bus.graph import Endpoint, TopicInfo
from tfbus.frames.moment import BusMoment
from tfbus.frames.recorded import RecordedFrames
from tfbus.recording.items import Item, Selection, TopicItem, TransformItem
from tfbus.recording.playhead import Playhead, stepped_ns
from tfbus.recording.reader import RecordingReader
from tfbus.view.data.layer import MOST_DECAYING_POINTS
from tfbus.view.data.topics import (
    EVERY,
    MOST_CHOICES,
    POINTS,
    Past,
    Waiting,
    message_type_of,
    size_of,
)
from tfbus.view.settings import TopicSettings, topic_of
from tfbus.view.timeline import known_timeline, whole_timeline
from tfbus.wire.codec import from_map
from tfbus.wire.fleet import Fleet, FrameNames
from tfbus.wire.keys import namespace_of_node, relative

# The time before the cursor that is read on a seek, for rates and trails: of this many messages,
# and these at the least and at the most.
_MESSAGES_BEFORE = 2500
_LEAST_BEFORE_S = 2.0
_MOST_BEFORE_S = 30.0

# Where frames are in the course of a recording, by this many moments.
_SAMPLES = 8
_SAMPLE_S = 0.5

# Where the cursor is this far ahead, nothing between is read.
_SKIP_S = 3.0

# A machine that sleeps lets the recording wait.
_MOST_STEP_S = 0.25


@dataclass(frozen=True)
class Cursor:
    """The moment that is shown: a log time, and the buffer as of then. `jumps` counts how often it
    did not come on from the one before.
    """

    at_ns: int
    buffer: Buffer
    jumps: int


class _WatchedClock(SystemClock):
    """Has run for the time that passed from picture to picture, while a browser watched."""

    watched_ns = 0

    def elapsed_ns(self) -> int:
        return self.watched_ns


class Replay:
    """The host, the publishers and the buffer of a page that shows a recording.

    It is at `at_ns` first, and plays if it should. `move` is for the page's thread; the playhead
    is for any. The timeline has the file's events at
    once, and after `measure` marks that are only found by reading it, as gaps. `samples` are then
    the transforms at some moments, for a camera that sees where frames will be. With a `fleet` the
    frames of robots in namespaces below are there, too. `mistake` says why the
    recording cannot be read at the cursor, "" if it can.
    """

    def __init__(
        self,
        reader: RecordingReader,
        *,
        at_ns: int,
        plays: bool = False,
        start_ns: int | None = None,
        end_ns: int | None = None,
        namespace: str = "",
        fleet: Fleet | None = None,
    ) -> None:
        self.log = logging.getLogger("tfbus.view")
        self._error = ""
        self.samples: tuple[Buffer, ...] = ()
        self._reader = reader
        self._namespace = namespace
        self.fleet = fleet
        start_ns = reader.start_ns if start_ns is None else start_ns
        end_ns = reader.end_ns if end_ns is None else end_ns
        self.timeline = known_timeline(reader, start_ns, end_ns)
        self._watched = _WatchedClock()
        self.playhead = Playhead(
            start_ns, end_ns, at_ns=at_ns, paused=not plays, clock=self._watched
        )
        self._ended = threading.Event()
        self._measuring: threading.Thread | None = None
        self._signals: StopSignals | None = None
        self._moved_s: float | None = None
        self._before_s = _before_s(reader)
        self._jumps = 0
        self._restart()
        self._try(self._seek, self._at_ns)
        self.cursor = self._cursor()

    # For a page

    @property
    def buffer(self) -> Buffer:
        """The transforms up to the cursor."""
        return self._frames.buffer

    @property
    def namespace(self) -> str:
        """The namespace that it shows."""
        return self._frames.namespace

    def moment(self) -> BusMoment:
        """The bus at the cursor."""
        return self._frames.moment()

    def topics(self) -> tuple[Mapping[str, TopicInfo], Mapping[str, str]]:
        """The topics that can be read, by their names as seen from the namespace; and their full
        names by these.
        """
        publishers: dict[str, set[str]] = {}
        for event in self._reader.events:
            if event.kind == "node" and isinstance(named := event.facts.get("publishes"), Mapping):
                above = namespace_of_node(event.name)
                for name in map(str, named):
                    full = name[1:] if name.startswith("/") else f"{above}/{name}".strip("/")
                    publishers.setdefault(full, set()).add(f"/{event.name.strip('/')}")
        topics, names = {}, {}
        for topic in self._reader.topics:
            if topic.is_readable:
                name = relative(f"/{topic.name}", self.namespace)
                ends = [
                    Endpoint(node, topic.type_name, retained=topic.is_retained)
                    for node in sorted(publishers.get(topic.name, {""}))
                ]
                topics[name] = TopicInfo(name, tuple(ends))
                names[name] = topic.name
        return topics, names

    def frame_names(self, topic: TopicInfo) -> FrameNames | None:
        """The names of the frames in messages of a topic: of its publishers' robot, else by the
        topic's name; None without a fleet.
        """
        if self.fleet is None:
            return None
        above = {namespace_of_node(end.node) for end in topic.publishers if end.node}
        full = f"{self.namespace}/{topic.name}".strip("/")
        namespace = above.pop() if len(above) == 1 else full.rpartition("/")[0]
        return self._frames.viewpoint.names(namespace)

    def hint(self, frame: str = "") -> str:
        """The place of a frame, or of any, elsewhere than at the cursor; "" if nowhere."""
        return self._frames.hint(frame)

    def wait(self, timeout_s: float | None, *, clock: Clock | None = None) -> bool:
        """Wait, at most until the end of the page; whether it goes on."""
        if self._signals is not None:
            return not self._signals.wait(timeout_s)
        return not self._ended.wait(timeout_s)

    def end(self) -> None:
        """End the page; from any thread."""
        self._ended.set()
        if self._signals is not None:
            self._signals.stop()

    def close(self) -> None:
        """Close the files, once the page has ended."""
        self._end_measuring()
        self._reader.close()

    @contextmanager
    def until_signal(self) -> Iterator[None]:
        """Ctrl-C and SIGTERM end the page from here to the end of the `with`."""
        self._signals = StopSignals()
        try:
            yield
        finally:
            self._end_measuring()
            self._signals.uninstall()
            self._signals = None

    def _end_measuring(self) -> None:
        # Python ends a process whose daemon thread is in the midst of C++ by an abort.
        self._ended.set()
        if self._measuring is not None:
            self._measuring.join()

    # How it moves

    def measure(self) -> None:
        """Complete the timeline by marks that only the index of the files shows; on any thread."""
        try:
            with self.opened_again() as reader:
                self.samples = tuple(self._samples(reader))
                found = whole_timeline(reader, self.timeline, self._ended.is_set)
        except (OSError, DecodeError) as error:
            self.log.warning("The timeline lacks what cannot be read: %s", error)
        else:
            self.timeline = found or self.timeline

    def _samples(self, reader: RecordingReader) -> Iterator[Buffer]:
        frames = self.frames_of(reader, _SAMPLE_S)
        start_ns, end_ns = self.playhead.start_ns, self.playhead.end_ns
        for part in range(_SAMPLES):
            if not self._ended.is_set():
                frames.seek(start_ns + (end_ns - start_ns) * (part + 1) // _SAMPLES)
                yield frames.buffer

    def measure_meanwhile(self) -> None:
        """`measure` on a thread of its own, which `end` ends."""
        self._measuring = threading.Thread(target=self.measure, name="tfbus timeline", daemon=True)
        self._measuring.start()

    def move(self, now_s: float, *, is_watched: bool, trail_s: float = 0.0) -> bool:
        """Bring buffer and streams to the cursor, which plays while a browser watches; `now_s` is
        the time of a steady clock. Whether it has jumped, or other browsers must follow it.

        At least `trail_s` seconds before it are there.
        """
        passed_s = 0.0 if self._moved_s is None or not is_watched else now_s - self._moved_s
        self._moved_s = now_s
        is_jump = self._try(self._move, min(passed_s, _MOST_STEP_S), trail_s)
        self.cursor = self._cursor()
        return is_jump

    def _cursor(self) -> Cursor:
        return Cursor(self._frames.at_ns, self.buffer, self._jumps)

    def _move(self, passed_s: float, trail_s: float) -> bool:
        jumps = self.playhead.jumps
        if steps := self.playhead.take_steps():
            at_ns = stepped_ns(self._reader, self.playhead, steps, _moves)
            self.playhead.seek(self._at_ns if at_ns is None else at_ns)
        self._watched.watched_ns += round(passed_s * 1e9)
        at_ns = self.playhead.advance().log_ns
        if trail_s > self._before_s:
            self._before_s = trail_s
            return self._seek(at_ns)
        return self._go_to(at_ns) or self.playhead.jumps != jumps

    def _go_to(self, at_ns: int) -> bool:
        """Whether it was a jump."""
        ahead_ns = at_ns - self._frames.at_ns
        if not ahead_ns:
            return False
        is_jump = not 0 < ahead_ns <= _SKIP_S * 1e9
        if is_jump:
            self._seek(at_ns)
        else:
            self._frames.advance(at_ns)
        self._error = ""
        return is_jump

    @property
    def mistake(self) -> str:
        """Why the files cannot be read at the cursor; "" if they can."""
        at_ns = self._at_ns
        for damage in self._reader.damage:
            from_ns, to_ns = damage.from_ns, damage.to_ns
            if from_ns is not None and to_ns is not None and from_ns <= at_ns <= to_ns:
                return f"Damaged: {damage.text(self._reader.start_ns)} cannot be read"
        return self._error

    def _seek(self, at_ns: int) -> bool:
        self._restart()
        # Were it damaged there, it is not tried again and again.
        self._frames.pass_time(at_ns)
        self._frames.seek(at_ns)
        return True

    def _restart(self) -> None:
        self._jumps += 1
        self._frames = self.frames_of(self._reader, self._before_s)

    def opened_again(self) -> RecordingReader:
        """The files for another thread."""
        return RecordingReader(*[part.path for part in self._reader.parts])

    def frames_of(self, reader: RecordingReader, cache_time_s: float) -> RecordedFrames:
        """The frames of files as they are shown here, at no moment yet."""
        return RecordedFrames(
            reader, namespace=self._namespace, fleet=self.fleet, cache_time_s=cache_time_s
        )

    def _try(self, move: Callable[..., bool], *given: Any) -> bool:
        """Move; if the file is damaged it holds, and a seek to another place is possible."""
        try:
            return move(*given)
        except DecodeError as error:
            if str(error) != self._error:
                self.log.warning("%s", error)
            self._error = str(error)
            self.playhead.pause()
            return True

    @property
    def _at_ns(self) -> int:
        return self.playhead.progress.log_ns


# Messages before the cursor that are looked at, of each topic, to draw the scene at it.
_MOST_BYTES = 100_000_000
_MOST_MESSAGES = 1000
_MOST_LOOKED_AT = 20_000
_MOST_LINES = 100
# Of the others the newest of this time are candidates.
_CHOICES_NS = 1_000_000_000
# Each message is placed by the frames of its time, and a little later.
_PAST_S = 4.0
_LATER_NS = 200_000_000
# Each of these has its own place.
_APART = (messages.Marker, messages.MarkerArray)


class RecordedData:
    """The messages of a recording up to the cursor of its replay, for the page that draws them.

    They are read on the thread that draws, from the chunks that have some.
    """

    is_recorded = True

    def __init__(self, replay: Replay) -> None:
        self._replay = replay
        self._topics, self._names = replay.topics()
        self._wanted: Mapping[str, type] = {}
        self._waiting: dict[str, Waiting] = {}
        self._rejected: Counter[str] = Counter()
        self._cursor = replay.cursor
        self._reader: RecordingReader | None = None
        self._past_frames: RecordedFrames | None = None
        self._rest: Iterator[Item] | None = None
        self._next: Item | None = None

    def topics(self) -> Mapping[str, TopicInfo]:
        """All topics."""
        return self._topics

    def want(self, topics: Mapping[str, TopicInfo]) -> None:
        """Read these, and no others."""
        self._wanted = {
            name: found
            for name, info in topics.items()
            if (found := message_type_of(info)) is not None
        }

    def waiting(self, topic: str) -> Waiting | None:
        """The messages of a topic that came since the cursor jumped; None if it is not read."""
        return self._waiting.get(topic)

    def rejected(self, topic: str) -> int:
        """How many of the messages looked at could not be read."""
        return self._rejected[topic]

    def now_ns(self) -> int:
        """The log time of the cursor."""
        return self._cursor.at_ns

    def close(self) -> None:
        """Close the files. Twice is fine."""
        if self._reader is not None:
            self._reader.close()

    def catch_up(self, now_s: float) -> float:
        """Read on to the cursor, or begin anew if it has jumped; its log time in s."""
        cursor, wanted = self._replay.cursor, self._wanted
        is_jump = cursor.jumps != self._cursor.jumps or cursor.at_ns < self._cursor.at_ns
        before, self._cursor = self._cursor, cursor
        types = {name: each.message_type for name, each in self._waiting.items()}
        if is_jump or types != wanted:
            self._rest = None
            kept = {} if is_jump else self._waiting
            self._waiting = {
                name: kept[name]
                if name in kept and kept[name].message_type is each
                else self._new_waiting(name, each)
                for name, each in wanted.items()
            }
        if wanted and not is_jump:
            self._read_on(before.at_ns, cursor.at_ns)
        return cursor.at_ns / 1e9

    def past(self, topic: str, settings: TopicSettings) -> Iterator[Past]:
        """The messages up to the cursor that the drawing there needs."""
        waiting = self._waiting[topic]
        waiting.take()
        found = self._found_before(topic, waiting.message_type, settings)
        if waiting.message_type in _APART or settings.decay_s:
            groups = [[each] for each in reversed(found)]
        else:
            groups = [found[::-1]] if found else []
        for group in groups:
            if self._is_overtaken:
                return
            log_ns = group[-1][0]
            yield self._buffer_at(log_ns), log_ns / 1e9, [message for _, message in group]

    def _found_before(
        self, topic: str, message_type: type, settings: TopicSettings
    ) -> list[tuple[int, Any]]:
        """Log times and messages, the newest first."""
        least_ns, most = 0, _MOST_MESSAGES
        size = points = 0
        is_newest = message_type not in EVERY
        if message_type is messages.Log:
            most = _MOST_LINES
        elif settings.decay_s and message_type in POINTS:
            least_ns = self._cursor.at_ns - int(settings.decay_s * 1e9)
            most, is_newest = _MOST_LOOKED_AT, False
        found: list[tuple[int, Any]] = []
        seen: set[tuple[str, int | None]] = set()
        selection = Selection(topics=(self._full_name(topic),))
        for count, item in enumerate(
            self._files.messages_before(self._cursor.at_ns, selection), start=1
        ):
            if is_newest and found:
                least_ns = found[0][0] - _CHOICES_NS
            if item.log_ns < least_ns or count > most or size > _MOST_BYTES or self._is_overtaken:
                break
            message = self._message(topic, message_type, item)
            if message is None or not _is_news(message, seen):
                continue
            found.append((item.log_ns, message))
            size += size_of(message)
            points += _count_points(message, settings)
            if points > MOST_DECAYING_POINTS and not is_newest:
                break
            if ("", None) in seen or (is_newest and len(found) >= MOST_CHOICES):
                break
        return found if is_newest or message_type in EVERY else _thinned(found)

    @property
    def _is_overtaken(self) -> bool:
        """Whether the cursor has jumped again: messages of its former place are not drawn."""
        return self._replay.cursor.jumps != self._cursor.jumps

    def _buffer_at(self, log_ns: int) -> Buffer:
        """The buffer as it was a little after a log time up to the cursor: a publisher may have
        begun anew since.
        """
        to_ns = log_ns + _LATER_NS
        if to_ns >= self._cursor.at_ns:
            return self._cursor.buffer
        if self._past_frames is None:
            self._past_frames = self._replay.frames_of(self._files, _PAST_S)
            self._past_frames.seek(to_ns)
        elif 0 <= to_ns - self._past_frames.at_ns <= _PAST_S * 1e9:
            self._past_frames.advance(to_ns)
        else:
            self._past_frames.seek(to_ns)
        return self._past_frames.buffer

    def _new_waiting(self, topic: str, message_type: type) -> Waiting:
        waiting = Waiting(message_type, self._replay.frame_names(self._topics[self._own(topic)]))
        if message_type is messages.CameraInfo:
            selection = Selection(topics=(self._full_name(topic),))
            last = next(self._files.messages_before(self._cursor.at_ns, selection), None)
            if last is not None and (found := self._message(topic, message_type, last)) is not None:
                waiting.put(found)
        return waiting

    def _read_on(self, from_ns: int, to_ns: int) -> None:
        if self._rest is None:
            names = tuple({*map(self._full_name, self._waiting)})
            self._rest = self._files.items(from_ns + 1, None, Selection(topics=names))
            self._next = next(self._rest, None)
        wanted: dict[str, list[str]] = {}
        for name in self._waiting:
            wanted.setdefault(self._full_name(name), []).append(name)
        while self._next is not None and self._next.log_ns <= to_ns:
            item, self._next = self._next, next(self._rest, None)
            if not isinstance(item, TopicItem):
                continue
            for name in wanted.get(item.topic, ()):
                waiting = self._waiting[name]
                if (message := self._message(name, waiting.message_type, item)) is not None:
                    waiting.put(message)

    def _full_name(self, topic: str) -> str:
        return self._names[self._own(topic)]

    def _own(self, topic: str) -> str:
        """The topic of the recording that is shown by this name."""
        return topic if topic in self._names else topic_of(topic)

    def _message(self, topic: str, message_type: type, item: TopicItem) -> Any:
        try:
            return from_map(message_type, item.values)
        except (DecodeError, ValueError, TypeError):
            self._rejected[topic] += 1
            return None

    @property
    def _files(self) -> RecordingReader:
        if self._reader is None:
            self._reader = self._replay.opened_again()
        return self._reader


def _count_points(message: Any, settings: TopicSettings) -> int:
    """How many points of a cloud or scan are drawn, at the least; 0 where that is not known."""
    if settings.voxel:
        return 0
    if isinstance(message, messages.LaserScan):
        count = int(np.count_nonzero(np.isfinite(message.xyz()[:, 0])))
        return min(count, int(settings.most_points))
    # Half of a cloud's may be NaN.
    count = len(message) // 2 if isinstance(message, messages.PointCloud) else 0
    return min(count, int(settings.most_points) // 2)


# Numbers times this have parts behind the point that are spread evenly, of each second one, too.
_GOLDEN = (5.0**0.5 - 1.0) / 2.0


def _thinned(found: list[tuple[int, Any]]) -> list[tuple[int, Any]]:
    """If there are too many, some from the whole time."""
    if len(found) <= _MOST_MESSAGES:
        return found
    # Every second message might be of one of two scanners.
    share = _MOST_MESSAGES / len(found)
    return [each for number, each in enumerate(found) if number * _GOLDEN % 1.0 < share]


def _is_news(message: Any, seen: set[tuple[str, int | None]]) -> bool:
    """Whether a message has a marker that no later one replaces; `seen` has the namespaces and
    numbers of the later ones, and None for all of a namespace. Of other messages each is news.
    """
    if isinstance(message, messages.MarkerArray):
        markers: Sequence[messages.Marker] = message.markers
    elif isinstance(message, messages.Marker):
        markers = (message,)
    else:
        return True
    keys = {
        (marker.ns, None if marker.action == messages.Marker.DELETEALL else marker.id)
        for marker in markers
    }
    is_news = not keys <= seen
    seen |= keys
    return is_news


def _moves(item: Item) -> bool:
    return isinstance(item, TransformItem) and not item.static


def _before_s(reader: RecordingReader) -> float:
    messages = sum(stream.messages for stream in reader.streams)
    span_s = (reader.end_ns - reader.start_ns) / 1e9
    wanted_s = span_s * _MESSAGES_BEFORE / messages if messages else _MOST_BEFORE_S
    return min(max(wanted_s, _LEAST_BEFORE_S), _MOST_BEFORE_S)
