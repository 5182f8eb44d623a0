"""Which streams claim which frame, and which of them has priority."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

from tfbus.errors import InvalidArgumentException
from tfbus.wire.descriptions import StreamDescription
from tfbus.wording import listed

# Which publisher wins: the last to send, as in tf2; the first started; or the highest priority.
Rule = Literal["latest", "first", "priority"]

# Names come from the bus: at most this many reported pairs are remembered.
_MOST_REPORTED = 10_000

_FRAMES_NAMED = 5


@dataclass(frozen=True)
class Claimant:
    """A live stream that lists a frame as its own."""

    stream: str
    description: StreamDescription

    @cached_property
    def _parents(self) -> dict[str, str]:
        return {child: parent for parent, child, _ in self.description.frames}

    def parent_of(self, child: str) -> str | None:
        """The parent that it lists for this frame."""
        return self._parents.get(child)

    def __str__(self) -> str:
        by = self.description
        return f"{self.stream!r} of {by.node} (host {by.host or '?'}, pid {by.pid or '?'})"


@dataclass(frozen=True)
class Resolution:
    """The frames of a stream that are accepted, and those that are rejected."""

    accepted: set[str]
    rejected: set[str]


@dataclass(frozen=True)
class Conflict:
    """Two live streams that claim the same frames; `first` has priority, or was started first."""

    first: Claimant
    other: Claimant
    frames: tuple[str, ...]


class Claims:
    """The claims to frames, by the descriptions of live streams: the same in every listener.

    Not safe from several threads at once.
    """

    def __init__(self, rule: Rule) -> None:
        if rule not in get_args(Rule):
            raise InvalidArgumentException(
                f"conflicts must be one of {', '.join(get_args(Rule))}, not {rule!r}"
            )
        self.rule = rule
        self._claims: dict[str, dict[str, Claimant]] = {}
        self._children: dict[str, frozenset[str]] = {}
        self._reported: set[frozenset[str]] = set()

    def update(self, stream: str, description: StreamDescription | None) -> set[str]:
        """Take the frames that a stream lists now, None where it is gone.

        Returns the frames among its former and present ones that another stream claims too.
        """
        claimed = _children(description)
        former = self._children.get(stream, frozenset())
        for child in former - claimed:
            self._claims[child].pop(stream)
        if description is not None:
            claimant = Claimant(stream, description)
            for child in claimed:
                self._claims.setdefault(child, {})[stream] = claimant
        self._children[stream] = claimed
        touched = former | claimed
        contested = {child for child in touched if self._others(child, stream)}
        for child in former - claimed:
            if not self._claims[child]:
                del self._claims[child]
        if not claimed:
            del self._children[stream]
        return contested

    def resolutions(self, stream: str, contested: Iterable[str]) -> dict[str, Resolution]:
        """For each stream its resolution over `contested`, what `update` of `stream` returned."""
        resolutions: dict[str, Resolution] = {stream: Resolution(set(contested), set())}
        for child in contested:
            for at, claimant in enumerate(self._ranked(child)):
                resolution = resolutions.setdefault(claimant.stream, Resolution(set(), set()))
                resolution.accepted.discard(child)
                wins = at == 0 or self.rule == "latest"
                (resolution.accepted if wins else resolution.rejected).add(child)
        return resolutions

    def news(self, contested: Iterable[str]) -> list[Conflict]:
        """The conflicts over these frames that are new; each pair of streams is reported once."""
        shared: dict[tuple[str, str], list[str]] = {}
        claimants: dict[str, Claimant] = {}
        for child in sorted(contested):
            ranked = self._ranked(child)
            claimants |= {claimant.stream: claimant for claimant in ranked}
            for other in ranked[1:]:
                shared.setdefault((ranked[0].stream, other.stream), []).append(child)
        news = []
        for pair, frames in shared.items():
            if frozenset(pair) not in self._reported:
                if len(self._reported) >= _MOST_REPORTED:
                    self._reported.clear()
                self._reported.add(frozenset(pair))
                first, other = (claimants[stream] for stream in pair)
                news.append(Conflict(first, other, tuple(frames)))
        return news

    def _others(self, child: str, stream: str) -> bool:
        return any(other != stream for other in self._claims.get(child, ()))

    def _ranked(self, child: str) -> list[Claimant]:
        return sorted(self._claims.get(child, {}).values(), key=self._rank)

    def _rank(self, claimant: Claimant) -> tuple[int, int, str]:
        description = claimant.description
        priority = -description.priority if self.rule == "priority" else 0
        # Where a clock goes back the epoch grows, though the publisher is as old as before.
        return (priority, description.started_ns or description.epoch, claimant.stream)


def name_some(frames: Sequence[str]) -> str:
    """The first five frames, quoted, and how many more there are."""
    return listed([repr(frame) for frame in frames], most=_FRAMES_NAMED)


def _children(description: StreamDescription | None) -> frozenset[str]:
    frames = () if description is None else description.frames
    return frozenset(child for _, child, _ in frames)
