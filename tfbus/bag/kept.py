"""Recordings that a recorder keeps on its disk, and serves: others fill their gaps from them."""

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from tfbus.bag.keeping import PartsWritten
from tfbus.base import scheduler
from tfbus.base.bounded import Bounded
from tfbus.base.errors import BusError, InvalidArgumentException, TfbusError
from tfbus.base.file_lock import locked
from tfbus.base.structs import Struct
from tfbus.base.wording import printable
from tfbus.bus.query import Query
from tfbus.node.node import Node
from tfbus.recording.items import ALL, EventItem, Item, Selection, TopicItem, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.state import BusState
from tfbus.wire.codec import decode_message, encode_map, encode_message
from tfbus.wire.keys import escape, kept_key
from tfbus.wire.pages import KeptMessage, Page, encode_page
from tfbus.wire.transforms import TransformMessage, encode_transforms

# A key of such a recorder's metadata in its files: the next one goes on with them.
KEPT = "kept"

_LEAST_PAGE = 1_000
_LARGEST_PAGE = 1_000_000

# Received messages are on the disk after this time; later ones are not asked for.
_WRITTEN_AFTER_NS = 1_500_000_000

_LAST_NS = 2**63 - 1

# The spans of so many files are known.
_MOST_FILES = 10_000

STREAM, NODE = "@tfbus/stream/", "@tfbus/node/"


class Wanted(Struct):
    """The part of the kept messages that is wanted, as in `Selection`; all by default."""

    topics: tuple[str, ...] = ()
    streams: tuple[str, ...] = ()
    frames: tuple[str, ...] = ()
    exclude_topics: tuple[str, ...] = ()

    def selection(self) -> Selection:
        """The selection of it."""
        return Selection(
            topics=self.topics,
            streams=self.streams,
            frames=self.frames,
            exclude_topics=self.exclude_topics,
        )


def wanted_of(selection: Selection) -> bytes | None:
    """The payload that asks for a selection; its regular expressions are not sent."""
    if selection == ALL:
        return None
    wanted = Wanted(selection.topics, selection.streams, selection.frames, selection.exclude_topics)
    return encode_message(wanted)


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Let no other recorder keep its files in a folder: each would delete the other's.

    Raises TfbusError if there is one.
    """
    if scheduler.is_simulated:  # one process for all: a killed one would hold it
        yield
        return
    with locked(folder, waits=False) as is_alone:
        if not is_alone:
            raise TfbusError(
                f"another recorder keeps its files in '{printable(str(folder))}': give another "
                "folder (-o), or end that one"
            )
        yield


def kept_files(folder: Path) -> list[Path]:
    """The files in a folder that such a recorder has written, the oldest first."""
    found = []
    for path in folder.glob("*.mcap"):
        with suppress(TfbusError, OSError), RecordingReader(path) as reader:
            if reader.about.get(KEPT):
                found.append((reader.start_ns, path))
    return [path for _, path in sorted(found)]


class _Opened(NamedTuple):
    """Files that were opened for a page, with all their items up to a log time."""

    paths: list[Path]
    until_ns: int
    reader: RecordingReader


class KeptFiles:
    """Serves the items of recordings, page by page, until `close()`.

    The last of the files of `parts` grows. A query asks for the items from `last_s`
    to `until_s` seconds ago; its payload may name a part of them, as `Wanted`.
    """

    def __init__(self, node: Node, parts: PartsWritten) -> None:
        self._parts = parts
        self._key = kept_key(node.name)
        self._lock = scheduler.Lock()
        # The first and last log times of files that are whole.
        self._spans: Bounded[Path, tuple[int, int]] = Bounded(_MOST_FILES)
        # The file that grows, and its first log time.
        self._growing: tuple[Path, int] | None = None
        # Of the page before, if another one follows: a file that grows has no index, and is read as
        # a whole to be opened.
        self._opened: _Opened | None = None
        session = node.session
        self._declared = [
            session.queryable(self._key, self._on_query, long=True),
            session.token(self._key),
        ]

    def close(self) -> None:
        """Serve nothing from now on. Twice is fine."""
        for each in reversed(self._declared):
            each.close()
        self._keep(None)

    def _keep(self, opened: _Opened | None) -> None:
        """Keep these files open for the next page, and no others."""
        with self._lock:
            former, self._opened = self._opened, opened
        if former is not None:
            former.reader.close()

    @contextmanager
    def _reader(self, paths: list[Path], end_ns: int) -> Iterator[RecordingReader]:
        """A reader of files that has all their items up to a log time."""
        with self._lock:
            opened, self._opened = self._opened, None
        if opened is not None and (opened.paths != paths or end_ns > opened.until_ns):
            opened.reader.close()
            opened = None
        if opened is None:
            until_ns = scheduler.time_ns() - _WRITTEN_AFTER_NS
            reader = RecordingReader(*paths, on_damage=lambda part, damage: None)
            opened = _Opened(paths, until_ns, reader)
        try:
            yield opened.reader
        finally:
            self._keep(opened)

    def _on_query(self, query: Query) -> None:
        with suppress(BusError), query.answering("what is kept"):
            now_ns = scheduler.time_ns()
            begin_ns, end_ns = _span(query, now_ns)
            selection = ALL
            if query.payload:
                selection = decode_message(Wanted, query.payload).selection()
            most = int(_number(query, "page", _LARGEST_PAGE))
            most = min(max(most, _LEAST_PAGE), _LARGEST_PAGE)
            page = self.page(begin_ns, end_ns, most, selection)
            if not page.next:
                self._keep(None)
            query.answer(self._key, encode_page(page._replace(now_ns=now_ns)))

    def page(self, begin_ns: int, end_ns: int, most_bytes: int, selection: Selection = ALL) -> Page:
        """The first items between two log times: of at most so many bytes, or all of the first log
        time.
        """
        taken: list[KeptMessage] = []
        size = 0
        for item in self._items(begin_ns, end_ns, selection):
            if not _was_sent(item):
                continue
            kept = message_of(item)
            size += len(kept.payload)
            # Messages of one log time come together: the next page begins with a later one.
            if taken and size > most_bytes and item.log_ns > taken[-1].log_ns:
                left_s = (end_ns - item.log_ns) / 1e9
                return Page(taken, f"{item.log_ns}.{end_ns}", left_s)
            taken.append(kept)
        return Page(taken)

    def _items(self, begin_ns: int, end_ns: int, selection: Selection) -> Iterator[Item]:
        state = BusState()
        # One after the other: a page is mostly of one file, and there may be hundreds.
        for paths in self._in_turn(begin_ns, end_ns):
            with self._reader(paths, end_ns) as reader:
                for item in reader.items(begin_ns, end_ns, selection):
                    # Each file begins with the state in force.
                    if not state.says(item):
                        state.apply(item)
                        yield item

    def _in_turn(self, begin_ns: int, end_ns: int) -> Iterator[list[Path]]:
        """The files with items between two log times; together the files whose spans overlap."""
        paths = self._parts.files
        found = [(span, path) for path in paths if (span := self._span_of(path, paths[-1]))]
        group: list[Path] = []
        until_ns = -1
        for (from_ns, to_ns), path in sorted(found):
            if from_ns > end_ns or to_ns < begin_ns:
                continue
            if group and from_ns > until_ns:
                yield group
                group = []
            group.append(path)
            until_ns = max(until_ns, to_ns)
        if group:
            yield group

    def _span_of(self, path: Path, last: Path) -> tuple[int, int] | None:
        with self._lock:
            span, growing = self._spans.get(path), self._growing
        if span is None and path == last and growing is not None and growing[0] == path:
            return growing[1], _LAST_NS
        if span is None:
            try:
                with RecordingReader(path) as reader:
                    span = reader.start_ns, reader.end_ns
                    with self._lock:
                        if reader.is_complete:
                            self._spans[path] = span
                        elif path == last:
                            self._growing = path, span[0]
            except (TfbusError, OSError):
                return None  # it was deleted, or has only begun
        return span


def _was_sent(item: Item) -> bool:
    if isinstance(item, EventItem):
        return item.kind in ("stream", "stream gone", "node", "node gone")
    return not (isinstance(item, TopicItem) and item.repeated)


def message_of(item: Item) -> KeptMessage:
    """An item as it was sent on the bus, at its full key: as a session without a namespace has it.

    An event of a stream or node is at `@tfbus/stream/` or `@tfbus/node/` and the full name,
    escaped: its description, or nothing.
    """
    if isinstance(item, TransformItem):
        stream = item.stream
        prefix = f"{stream.namespace}/" if stream.namespace else ""
        key = f"{prefix}{'tf_static' if item.static else 'tf'}/"
        key += escape(stream.name.removeprefix(prefix))
        if stream.split and not item.static:
            key += f"/{escape(min(item.rows.children(), default=''))}"
        message = TransformMessage(item.rows, stream.epoch_ns, item.seq)
        return KeptMessage(key, item.log_ns, encode_transforms(message))
    if isinstance(item, EventItem):
        kind = STREAM if item.kind.startswith("stream") else NODE
        facts = item.facts if item.kind in ("stream", "node") else {}
        payload = encode_map(facts) if facts else b""
        return KeptMessage(f"{kind}{escape(item.name)}", item.log_ns, payload)
    return KeptMessage(item.topic, item.log_ns, encode_map(item.values))


def _span(query: Query, now_ns: int) -> tuple[int, int]:
    """The log times that a query asks for, both included."""
    if place := query.parameter("from"):
        begin, _, end = place.partition(".")
        if begin.isdecimal() and end.isdecimal() and len(place) < 50:
            return int(begin), int(end)
        raise InvalidArgumentException(f"{place!r:.60} is no place in what is kept")
    begin_s, end_s = _number(query, "last_s", math.inf), _number(query, "until_s", 0.0)
    begin_ns = now_ns - int(min(begin_s, now_ns / 1e9) * 1e9)
    return begin_ns, now_ns - max(int(end_s * 1e9), _WRITTEN_AFTER_NS)


def _number(query: Query, name: str, default: float) -> float:
    text = query.parameter(name)
    if text is None:
        return default
    with suppress(ValueError):
        if 0.0 <= (number := float(text)) <= 1e10:
            return number
    raise InvalidArgumentException(f"{name} must be a number, 0 or more, not {text!r:.40}")
