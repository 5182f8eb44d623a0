"""Which streams claim which frame, and which of them has the right of way."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

from tfbus.errors import InvalidArgumentException
from tfbus.wire.descriptions import StreamDescription

# What wins: who sent last, as in tf2; who was first; or who has the higher priority.
Rule = Literal["latest", "first", "priority"]

# Names come from the bus: what is remembered of them has an end.
_MOST_TOLD = 10_000

_FRAMES_NAMED = 5


@dataclass(frozen=True)
class Claimant:
    """A living stream that lists a frame as its own."""

    stream: str
    description: StreamDescription

    @cached_property
    def _parents(self) -> dict[str, str]:
        return {child: parent for parent, child, _ in self.description.frames}

    def parent_of(self, child: str) -> str | None:
        """The parent that it gives this frame."""
        return self._parents.get(child)

    def __str__(self) -> str:
        told = self.description
        return f"{self.stream!r} of {told.node} (host {told.host or '?'}, pid {told.pid or '?'})"


@dataclass(frozen=True)
class Resolution:
    """Frames that a stream may send, and frames that it may not."""

    accepted: set[str]
    rejected: set[str]


@dataclass(frozen=True)
class Conflict:
    """Two living streams that claim the same frames; `first` has been there longer or wins."""

    first: Claimant
    other: Claimant
    frames: tuple[str, ...]


class Claims:
    """Who claims which frame, by the descriptions of living streams; so it comes out the same
    in every listener. Safe in one thread at a time.
    """

    def __init__(self, rule: Rule) -> None:
        if rule not in get_args(Rule):
            raise InvalidArgumentException(
                f"conflicts={rule!r} is not known; choose one of {', '.join(get_args(Rule))}"
            )
        self.rule = rule
        self._claims: dict[str, dict[str, Claimant]] = {}
        self._children: dict[str, frozenset[str]] = {}
        self._told: set[frozenset[str]] = set()

    def update(self, stream: str, description: StreamDescription | None) -> set[str]:
        """Take what a stream claims now, nothing where it is not there: the frames that several
        claim or have claimed.
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
        """What follows for each stream after `update` of one: which of the frames it may send,
        and of which another has the right of way.
        """
        resolutions: dict[str, Resolution] = {stream: Resolution(set(contested), set())}
        for child in contested:
            for at, claimant in enumerate(self._ranked(child)):
                resolution = resolutions.setdefault(claimant.stream, Resolution(set(), set()))
                resolution.accepted.discard(child)
                wins = at == 0 or self.rule == "latest"
                (resolution.accepted if wins else resolution.rejected).add(child)
        return resolutions

    def news(self, contested: Iterable[str]) -> list[Conflict]:
        """The conflicts over these frames that have not been told yet; each pair is told once."""
        shared: dict[tuple[str, str], list[str]] = {}
        claimants: dict[str, Claimant] = {}
        for child in sorted(contested):
            ranked = self._ranked(child)
            claimants |= {claimant.stream: claimant for claimant in ranked}
            for other in ranked[1:]:
                shared.setdefault((ranked[0].stream, other.stream), []).append(child)
        news = []
        for pair, frames in shared.items():
            if frozenset(pair) not in self._told:
                if len(self._told) >= _MOST_TOLD:
                    self._told.clear()
                self._told.add(frozenset(pair))
                first, other = (claimants[stream] for stream in pair)
                news.append(Conflict(first, other, tuple(frames)))
        return news

    def _others(self, child: str, stream: str) -> bool:
        return any(other != stream for other in self._claims.get(child, ()))

    def _ranked(self, child: str) -> list[Claimant]:
        return sorted(self._claims.get(child, {}).values(), key=self._rank)

    def _rank(self, claimant: Claimant) -> tuple[int, int, str]:
        told = claimant.description
        priority = -told.priority if self.rule == "priority" else 0
        # The epoch grows where a clock goes back, and is no younger a publisher for it.
        return (priority, told.started_ns or told.epoch, claimant.stream)


def name_some(frames: Sequence[str]) -> str:
    """The first few frames, and how many more there are, to be said in a line."""
    more = len(frames) - _FRAMES_NAMED
    named = ", ".join(map(repr, frames[:_FRAMES_NAMED]))
    return f"{named} and {more} more" if more > 0 else named


def _children(description: StreamDescription | None) -> frozenset[str]:
    frames = () if description is None else description.frames
    return frozenset(child for _, child, _ in frames)
