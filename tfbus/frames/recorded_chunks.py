"""The chunks of a recording with the last transforms of frames, by its index."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tfbus.recording.reader import RecordingReader


def last_chunks(
    reader: RecordingReader,
    stream: str,
    outside: Callable[[str], str],
    frames: set[str],
    before_ns: int,
) -> set[tuple[int, int]]:
    """The log times, from and to, of the last chunks that begin before a time and have
    transforms of these frames of a stream; `outside` is how its frames are called here.
    """
    import numpy as np  # which a look at frames that all came needs not

    last: dict[str, tuple[int, int]] = {}
    spans = {(each.part.number, each.offset): (each.from_ns, each.to_ns) for each in reader.chunks}
    for part in reader.parts:
        channels = [
            channel.id for channel in part.stream_channels.values() if channel.stream.name == stream
        ]
        index = part.index
        edges = {
            number: name
            for number, (_, child) in enumerate(index.edges)
            if (name := outside(child)) in frames
        }
        if not channels or not edges:
            continue
        rows = np.isin(index.channel, channels) & np.isin(index.edge, list(edges))
        found = zip(index.edge[rows].tolist(), index.chunk[rows].tolist(), strict=True)
        for edge, chunk in found:
            span = spans[part.number, index.offsets[chunk]]
            name = edges[edge]
            if span[0] < before_ns and (name not in last or span[1] > last[name][1]):
                last[name] = span
    return set(last.values())
