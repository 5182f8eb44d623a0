"""The thread that takes messages out of the queue and has them written, and the conditions on which
it writes a snapshot, `gone base_link`.
"""

import logging
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from weakref import WeakSet

from tfbus.bag.keeping import (
    UNSPLIT,
    Fill,
    InFiles,
    ItemWriter,
    Keeping,
    LastSeconds,
    MissedMessages,
    PartsWritten,
    Received,
    Splits,
    WrittenPart,
)
from tfbus.bag.raw_queue import EVENTS, MessageSource, Past, Raw, RawQueue, SourceOf
from tfbus.base import scheduler
from tfbus.base.callbacks import Given
from tfbus.base.errors import DecodeError, InvalidArgumentException, TfbusError
from tfbus.base.log import LogOnce
from tfbus.base.wording import counted, did_you_mean, duration, listed, printable
from tfbus.recording.items import EventItem, Item, Selection
from tfbus.streams.conflicts import Claims
from tfbus.wire.codec import from_map
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.fleet import FrameNames, has_name
from tfbus.wire.keys import namespace_of_node

_KINDS = ("gone", "conflict")


@dataclass(frozen=True)
class SnapshotCondition:
    """A frame's publisher is gone, or two publishers send it; "" is any frame."""

    kind: str
    frame: str = ""

    @classmethod
    def parse(cls, text: str) -> "SnapshotCondition":
        """The condition in `gone base_link`. Raises InvalidArgumentException."""
        kind, _, frame = text.strip().partition(" ")
        if kind not in _KINDS:
            raise InvalidArgumentException(
                f"'{printable(text, 60)}' is no condition: write 'gone FRAME' or 'conflict FRAME'; "
                "without FRAME it holds for any"
            )
        return cls(kind, frame.strip())

    def __str__(self) -> str:
        return f"{self.kind} {self.frame}".strip()


@dataclass
class Triggers:
    """Finds events of streams that fulfil a condition. The frames of conditions are named as on the
    robot, or as in a fleet: `base_link`, `robot7/base_link`.
    """

    conditions: tuple[SnapshotCondition, ...]
    _claims: Claims = field(default_factory=lambda: Claims("latest"))
    # Of each stream its namespace and child frames, as they are called in a fleet.
    _frames: dict[str, tuple[FrameNames, list[str]]] = field(default_factory=dict)

    def fulfilled_by(self, event: EventItem) -> str:
        """How the event fulfils a condition, as a sentence; "" if it does not."""
        if event.kind == "stream":
            return self._conflict(event)
        if event.kind != "stream gone":
            return ""
        self._claims.update(event.name, None)
        names, children = self._frames.pop(event.name, (FrameNames(""), []))
        frames = self._wanted("gone", names, children)
        return f"stream {event.name!r} is gone, with {listed(frames, most=3)}" if frames else ""

    def _conflict(self, event: EventItem) -> str:
        try:
            description = from_map(StreamDescription, event.facts)
        except DecodeError:
            return ""
        # Two robots may have frames of one name.
        names = FrameNames(namespace_of_node(description.node))
        description = names.description_outside(description)
        self._frames[event.name] = names, [child for _, child, _ in description.frames]
        contested = self._claims.update(event.name, description)
        for conflict in self._claims.news(event.name, contested):
            if frames := self._wanted("conflict", names, conflict.frames):
                streams = f"{conflict.first.stream!r} and {conflict.other.stream!r}"
                return f"streams {streams} both send {listed(frames, most=3)}"
        return ""

    def _wanted(self, kind: str, names: FrameNames, frames: Iterable[str]) -> list[str]:
        wanted = [each.frame for each in self.conditions if each.kind == kind]
        return [
            frame
            for frame in frames
            for own in [frame.removeprefix(f"{names.namespace}/")]
            if any(not name or has_name(own, names.namespace, name) for name in wanted)
        ]


def unmatched(
    selection: Selection,
    conditions: Collection[SnapshotCondition],
    described: Mapping[str, StreamDescription],
    received: Collection[str],
) -> Iterator[str]:
    """A clause for each stream and frame that is asked for and was not found; `described` are the
    streams that there were, `received` the names of streams of which messages came. A frame may
    come in a stream without a description: then nothing is said.
    """
    known = {*described, *received}
    for name in selection.streams:
        if name not in known:
            yield f"no stream is called '{printable(name, 60)}'{did_you_mean(name, known)}"
    if set(received) - set(described):
        return
    frames = {
        (namespace_of_node(each.node), child)
        for each in described.values()
        for _, child, _ in each.frames
    }
    in_fleet = {FrameNames(namespace).outside(child) for namespace, child in frames}
    asked = [*selection.frames, *(each.frame for each in conditions if each.frame)]
    for name in dict.fromkeys(asked):
        if not any(has_name(child, namespace, name) for namespace, child in frames):
            yield f"no frame is called '{printable(name, 60)}'{did_you_mean(name, in_fleet)}"


# The queue is looked at so often. Few wake-ups cost less than one for each message.
_LOOK_EVERY_S = 0.4

# Messages are on the disk with the first look after this time: the second one.
_FLUSH_EVERY_S = 0.7

# The first messages of a stream or topic wait for its description; later ones wait behind them.
_DESCRIBED_WITHIN_NS = 250_000_000

# A clock that is set back by less is being adjusted.
_SLEWED_NS = 50_000_000

# Dropped messages become an event at most so often.
_DROPPED_EVERY_S = 1.0

# A service, or a key, waits at most this long for the thread.
_ANSWER_WITHIN_S = 60.0

MISSING, HISTORY = "missing", "history"


@dataclass(frozen=True)
class Filled:
    """The items that were written into a gap, and its fill."""

    items: list[Item]
    fill: Fill


@dataclass(frozen=True)
class Snapshots:
    """Write the last `last_s` seconds when asked, or when one of the `triggers` fires; keep at most
    `most_bytes` in memory.
    """

    last_s: float
    most_bytes: int
    triggers: Triggers


class Recorder:
    """Writes the messages of a queue into files, on a thread of its own, until `close()`.

    With `snapshots` only the last seconds are kept, and written when asked. `past` is waited for
    first, and `source` gives the source of a key's messages. `on_file(path, written, why)` is
    called for each further file that is asked for: it goes on in the file `path`, or has written
    that, and `written` is whole.

    If a file cannot be written, `failure` says why, and nothing further is recorded.
    """

    def __init__(
        self,
        queue: RawQueue,
        parts: PartsWritten,
        log: logging.Logger,
        *,
        selection: Selection,
        splits: Splits = UNSPLIT,
        snapshots: Snapshots | None = None,
        past: Past | None = None,
        source: SourceOf = lambda key: None,
        on_file: Callable[[Path, WrittenPart, str], object] = lambda path, written, why: None,
    ) -> None:
        items = ItemWriter(parts, selection, log)
        self.counts = items.counts
        self.failure = ""
        # How many messages came, also such as are only held.
        self.received = 0
        self.began_s = scheduler.monotonic()
        self._queue = queue
        self._parts = parts
        self._log = log
        self._once = LogOnce(log)
        self._triggers = None if snapshots is None else snapshots.triggers
        self._past = past
        self._source = source
        self._on_file = on_file
        self._pending: deque[Raw] = deque()
        # Sources whose messages wait no further.
        self._undescribed: WeakSet[MessageSource] = WeakSet()
        # Questions come from any thread, until the writing one has ended.
        self._asking = scheduler.Lock()
        self._has_ended = False
        self._asked: deque[tuple[Callable[[], object], Future[object]]] = deque()
        self._dropped_noted: Counter[str] = Counter()
        self._flushed_s = self._noted_s = self.began_s
        self._closing = scheduler.Event()
        self._missed = MissedMessages()
        # Called on the thread that writes, as `MissedMessages.on_outage`.
        self.on_outage: Callable[[str, int, int], object] = lambda stream, from_ns, until_ns: None
        self.window: LastSeconds | None = None
        self._files: InFiles | None = None
        self._keeping: Keeping
        if snapshots is None:
            parts.open()
            self._keeping = self._files = files = InFiles(parts, splits, items)
            self._missed = files.missed
            self._missed.on_outage = lambda *outage: self.on_outage(*outage)
        else:
            self._keeping = self.window = LastSeconds(
                parts, snapshots.last_s, snapshots.most_bytes, items
            )
        # Not a daemon: the process ends when the file is whole.
        self._thread = scheduler.Thread(target=self._run, name="recorder")
        self._thread.start()

    # From any thread

    @property
    def is_running(self) -> bool:
        """Whether it records still: False after `close()`, and after a failure."""
        return self._thread.is_alive() and not self.failure

    @property
    def is_paused(self) -> bool:
        """Whether it records only the state in force: streams, nodes, statics."""
        return self._queue.is_paused

    @property
    def is_waiting(self) -> bool:
        """Whether it still waits for messages that publishers hold from before."""
        return self._past is not None

    def pause(self) -> None:
        """Record only the state in force, until `resume`. Twice is fine."""
        if not self._queue.is_paused:
            self._queue.put(EVENTS, EventItem(0, "paused"))
            self._queue.is_paused = True

    def resume(self) -> None:
        """Record everything again. Twice is fine."""
        if self._queue.is_paused:
            # First: after it the numbers of messages begin anywhere.
            self._queue.put(EVENTS, EventItem(0, "resumed"))
            self._queue.is_paused = False

    def split(self) -> WrittenPart:
        """Go on in a new file, or write a snapshot: the file that is whole then. Raises TfbusError
        if it cannot.
        """
        written = self._ask(self._split, "asked")
        assert isinstance(written, WrittenPart)
        return written

    def split_later(self) -> None:
        """As `split`, without waiting for it."""
        self._submit(self._split, "asked")

    def now_ns(self) -> int:
        """The log time of now."""
        return self._queue.now_ns()

    def notice_received(self, *, held: bool) -> None:
        """Know from now on which messages come by themselves, so that `fill` writes the others: for
        a minute or, `held`, until it is called again.
        """

        def notice() -> None:
            if (files := self._files) is not None:
                if files.received is None or (held and not files.received.is_held):
                    files.received = files.received or Received()
                files.received.is_held = held

        self._submit(notice)

    def fill(self, raws: Sequence[Raw], fill: Fill | None, again_ns: int) -> "Future[object]":
        """Write messages of before the last ones, if they did not come by themselves; None begins a
        fill. From the log time `again_ns` on they may come again. The result is a `Filled`, or an
        error.
        """

        def write() -> Filled:
            assert self._files is not None
            of = fill or self._files.begin_fill()
            items = self._files.fill(raws, of, again_ns)
            for item in items:
                self.counts.add(item)
            self.counts.filled += sum(not isinstance(item, EventItem) for item in items)
            return Filled(items, of)

        return self._submit(write)

    def close(self) -> None:
        """Write all that has come, end the file, and wait for that. Twice is fine."""
        self._closing.set()
        self._queue.wake()
        self._thread.join()

    # On its own thread

    def _run(self) -> None:
        try:
            self._record()
        except OSError as error:
            self._fail(error)
        except Exception as error:
            self._log.exception("Stopped recording")
            self._fail(error)
        with self._asking:
            self._has_ended = True
            while self._asked:
                self._asked.popleft()[1].set_exception(self._why_ended())

    def _record(self) -> None:
        is_closing = False
        held_bytes = 0
        while not is_closing:
            is_closing = self._closing.is_set()
            came = self._queue.drain(0.0 if is_closing else _LOOK_EVERY_S, held_bytes)
            self._pending.extend(came)
            if self._past is not None:
                if not is_closing and not self._past.is_complete():
                    held_bytes += sum(raw.size for raw in came)
                    continue
                self._pending = deque(self._past.before(self._pending, self._source))
                self._note_history(self._past.dropped)
                self._past = None
            while self._pending and (is_closing or not self._waits(self._pending[0])):
                self._keep(self._pending.popleft())
            held_bytes = sum(raw.size for raw in self._pending)
            while self._asked:
                self._answer(*self._asked.popleft())
            self._do_regularly(is_closing)
        self._parts.close()

    def _note_history(self, dropped: int) -> None:
        if dropped:
            self.counts.lost[HISTORY] = dropped
            self._log.warning(
                "Dropped %s that publishers held from before: the memory for them is full",
                counted(dropped, "message"),
            )

    def _waits(self, raw: Raw) -> bool:
        """Whether a message waits for its description: the first of its source, for a moment."""
        if raw.source in self._undescribed or raw.source.is_described(raw.payload):
            return False
        if 0 <= self._queue.now_ns() - raw.log_ns < _DESCRIBED_WITHIN_NS:
            return True
        self._undescribed.add(raw.source)
        return False

    def _keep(self, raw: Raw) -> None:
        self.received += raw.source is not EVENTS
        event = self._keeping.keep(raw)
        if event is None or self._triggers is None:
            return
        if why := self._triggers.fulfilled_by(event):
            self._split(why)

    def _split(self, why: str) -> WrittenPart:
        path = self._keeping.split(max(scheduler.time_ns(), self._queue.last_ns))
        written = self._parts.written[-1]
        self._on_file(path, written, why)
        return written

    def _do_regularly(self, is_closing: bool) -> None:
        now_s = scheduler.monotonic()
        if is_closing or now_s >= self._noted_s + _DROPPED_EVERY_S:
            self._noted_s = now_s
            if self._queue.set_back_ns > _SLEWED_NS:
                self._once.warning(
                    "set back",
                    "The system's clock was set back by %s: log times go on, a tenth more slowly "
                    "until it has caught up",
                    duration(self._queue.set_back_ns / 1e9),
                )
            self._note_dropped()
        if is_closing or now_s >= self._flushed_s + _FLUSH_EVERY_S:
            self._flushed_s = now_s
            self._parts.flush()

    def _note_dropped(self) -> None:
        dropped = Counter(self._queue.dropped)
        # Transforms that the queue has dropped are missing too.
        missing = self._missed.count - dropped["transforms"]
        if missing > 0:
            self.counts.lost[MISSING] = missing
        else:
            self.counts.lost.pop(MISSING, None)
        news = dropped - self._dropped_noted
        if not news:
            return
        self._dropped_noted = dropped
        self.counts.lost.update(news)
        self._once.warning(
            "dropped", "Dropped %d messages: the disk or this machine is too slow", news.total()
        )
        facts = {"messages": news.total(), **news}
        log_ns = max(scheduler.time_ns(), self._queue.last_ns)
        self._keep(Raw(log_ns, EVENTS, EventItem(0, "dropped", "", facts)))

    def _fail(self, error: Exception) -> None:
        self.failure = str(getattr(error, "strerror", None) or error)
        with suppress(OSError):
            self._parts.close()
        self._closing.set()

    # Questions of other threads

    def _submit(self, job: Callable[[*Given], object], *given: *Given) -> "Future[object]":
        answer: Future[object] = Future()
        with self._asking:
            if self._has_ended:
                answer.set_exception(self._why_ended())
            else:
                self._asked.append((partial(job, *given), answer))
        self._queue.wake()
        return answer

    def _why_ended(self) -> TfbusError:
        return TfbusError(self.failure or "the recorder has ended")

    def _ask(self, job: Callable[[*Given], object], *given: *Given) -> object:
        try:
            return self._submit(job, *given).result(_ANSWER_WITHIN_S)
        except TimeoutError:
            raise TfbusError(
                f"the recorder did not answer within {_ANSWER_WITHIN_S:g} s: is the disk too slow?"
            ) from None

    def _answer(self, job: Callable[[], object], answer: "Future[object]") -> None:
        try:
            answer.set_result(job())
        except TfbusError as error:
            answer.set_exception(error)
        except Exception as error:
            answer.set_exception(TfbusError(str(getattr(error, "strerror", None) or error)))
            raise
