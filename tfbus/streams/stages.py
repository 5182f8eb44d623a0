"""The five stages of a stream's reception: admission by epoch, rights, contested frames, insertion
with refused statics that are retried, and the marks of frames in the buffer.
"""

import math
from collections.abc import Callable, Collection, Set
from contextlib import suppress

from tfbus.base import scheduler
from tfbus.base.bounded import Bounded
from tfbus.base.errors import TransformException
from tfbus.base.wording import listed, quoted, stamp_text
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import Change
from tfbus.buffer.insert_many import Permit
from tfbus.bus.patterns import matches
from tfbus.geometry.columns import Columns, FoundOfRows
from tfbus.streams.stream_facts import Publisher, ReceptionHooks, StreamFacts, Verdict


class Marks:
    """The last stage: marks the frames of one stream as gone, or not, by its epochs, its statics
    and its list of frames.

    Safe from any thread; `update` and `settle` are not to be called with the stream's lock held.
    """

    def __init__(self, facts: StreamFacts) -> None:
        # Frames of a former epoch, which the present one has not sent so far.
        self.left_behind: frozenset[str] = frozenset()
        self._stream = facts.name
        self._buffer = facts.buffer
        self._epochs = facts.epochs
        self._static_set = facts.static_set
        self._listing = facts.listing
        # Counts changes of epochs and lists.
        self._turns = 0
        # How many epochs have begun while samples of former ones were not yet dropped.
        self._begun = 0

    def invalidate(self) -> None:
        """An epoch or a list has changed, and `update` follows; with the stream's lock held."""
        self._turns += 1

    def begin_epoch(self) -> None:
        """An epoch has begun, and `end_former` follows; with the stream's lock held."""
        self._begun += 1
        self._turns += 1

    def end_former(self) -> None:
        """The samples of the former epoch are dropped, and `update` follows; with the stream's lock
        held.
        """
        self._begun -= 1
        self._turns += 1

    def update(self) -> None:
        """Mark each frame in the buffer.

        All are gone if the publisher is. Else the frames are that a former epoch left behind: not
        listed, and without a sample of this epoch. Before this epoch has a list, gone frames stay
        gone until they are sent: all of them if nothing of this epoch has come since the publisher
        was gone, as the publisher that is there may be another.
        """
        marked = -1
        # It may change meanwhile, on another thread, whose marks must not be overwritten.
        while marked != self._turns:
            marked = self._turns
            held = self._buffer.sent_by(self._stream)
            if self._epochs.gone:
                self.left_behind = frozenset()
                self._buffer.mark_gone(held, True, self._stream)
                continue
            self.left_behind = self._find_left_behind(held)
            if self._listing.epoch_ns == self._epochs.present_ns:
                self._buffer.mark_gone(self.left_behind, True, self._stream)
            self._buffer.mark_gone(held.keys() - self.left_behind, False, self._stream)

    def settle(self, rows: Columns) -> None:
        """Mark the frames of rows that are in the buffer now: frames that were left behind, and are
        sent again, are not gone.
        """
        if self._epochs.gone:
            self.update()
        elif self.left_behind and not self.left_behind.isdisjoint(rows.frames):
            found = self.left_behind & rows.children()
            self.left_behind -= found
            self._buffer.mark_gone(found, False, self._stream)

    def _find_left_behind(self, held: dict[str, int]) -> frozenset[str]:
        current: set[str] = set()
        present_ns, statics = self._epochs.present_ns, self._static_set
        if self._listing.epoch_ns == present_ns:
            current |= self._listing.children
        elif self._epochs.was_gone:
            return frozenset(held)
        if statics.batch is not None and statics.epoch_ns == present_ns:
            current |= statics.batch.children()
        former = {frame for frame, samples in held.items() if self._begun or not samples}
        return frozenset(former - current)


# Messages of a disputed epoch ask at most this often for the publisher's word.
_DISPUTES_APART_S = 1.0


class Admission:
    """The first stage: admits the messages of one stream whose epoch counts; with the first of a
    new epoch, all that was sent before is void.

    `now_s` is a clock that never goes back. Not to be called with the stream's lock held.
    """

    def __init__(
        self, facts: StreamFacts, marks: Marks, around: ReceptionHooks, now_s: Callable[[], float]
    ) -> None:
        self._facts = facts
        self._marks = marks
        self._around = around
        self._now_s = now_s
        self._has_warned_of_two = False
        self._disputed_s = -math.inf

    def admit(
        self,
        epoch_ns: int,
        *,
        live: bool = False,
        receive: Callable[[bytes], None] | None = None,
        payload: bytes = b"",
    ) -> bool:
        """Whether a message of this epoch counts; `live` if it was sent just now.

        A message of an epoch that has to be confirmed does not count yet: its `payload` goes to
        `receive` once it is.
        """
        facts, epochs = self._facts, self._facts.epochs
        with facts.lock:
            was_gone = epochs.was_gone
            if live:
                of_present = facts.counts.messages - facts.static_set.of_others
                verdict = epochs.judge_live(epoch_ns, of_present, self._now_s())
            else:
                verdict = epochs.judge(epoch_ns)
            is_back = was_gone and not epochs.was_gone
            if verdict is Verdict.PRESENT:
                if is_back:
                    self._marks.invalidate()
            elif verdict is Verdict.OUTDATED:
                facts.counts.outdated += 1
            elif not verdict.counts:
                facts.counts.disputed += 1
            else:
                self._begin_epoch(verdict)
        if verdict is Verdict.PRESENT:
            if is_back:
                self._marks.update()
            return True
        if verdict is Verdict.OUTDATED and epochs.second_publisher_is_alive:
            self._warn_of_two()
        if verdict is Verdict.FUTURE:
            self._warn_future(epoch_ns)
        if verdict is Verdict.DISPUTED:
            if receive is not None:
                self._around.pending.add(facts.name, epoch_ns, receive, payload)
                if epoch_ns == epochs.present_ns:
                    # Confirmed in between, perhaps before the message was added.
                    self._around.pending.release(facts.name, epoch_ns)
                    return False
            self._dispute(epoch_ns)
        if verdict in (Verdict.RESTART, Verdict.TAKEOVER):
            self._restart(epoch_ns, verdict)
        return verdict.counts

    def admit_unconfirmed(self, epoch_ns: int) -> bool:
        """Whether a description of this epoch counts, though it is not confirmed."""
        with self._facts.lock:
            if self._facts.epochs.is_outdated(epoch_ns):
                return False
        return self.admit(epoch_ns)

    def confirm(self, epoch_ns: int, publisher: Publisher | None) -> bool:
        """Take the publisher's word for its epoch; False if it has said a later one since."""
        facts = self._facts
        with facts.lock:
            confirmed_ns = facts.epochs.confirmed_ns
            is_same = publisher is not None and publisher == facts.listing.publisher
            if is_same and confirmed_ns is not None and epoch_ns < confirmed_ns:
                return False
            verdict = facts.epochs.confirm(epoch_ns)
            if verdict is Verdict.RESTART:
                self._begin_epoch(verdict)
        if verdict is Verdict.RESTART:
            self._restart(epoch_ns, verdict)
        return True

    def _begin_epoch(self, verdict: Verdict) -> None:
        """An epoch begins; with the lock held."""
        facts = self._facts
        if verdict is Verdict.FIRST:
            self._marks.invalidate()
        else:
            self._marks.begin_epoch()
            facts.revoke_permit()
        facts.counts.forget_delays()
        present_ns, last_ns = facts.epochs.present_ns or 0, facts.static_set.epoch_ns or 0
        if verdict is Verdict.TAKEOVER or present_ns < last_ns:
            # The set is of another process, or made up: that of an earlier epoch counts now.
            facts.static_set.accept_any()

    def _restart(self, epoch_ns: int, verdict: Verdict) -> None:
        """Drop the samples from before the epoch that has begun."""
        facts, is_takeover = self._facts, verdict is Verdict.TAKEOVER
        if is_takeover:
            self._warn_of_two()
        facts.buffer.forget(facts.name)
        with facts.lock:
            self._marks.end_former()
        self._around.lines.info(
            ("restarted", facts.name, is_takeover),
            "Stream %r restarted: %s; its samples so far are dropped, static transforms stay",
            facts.name,
            "one of the two processes that publish it is silent, so the other counts"
            if is_takeover
            else "its publisher was started again, or its clock went back",
        )
        self._marks.update()
        if is_takeover:
            self._around.on_takeover(facts.name, epoch_ns)

    def _dispute(self, epoch_ns: int) -> None:
        now_s = self._now_s()
        if now_s >= self._disputed_s + _DISPUTES_APART_S:
            self._disputed_s = now_s
            self._around.on_dispute(self._facts.name, epoch_ns)

    def _warn_future(self, epoch_ns: int) -> None:
        self._facts.warn_once(
            "future",
            "Dropped a message of stream %r: its epoch %s is in the future. The clock of its "
            "publisher is wrong, or another process sends on its key",
            self._facts.name,
            stamp_text(epoch_ns),
        )

    def _warn_of_two(self) -> None:
        if not self._has_warned_of_two:
            self._has_warned_of_two = True
            publisher = self._facts.listing.publisher
            self._facts.log.warning(
                "Two processes publish stream %r: %s was started twice, and the messages of one "
                "are dropped. Stop one, or give each its own name (--name)",
                self._facts.name,
                "its node" if publisher is None else publisher[0],
            )


# A publisher may make up names: beyond this number they are judged again.
_MOST_NAMES = 10_000


class FrameRights:
    """The second stage of a stream's reception, on a closed bus: drops rows of frames that its
    publishers may not have, whose names match none of the patterns.

    Frames are called here with `prefix` in front.
    """

    def __init__(self, patterns: tuple[str, ...], prefix: str, facts: StreamFacts) -> None:
        self._patterns = patterns
        self._prefix = prefix
        self._facts = facts
        self._allowed: Bounded[str, None] = Bounded(_MOST_NAMES)
        # Rows whose frames all may come.
        self._clean = FoundOfRows(_MOST_NAMES)

    def allowed_of(self, rows: Columns) -> Columns:
        """The transforms whose child frame may come."""
        if self._clean.get(rows):
            return rows
        refused = frozenset(child for child in rows.children() if not self._allows(child))
        if not refused:
            self._clean.put(rows, True)
            return rows
        for child in refused:
            self._refuse(child)
        return rows.without(refused)

    def _refuse(self, frame: str) -> None:
        """Count a transform of a frame that the stream may not have; log the first."""
        facts = self._facts
        with facts.lock:
            facts.counts.forbidden += 1
        facts.warn_once(
            "forbidden",
            "Refused frame %r of stream %r: by the rights of this bus it may publish only %s",
            frame,
            facts.name,
            listed(self._patterns) or "nothing",
        )

    def _allows(self, frame: str) -> bool:
        if frame in self._allowed:
            return True
        name = frame.removeprefix(self._prefix)
        if not any(matches(pattern, name) for pattern in self._patterns):
            return False
        self._allowed[frame] = None
        return True


# A publisher lists a frame a moment after it sends it: rows dropped until then are not logged.
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

    def __init__(
        self, facts: StreamFacts, around: ReceptionHooks, now_s: Callable[[], float]
    ) -> None:
        self.excluded: frozenset[str] = frozenset()
        self._facts = facts
        self._listing = facts.listing
        self._around = around
        self._now_s = now_s
        # The judgements of its messages' frames, mostly the same from one to the next.
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
        """The rows of frames that the stream may have, by the lists of other streams now."""
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

    def exclude(self, accepted: Set[str], rejected: Set[str]) -> bool:
        """Take the accepted frames from now on, and drop the rejected ones; whether that is new."""
        former = self.excluded
        excluded = (former - accepted) | rejected
        if excluded == former:
            return False
        with self._facts.lock:
            self.excluded = excluded
            self._facts.revoke_permit()
        # Its earlier samples lie between the other publisher's samples, or in their future.
        self._facts.buffer.forget(self._facts.name, excluded - former)
        return True

    def inherit(self, frames: Collection[str], sender: str) -> None:
        """Take these frames, which it lists, from a stream that does not: the other's samples of a
        frame are dropped when this stream sends it, so that none is missing meanwhile.
        """
        self._inherits.update(dict.fromkeys(frames, sender))

    def _judge(self, rows: Columns) -> tuple[Columns, _Judged]:
        """The rows that may come, and the judgement of all rows like these until the stream lists
        other frames, or another stream gets priority.
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
                quoted(sorted(claimed)),
                self._facts.name,
            )
        return self._without(rows, claimed)

    def _take_over(self, rows: Columns) -> None:
        for child in rows.children() & self._inherits.keys():
            sender = self._inherits.pop(child, None)
            if sender is not None:
                self._facts.buffer.forget(sender, [child])


class Insertion:
    """The fourth stage of a stream's reception: stores rows."""

    def __init__(self, facts: StreamFacts) -> None:
        self._facts = facts
        self._buffer = facts.buffer
        self._stream = facts.name
        self._rejected = facts.buffer.rejected

    def insert(self, rows: Columns, static: bool, permit: Permit) -> bool | None:
        """Store the rows; whether none was refused. None if the permit was taken back before all
        were stored.
        """
        rejected = self._rejected
        refused = rejected.rows
        stored = self._buffer.set_transforms(
            rows, static=static, authority=self._stream, permit=permit
        )
        # Rows that are only too old are not stored either, but not refused.
        if stored == rows.count:
            return True
        if not permit.is_valid:
            return None
        if rejected.rows == refused:
            return True
        self._facts.warn_once(
            "refused", "Refused a transform of stream %r: %s", self._stream, rejected.last
        )
        return False


_InTheWay = dict[str, frozenset[str]]


class StaticRetries:
    """Calls `retry` when an edge that was in the way of refused static transforms is gone.

    Safe from any thread.
    """

    def __init__(self, buffer: Buffer, retry: Callable[[], None]) -> None:
        self._buffer = buffer
        self._retry = retry
        self._lock = scheduler.Lock()
        # The frames in the way of each refused child, and all of them together.
        self._in_the_way: dict[str, frozenset[str]] = {}
        self._blocking: frozenset[str] = frozenset()
        self._end_watch: Callable[[], None] | None = None
        self._is_closed = False

    def watch(self, batch: Columns) -> None:
        """Some of these transforms were refused: watch the frames that would make a loop with them.
        Other children are watched as before.
        """
        found = {
            batch.frames[child]: frozenset(self._between(batch.frames[parent], batch.frames[child]))
            for parent, child in batch.pairs()
        }
        self._change(lambda known: {**known, **found})

    def forget(self, children: Collection[str]) -> None:
        """The static transforms of these children are in."""
        self._change(lambda known: {child: known[child] for child in known.keys() - set(children)})

    def keep_only(self, children: Collection[str]) -> None:
        """There are no static transforms of other children any longer."""
        self._change(lambda known: {child: known[child] for child in known.keys() & set(children)})

    def clear(self) -> None:
        """There are no static transforms any longer."""
        self._change(lambda known: {})

    def close(self) -> None:
        """Watch nothing from now on."""
        with self._lock:
            self._is_closed = True
        self.clear()

    def _between(self, parent: str, child: str) -> list[str]:
        """The frames from a refused parent up to the child; of a stored edge, too."""
        with suppress(TransformException):
            return self._buffer.path(child, parent)[:-1]
        return []

    def _change(self, change: Callable[[_InTheWay], _InTheWay]) -> None:
        if self._end_watch is None and not change({}):
            return
        end = None
        with self._lock:
            known = {} if self._is_closed else change(self._in_the_way)
            self._in_the_way = {child: frames for child, frames in known.items() if frames}
            self._blocking = frozenset().union(*self._in_the_way.values())
            if not self._blocking:
                end, self._end_watch = self._end_watch, None
            elif self._end_watch is None:
                self._end_watch = self._buffer.on_change(self._on_change)
        if end is not None:
            end()

    def _on_change(self, change: Change) -> None:
        if change.kind in ("publisher gone", "removed", "reparented"):
            with self._lock:
                if change.frame not in self._blocking:
                    return
                # Until the frames in the way are known again: the retry makes changes itself.
                self._in_the_way, self._blocking = {}, frozenset()
            self._retry()
