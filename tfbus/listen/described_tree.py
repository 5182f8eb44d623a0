"""The tree of frames by the streams' descriptions, and which of its edges a lookup needs.

It knows which stream sends which edge, and on which key, without a transform.
"""

from collections import Counter
from collections.abc import Callable, Iterable
from typing import NamedTuple

from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.fleet import FrameNames
from tfbus.wire.keys import static_transforms_key_beside, transforms_key_beside

# Streams come and go: at most this many of those that are gone are remembered.
_MOST_GONE = 1000

# Target frame, source frame.
Pair = tuple[str, str]


class DescribedEdge(NamedTuple):
    """An edge from parent to child that a stream says it sends, and the key that carries it.

    An edge that only the buffer has has no stream and no key.
    """

    parent: str
    child: str
    static: bool
    stream: str
    key: str


def described_edges(
    stream: str, stream_key: str, description: StreamDescription, names: FrameNames | None = None
) -> list[DescribedEdge]:
    """The edges of a stream whose token is at `stream_key`; `names` is how its frames are called
    here, None for their own names.
    """
    whole = transforms_key_beside(stream_key)
    static_key = static_transforms_key_beside(stream_key)
    called = (lambda frame: frame) if names is None else names.outside
    edges = []
    for parent, child, static in description.frames:
        dynamic_key = transforms_key_beside(stream_key, child) if description.split else whole
        key = static_key if static else dynamic_key
        edges.append(DescribedEdge(called(parent), called(child), static, stream, key))
    return edges


class DescribedTree:
    """The edges that all streams describe. Not safe from several threads at once.

    `parent_elsewhere(frame)` gives the parent of a frame that no stream describes as a child: the
    application may have put such an edge into the buffer.
    """

    def __init__(self, parent_elsewhere: Callable[[str], str | None] = lambda frame: None) -> None:
        self._parent_elsewhere = parent_elsewhere
        self._streams: dict[str, list[DescribedEdge]] = {}
        self._gone: dict[str, None] = {}
        self._above: dict[str, dict[str, DescribedEdge]] = {}
        # How many edges begin at a frame.
        self._below: Counter[str] = Counter()

    def update(self, stream: str, edges: list[DescribedEdge], *, alive: bool) -> None:
        """Take the edges of a stream in place of its former ones."""
        self._remove(stream)
        self._streams[stream] = edges = list({edge.child: edge for edge in edges}.values())
        for edge in edges:
            self._above.setdefault(edge.child, {})[stream] = edge
            self._below[edge.parent] += 1
        if not alive:
            self._gone[stream] = None
            if len(self._gone) > _MOST_GONE:
                self._remove(next(iter(self._gone)))

    def _remove(self, stream: str) -> None:
        self._gone.pop(stream, None)
        for edge in self._streams.pop(stream, ()):
            above = self._above[edge.child]
            del above[stream]
            if not above:
                del self._above[edge.child]
            self._below[edge.parent] -= 1
            if not self._below[edge.parent]:
                del self._below[edge.parent]

    def frames(self) -> set[str]:
        """All frames that a stream describes, as a child or as a parent."""
        return self._above.keys() | self._below.keys()

    def describes(self, frame: str) -> bool:
        """Whether a stream describes the frame, as a child or as a parent."""
        return frame in self._above or frame in self._below

    def children(self, key: str, stream: str) -> set[str]:
        """The child frames that a stream sends on one key."""
        return {edge.child for edge in self._streams.get(stream, ()) if edge.key == key}

    def edges_needed(self, pairs: Iterable[Pair]) -> list[DescribedEdge]:
        """The edges that lookups between the pairs of frames are made of, each once.

        They are those above the target and the source, up to the lowest frame that is above both,
        or to the roots if nothing joins them. If streams disagree about the parent of a
        frame, only their transforms show which one counts: then all ways up are needed.
        """
        needed = (edge for target, source in pairs for edge in self._between(target, source))
        return list(dict.fromkeys(needed))

    def are_connected(self, target: str, source: str) -> bool:
        """Whether a frame is above both."""
        return not self._ways_up(target).keys().isdisjoint(self._ways_up(source))

    def roots(self, frame: str) -> list[str]:
        """The topmost frames above a frame, sorted; one where streams agree."""
        return sorted(above for above, edges in self._ways_up(frame).items() if not edges)

    def _between(self, target: str, source: str) -> list[DescribedEdge]:
        from_target, from_source = self._ways_up(target), self._ways_up(source)
        ways = from_target | from_source
        if target != source and all(map(_agree, ways.values())):
            for frame in from_target.keys() & from_source.keys():
                del ways[frame]
        return [edge for edges in ways.values() for edge in edges if edge.stream]

    def _ways_up(self, frame: str) -> dict[str, list[DescribedEdge]]:
        """The frame and all above it, each with the edges that lead further up."""
        ways: dict[str, list[DescribedEdge]] = {}
        ahead = [frame]
        while ahead:
            frame = ahead.pop()
            if frame not in ways:
                ways[frame] = self._edges_above(frame)
                ahead += [edge.parent for edge in ways[frame]]
        return ways

    def _edges_above(self, frame: str) -> list[DescribedEdge]:
        """The edges above a frame; those of gone streams only if no other has it."""
        edges = list(self._above.get(frame, {}).values())
        if not edges:
            parent = self._parent_elsewhere(frame)
            return [] if parent is None else [DescribedEdge(parent, frame, True, "", "")]
        return [edge for edge in edges if edge.stream not in self._gone] or edges


def _agree(edges: list[DescribedEdge]) -> bool:
    return len({edge.parent for edge in edges}) <= 1
