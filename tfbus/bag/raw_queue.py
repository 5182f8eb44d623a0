"""Messages as they came, in a queue, the sources that read them, and the history from before."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from operator import attrgetter
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

from tfbus.base import scheduler
from tfbus.base.errors import DecodeError
from tfbus.base.executor import Executor
from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.recording.items import EventItem, Item, RecordedStream, TopicItem, TransformItem
from tfbus.ros.schema import MessageCodec
from tfbus.streams.history import AskPages, PagesInTurn
from tfbus.streams.info import StreamState
from tfbus.wire.codec import decode_map, encode_map
from tfbus.wire.descriptions import FLOAT64, StreamDescription
from tfbus.wire.keys import transforms_key_beside
from tfbus.wire.numbered import NO_NUMBERS, numbers_of
from tfbus.wire.pages import Page
from tfbus.wire.transforms import TransformMessage, TransformReader

# The bytes of Python's objects of a message, besides its payload.
OVERHEAD_BYTES = 200

# The bytes of a description's objects for each byte of its encoding.
_BYTES_OF_OBJECTS = 5

# The thread that writes wakes at once if this much of the room is taken.
_MUCH = 1 / 16


# Of ten seconds of a clock that was set back, log times go on by nine, until it has caught up.
_CATCHES_UP_BY = 10


class MessageSource(Protocol):
    """The kind of messages of one key, and how to read them.

    `kind` is counted if messages are dropped: "transforms", "statics", "topics" or "events".
    An `is_essential` message is needed to understand the messages after it.
    """

    kind: str
    is_essential: bool

    def is_described(self, payload: Any) -> bool:
        """Whether all is known that a message does not say itself."""

    def item(self, log_ns: int, payload: Any) -> Item:
        """A message, read. Raises DecodeError."""


class Raw(NamedTuple):
    """A message as it came: its log time (ns since the Unix epoch), source and bytes, or the event
    itself.
    """

    log_ns: int
    source: MessageSource
    payload: Any

    @property
    def size(self) -> int:
        """The memory that it takes, in bytes."""
        return _size(self.payload)

    def item(self) -> Item:
        """The message, read. Raises DecodeError."""
        return self.source.item(self.log_ns, self.payload)


class RawQueue:
    """Takes messages from any thread, at most `most_bytes` of them; one thread takes them out.

    Beyond that a message is `dropped`, and counted by its kind. Essential ones have as much room
    again. A message that was taken out counts until the next `drain`, and longer if its taker still
    holds it then.

    Log times never go back: if the system's clock is set back, they go on from the last one, by
    `set_back_ns` ahead of the clock, and a tenth more slowly until it has caught up.
    """

    def __init__(
        self, most_bytes: int, clock_ns: Callable[[], int] = lambda: scheduler.time_ns()
    ) -> None:
        self.dropped: Counter[str] = Counter()
        self.is_paused = False
        # The newest log time, and by how much it is ahead of the system's clock.
        self.last_ns = self.set_back_ns = 0
        self._most_bytes = most_bytes
        self._clock_ns = clock_ns
        self._lock = scheduler.Lock()
        self._waiting: list[Raw] = []
        self._bytes = self._taken_bytes = 0
        self._wakes = scheduler.Event()

    def put(self, source: MessageSource, payload: Any) -> bool:
        """Note that a message has come now; whether it was taken. While the queue is paused only
        essential ones are.
        """
        is_essential = source.is_essential
        if self.is_paused and not is_essential:
            return False
        size = _size(payload)
        with self._lock:
            taken = self._bytes + size
            if taken + self._taken_bytes > self._most_bytes * (2 if is_essential else 1):
                self.dropped[source.kind] += 1
                return False
            self._bytes = taken
            log_ns = self._clock_ns()
            if self.set_back_ns or log_ns < self.last_ns:
                log_ns += self._ahead(log_ns)
            self.last_ns = log_ns
            self._waiting.append(Raw(log_ns, source, payload))
        if taken > self._most_bytes * _MUCH:
            self._wakes.set()
        return True

    def _ahead(self, clock_ns: int) -> int:
        """By how much the log time of now is ahead of the clock: of the time since the last message
        a tenth less than was the last.
        """
        passed_ns = max(0, clock_ns - (self.last_ns - self.set_back_ns))
        behind_ns = self.set_back_ns - passed_ns // _CATCHES_UP_BY
        self.set_back_ns = max(0, self.last_ns - clock_ns, behind_ns)
        return self.set_back_ns

    def now_ns(self) -> int:
        """The log time of now."""
        return self._clock_ns() + self.set_back_ns

    def wake(self) -> None:
        """End the wait of `take`."""
        self._wakes.set()

    def drain(self, wait_s: float, held_bytes: int = 0) -> list[Raw]:
        """All that waits, in the order in which it came, after at most `wait_s` seconds.

        `held_bytes` is the size of messages taken before that are still to be written.
        """
        with self._lock:
            self._taken_bytes = held_bytes
        self._wakes.wait(wait_s)
        self._wakes.clear()
        with self._lock:
            waiting, self._waiting = self._waiting, []
            self._taken_bytes, self._bytes = held_bytes + self._bytes, 0
        return waiting


def _size(payload: Any) -> int:
    if payload.__class__ is bytes:
        return OVERHEAD_BYTES + len(payload)
    facts = payload.facts if isinstance(payload, EventItem) else {}
    return OVERHEAD_BYTES + (len(encode_map(facts)) * _BYTES_OF_OBJECTS if facts else 0)


class FullNames:
    """Full names: as a session of this namespace has them, as one without a namespace does."""

    def __init__(self, namespace: str) -> None:
        self._prefix = f"{namespace}/" if namespace else ""

    def full(self, name: str) -> str:
        """`turtle1/pose` in the namespace robot7 is `robot7/turtle1/pose`."""
        return name[1:] if name.startswith("/") else f"{self._prefix}{name}"

    def namespace(self, below: str) -> str:
        """The full namespace of the namespace `below` ours."""
        return f"{self._prefix}{below}".rstrip("/")


class TransformSource:
    """The transforms of one key of a stream; `described` has the descriptions of streams."""

    def __init__(
        self,
        name: str,
        namespace: str,
        described: Mapping[str, StreamDescription],
        reader: TransformReader,
        *,
        static: bool,
    ) -> None:
        self.kind = "statics" if static else "transforms"
        self.is_essential = static
        self.name = name
        self._namespace = namespace
        self._described = described
        self._reader = reader
        self._static = static
        self._last: tuple[StreamDescription | None, RecordedStream] | None = None
        self._numbered_by: StreamDescription | None = None
        self._numbers = NO_NUMBERS
        # The last message that `is_described` has read: payload, description and message.
        self._read_before: tuple[bytes, StreamDescription | None, TransformMessage] | None = None

    def is_described(self, payload: bytes) -> bool:
        """Whether its publisher's node is known, and the names of all frames in the message."""
        description = self._described.get(self.name)
        if description is None:
            return False
        if description.poses == FLOAT64:
            return True
        try:
            message = self._read(payload, description)
        except DecodeError:
            return True
        self._read_before = payload, description, message
        return not message.unnamed

    def _read(self, payload: bytes, description: StreamDescription | None) -> TransformMessage:
        before = self._read_before
        if before is not None and before[0] is payload and before[1] is description:
            return before[2]
        if description is not self._numbered_by:
            self._numbered_by = description
            self._numbers = NO_NUMBERS if description is None else numbers_of(description)
        return self._reader.read(payload, self._numbers)

    def item(self, log_ns: int, payload: bytes) -> TransformItem:
        """A message, read. Raises DecodeError."""
        description = self._described.get(self.name)
        message = self._read(payload, description)
        self._read_before = None
        if message.unnamed and not len(message.rows):
            raise DecodeError("the description of its stream has no names for its frames")
        last = self._last
        if last is None or last[0] is not description or last[1].epoch_ns != message.epoch_ns:
            last = self._last = (description, self._stream(description, message.epoch_ns))
        return TransformItem(log_ns, last[1], message.rows, self._static, message.seq)

    def _stream(self, description: StreamDescription | None, epoch_ns: int) -> RecordedStream:
        if description is None:
            return RecordedStream(self.name, "", self._namespace, epoch_ns)
        return RecordedStream(
            self.name, description.node, self._namespace, epoch_ns, description.split
        )


class TopicSource:
    """The messages of one topic; `types` has the type names of topics, and `codecs` the codecs of
    ROS's types among them. Retained ones stay in force, and so begin each file.

    `on_unfit(name)` is called for a message that is not of the type that its publisher says.
    """

    kind = "topics"

    def __init__(
        self,
        name: str,
        types: Mapping[str, str],
        codecs: Mapping[str, MessageCodec] = MappingProxyType({}),
        *,
        retained: bool = False,
        on_unfit: Callable[[str], object] = lambda name: None,
    ) -> None:
        self.name = name
        self.is_essential = retained
        self._types = types
        self._codecs = codecs
        self._on_unfit = on_unfit

    def is_described(self, payload: Any) -> bool:
        """Whether its type is known."""
        return self.name in self._types

    def item(self, log_ns: int, payload: bytes) -> TopicItem:
        """A message, read. Raises DecodeError."""
        values = decode_map(payload)
        type_name = self._types.get(self.name, "")
        encoded = None
        if (codec := self._codecs.get(self.name)) is not None:
            if (message := codec.encode_fitted(values)) is not None:
                encoded = codec.definition, message
            else:
                self._on_unfit(self.name)
        return TopicItem(log_ns, self.name, type_name, values, encoded, self.is_essential)


class EventSource:
    """Changes of the bus: its payloads are events."""

    kind = "events"
    is_essential = True

    def is_described(self, payload: Any) -> bool:
        """An event says all itself."""
        return True

    def item(self, log_ns: int, payload: Any) -> EventItem:
        """The event, at the time when it came."""
        event: EventItem = payload
        return replace(event, log_ns=log_ns)


EVENTS = EventSource()


# Streams that are there already are met one after the other; after this time no longer.
_QUIET_S = 0.7
# The messages that streams hold come page by page; they are waited for as long as pages come, and
# no longer than that: until then nothing is in the file.
_NO_PAGE_S, _LONGEST_S = 6.0, 30.0

SourceOf = Callable[[str], TransformSource | None]


class Past:
    """Asks the streams that are met first for their held messages, page by page, until
    `is_complete`.

    At most `most_bytes` of them are taken; `dropped` counts the messages beyond.
    """

    def __init__(self, session: Session, executor: Executor, most_bytes: int) -> None:
        self.dropped = 0
        self._most_bytes = most_bytes
        self._bytes = 0
        self._session = session
        self._executor = executor
        self._lock = scheduler.Lock()
        self._asked: dict[str, AskPages] = {}
        self._turns = PagesInTurn(executor)
        # Key, payload, and when it came.
        self._kept: list[tuple[str, bytes, int]] = []
        self._began_s = self._news_s = scheduler.monotonic()
        self._open = 0

    def meet(self, state: StreamState) -> None:
        """A stream is there: ask it."""
        description = state.description
        if not state.alive or description is None or state.key in self._asked:
            return
        with self._lock:
            self._news_s = scheduler.monotonic()
            if not description.history_s:
                return
            self._open += 1
        self._asked[state.key] = asking = _AskHeld(self, state.key)
        asking.start()

    def is_complete(self) -> bool:
        """Whether all has come of the streams that were there at first; or no page in the last 6 s,
        or 30 s have passed.
        """
        now_s = scheduler.monotonic()
        with self._lock:
            is_quiet = now_s - self._news_s > (_NO_PAGE_S if self._open else _QUIET_S)
        return is_quiet or now_s - self._began_s > _LONGEST_S

    def before(self, live: Iterable[Raw], source: SourceOf) -> list[Raw]:
        """The messages that came, and held ones from before them, in order of time.

        A held message gets the log time that it had with the delay of the others of its stream.
        Essential messages among the ones that came go to the beginning.
        """
        for asking in [*self._asked.values()]:
            asking.close()
        came = list(live)
        held = list(self._held(came, source))
        began_ns = min((raw.log_ns for raw in (*held, *came)), default=0)
        first = [raw._replace(log_ns=began_ns) for raw in came if raw.source.is_essential]
        rest = [raw for raw in came if not raw.source.is_essential]
        return [*first, *sorted([*held, *rest], key=attrgetter("log_ns"))]

    def _held(self, came: list[Raw], source: SourceOf) -> Iterator[Raw]:
        known, delays_ns, first_ns = _known(came)
        with self._lock:
            kept, self._kept = self._kept, []
        held: dict[str, list[tuple[Raw, int]]] = {}
        for key, payload, came_ns in kept:
            of = source(key)
            item = None if of is None else _read(of, came_ns, payload)
            if of is not None and item is not None and _identity(of, item, payload) not in known:
                stamp_ns = _newest_ns(item)
                held.setdefault(of.name, []).append((Raw(came_ns, of, payload), stamp_ns))
        for stream, messages in held.items():
            newest_ns = max(stamp_ns for _, stamp_ns in messages)
            delay_ns = delays_ns.get(stream, messages[-1][0].log_ns - newest_ns)
            # None of them was sent after the first that came by itself.
            latest_ns = first_ns.get(stream, messages[-1][0].log_ns)
            for raw, stamp_ns in messages:
                yield raw._replace(log_ns=min(stamp_ns + delay_ns, latest_ns))

    def _keep(self, key: str, payload: bytes) -> None:
        with self._lock:
            self._news_s = scheduler.monotonic()
            size = OVERHEAD_BYTES + len(payload)
            if self._bytes + size > self._most_bytes:
                self.dropped += 1
            else:
                self._bytes += size
                self._kept.append((key, payload, scheduler.time_ns()))


class _AskHeld(AskPages):
    """Asks the stream of a token for all that it holds."""

    def __init__(self, past: Past, stream_key: str) -> None:
        super().__init__(past._session, past._executor, past._turns)
        self._past = past
        self._keys = f"{transforms_key_beside(stream_key)}/**"
        self._namespace = stream_key.partition("@tfbus/")[0]

    def selector(self) -> str:
        return self._keys

    def on_page(self, page: Page) -> None:
        for message in page.messages:
            self._past._keep(f"{self._namespace}{message.key}", message.payload)

    def on_message(self, answer: Answer) -> bool:
        self._past._keep(answer.key, answer.payload)
        return True

    def on_over(self) -> None:
        past = self._past
        with past._lock:
            past._open -= 1
            past._news_s = scheduler.monotonic()


def _known(came: list[Raw]) -> tuple[set[object], dict[str, int], dict[str, int]]:
    """Which messages of transforms have come by themselves; and by stream, the least time from a
    stamp to its arrival, and when the first arrived.
    """
    known: set[object] = set()
    delays_ns: dict[str, int] = {}
    first_ns: dict[str, int] = {}
    for raw in came:
        of = raw.source
        if isinstance(of, TransformSource) and not of.is_essential:
            item = _read(of, raw.log_ns, raw.payload)
            if item is not None:
                known.add(_identity(of, item, raw.payload))
                delay_ns = raw.log_ns - _newest_ns(item)
                delays_ns[of.name] = min(delay_ns, delays_ns.get(of.name, delay_ns))
                first_ns.setdefault(of.name, raw.log_ns)
    return known, delays_ns, first_ns


def _read(source: TransformSource, log_ns: int, payload: bytes) -> TransformItem | None:
    try:
        item = source.item(log_ns, payload)
    except DecodeError:
        return None
    return item if item.rows.count else None


def _identity(source: TransformSource, item: TransformItem, payload: bytes) -> object:
    if item.seq is None:
        return payload
    return source, item.stream.epoch_ns, item.seq


def _newest_ns(item: TransformItem) -> int:
    return max(item.rows.stamps_as_ints())
