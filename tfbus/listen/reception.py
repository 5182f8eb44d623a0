"""Receiving one stream: payloads go into the buffer.

A message takes the short way through `DynamicReception.receive`: read, one look at the epoch,
inserted. Rare cases have separate methods.

The lock of a stream guards its own state only, and is never held while the buffer is filled:
callbacks for changes of the buffer may do anything. So an epoch may end while a message of it goes
into the buffer; `insert` looks at the epoch again afterwards.
"""

import logging
import math
from collections.abc import Callable, Collection

from tfbus.buffer.buffer import Buffer
from tfbus.errors import DecodeError
from tfbus.geometry.columns import Columns, FoundOfRows
from tfbus.listen.claims import Resolution, name_some
from tfbus.listen.counts import Counts
from tfbus.listen.epochs import Epochs, Verdict
from tfbus.listen.gone_marks import Marks
from tfbus.listen.held import DisputedMessages
from tfbus.listen.listing import Listing, Publisher
from tfbus.listen.refused_statics import RefusedStatics
from tfbus.listen.static_set import StaticSet, children_of
from tfbus.listen.stream_rights import FrameRights
from tfbus.runtime import scheduler
from tfbus.runtime.log_once import LogOnce
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.transforms import TransformMessage, TransformReader
from tfbus.wording import listed, stamp_text

# Messages of a disputed epoch ask at most this often for the publisher's word.
_DISPUTES_APART_S = 1.0

# A publisher lists a frame a moment after it sends it: what is dropped until then is not logged.
_LISTED_WITHIN_S = 1.0

# Lines that a stream could cause without end come again after this time, with their number; in that
# time of at most this many streams.
_LINES_APART_S = 60.0
_MOST_LINES = 50

# A message may bring new frames: after this many transforms a stream is weighed again.
_GROWS_AFTER = 1000


def lines_of(log: logging.Logger) -> LogOnce:
    """The log for what streams do again and again."""
    return LogOnce(log, again_s=_LINES_APART_S, most=_MOST_LINES)


# Rows whose frames need not be judged again, in all messages of a stream.
_MOST_JUDGED_ROWS = 10_000

_NONE: frozenset[str] = frozenset()

# Transforms of one set may trade places: the first may fit only when the second is in.
_STATIC_ATTEMPTS = 3


class _Judged:
    """A finding about the frames of rows: all may come while the stream lists `listed`, and others
    have priority for `excluded`. `unlisted` are the child frames that it does not list.
    """

    __slots__ = ("excluded", "listed", "unlisted")

    def __init__(
        self, listed: frozenset[str], excluded: frozenset[str], unlisted: frozenset[str]
    ) -> None:
        self.listed = listed
        self.excluded = excluded
        self.unlisted = unlisted


class StreamReception:
    """A stream as a listener receives it.

    `excluded` are the frames for which another publisher has priority. `reader` is one for all
    streams of a namespace. `now_s` is a clock that never goes back.

    `claimed_by_others(children)` is which of these frames other live streams list: a stream that
    does not list them itself does not get them.

    `on_overlap(name, frames)` is called where transforms of these frames came to lie over those of
    a publisher that has just got priority, or lists them, and where they were removed.
    `on_unlisted(name, frames)` is called if it has sent these frames and does not list them, at
    each message and list: `drop_unlisted` drops them once they are silent.
    `on_takeover(name, epoch_ns)` is called if two processes publish the stream, one fell silent,
    and the messages of the other count from now on. `on_message_while_gone(name)` is called for
    each message that comes though the publisher is gone.

    `once` logs what is wrong with a stream whose publisher has confirmed it, `once_of_strangers`
    what is wrong with others: any process can make up their names, and so fill its log.
    """

    def __init__(
        self,
        name: str,
        buffer: Buffer,
        log: logging.Logger,
        now_ns: Callable[[], int],
        reader: TransformReader,
        on_overlap: Callable[[str, frozenset[str]], None] = lambda name, frames: None,
        on_takeover: Callable[[str, int], None] = lambda name, epoch_ns: None,
        now_s: Callable[[], float] = lambda: scheduler.monotonic(),
        *,
        on_dispute: Callable[[str, int], None] = lambda name, epoch_ns: None,
        on_growth: Callable[[str], None] = lambda name: None,
        on_unlisted: Callable[[str, frozenset[str]], None] = lambda name, frames: None,
        on_message_while_gone: Callable[[str], None] = lambda name: None,
        claimed_by_others: Callable[[frozenset[str]], frozenset[str]] = lambda children: _NONE,
        held: DisputedMessages | None = None,
        once: LogOnce | None = None,
        once_of_strangers: LogOnce | None = None,
        lines: LogOnce | None = None,
    ) -> None:
        self.name = name
        self.buffer = buffer
        self.log = log
        self.now_ns = now_ns
        self.reader = reader
        self.on_overlap = on_overlap
        self.on_takeover = on_takeover
        self.on_dispute = on_dispute
        self.on_growth = on_growth
        self.on_unlisted = on_unlisted
        self.on_message_while_gone = on_message_while_gone
        self.claimed_by_others = claimed_by_others
        self.now_s = now_s
        self.lock = scheduler.Lock()
        self.epochs = Epochs()
        self.statics = StaticSet()
        self.listing = Listing()
        self.excluded: frozenset[str] = frozenset()
        # On a closed bus, where its publishers may not have all frames.
        self.frame_rights: FrameRights | None = None
        self.counts = Counts()
        # By frame the stream that it is taken from with the next message that has it.
        self._inherits: dict[str, str] = {}
        # What was found of the frames of its messages, mostly the same from one to the next.
        self._judged = FoundOfRows(_MOST_JUDGED_ROWS)
        self._rejected = buffer.rejected
        self._marks = Marks(name, buffer, self.epochs, self.statics, self.listing)
        self._held = held or DisputedMessages()
        self._refused_statics = RefusedStatics(buffer, self._retry_statics)
        self._once = once or LogOnce(log)
        self._once_of_strangers = once_of_strangers or self._once
        self._lines = lines or lines_of(log)
        self._has_warned_of_two = False
        self._disputed_s = -math.inf
        # When it first sent a frame that others list, and it did not.
        self._claimed_s = math.inf
        # At this count of transforms it may have grown.
        self.grows_at = _GROWS_AFTER

    @property
    def judged_rows(self) -> int:
        """How many rows it has found something of, and keeps that."""
        return self._judged.count

    @property
    def epoch_ns(self) -> int | None:
        """The epoch that counts; None before the first message."""
        return self.epochs.present_ns

    # Every message

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
        with self.lock:
            was_gone = self.epochs.was_gone
            if live:
                verdict = self.epochs.judge_live(epoch_ns, self.counts.messages, self.now_s())
            else:
                verdict = self.epochs.judge(epoch_ns)
            is_back = was_gone and not self.epochs.was_gone
            if verdict is Verdict.PRESENT:
                if is_back:
                    self._marks.invalidate()
            elif verdict is Verdict.OUTDATED:
                self.counts.outdated += 1
            elif not verdict.counts:
                self.counts.disputed += 1
            else:
                self._begin_epoch(verdict)
        if verdict is Verdict.PRESENT:
            if is_back:
                self._marks.update()
            return True
        if verdict is Verdict.OUTDATED and self.epochs.second_publisher_is_alive:
            self._warn_of_two()
        if verdict is Verdict.FUTURE:
            self._warn_future(epoch_ns)
        if verdict is Verdict.DISPUTED:
            if receive is not None:
                self._held.keep(self.name, epoch_ns, receive, payload)
                if epoch_ns == self.epochs.present_ns:
                    # Confirmed in between, perhaps before the message was kept.
                    self._held.release(self.name, epoch_ns)
                    return False
            self._dispute(epoch_ns)
        if verdict in (Verdict.RESTART, Verdict.TAKEOVER):
            self._restart(epoch_ns, verdict)
        return verdict.counts

    def _begin_epoch(self, verdict: Verdict) -> None:
        """An epoch begins; with the lock held."""
        if verdict is Verdict.FIRST:
            self._marks.invalidate()
        else:
            self._marks.begin_epoch()
        self.counts.forget_delays()
        if verdict is Verdict.TAKEOVER or (self.epoch_ns or 0) < (self.statics.epoch_ns or 0):
            # The set is of another process, or made up: that of an earlier epoch counts now.
            self.statics.accept_any()

    def _dispute(self, epoch_ns: int) -> None:
        now_s = self.now_s()
        if now_s >= self._disputed_s + _DISPUTES_APART_S:
            self._disputed_s = now_s
            self.on_dispute(self.name, epoch_ns)

    def _warn_future(self, epoch_ns: int) -> None:
        self._warn_once(
            "future",
            "Dropped a message of stream %r: its epoch %s is in the future. The clock of its "
            "publisher is wrong, or another process sends on its key",
            self.name,
            stamp_text(epoch_ns),
        )

    def _restart(self, epoch_ns: int, verdict: Verdict) -> None:
        is_takeover = verdict is Verdict.TAKEOVER
        if is_takeover:
            self._warn_of_two()
        self.buffer.forget(self.name)
        with self.lock:
            self._marks.end_former()
        self._lines.info(
            ("restarted", self.name, is_takeover),
            "Stream %r restarted: %s; its samples so far are dropped, static transforms stay",
            self.name,
            "one of the two processes that publish it is silent, so the other counts"
            if is_takeover
            else "its publisher was started again, or its clock went back",
        )
        self._marks.update()
        if is_takeover:
            self.on_takeover(self.name, epoch_ns)

    def insert(self, rows: Columns, epoch_ns: int, *, static: bool = False) -> bool:
        """Put the transforms into the buffer, except those for which another has priority; whether
        none was refused.
        """
        judged: _Judged | None = self._judged.get(rows)
        if (
            judged is None
            or judged.listed is not self.listing.children
            or judged.excluded is not self.excluded
        ):
            rows, judged = self._judge(rows)
        unlisted, claimed = judged.unlisted, _NONE
        if unlisted:
            if not static and epoch_ns == self.listing.epoch_ns:
                self.on_unlisted(self.name, unlisted)
            if claimed := self.claimed_by_others(unlisted):
                rows = self._without_claimed(rows, claimed)
        if self._inherits:
            self._take_over(rows)
        buffer, rejected = self.buffer, self._rejected
        refused = rejected.rows
        taken = buffer.set_transforms(rows, static=static, authority=self.name)
        # Rows that are only too old are not taken either, but not refused.
        are_taken = taken == rows.count or rejected.rows == refused
        if not are_taken:
            self._warn_refused()
        epochs, marks = self.epochs, self._marks
        if epochs.gone:
            marks.update()
        elif marks.left_behind and not marks.left_behind.isdisjoint(rows.frames):
            marks.restore(children_of(rows))
        if epoch_ns != epochs.present_ns and not static:
            # The epoch ended in between: none of it may stay.
            buffer.forget(self.name)
        if self.excluded is not judged.excluded:
            self._give_way(rows, self.excluded - judged.excluded)
        if unlisted and (late := self.claimed_by_others(unlisted) - claimed):
            # Another listed them while they were inserted.
            self.on_overlap(self.name, late)
        return are_taken

    def _judge(self, rows: Columns) -> tuple[Columns, "_Judged"]:
        """The rows that may come, and what holds for all rows like these until the stream lists
        other frames, or another one gets priority.
        """
        kept = rows if self.frame_rights is None else self.frame_rights.allowed_of(rows)
        listed, excluded = self.listing.children, self.excluded
        judged = _Judged(listed, excluded, children_of(kept) - listed)
        if excluded:
            kept = self._without(kept, excluded)
        if len(kept) == len(rows):
            self._judged.put(rows, judged)
        return kept, judged

    def decode(self, payload: bytes) -> TransformMessage | None:
        """The message in a payload; None, and counted, if it cannot be read."""
        try:
            return self.reader.read(payload)
        except DecodeError as error:
            self.reject(error)
            return None

    def reject(self, error: DecodeError) -> None:
        """Count a message that cannot be read; log the first."""
        with self.lock:
            self.counts.rejected += 1
        self._warn_once("rejected", "Dropped a message of stream %r: %s", self.name, error)

    def refuse_frame(self, frame: str) -> None:
        """Count a transform whose frame the stream may not have; log the first."""
        with self.lock:
            self.counts.forbidden += 1
        self._warn_once(
            "forbidden",
            "Refused frame %r of stream %r: by the rights of this bus it may publish only %s",
            frame,
            self.name,
            listed(self.frame_rights.patterns if self.frame_rights else ()) or "nothing",
        )

    def _warn_refused(self) -> None:
        refused = self.buffer.rejected.last
        self._warn_once("refused", "Refused a transform of stream %r: %s", self.name, refused)

    def _warn_once(self, kind: str, text: str, *values: object) -> None:
        """Log the first of a kind of this stream."""
        of_stream = kind, self.name
        logs = self._once, self._once_of_strangers
        of_now = logs[0] if self.epochs.confirmed_ns is not None else logs[1]
        once = next((log for log in logs if of_stream in log.counts), of_now)
        once.warning(of_stream, text, *values)

    def _warn_of_two(self) -> None:
        if not self._has_warned_of_two:
            self._has_warned_of_two = True
            publisher = self.listing.publisher
            self.log.warning(
                "Two processes publish stream %r: %s was started twice, and the messages of one "
                "are dropped. Stop one, or give each its own name (--name)",
                self.name,
                "its node" if publisher is None else publisher[0],
            )

    # Frames that another publisher has too

    def exclude(self, resolution: Resolution) -> bool:
        """Take its accepted frames from now on, and drop its rejected ones; whether that is new."""
        former = self.excluded
        self.excluded = (former - resolution.accepted) | resolution.rejected
        # Its earlier samples lie between those of the other publisher, or in their future.
        self.buffer.forget(self.name, self.excluded - former)
        return self.excluded != former

    def _without(self, rows: Columns, excluded: frozenset[str]) -> Columns:
        kept = rows.without(excluded)
        with self.lock:
            self.counts.excluded += len(rows) - len(kept)
        return kept

    def _without_claimed(self, rows: Columns, claimed: frozenset[str]) -> Columns:
        """Without the frames that others list, and this stream does not. It may be about to list
        them; its static transforms are taken then.
        """
        now_s = self.now_s()
        self._claimed_s = min(self._claimed_s, now_s)
        if now_s > self._claimed_s + _LISTED_WITHIN_S:
            self._warn_once(
                "claimed",
                "Dropped %s of stream %r, which does not list it: another stream does",
                name_some(sorted(claimed)),
                self.name,
            )
        return self._without(rows, claimed)

    def inherit(self, frames: Collection[str], sender: str) -> None:
        """Take these frames, which it lists, from a stream that does not: what that has sent of one
        is dropped when this one sends it, so that none is missing meanwhile.
        """
        self._inherits.update(dict.fromkeys(frames, sender))

    def _take_over(self, rows: Columns) -> None:
        for child in children_of(rows) & self._inherits.keys():
            sender = self._inherits.pop(child, None)
            if sender is not None:
                self.buffer.forget(sender, [child])

    def _give_way(self, rows: Columns, rejected: frozenset[str]) -> None:
        """Another publisher got priority for these frames while the rows were inserted."""
        if not rejected.isdisjoint(rows.frames):
            self.buffer.forget(self.name, rejected)
            self.on_overlap(self.name, rejected)

    # Kept messages

    def receive_kept(self, payload: bytes) -> None:
        """Take a message that the stream has kept, and that may have come before.

        Frames that the stream has listed, and no longer lists, have been removed since. A frame
        that it has not listed so far may be newer than its list.
        """
        message = self.decode(payload)
        if message is None or not self.admit(message.epoch_ns):
            return
        batch = message.rows
        stamp_ns, now_ns = batch.last_stamp_ns(), self.now_ns()
        with self.lock:
            self.counts.add(len(batch), len(payload))
            # 0 while a simulated time is not known.
            if stamp_ns is not None and now_ns:
                self.counts.add_kept_delay((now_ns - stamp_ns) / 1e9)
            removed = self.listing.removed_in(message.epoch_ns)
        self.insert(batch.without(removed) if removed else batch, message.epoch_ns)
        with self.lock:
            removed_since = self.listing.removed_in(message.epoch_ns) - removed
        if removed_since:
            self.buffer.remove_sent(removed_since & children_of(batch), self.name)

    # Static transforms

    def receive_static(self, payload: bytes) -> None:
        """Take the whole set of static transforms of the stream, in place of the former one."""
        message = self.decode(payload)
        if message is not None:
            self._take_static(
                message, len(payload), scheduler.time_ns(), self.receive_static, payload
            )

    def take_recorded_statics(self, message: TransformMessage, heard_ns: int) -> None:
        """Take the set of a recording, which came at `heard_ns`, as `receive_static` did then."""
        self._take_static(message, 0, heard_ns)

    def _take_static(
        self,
        message: TransformMessage,
        size: int,
        heard_ns: int,
        receive: Callable[[bytes], None] | None = None,
        payload: bytes = b"",
    ) -> None:
        epoch_ns = message.epoch_ns
        with self.lock:
            if self._is_outdated_set(epoch_ns):
                self.counts.outdated += 1
                return
            is_later = self.epochs.present_ns is None or epoch_ns > self.epochs.present_ns
        if is_later and not self.admit(epoch_ns, receive=receive, payload=payload):
            return
        with self.lock:
            self.counts.add(len(message.rows), size)
            self.counts.last_heard_ns = heard_ns
            removed = self.statics.replace(message, is_current=not self.epochs.gone)
        if self.epochs.gone:
            self.on_message_while_gone(self.name)
        if removed is None:
            return
        # First, as a former one may be in the way of one of the set.
        self._remove_statics(removed)
        if removed:
            self.on_overlap(self.name, removed)
        self.apply_statics(None)
        self.on_growth(self.name)

    def _is_outdated_set(self, epoch_ns: int) -> bool:
        """Whether static transforms of this epoch are outdated; with the lock held.

        Messages of an epoch before the present one may be the last: a stream whose clock went back
        keeps its statics, and may not send them again.
        """
        epochs, last_ns = self.epochs, self.statics.epoch_ns
        if last_ns is not None and epoch_ns < last_ns and not epochs.was_gone:
            return True
        return epoch_ns > (epochs.present_ns or 0) and epochs.is_outdated(epoch_ns)

    def lacks_statics(self) -> bool:
        """Whether its publisher is there and lists static transforms that have not come, or may
        have changed while it was gone.
        """
        with self.lock:
            return not self.epochs.gone and self.statics.is_missing()

    def forget_statics(self) -> None:
        """The static transforms are no longer read."""
        with self.lock:
            self.statics.clear()
        self._refused_statics.clear()

    def close(self) -> None:
        """Put nothing into the buffer by itself from now on."""
        self._refused_statics.close()

    def apply_statics(self, children: Collection[str] | None) -> None:
        """Put the static transforms of these children, None for all, into the buffer, as they were
        last received.
        """
        applied = None
        while (batch := self.statics.batch) is not applied and batch is not None:
            if children is None:
                self._refused_statics.keep_only(children_of(batch))
            rows = batch if children is None else batch.only(children)
            if len(rows):
                self._insert_statics(rows)
            applied = batch

    def _insert_statics(self, rows: Columns) -> None:
        epoch_ns = self.statics.epoch_ns or 0
        for _ in range(_STATIC_ATTEMPTS):
            if self.insert(rows, epoch_ns, static=True):
                self._refused_statics.forget(children_of(rows))
                return
        self._refused_statics.watch(rows)

    def _retry_statics(self) -> None:
        if not self.epochs.gone:
            self.apply_statics(None)

    def _remove_statics(self, children: Collection[str]) -> None:
        if children:
            held = self.buffer.sent_by(self.name)
            # A frame with samples is dynamic now, and left the set for that reason.
            removed = [child for child in children if held.get(child) == 0]
            self.buffer.remove_sent(removed, self.name)

    # What the stream says of itself, and its token

    def take_description(self, description: StreamDescription, *, confirmed: bool = False) -> None:
        """Take the description of the stream, as `describe`."""
        publisher = (description.node, description.pid, description.session)
        self.describe(
            description.epoch,
            frozenset(child for _, child, _ in description.frames),
            frozenset(child for _, child, static in description.frames if static),
            publisher if description.session else None,
            started_ns=description.started_ns,
            confirmed=confirmed,
        )

    def describe(
        self,
        epoch_ns: int,
        children: frozenset[str],
        statics: frozenset[str] = frozenset(),
        publisher: Publisher | None = None,
        *,
        started_ns: int = 0,
        confirmed: bool = False,
    ) -> None:
        """Take the child frames that the stream lists, and which of them are static; those that the
        same publisher no longer lists are removed. It began at `started_ns`, 0 for its epoch.

        `confirmed` if it came from the publisher's own session: its epoch counts.
        """
        if not (self._confirm(epoch_ns, publisher) if confirmed else self._takes(epoch_ns)):
            return
        with self.lock:
            if publisher is not None and self.listing.publisher not in (None, publisher):
                self.statics.expire_before(started_ns or epoch_ns)
            removed = self.listing.replace(epoch_ns, children, publisher)
            found = statics - self.statics.listed
            self.statics.listed = statics
            self._marks.invalidate()
        if removed:
            self.buffer.remove_sent(removed, self.name)
            self.on_overlap(self.name, removed)
        # An earlier list may have left them out, wrongly.
        if found and self.statics.batch is not None:
            self.apply_statics(found)
        self._marks.update()
        held = self.buffer.sent_by(self.name)
        if unlisted := frozenset(child for child in held.keys() - children if held[child]):
            self.on_unlisted(self.name, unlisted)
        if confirmed:
            self._held.release(self.name, epoch_ns)

    def drop_unlisted(self, silent: frozenset[str]) -> None:
        """Drop those of these frames that have not come for a while, and are still not listed: the
        publisher, which is there, has removed them.
        """
        with self.lock:
            if self.epochs.gone or self.listing.epoch_ns != self.epochs.present_ns:
                return
            unlisted = silent - self.listing.children
        held = self.buffer.sent_by(self.name)
        if removed := frozenset(child for child in unlisted if held.get(child)):
            self.buffer.remove_sent(removed, self.name)
            self.on_overlap(self.name, removed)

    def _takes(self, epoch_ns: int) -> bool:
        """Whether a list of this epoch counts, though it is not confirmed."""
        with self.lock:
            if self.epochs.is_outdated(epoch_ns):
                return False
        return self.admit(epoch_ns)

    def _confirm(self, epoch_ns: int, publisher: Publisher | None) -> bool:
        """Take the publisher's word for its epoch; False if it has said a later one since."""
        with self.lock:
            confirmed_ns = self.epochs.confirmed_ns
            is_same = publisher is not None and publisher == self.listing.publisher
            if is_same and confirmed_ns is not None and epoch_ns < confirmed_ns:
                return False
            verdict = self.epochs.confirm(epoch_ns)
            if verdict is Verdict.RESTART:
                self._begin_epoch(verdict)
        if verdict is Verdict.RESTART:
            self._restart(epoch_ns, verdict)
        return True

    def appear(self) -> None:
        """The publisher is there, for the first time or again, with the description it had."""
        self.arrive()
        self.mark()

    def arrive(self) -> None:
        """The publisher is there; `mark` follows when its description has been taken."""
        with self.lock:
            self.epochs.appear()
            self._marks.invalidate()

    def mark(self) -> None:
        """Mark its frames in the buffer as gone, or not."""
        self._marks.update()

    def vanish(self) -> None:
        """The publisher is gone."""
        with self.lock:
            self.epochs.vanish()
            self.statics.expire()
            self._marks.invalidate()
        self._marks.update()


class DynamicReception:
    """A key of a stream that carries dynamic transforms; its messages are numbered."""

    def __init__(self, stream: StreamReception) -> None:
        self.stream = stream
        self._epoch_ns: int | None = None
        self._next_seq = 0

    def receive(self, payload: bytes) -> None:
        """Take one message as it comes."""
        stream = self.stream
        try:
            message = stream.reader.read(payload)
        except DecodeError as error:
            stream.reject(error)
            return
        epoch_ns, epochs = message.epoch_ns, stream.epochs
        if (epoch_ns != epochs.present_ns or epochs.was_gone) and not stream.admit(
            epoch_ns, live=True, receive=self.receive, payload=payload
        ):
            return
        self._take(message, len(payload), scheduler.time_ns())

    def take_recorded(self, message: TransformMessage, heard_ns: int) -> None:
        """Take a message of a recording, which came at `heard_ns`, as `receive` did then."""
        if self.stream.admit(message.epoch_ns, live=True):
            self._take(message, 0, heard_ns)

    def _take(self, message: TransformMessage, size: int, heard_ns: int) -> None:
        stream, rows, epoch_ns = self.stream, message.rows, message.epoch_ns
        # First of all, so that no lookup waits for the rest.
        stream.insert(rows, epoch_ns)
        stamp_ns = rows.last_stamp_ns()
        with stream.lock:
            counts = stream.counts
            counts.add(rows.count, size)
            counts.last_heard_ns = heard_ns
            if message.seq is not None:
                self._count_missed(epoch_ns, message.seq)
            # 0 while a simulated time is not known.
            if stamp_ns is not None and (now_ns := stream.now_ns()):
                counts.add_delay((now_ns - stamp_ns) / 1e9)
            grows = counts.transforms >= stream.grows_at
        if grows:
            stream.grows_at = counts.transforms + _GROWS_AFTER
            stream.on_growth(stream.name)
        if stream.epochs.gone:
            stream.on_message_while_gone(stream.name)

    def _count_missed(self, epoch_ns: int, seq: int) -> None:
        next_seq = self._next_seq
        if epoch_ns != self._epoch_ns:
            # Messages sent before the first one received do not count as missed.
            self._epoch_ns, self._next_seq = epoch_ns, seq + 1
        elif seq >= next_seq:
            self.stream.counts.missed += seq - next_seq
            self._next_seq = seq + 1


class StaticReception:
    """The key of a stream that carries its static transforms."""

    def __init__(self, stream: StreamReception) -> None:
        self.stream = stream

    def receive(self, payload: bytes) -> None:
        """Take one message as it comes."""
        self.stream.receive_static(payload)
