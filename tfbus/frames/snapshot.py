"""The tree of frames at one moment, with the publisher of each edge and what is wrong."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import FrameInfo
from tfbus.listen.info import StreamInfo
from tfbus.wire.fleet import shared_name
from tfbus.wording import counted

ProblemKind = Literal["loop", "conflict", "gone", "disconnected", "orphan", "silent"]

_NS_PER_S = 1e9


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with the tree: its kind, the frames it is about, and a sentence."""

    kind: ProblemKind
    frames: tuple[str, ...]
    text: str


@dataclass(frozen=True)
class FrameTree:
    """All frames by name, and all streams by name, as they were at `recorded_ns` (ns since the
    Unix epoch).
    """

    frames: Mapping[str, FrameInfo]
    streams: Mapping[str, StreamInfo]
    recorded_ns: int

    @property
    def roots(self) -> list[FrameInfo]:
        """The frames without a parent: the one of the largest tree first, then by name."""
        roots = [frame for frame in self.frames.values() if frame.parent is None]
        return sorted(roots, key=lambda root: (-len(self.below(root.name)), root.name))

    def below(self, frame: str) -> list[str]:
        """All frames below this one, a parent always before its children."""
        return [info.name for _, info in self.walk(frame)][1:]

    def walk(self, frame: str) -> Iterator[tuple[int, FrameInfo]]:
        """The frame and all below it, with their depth: each before its children."""
        stack = [(0, frame)]  # a tree may be deeper than Python's own stack
        while stack:
            depth, name = stack.pop()
            info = self.frames[name]
            yield depth, info
            stack += [(depth + 1, child) for child in reversed(self.children(name))]

    def children(self, frame: str) -> list[str]:
        """The frames right below this one, by name."""
        return sorted(child for child in self.frames[frame].children if child in self.frames)

    def age_s(self, frame: FrameInfo) -> float | None:
        """How old the newest sample of a frame is; None where it is static or has none."""
        if frame.static or frame.newest_ns is None:
            return None
        return (self.recorded_ns - frame.newest_ns) / _NS_PER_S

    def kept_s(self, frame: FrameInfo) -> float | None:
        """How long a time the samples of a frame span; None where it is static or has none."""
        if frame.static or frame.newest_ns is None or frame.oldest_ns is None:
            return None
        return (frame.newest_ns - frame.oldest_ns) / _NS_PER_S

    def publisher(self, frame: FrameInfo) -> StreamInfo:
        """The stream that the frame's last transform came in."""
        return self.streams.get(frame.authority, StreamInfo(frame.authority))

    def claims(self) -> dict[str, list[tuple[str, StreamInfo]]]:
        """For each child frame the parents that living streams give it, and by which stream."""
        claims: dict[str, list[tuple[str, StreamInfo]]] = {}
        for stream in self.streams.values():
            if stream.alive:
                for parent, child, _ in stream.frames:
                    claims.setdefault(child, []).append((parent, stream))
        return claims

    def problems(self) -> list[Problem]:
        """What is wrong with the tree, the worst first; nothing where all is well."""
        claims = self.claims()
        return [
            *_loops(claims),
            *_conflicts(claims),
            *self._gone(),
            *self._disconnected(),
            *self._silent(claims),
        ]

    def _gone(self) -> Iterator[Problem]:
        by_stream: dict[str, list[str]] = {}
        for frame in self.frames.values():
            if frame.gone:
                by_stream.setdefault(frame.authority, []).append(frame.name)
        for name, frames in by_stream.items():
            stream = self.streams.get(name, StreamInfo(name))
            yield Problem(
                "gone",
                tuple(frames),
                f"the publisher of {listed(frames)} is gone: {who(stream)}",
            )

    def _disconnected(self) -> Iterator[Problem]:
        main, *others = [root.name for root in self.roots] or [""]
        for name in others:
            below = self.below(name)
            shared = shared_name(main, name)
            if below:
                hint = f"; if the robots share {shared!r}, say so: --shared {shared}"
                yield Problem(
                    "disconnected",
                    (name, *below),
                    f"{name!r} and {counted(len(below), 'frame')} below it are a tree apart: no "
                    f"transform joins {name!r} to the tree of {main!r}{hint if shared else ''}",
                )
            else:
                yield Problem(
                    "orphan", (name,), f"{name!r} is alone: no transform joins it to another frame"
                )

    def _silent(self, claims: Mapping[str, list[tuple[str, StreamInfo]]]) -> Iterator[Problem]:
        for stream in self.streams.values():
            told = [child for _, child, _ in stream.frames if child not in self.frames]
            if stream.alive and told:
                yield Problem(
                    "silent",
                    tuple(told),
                    f"no transform of {listed(told)} has come, though {who(stream)} tells of it",
                )


def frame_tree(buffer: Buffer, streams: Iterable[StreamInfo], recorded_ns: int) -> FrameTree:
    """What the buffer and its listener know at the time `recorded_ns`."""
    frames = {frame.name: frame for frame in buffer.all_frames()}
    return FrameTree(frames, {stream.name: stream for stream in streams}, recorded_ns)


def who(stream: StreamInfo) -> str:
    """A publisher as a person looks for it: its node, host and pid."""
    if not stream.node:
        return f"stream {stream.name!r}"
    return f"{stream.node} on {stream.host}, pid {stream.pid}"


def listed(frames: list[str], most: int = 5) -> str:
    """Names of frames in a sentence; the first few of many."""
    named = ", ".join(repr(frame) for frame in frames[:most])
    rest = len(frames) - most
    return f"{named} and {rest} more" if rest > 0 else named


def _conflicts(claims: Mapping[str, list[tuple[str, StreamInfo]]]) -> Iterator[Problem]:
    for child, claimed in claims.items():
        if len({stream.name for _, stream in claimed}) > 1:
            sides = "; ".join(f"{who(stream)} under {parent!r}" for parent, stream in claimed)
            yield Problem(
                "conflict", (child,), f"{child!r} is published by several at once: {sides}"
            )


def _loops(claims: Mapping[str, list[tuple[str, StreamInfo]]]) -> Iterator[Problem]:
    """The loops that the edges of living streams would make; a buffer refuses to close them."""
    done: set[str] = set()
    for start in claims:
        path: list[str] = []
        stack = [(start, 0)]
        while stack:
            child, depth = stack.pop()
            del path[depth:]
            if child in path:
                loop = path[path.index(child) :]
                sides = {who(stream): None for frame in loop for _, stream in claims[frame]}
                yield Problem(
                    "loop",
                    tuple(loop),
                    f"{' -> '.join(repr(frame) for frame in [*loop, child][::-1])} is a loop, "
                    f"made by {' and '.join(sides)}: one has parent and child the wrong way round",
                )
            elif child not in done:
                path.append(child)
                stack += [(parent, depth + 1) for parent, _ in claims.get(child, ())]
            done.add(child)
