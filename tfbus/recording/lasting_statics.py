"""Static transforms that hold at all times of a recording, also before they were received."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from typing import Literal

from tfbus.core.packed import edge_bytes
from tfbus.geometry.columns import Columns
from tfbus.recording.items import TransformItem
from tfbus.recording.reader import RecordingReader

# Which static transforms a lookup knows: those of the whole recording, or those received by then.
Statics = Literal["always", "then"]
STATICS: tuple[Statics, ...] = ("always", "then")


class LastingStatics:
    """The static transforms that each frame was given first: they hold before they came, too, as
    static transforms do in a buffer that has all of the recording.

    Of a frame that several streams set the first one counts. Only chunks are read in which a frame
    is static for the first time.
    """

    def __init__(self, reader: RecordingReader) -> None:
        first: dict[str, TransformItem] = {}
        for item in _first_sets(reader):
            for child in item.rows.children():
                if child not in first or item.log_ns < first[child].log_ns:
                    first[child] = item
        # By stream: its sets with frames that come first there, and these frames.
        self._of_stream: dict[str, list[tuple[TransformItem, frozenset[str]]]] = {}
        own: dict[int, set[str]] = {}
        for child, item in first.items():
            own.setdefault(id(item), set()).add(child)
        for item in {id(each): each for each in first.values()}.values():
            children = frozenset(own[id(item)])
            self._of_stream.setdefault(item.stream.name, []).append((item, children))

    def with_later(self, sets: Iterable[TransformItem], log_ns: int) -> list[TransformItem]:
        """The static sets in force at a log time, with the frames that come later only."""
        found = {item.stream.name: self.widened(item) for item in sets}
        for name, firsts in self._of_stream.items():
            if name not in found and all(item.log_ns > log_ns for item, _ in firsts):
                earliest = min((item for item, _ in firsts), key=lambda item: item.log_ns)
                found[name] = self.widened(replace(earliest, log_ns=log_ns, rows=_NONE, seq=None))
        return list(found.values())

    def widened(self, item: TransformItem) -> TransformItem:
        """A static set with the frames that its stream sets later for the first time."""
        own = item.rows.children()
        later = [
            first.rows.only(children - own)
            for first, children in self._of_stream.get(item.stream.name, ())
            if first.log_ns > item.log_ns and not children <= own
        ]
        return replace(item, rows=_joined([item.rows, *later])) if later else item


_NONE = Columns.of_bytes((), b"", b"", b"")


def _joined(parts: list[Columns]) -> Columns:
    """All rows, as they are: those of a file may be no valid transforms."""
    numbers: dict[str, int] = {}
    edges = [
        edge_bytes(
            numbers.setdefault(rows.frames[parent], len(numbers)),
            numbers.setdefault(rows.frames[child], len(numbers)),
        )
        for rows in parts
        for parent, child in rows.pairs()
    ]
    stamps = b"".join(rows.stamps_bytes() for rows in parts)
    poses = b"".join(rows.poses_bytes() for rows in parts)
    return Columns.of_bytes(tuple(numbers), b"".join(edges), stamps, poses)


def _first_sets(reader: RecordingReader) -> list[TransformItem]:
    """The sets of static transforms of the chunks in which a frame is static for the first time."""
    numbers = {(chunk.part.number, chunk.offset): at for at, chunk in enumerate(reader.chunks)}
    first: dict[tuple[str, str], int] = {}
    for part in reader.parts:
        index = part.index
        statics = {each.id for each in part.stream_channels.values() if each.is_static}
        for chunk, channel, edge in zip(
            index.chunk.tolist(), index.channel.tolist(), index.edge.tolist(), strict=True
        ):
            if channel in statics:
                key = part.stream_channels[channel].stream.name, index.edges[edge][1]
                at = numbers[part.number, index.offsets[chunk]]
                first[key] = min(at, first.get(key, at))
    wanted: dict[int, set[str]] = defaultdict(set)
    for (stream, _), at in first.items():
        wanted[at].add(stream)
    chunks = list(reader.chunks)
    return [
        item
        for at in sorted(wanted)
        for item, _ in chunks[at].statics()
        if item.stream.name in wanted[at]
    ]
