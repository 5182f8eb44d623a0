"""The history that publishers still hold from before a recording began."""

from collections.abc import Callable, Iterable, Iterator

from tfbus.bag.raw_queue import OVERHEAD_BYTES, Raw, TransformSource
from tfbus.bus.session import Session
from tfbus.errors import DecodeError
from tfbus.listen.info import StreamState
from tfbus.listen.queries import AskPages, PagesInTurn
from tfbus.recording.items import TransformItem
from tfbus.runtime import scheduler
from tfbus.runtime.executor import Executor
from tfbus.wire.keys import transforms_key_beside
from tfbus.wire.pages import Page

# Streams that are there already are met one after the other; after this time no longer.
_QUIET_S = 0.7
# What streams hold comes page by page; it is waited for as long as pages come, and no longer than
# that: until then nothing is in the file.
_NO_PAGE_S, _LONGEST_S = 6.0, 30.0

SourceOf = Callable[[str], TransformSource | None]


class Past:
    """Asks the streams that are met first for what they hold, page by page, until `is_complete`.

    At most `most_bytes` of that are taken; `dropped` counts the messages beyond.
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
        self._asked[state.key] = asking = self._asking(state.key)
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
        """The messages that came, and those held from before them, in order of time.

        A message held gets the log time that it had with the delay of the others of its stream.
        Items that are not understood without, among what has come, go to the beginning.
        """
        for asking in [*self._asked.values()]:
            asking.close()
        came = list(live)
        held = list(self._held(came, source))
        began_ns = min((raw.log_ns for raw in (*held, *came)), default=0)
        first = [raw._replace(log_ns=began_ns) for raw in came if raw.source.is_essential]
        rest = [raw for raw in came if not raw.source.is_essential]
        return [*first, *sorted([*held, *rest], key=lambda raw: raw.log_ns)]

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

    def _asking(self, stream_key: str) -> AskPages:
        """Asks the stream of this token for all that it holds."""
        keys = f"{transforms_key_beside(stream_key)}/**"
        namespace = stream_key.partition("@tfbus/")[0]

        def take(page: Page, _: str) -> None:
            for message in page.messages:
                self._keep(f"{namespace}{message.key}", message.payload)

        def on_over() -> None:
            with self._lock:
                self._open -= 1
                self._news_s = scheduler.monotonic()

        return AskPages(
            self._session,
            self._executor,
            lambda: keys,
            on_page=take,
            on_message=lambda answer: self._keep(answer.key, answer.payload),
            on_over=on_over,
            turns=self._turns,
        )


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
