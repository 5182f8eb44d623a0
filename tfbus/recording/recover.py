"""The readable part of a recording that was cut short or damaged."""

import os
import re
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from heapq import merge
from operator import attrgetter

from tfbus.base.errors import DecodeError
from tfbus.base.wording import counted, listed
from tfbus.recording.items import ALL, Item
from tfbus.recording.mcap_file import McapFile
from tfbus.recording.part import Part, UnreadItem, read_items
from tfbus.recording.reader import in_order
from tfbus.recording.records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    MAGIC,
    MESSAGE,
    METADATA,
    PREFIX,
    SCHEMA,
    Chunk,
    Damage,
    Message,
    chunk_records,
    read_message,
    records_in,
    time_text,
    united,
)
from tfbus.recording.state import BusState
from tfbus.wire.limits import size_text

# The greatest opcode of MCAP's own; opcodes from the second on are left to others.
_LAST_OPCODE, _PRIVATE_OPCODES = 15, 0x80

# The length that these records have always.
_FIXED_LENGTHS = {FOOTER: 20, DATA_END: 4}

# The opcode of a chunk and its length, whose last four bytes are zero below 4 GB; and the size of a
# chunk's head before the name of its compression, from its opcode on.
_CHUNK_LIKE = re.compile(rb"(?=\x06.{4}\0{4})", re.DOTALL)
_CHUNK_HEAD = PREFIX.size + 8 + 8 + 8 + 4
_COMPRESSIONS = (b"zstd", b"lz4", b"")

_SEARCH_BYTES = 2**22

# Of the losses a file lists this number of itself.
_MOST_LINES = 20


@dataclass(frozen=True)
class Loss:
    """The unreadable parts: `damage` in the middle, the bytes behind the last whole record, and
    how many messages are of no known channel, or none of its type. `is_cut_short` is whether the
    file does not end as it should; `has_all_messages` whether that is behind the last of them. The
    recording is from `start_ns` to `end_ns`.
    """

    damage: tuple[Damage, ...]
    tail_bytes: int
    messages: int
    is_cut_short: bool
    has_all_messages: bool
    start_ns: int
    end_ns: int

    def __bool__(self) -> bool:
        return bool(self.damage or self.tail_bytes or self.messages or self.is_cut_short)

    def lines(self, *, in_utc: bool = False) -> list[str]:
        """Each loss in a line, with times since the beginning of the recording, or in UTC."""
        start_ns = None if in_utc else self.start_ns
        found = [each.text(start_ns) for each in self.damage if not each.what]
        if self.messages:
            found.append(f"{counted(self.messages, 'message')} that cannot be read")
        if self.is_cut_short and self.has_all_messages:
            found.append("the end, its index, but no message")
        elif self.is_cut_short:
            after = f"what came after {time_text(self.end_ns, start_ns)}"
            left = f" ({size_text(self.tail_bytes)} are there)" if self.tail_bytes else ""
            found.append(f"{after}{left}")
        return found

    def __str__(self) -> str:
        return listed(self.lines(in_utc=True), most=_MOST_LINES)


class Salvage:
    """Reads a file as far as it can. Raises DecodeError if nothing in it is of a recording, and
    OSError.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._file = file = _DamagedFile(path)
        self._part = Part(file)
        if not file.chunks and not self._part.events:
            self.close()
            raise DecodeError(f"{self._part.name} holds no recording that could be read")
        self.topics_left_out = tuple(
            sorted({each.topic for each in self._part.topic_channels.values() if not each.decode})
        )
        events = [event.log_ns for event in self._part.events]
        self.start_ns = min([*(chunk.from_ns for chunk in file.chunks), *events])
        self.end_ns = self._part.end_ns

    def close(self) -> None:
        """Close the file."""
        self._part.close()

    @property
    def loss(self) -> Loss:
        """The unreadable parts, once the items were."""
        file = self._file
        return Loss(
            tuple(united(file.damage)),
            file.tail_bytes,
            file.orphans + self._part.unreadable,
            not file.is_complete,
            file.has_all_messages,
            self.start_ns,
            self.end_ns,
        )

    @property
    def about(self) -> Mapping[str, str]:
        """The recorder's note on itself."""
        return self._part.about

    def items(self) -> Iterator[Item]:
        """The items in order of log time."""
        chunks = sorted(self._part.chunks, key=attrgetter("from_ns"))
        state = BusState()
        for item in merge(
            sorted(self._part.events, key=_log_ns),
            read_items(
                in_order(
                    ((chunk.from_ns, *chunk.items(ALL, self._part.tf)) for chunk in chunks), _log_ns
                )
            ),
            key=_log_ns,
        ):
            if not state.says(item):
                state.apply(item)
                yield item


def items_of_all(salvages: Iterable[Salvage]) -> Iterator[Item]:
    """The items of the files of one recording, in order of log time, without the state that each
    file repeats at its beginning.
    """
    state = BusState()
    for item in merge(*(salvage.items() for salvage in salvages), key=_log_ns):
        if not state.says(item):
            state.apply(item)
            yield item


def _log_ns(item: Item | UnreadItem) -> int:
    return item.log_ns


class _DamagedFile(McapFile):
    """Reads the records one after the other, and goes on at the next chunk if there is none.

    `tail_bytes` at the end were no records; `orphans` are messages of channels that are not known.
    `has_all_messages` is whether the part with messages ends as it should.
    """

    def _open(self) -> None:
        self.tail_bytes = self.orphans = 0
        self.has_all_messages = False
        # The chunks of the summary, if there is one, by the places where they begin.
        self._stated: dict[int, Chunk] = {}
        self._stated_at: list[int] = []  # their offsets, sorted
        self._counted: set[int] = set()
        self.size = os.fstat(self._file).st_size
        self._read_header()
        self._read_definitions()
        known = len(self.channels)
        self._scan()
        if self.orphans and len(self.channels) > known:
            # Their channels stand behind them, in a summary that is not where the footer says.
            self._forget_all_but_definitions()
            self._scan()

    def _read_definitions(self) -> None:
        """The records of the summary, if there is one: the chunk that has them may be lost."""
        try:
            self._read_summary()
        except DecodeError:
            self._clear()
            return
        self._stated = {chunk.offset: chunk for chunk in self.chunks}
        self._stated_at = sorted(self._stated)
        self._forget_all_but_definitions()

    def _forget_all_but_definitions(self) -> None:
        schemas, channels = dict(self.schemas), dict(self.channels)
        self._clear()
        self.tail_bytes = self.orphans = 0
        self._counted.clear()
        self.schemas.update(schemas)
        self.channels.update(channels)

    def _scan(self) -> None:
        # The latest time of the first `_seen` chunks.
        self._latest_ns = self._seen = 0
        at = len(MAGIC)
        bare_at = None  # where messages without a chunk begin
        is_summary = False
        while at < self.size:
            opcode, end = self._record_at(at)
            if bare_at is not None and opcode not in (MESSAGE, SCHEMA, CHANNEL):
                self._scan_chunk(Chunk(bare_at, at - bare_at, 0, 0, is_bare=True))
                bare_at = None
            if opcode == 0:
                end = self._next_chunk(at + 1)
                if end == self.size:
                    self.tail_bytes += end - at
                    # tfbus writes these between the last message and the end of that part.
                    self.has_all_messages |= self._read(at, 1)[0] in (ATTACHMENT, DATA_END)
                else:
                    self.note_damage(self._lost(at, end))
            elif opcode == FOOTER:
                self.is_complete = self._ends_well(at)
                return
            elif opcode == DATA_END:
                is_summary = self.has_all_messages = True
            elif is_summary and opcode in (SCHEMA, CHANNEL):
                with suppress(DecodeError):
                    self._take_definition(opcode, self._content(opcode, at, end - at))
            elif opcode in (CHUNK, METADATA, ATTACHMENT):
                self._scan_record(opcode, at, end - at)
            elif opcode in (MESSAGE, SCHEMA, CHANNEL) and bare_at is None:
                bare_at = at
            at = end
        if bare_at is not None:
            self._scan_chunk(Chunk(bare_at, at - bare_at, 0, 0, is_bare=True))

    def _lost(self, at: int, end: int) -> Damage:
        """Bytes in the middle that are no records, with the times and count of their chunks by the
        summary or, without one, the times of the chunks around them.
        """
        first = bisect_left(self._stated_at, at)
        offsets = self._stated_at[first : bisect_left(self._stated_at, end, first)]
        stated = [self._stated[offset] for offset in offsets]
        indexed = [self._damage_of(chunk, DecodeError("")) for chunk in stated]
        counts = [each.messages for each in indexed if each.messages]
        if stated:
            begin = min(chunk.from_ns for chunk in stated)
            until = max(chunk.to_ns for chunk in stated)
            return Damage(at, end - at, "no records", begin, until, sum(counts) or None)
        for chunk in self.chunks[self._seen :]:
            self._latest_ns = max(self._latest_ns, chunk.to_ns)
        self._seen = len(self.chunks)
        before = self._latest_ns
        behind = self._said_times(Chunk(end, 0, 0, 0)) if self._is_chunk(end) else []
        return Damage(
            at,
            end - at,
            "no records",
            *((before, behind[0]) if before and behind else (None, None)),
        )

    def _record_at(self, at: int) -> tuple[int, int]:
        """The opcode of the record here, and where it ends; opcode 0 if there is none."""
        found, end = self._prefix_at(at)
        is_last = end == self.size or (found == FOOTER and end + len(MAGIC) == self.size)
        if not found or is_last or self._prefix_at(end)[0]:
            return found, end
        # No record follows: one of the two lengths is wrong, unless the file is cut just there.
        try:
            if found == CHUNK:
                chunk_records(self._content(CHUNK, at, end - at))
            return (found, end) if found == CHUNK else (0, at)
        except DecodeError:
            return 0, at

    def _prefix_at(self, at: int) -> tuple[int, int]:
        if at + PREFIX.size > self.size:
            return 0, at
        opcode, length = PREFIX.unpack(self._read(at, PREFIX.size))
        end = at + PREFIX.size + length
        is_known = 0 < opcode <= _LAST_OPCODE or opcode >= _PRIVATE_OPCODES
        if not is_known or end > self.size or _FIXED_LENGTHS.get(opcode, length) != length:
            return 0, at
        return opcode, end

    def _next_chunk(self, at: int) -> int:
        """The beginning of the next chunk; the size of the file if there is none."""
        while at < self.size:
            block = self._read(at, min(_SEARCH_BYTES, self.size - at))
            for found in _CHUNK_LIKE.finditer(block):
                if self._is_chunk(at + found.start()):
                    return at + found.start()
            if at + len(block) == self.size:
                break
            at += len(block) - PREFIX.size
        return self.size

    def _is_chunk(self, at: int) -> bool:
        opcode, end = self._prefix_at(at)
        head = at + _CHUNK_HEAD
        if opcode != CHUNK or head + 4 > end:
            return False
        size = int.from_bytes(self._read(head, 4), "little")
        if size > 4 or head + 4 + size + 8 > end:
            return False
        name = self._read(head + 4, size)
        length = int.from_bytes(self._read(head + 4 + size, 8), "little")
        return name in _COMPRESSIONS and head + 4 + size + 8 + length == end

    def _messages(self, chunk: Chunk) -> list[Message]:
        data = self._records(chunk)
        messages = []
        orphans = 0
        for opcode, start, end in records_in(data):
            if opcode == MESSAGE:
                message = read_message(data, start, end)
                if message.channel in self.channels:
                    messages.append(message)
                else:
                    orphans += 1
            elif opcode in (SCHEMA, CHANNEL):
                self._take_definition(opcode, data[start:end])
        if chunk.offset not in self._counted:
            self._counted.add(chunk.offset)
            self.orphans += orphans
        return messages
