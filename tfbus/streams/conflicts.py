"""Frames that two live publishers claim: which of them has priority, and the report."""

import logging
from collections.abc import Callable, Iterable
from functools import cached_property
from itertools import islice
from typing import Literal, NamedTuple, get_args

from tfbus.base import scheduler
from tfbus.base.bounded import Bounded
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.structs import Struct
from tfbus.base.wording import quoted
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import Change
from tfbus.streams.reception import StreamReception
from tfbus.streams.stream_facts import lines_of
from tfbus.wire.descriptions import StreamDescription

# Which publisher wins: the last to send, as in tf2; the first started; or the highest priority.
Rule = Literal["latest", "first", "priority"]

# Names come from the bus: at most this many reported pairs are remembered.
_MOST_REPORTED = 10_000

# Of so many pairs of a stream and a frame that it asked for is it known which lists concern them.
_MOST_ASKED = 100_000

# And of one frame at most this many pairs are reported at once.
_MOST_OTHERS = 100

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
    """The accepted and the rejected frames of a stream."""

    accepted: set[str]
    rejected: set[str]


class Conflict(NamedTuple):
    """Two live streams that claim the same frames; `first` has priority, or was started first."""

    first: Claimant
    other: Claimant
    frames: tuple[str, ...]


class _Answer:
    """Which of these frames other streams list; None until that has been found."""

    __slots__ = ("children", "of_others")

    def __init__(self, children: frozenset[str]) -> None:
        self.children = children
        self.of_others: frozenset[str] | None = None


class _Answers:
    """The last answer to each stream, and which streams have asked for a frame. Safe from several
    threads at once.

    The frames of all questions of a stream count until one of them changes: messages of its former
    questions may still be under way. If they are too many, the next change concerns all streams.
    """

    def __init__(self) -> None:
        self._lock = scheduler.Lock()
        self._last: dict[str, _Answer] = {}
        self._frames: dict[str, set[str]] = {}
        self._streams: dict[str, set[str]] = {}
        self._count = 0
        self._of_any_frame: set[str] = set()

    def last(self, stream: str) -> _Answer | None:
        """The last answer to a stream, if no change has concerned it since."""
        return self._last.get(stream)

    def begin(self, stream: str, children: frozenset[str]) -> _Answer:
        """The answer to be found for a stream. A change from now on is told by `end`."""
        answer = _Answer(children)
        with self._lock:
            self._last[stream] = answer
            frames = self._frames.setdefault(stream, set())
            new = children - frames
            frames |= new
            for child in new:
                self._streams.setdefault(child, set()).add(stream)
            self._count += len(new)
            if self._count > _MOST_ASKED:
                self._of_any_frame.update(self._frames)
                self._frames.clear()
                self._streams.clear()
                self._count = 0
        return answer

    def end(self, stream: str, changed: frozenset[str], is_gone: bool) -> set[str]:
        """The streams whose answers no longer hold, since this one lists other frames."""
        with self._lock:
            ended = {stream} & self._frames.keys() if is_gone else set()
            if changed:
                ended.update(self._of_any_frame, *(self._streams.get(each, ()) for each in changed))
            if not is_gone:
                ended.discard(stream)
            for each in ended:
                self._forget(each)
        return ended

    def _forget(self, stream: str) -> None:
        self._of_any_frame.discard(stream)
        self._last.pop(stream, None)
        frames = self._frames.pop(stream, set())
        self._count -= len(frames)
        for child in frames:
            streams = self._streams[child]
            streams.discard(stream)
            if not streams:
                del self._streams[child]


class Claims:
    """The claims to frames, by the descriptions of live streams: the same in every listener.

    Not safe from several threads at once. A stream that lists thousands of frames which thousands
    of others list costs no more than its own.
    """

    def __init__(self, rule: Rule) -> None:
        if rule not in get_args(Rule):
            raise InvalidArgumentException(
                f"conflicts must be one of {', '.join(get_args(Rule))}, not {rule!r}"
            )
        self.rule = rule
        self._starts = Starts()
        self._claims: dict[str, dict[str, Claimant]] = {}
        self._children: dict[str, frozenset[str]] = {}
        # By stream; the least comes first.
        self._ranks: dict[str, Rank] = {}
        # By frame: the stream that comes first, and the one that did before the last update.
        self._firsts: dict[str, str] = {}
        self._displaced: dict[str, str] = {}
        self._reported: set[frozenset[str]] = set()
        self._answers = _Answers()
        # The streams for which the last update has changed the answer of `of_others`.
        self.outdated: set[str] = set()

    def update(self, stream: str, description: StreamDescription | None) -> set[str]:
        """Take the frames that a stream lists now, None if it is gone.

        Returns the frames among its former and present ones that another stream claims too.
        """
        claimed = listed_children(description)
        former = self._children.get(stream, frozenset())
        touched = former | claimed
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
        self.outdated = self._answers.end(stream, former ^ claimed, description is None)
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
        answer = self._answers.last(stream)
        if answer is not None and answer.children is children and answer.of_others is not None:
            return answer.of_others
        # Before the look at the claims: a change from then on ends the answer.
        answer = self._answers.begin(stream, children)
        claims = [(child, self._claims.get(child, ())) for child in children]
        of_others = frozenset(child for child, by in claims if len(by) > (stream in by))
        answer.of_others = of_others
        return of_others

    def resolutions(self, stream: str, contested: Iterable[str]) -> dict[str, Resolution]:
        """The possible changes, by stream, over the frames that `update` of `stream` returned."""
        resolutions: dict[str, Resolution] = {stream: Resolution(set(contested), set())}
        for child in sorted(contested):
            claims = self._claims.get(child, {})
            if self.rule == "latest":
                for each in claims:
                    resolutions.setdefault(each, Resolution(set(), set())).accepted.add(child)
                continue
            first = self._firsts.get(child)
            # Not a loop over the claims: thousands of streams may list the frame.
            concerned = dict.fromkeys((first, stream, self._displaced.get(child)))
            for name in (each for each in concerned if each is not None and each in claims):
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
        return (priority, *self._starts.start_ns(stream, description), stream)


class Starts:
    """When streams were started, as far as their word is worth it.

    A stream that says that it was started long before this listener first met it, while the
    listener was there to meet it, may say so to win: it counts as started when it was met. So it
    does if its clock is wrong. Streams met within 5 s of each other, as after a cut link, keep the
    order of their word.
    """

    def __init__(self) -> None:
        self._met_ns = scheduler.time_ns()
        self._is_late = False
        # By stream and session: a process is started once.
        self._starts: Bounded[tuple[str, str], tuple[int, int]] = Bounded(_MOST_STARTS)

    def start_ns(self, stream: str, description: StreamDescription) -> tuple[int, int]:
        """When a stream counts as started, then when it says so, both in ns."""
        # Where a clock goes back the epoch grows, though the publisher is as old as before.
        said_ns = description.started_ns or description.epoch
        key = (stream, description.session)
        known = self._starts.get(key)
        is_known = known is not None and (description.session or known[1] == said_ns)
        start = known if known is not None and is_known else self._judge(said_ns)
        self._starts[key] = start
        return start

    def _judge(self, said_ns: int) -> tuple[int, int]:
        now_ns = scheduler.time_ns()
        if now_ns > self._met_ns + _TOGETHER_NS:
            if said_ns > now_ns - _NEW_NS:
                return said_ns, said_ns
            self._met_ns = now_ns
            self._is_late = True
        return (self._met_ns, said_ns) if self._is_late else (said_ns, said_ns)


def listed_children(description: StreamDescription | None) -> frozenset[str]:
    """The child frames that a description lists; none without one."""
    frames = () if description is None else description.frames
    return frozenset(child for _, child, _ in frames)


class Conflicts:
    """Decides whose transforms of a frame are taken if several streams list it.

    `reception(name)` is a stream's, None if it has been forgotten. Not safe from several
    threads at once.
    """

    def __init__(
        self,
        rule: Rule,
        buffer: Buffer,
        reception: Callable[[str], StreamReception | None],
        log: logging.Logger,
    ) -> None:
        self._claims = Claims(rule)
        self._buffer = buffer
        self._reception = reception
        self._lines = lines_of(log)

    def judge(self, name: str, description: StreamDescription | None) -> None:
        """Take the frames that a stream lists now; None if its publisher is gone."""
        contested = self._claims.update(name, description)
        frames = listed_children(description)
        self._revoke_permits(self._claims.outdated)
        self._take_back(name, frames)
        if not contested:
            return
        for conflict in self._claims.news(name, contested):
            self._report(conflict)
        left = contested - frames
        resolutions = self._claims.resolutions(name, contested)
        receptions = self._known(resolutions)
        changed = [each.contest.exclude(*resolutions[each.name]) for each in receptions]
        # A static transform that gets priority, or that another has replaced, is not sent again.
        for each in receptions:
            accepted = resolutions[each.name].accepted
            taken = accepted if any(changed) else accepted & left
            each.statics.apply(taken - left if each.name == name else taken)

    def _known(self, names: Iterable[str]) -> list[StreamReception]:
        """The receptions of the streams of these names, without forgotten streams."""
        receptions = map(self._reception, names)
        return [reception for reception in receptions if reception is not None]

    def _revoke_permits(self, senders: set[str]) -> None:
        """Judge rows that these streams have under way again: other streams list other frames."""
        for reception in self._known(sorted(senders)):
            with reception.facts.lock:
                reception.facts.revoke_permit()

    def _take_back(self, name: str, frames: frozenset[str]) -> None:
        """Take the frames that a stream lists from streams that do not list them."""
        senders = self._buffer.senders_of(frames)
        for stream in self._known([name]):
            for sender in self._known(sorted(senders.keys() - {name})):
                unlisted = senders[sender.name] - sender.facts.listing.children
                if unlisted:
                    stream.contest.inherit(unlisted, sender.name)
                    stream.statics.apply(unlisted)

    def claimed_by_others(self, name: str, children: frozenset[str]) -> frozenset[str]:
        """Which of these frames, which the stream sends and does not list, other live streams list.
        Safe from any thread.
        """
        return self._claims.of_others(name, children)

    def restore(self, name: str, frames: frozenset[str]) -> None:
        """Put back the static transforms of the streams with priority for these frames, which the
        stream of this name has replaced since, or removed.
        """
        resolutions = self._claims.resolutions(name, frames)
        listed = [each.facts.listing.children for each in self._known([name])]
        for each in self._known(each for each in resolutions if each != name):
            accepted = resolutions[each.name].accepted
            each.contest.inherit(accepted.difference(*listed), name)
            each.statics.apply(accepted)

    def _report(self, conflict: Conflict) -> None:
        first, other, rule = conflict.first, conflict.other, self._claims.rule
        wins = {
            "latest": "the last to send wins",
            "first": f"{first.stream!r} wins, since it was started first",
            "priority": f"{first.stream!r} wins, by its priority or since it was started first",
        }
        self._lines.warning(
            (first.stream, other.stream),
            "Two publishers send %s: stream %s, and stream %s; %s (conflicts=%r). Stop one, or "
            "rename its frame",
            quoted(conflict.frames),
            first,
            other,
            wins[rule],
            rule,
        )
        for child in conflict.frames:
            parents = other.parent_of(child), first.parent_of(child)
            change = Change("conflict", child, *parents, other.stream, first.stream, 0)
            self._buffer.announce(change)
