"""Two live publishers of one frame: reports it, and drops transforms by the rule."""

import logging
import math
from collections.abc import Callable, Collection, Iterable
from typing import TYPE_CHECKING

from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import Change
from tfbus.geometry.columns import Columns, FoundOfRows
from tfbus.listen.claims import Claims, Conflict, Resolution, Rule, listed_children, name_some
from tfbus.listen.stream_facts import Listening, StreamFacts, lines_of
from tfbus.wire.descriptions import StreamDescription

if TYPE_CHECKING:
    from tfbus.listen.reception import StreamReception

# A publisher lists a frame a moment after it sends it: what is dropped until then is not logged.
_LISTED_WITHIN_S = 1.0

# Rows whose frames need not be judged again, in all messages of a stream.
_MOST_JUDGED_ROWS = 10_000


class _Judged:
    """A finding about the frames of rows: none is excluded while the stream lists `listed`, and
    others have priority for `excluded`. `unlisted` are the child frames that it does not list.
    """

    __slots__ = ("excluded", "listed", "unlisted")

    def __init__(
        self, listed: frozenset[str], excluded: frozenset[str], unlisted: frozenset[str]
    ) -> None:
        self.listed = listed
        self.excluded = excluded
        self.unlisted = unlisted


class Contest:
    """The third stage of a stream's reception: drops the rows of frames that others have.

    `excluded` are the frames for which another publisher has priority. Frames that other live
    streams list, and this one does not, are not its own either.
    """

    def __init__(self, facts: StreamFacts, around: Listening, now_s: Callable[[], float]) -> None:
        self.excluded: frozenset[str] = frozenset()
        self._facts = facts
        self._listing = facts.listing
        self._around = around
        self._now_s = now_s
        # What was found of the frames of its messages, mostly the same from one to the next.
        self._judged = FoundOfRows(_MOST_JUDGED_ROWS)
        # By frame the stream that it is taken from with the next message that has it.
        self._inherits: dict[str, str] = {}
        # When it first sent a frame that others list, and it did not.
        self._claimed_s = math.inf

    @property
    def judged_rows(self) -> int:
        """How many rows it has found something of, and keeps that."""
        return self._judged.count

    def uncontested(self, rows: Columns, epoch_ns: int, static: bool) -> Columns:
        """The rows of frames that the stream may have, by what others list now."""
        listing = self._listing
        judged: _Judged | None = self._judged.get(rows)
        if (
            judged is None
            or judged.listed is not listing.children
            or judged.excluded is not self.excluded
        ):
            rows, judged = self._judge(rows)
        if judged.unlisted:
            if not static and epoch_ns == listing.epoch_ns:
                self._around.on_unlisted(self._facts.name, judged.unlisted)
            if claimed := self._around.claimed_by_others(self._facts.name, judged.unlisted):
                rows = self._without_claimed(rows, claimed)
        if self._inherits:
            self._take_over(rows)
        return rows

    def exclude(self, resolution: Resolution) -> bool:
        """Accept frames from now on, and drop those that are rejected; whether that is new."""
        former = self.excluded
        excluded = (former - resolution.accepted) | resolution.rejected
        if excluded == former:
            return False
        with self._facts.lock:
            self.excluded = excluded
            self._facts.revoke_permit()
        # Its earlier samples lie between those of the other publisher, or in their future.
        self._facts.buffer.forget(self._facts.name, excluded - former)
        return True

    def inherit(self, frames: Collection[str], sender: str) -> None:
        """Take these frames, which it lists, from a stream that does not: what that has sent of one
        is dropped when this one sends it, so that none is missing meanwhile.
        """
        self._inherits.update(dict.fromkeys(frames, sender))

    def _judge(self, rows: Columns) -> tuple[Columns, _Judged]:
        """The rows that may come, and what holds for all rows like these until the stream lists
        other frames, or another one gets priority.
        """
        listed, excluded = self._facts.listing.children, self.excluded
        judged = _Judged(listed, excluded, rows.children() - listed)
        kept = self._without(rows, excluded) if excluded else rows
        if len(kept) == len(rows):
            self._judged.put(rows, judged)
        return kept, judged

    def _without(self, rows: Columns, excluded: frozenset[str]) -> Columns:
        kept = rows.without(excluded)
        with self._facts.lock:
            self._facts.counts.excluded += len(rows) - len(kept)
        return kept

    def _without_claimed(self, rows: Columns, claimed: frozenset[str]) -> Columns:
        """Without the frames that others list, and this stream does not. It may be about to list
        them; its static transforms are taken then.
        """
        now_s = self._now_s()
        self._claimed_s = min(self._claimed_s, now_s)
        if now_s > self._claimed_s + _LISTED_WITHIN_S:
            self._facts.warn_once(
                "claimed",
                "Dropped %s of stream %r, which does not list it: another stream does",
                name_some(sorted(claimed)),
                self._facts.name,
            )
        return self._without(rows, claimed)

    def _take_over(self, rows: Columns) -> None:
        for child in rows.children() & self._inherits.keys():
            sender = self._inherits.pop(child, None)
            if sender is not None:
                self._facts.buffer.forget(sender, [child])


class Conflicts:
    """Decides whose transforms of a frame are taken if several streams list it.

    `reception(name)` is that of a stream, None if it has been forgotten. Not safe from several
    threads at once.
    """

    def __init__(
        self,
        rule: Rule,
        buffer: Buffer,
        reception: "Callable[[str], StreamReception | None]",
        log: logging.Logger,
    ) -> None:
        self._claims = Claims(rule)
        self._buffer = buffer
        self._reception = reception
        self._lines = lines_of(log)
        # Streams that send frames which they do not list: others that list one have them.
        self._senders_of_unlisted: set[str] = set()

    def judge(self, name: str, description: StreamDescription | None) -> None:
        """Take the frames that a stream lists now; None if its publisher is gone."""
        contested = self._claims.update(name, description)
        frames = listed_children(description)
        if frames:
            self._revoke_permits(self._senders_of_unlisted - {name})
        self._take_back(name, frames)
        if not contested:
            return
        for conflict in self._claims.news(name, contested):
            self._report(conflict)
        left = contested - frames
        resolutions = self._claims.resolutions(name, contested)
        receptions = self._known(resolutions)
        changed = [each.contest.exclude(resolutions[each.name]) for each in receptions]
        # A static transform that gets priority, or that another has replaced, is not sent again.
        for each in receptions:
            accepted = resolutions[each.name].accepted
            taken = accepted if any(changed) else accepted & left
            each.statics.apply(taken - left if each.name == name else taken)

    def _known(self, names: Iterable[str]) -> "list[StreamReception]":
        """The receptions of the streams of these names, without those that have been forgotten."""
        receptions = map(self._reception, names)
        return [reception for reception in receptions if reception is not None]

    def _revoke_permits(self, senders: set[str]) -> None:
        """What these streams have under way was judged before some frames were listed."""
        for sender in sorted(senders):
            if (reception := self._reception(sender)) is not None:
                reception.revoke_permit()
            else:
                self._senders_of_unlisted.discard(sender)

    def _take_back(self, name: str, frames: frozenset[str]) -> None:
        """Take the frames that a stream lists from those that do not list them."""
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
        # Before the look at the claims: what changes from then on takes its permit back.
        self._senders_of_unlisted.add(name)
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
            name_some(conflict.frames),
            first,
            other,
            wins[rule],
            rule,
        )
        for child in conflict.frames:
            parents = other.parent_of(child), first.parent_of(child)
            change = Change("conflict", child, *parents, other.stream, first.stream, 0)
            self._buffer.tell(change)
