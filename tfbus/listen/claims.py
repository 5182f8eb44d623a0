"""Which streams claim which frame, and which of them has priority."""

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from itertools import islice
from typing import Literal, NamedTuple, get_args

from tfbus.errors import InvalidArgumentException
from tfbus.runtime import scheduler
from tfbus.runtime.structs import Struct
from tfbus.wire.descriptions import StreamDescription
from tfbus.wording import listed

# Which publisher wins: the last to send, as in tf2; the first started; or the highest priority.
Rule = Literal["latest", "first", "priority"]

# Names come from the bus: at most this many reported pairs are remembered.
_MOST_REPORTED = 10_000

# And of one frame at most this many pairs are reported at once.
_MOST_OTHERS = 100

_FRAMES_NAMED = 5

# Streams that are met within this time of each other are met together. One that is new was started
# less than the other time ago: it may take a while to send.
_TOGETHER_NS = 5 * 10**9
_NEW_NS = 30 * 10**9
_MOST_STARTS = 100_000

# Priority, start and name: the order of publishers.
Rank = tuple[int, int, int, str]


class Claimant(Struct):
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


class Resolution(NamedTuple):
    """The frames of a stream that are accepted, and those that are rejected."""

    accepted: set[str]
    rejected: set[str]


class Conflict(NamedTuple):
    """Two live streams that claim the same frames; `first` has priority, or was started first."""

    first: Claimant
    other: Claimant
    frames: tuple[str, ...]


class Claims:
    """The claims to frames, by the descriptions of live streams: the same in every listener.

    Not safe from several threads at once. A stream that lists thousands of frames which thousands
    of others list costs no more than its own.
    """

    def __init__(self, rule: Rule, starts: "Starts | None" = None) -> None:
        if rule not in get_args(Rule):
            raise InvalidArgumentException(
                f"conflicts must be one of {', '.join(get_args(Rule))}, not {rule!r}"
            )
        self.rule = rule
        self._starts = starts or Starts()
        self._claims: dict[str, dict[str, Claimant]] = {}
        self._children: dict[str, frozenset[str]] = {}
        # By stream; the least comes first.
        self._ranks: dict[str, Rank] = {}
        # By frame: the stream that comes first, and the one that did before the last update.
        self._firsts: dict[str, str] = {}
        self._displaced: dict[str, str] = {}
        self._reported: set[frozenset[str]] = set()
        # By stream the frames that were last asked for, and which of them others claim; begun anew
        # by each update.
        self._asked: dict[str, tuple[frozenset[str], frozenset[str]]] = {}

    def update(self, stream: str, description: StreamDescription | None) -> set[str]:
        """Take the frames that a stream lists now, None if it is gone.

        Returns the frames among its former and present ones that another stream claims too.
        """
        claimed = listed_children(description)
        touched = self._children.get(stream, frozenset()) | claimed
        former_rank = self._ranks.pop(stream, None)
        if description is not None:
            self._ranks[stream] = self._rank(stream, description)
            claimant = Claimant(stream, description)
        self._displaced.clear()
        contested = set()
        for child in touched:
            claims = self._claims.setdefault(child, {})
            if child in claimed:
                claims[stream] = claimant
            else:
                claims.pop(stream, None)
            if not claims:
                del self._claims[child]
                self._firsts.pop(child, None)
                continue
            self._choose_first(child, stream, former_rank)
            if len(claims) > 1 or stream not in claims:
                contested.add(child)
        if claimed:
            self._children[stream] = claimed
        else:
            self._children.pop(stream, None)
        # After all else: an answer that was found meanwhile is kept nowhere.
        self._asked = {}
        return contested

    def _choose_first(self, child: str, stream: str, former_rank: "Rank | None") -> None:
        """The claim of a stream to a frame is new, another, or gone."""
        claims, ranks, first = self._claims[child], self._ranks, self._firsts.get(child)
        is_here = stream in claims
        if first is None:
            self._firsts[child] = stream if is_here else min(claims, key=ranks.__getitem__)
        elif first != stream:
            if is_here and ranks[stream] < ranks[first]:
                self._firsts[child], self._displaced[child] = stream, first
        elif not is_here or (former_rank is not None and ranks[stream] > former_rank):
            self._firsts[child] = min(claims, key=ranks.__getitem__)

    def of_others(self, stream: str, children: frozenset[str]) -> frozenset[str]:
        """Which of these frames live streams other than this one list. Safe from any thread.

        A stream that asks for the very same set again has its answer at once.
        """
        asked = self._asked
        last = asked.get(stream)
        if last is not None and last[0] is children:
            return last[1]
        claims = [(child, self._claims.get(child, ())) for child in children]
        of_others = frozenset(child for child, by in claims if len(by) > (stream in by))
        asked[stream] = children, of_others
        return of_others

    def resolutions(self, stream: str, contested: Iterable[str]) -> dict[str, Resolution]:
        """What may have changed over `contested`, what `update` of `stream` returned, by stream."""
        resolutions: dict[str, Resolution] = {stream: Resolution(set(contested), set())}
        for child in sorted(contested):
            claims = self._claims.get(child, {})
            if self.rule == "latest":
                for each in claims:
                    resolutions.setdefault(each, Resolution(set(), set())).accepted.add(child)
                continue
            first = self._firsts.get(child)
            concerned = first, stream, self._displaced.get(child)
            for name in (each for each in claims if each in concerned):
                resolution = resolutions.setdefault(name, Resolution(set(), set()))
                resolution.accepted.discard(child)
                (resolution.accepted if name == first else resolution.rejected).add(child)
        return resolutions

    def news(self, stream: str, contested: Iterable[str]) -> list[Conflict]:
        """The conflicts of a stream over these frames that are new: with the stream that comes
        first, or, if it does so itself, with the others. Each pair is reported once.
        """
        shared: dict[tuple[str, str], list[str]] = {}
        for child in sorted(contested):
            claims = self._claims.get(child, {})
            first = self._firsts.get(child, stream)
            others = islice(claims, _MOST_OTHERS) if first == stream else (stream,)
            for other in others:
                if other != first and other in claims:
                    shared.setdefault((first, other), []).append(child)
        news = []
        for pair, frames in shared.items():
            if frozenset(pair) not in self._reported:
                if len(self._reported) >= _MOST_REPORTED:
                    self._reported.clear()
                self._reported.add(frozenset(pair))
                claims = self._claims[frames[0]]
                news.append(Conflict(claims[pair[0]], claims[pair[1]], tuple(frames)))
        return news

    def _rank(self, stream: str, description: StreamDescription) -> "Rank":
        priority = -description.priority if self.rule == "priority" else 0
        return (priority, *self._starts.of(stream, description), stream)


class Starts:
    """When streams were started, as far as their word is worth it.

    A stream that says that it was started long before this listener first met it, while the
    listener was there to meet it, may say so to win: it counts as started when it was met. So it
    does if its clock is wrong. Of those met within 5 s of each other, as after a cut link, the
    order is that of their word. `clock_ns` is the system's clock.
    """

    def __init__(self, clock_ns: Callable[[], int] = lambda: scheduler.time_ns()) -> None:
        self._clock_ns = clock_ns
        self._met_ns = clock_ns()
        self._is_late = False
        # By stream and session: a process is started once.
        self._starts: dict[tuple[str, str], tuple[int, int]] = {}

    def of(self, stream: str, description: StreamDescription) -> tuple[int, int]:
        """When a stream counts as started, then when it says so, both in ns."""
        # Where a clock goes back the epoch grows, though the publisher is as old as before.
        said_ns = description.started_ns or description.epoch
        key = (stream, description.session)
        known = self._starts.pop(key, None)
        is_known = known is not None and (description.session or known[1] == said_ns)
        start = known if known is not None and is_known else self._judge(said_ns)
        self._starts[key] = start
        if len(self._starts) > _MOST_STARTS:
            del self._starts[next(iter(self._starts))]
        return start

    def _judge(self, said_ns: int) -> tuple[int, int]:
        now_ns = self._clock_ns()
        if now_ns > self._met_ns + _TOGETHER_NS:
            if said_ns > now_ns - _NEW_NS:
                return said_ns, said_ns
            self._met_ns = now_ns
            self._is_late = True
        return (self._met_ns, said_ns) if self._is_late else (said_ns, said_ns)


def name_some(frames: Sequence[str]) -> str:
    """The first five frames, quoted, and how many more there are."""
    return listed([repr(frame) for frame in frames], most=_FRAMES_NAMED)


def listed_children(description: StreamDescription | None) -> frozenset[str]:
    """The child frames that a description lists; none without one."""
    frames = () if description is None else description.frames
    return frozenset(child for _, child, _ in frames)
