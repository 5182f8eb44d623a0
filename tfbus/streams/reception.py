"""Receiving one stream: payloads go into the buffer, through five stages.

A message is admitted by its epoch (`Admission`); rows are left out to which its publishers have no
right (`FrameRights`), and rows of frames that others have (`Contest`); the rest goes into the
buffer (`Insertion`), and marks its frames (`Marks`). Rows are dropped before they are stored, and
nothing is undone: if something changes meanwhile, the buffer refuses the rows (`StreamFacts`),
and the message begins again.
"""

import logging
from collections.abc import Callable, Collection
from functools import partial

from tfbus.base import scheduler
from tfbus.base.errors import DecodeError
from tfbus.base.structs import replace
from tfbus.base.wording import printable
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.insert_many import Permit
from tfbus.geometry.columns import Columns
from tfbus.streams.info import StreamCounts, StreamInfo, StreamState, described_stream
from tfbus.streams.stages import (
    Admission,
    Contest,
    FrameRights,
    Insertion,
    Marks,
    StaticRetries,
)
from tfbus.streams.stream_facts import (
    OF_EPOCH,
    OF_NAMES,
    Publisher,
    ReceptionHooks,
    StreamFacts,
)
from tfbus.wire.descriptions import FLOAT64, StreamDescription
from tfbus.wire.numbered import NO_NUMBERS, FrameNumbers, numbers_of
from tfbus.wire.transforms import TransformMessage, TransformReader

# A message may bring new frames: after this many transforms a stream is weighed again.
_GROWS_AFTER = 1000

# Messages that are lost one by one are not asked for again.
_SILENT_NS = 1_000_000_000

NOT_NAMED = "Dropped rows of a message of stream %r: its description has no names for their numbers"

TOO_MANY_WAIT = "Dropped messages that waited for a description %s: too many wait"

# A message waits for names in so many descriptions: the first may be older than the message.
TIMES_HELD = 3

# Transforms of one set may trade places: the first may fit only when the second is in.
_STATIC_ATTEMPTS = 3


class StreamReception:
    """A stream as a listener receives it; the keys that carry its messages are received by
    `DynamicReception` and `statics`.

    `reader` is one for all streams of a namespace, `around` the listener, which does nothing if it
    is None. `now_s` is a clock that never goes back. `rights` are None if the publishers may
    have all frames.
    """

    def __init__(
        self,
        name: str,
        buffer: Buffer,
        log: logging.Logger,
        now_ns: Callable[[], int],
        reader: TransformReader,
        *,
        around: ReceptionHooks | None = None,
        now_s: Callable[[], float] = lambda: scheduler.monotonic(),
    ) -> None:
        self.name = name
        self.around = around or ReceptionHooks(log)
        self.reader = reader
        self.now_ns = now_ns
        self.facts = StreamFacts(name, buffer, log, self.around)
        self.marks = Marks(self.facts)
        self.admission = Admission(self.facts, self.marks, self.around, now_s)
        # On a closed bus, where its publishers may not have all frames.
        self.rights: FrameRights | None = None
        self.contest = Contest(self.facts, self.around, now_s)
        self.insertion = Insertion(self.facts)
        self.statics = StaticReception(self)
        # The frames of its messages, if it gives them numbers.
        self.numbers = NO_NUMBERS
        # At this count of transforms it may have grown.
        self.grows_at = _GROWS_AFTER

    @property
    def counts(self) -> StreamCounts:
        """The messages that have been received, in numbers."""
        return self.facts.counts

    @property
    def epoch_ns(self) -> int | None:
        """The epoch that counts; None before the first message."""
        return self.facts.epochs.present_ns

    def report(self, state: StreamState | None) -> StreamInfo:
        """The report of the stream with its counts; `state` is its token and its description."""
        info = self.counts.added_to(described_stream(self.name, state))
        return info if self.epoch_ns is None else replace(info, epoch_ns=self.epoch_ns)

    # Messages

    def store(self, rows: Columns, epoch_ns: int, static: bool, permit: Permit) -> bool | None:
        """Take the rows of an admitted message through the other stages; whether none was refused.
        None if the permit, which was there when it was admitted, has been taken back before all
        were stored: then admit it again.
        """
        if self.rights is not None:
            rows = self.rights.allowed_of(rows)
        rows = self.contest.uncontested(rows, epoch_ns, static)
        are_taken = self.insertion.insert(rows, static, permit)
        if self.marks.left_behind or self.facts.epochs.gone:
            self.marks.settle(rows)
        return are_taken

    def receive_kept(self, payload: bytes) -> None:
        """Receive a message that the stream has kept, and that may have come before.

        Frames that the stream has listed, and no longer lists, have been removed since. A frame
        that it has not listed so far may be newer than its list.
        """
        message = self.decode(payload)
        if message is None:
            return
        facts, rows = self.facts, message.rows
        if message.unnamed:
            self.hold(message.epoch_ns, payload)
        are_taken = None
        while are_taken is None:
            permit = facts.permit
            if not self.admission.admit(message.epoch_ns):
                return
            with facts.lock:
                removed = facts.listing.removed_in(message.epoch_ns)
            left = rows.without(removed) if removed else rows
            are_taken = self.store(left, message.epoch_ns, False, permit)
        stamp_ns, now_ns = rows.last_stamp_ns(), self.now_ns()
        # 0 while a simulated time is not known.
        delay_s = (now_ns - stamp_ns) / 1e9 if stamp_ns is not None and now_ns else None
        with facts.lock:
            facts.counts.add_kept(len(rows), len(payload), delay_s)

    def hold(self, epoch_ns: int, payload: bytes) -> None:
        """Read a message again when the numbers of all its frames are described."""
        with self.facts.lock:
            self.counts.unnamed += 1
        self._hold(epoch_ns, payload, TIMES_HELD)

    def _hold(self, epoch_ns: int, payload: bytes, times: int) -> None:
        numbers, pending = self.numbers, self.around.pending
        receive = partial(self._receive_again, times=times - 1)
        of = OF_NAMES if epoch_ns == numbers.epoch_ns else OF_EPOCH
        if dropped := pending.add(self.name, epoch_ns, receive, payload, of):
            self.facts.warn_once("full", TOO_MANY_WAIT, dropped)
        self.around.on_unnamed(self.name, epoch_ns)
        if self.numbers is not numbers:  # it came in between, perhaps before the message was added
            pending.release(self.name, epoch_ns)

    def _receive_again(self, payload: bytes, times: int) -> None:
        """Store the rows of a message that came before their names, and was counted then; it may
        be held for so many more descriptions.
        """
        message = self.decode(payload)
        if message is None:
            return
        are_taken = None
        while are_taken is None:
            permit = self.facts.permit
            if not self.admission.admit(message.epoch_ns):
                return
            are_taken = self.store(message.rows, message.epoch_ns, False, permit)
        if message.unnamed and times:
            self._hold(message.epoch_ns, payload, times)
        elif message.unnamed:
            self.facts.warn_once("unnamed", NOT_NAMED, self.name)

    def decode(self, payload: bytes) -> TransformMessage | None:
        """The message in a payload; None, and counted, if it cannot be read."""
        try:
            return self.reader.read(payload, self.numbers)
        except DecodeError as error:
            self.reject(error)
            return None

    def reject(self, error: DecodeError) -> None:
        """Count a message that cannot be read; log the first."""
        with self.facts.lock:
            self.counts.rejected += 1
            self.counts.unreadable = printable(str(error))
        self.facts.warn_once("rejected", "Dropped a message of stream %r: %s", self.name, error)

    # The stream's description, and its token

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
            numbers=numbers_of(description) if description.poses != FLOAT64 else NO_NUMBERS,
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
        numbers: FrameNumbers = NO_NUMBERS,
    ) -> None:
        """Take the child frames that the stream lists, and which of them are static; frames that
        the same publisher no longer lists are removed. It began at `started_ns`, 0 for its epoch,
        and its frames have these `numbers`.

        `confirmed` if it came from the publisher's own session: its epoch counts.
        """
        facts, admission = self.facts, self.admission
        if not (
            admission.confirm(epoch_ns, publisher)
            if confirmed
            else admission.admit_unconfirmed(epoch_ns)
        ):
            return
        self.numbers = numbers
        with facts.lock:
            if publisher is not None and facts.listing.publisher != publisher:
                facts.static_set.expire_before(min(started_ns or epoch_ns, epoch_ns))
            removed = facts.listing.replace(epoch_ns, children, publisher)
            found = statics - facts.static_set.listed
            facts.static_set.listed = statics
            self.marks.invalidate()
            if removed:
                facts.revoke_permit()
        self._remove(removed)
        # An earlier list may have left them out, wrongly.
        if found and facts.static_set.batch is not None:
            self.statics.apply(found)
        self.marks.update()
        held = facts.buffer.sent_by(self.name)
        if unlisted := frozenset(child for child in held.keys() - children if held[child]):
            self.around.on_unlisted(self.name, unlisted)
        if confirmed or (numbers is not NO_NUMBERS and facts.epochs.confirmed_ns is None):
            self.around.pending.release(self.name, epoch_ns)

    def drop_unlisted(self, silent: frozenset[str]) -> None:
        """Drop all of these frames that have not come for a while, and are still not listed: the
        publisher, which is there, has removed them.
        """
        facts = self.facts
        with facts.lock:
            if facts.epochs.gone or facts.listing.epoch_ns != facts.epochs.present_ns:
                return
            unlisted = silent - facts.listing.children
        held = facts.buffer.sent_by(self.name)
        self._remove(frozenset(child for child in unlisted if held.get(child)))

    def _remove(self, frames: frozenset[str]) -> None:
        if frames:
            self.facts.buffer.remove_sent(frames, self.name)
            self.around.on_overlap(self.name, frames)

    def arrive(self) -> None:
        """The publisher is there; `marks.update` follows when its description has been taken."""
        with self.facts.lock:
            self.facts.epochs.appear()
            self.marks.invalidate()

    def fall_silent(self) -> None:
        """The publisher is out of reach: its static set may change meanwhile."""
        with self.facts.lock:
            self.facts.static_set.expire()

    def vanish(self) -> None:
        """The publisher is gone."""
        with self.facts.lock:
            self.facts.epochs.vanish()
            self.facts.static_set.expire()
            self.marks.invalidate()
        self.marks.update()


class DynamicReception:
    """A key of a stream that carries dynamic transforms; its messages are numbered."""

    def __init__(self, stream: StreamReception) -> None:
        self.stream = stream
        self._epoch_ns: int | None = None
        self._next_seq = 0

    def receive(self, payload: bytes) -> None:
        """Receive one message as it comes."""
        stream = self.stream
        try:
            message = stream.reader.read(payload, stream.numbers)
        except DecodeError as error:
            stream.reject(error)
            return
        self._accept(message, scheduler.time_ns(), self.receive, payload)

    def take_recorded(self, message: TransformMessage, heard_ns: int) -> None:
        """Receive a message of a recording, which came at `heard_ns`, as `receive` did then."""
        self._accept(message, heard_ns, None, b"")

    def _accept(
        self,
        message: TransformMessage,
        heard_ns: int,
        receive: Callable[[bytes], None] | None,
        payload: bytes,
    ) -> None:
        stream, rows, epoch_ns = self.stream, message.rows, message.epoch_ns
        facts = stream.facts
        epochs = facts.epochs
        are_taken = None
        # First of all, so that no lookup waits for the rest.
        while are_taken is None:
            permit = facts.permit
            if (epoch_ns != epochs.present_ns or epochs.was_gone) and not stream.admission.admit(
                epoch_ns, live=True, receive=receive, payload=payload
            ):
                return
            are_taken = stream.store(rows, epoch_ns, False, permit)
        if message.unnamed:
            stream.hold(epoch_ns, payload)
        stamp_ns, now_ns = rows.last_stamp_ns(), stream.now_ns()
        seq, counts = message.seq, facts.counts
        # 0 while a simulated time is not known.
        delay_s = (now_ns - stamp_ns) / 1e9 if stamp_ns is not None and now_ns else None
        silent_ns = 0
        with facts.lock:
            former_ns = counts.last_heard_ns
            counts.add(rows.count, len(payload), heard_ns, delay_s)
            if seq is not None:
                if epoch_ns != self._epoch_ns:
                    # Messages sent before the first one received do not count as missed.
                    self._epoch_ns, self._next_seq = epoch_ns, seq + 1
                elif seq >= self._next_seq:
                    if seq != self._next_seq:
                        counts.missed += seq - self._next_seq
                        silent_ns = heard_ns - (former_ns or heard_ns)
                    self._next_seq = seq + 1
        if counts.transforms >= stream.grows_at:
            stream.grows_at = counts.transforms + _GROWS_AFTER
            stream.around.on_growth(stream.name)
        if epochs.gone:
            stream.around.on_message_while_gone(stream.name)
        if silent_ns > _SILENT_NS:
            stream.around.on_gap(stream.name, silent_ns / 1e9)


class StaticReception:
    """The key of a stream that carries its static transforms: each message is the whole set."""

    def __init__(self, stream: StreamReception) -> None:
        self.stream = stream
        self._facts = stream.facts
        self._set = stream.facts.static_set
        self._retries = StaticRetries(stream.facts.buffer, self._retry)

    @property
    def batch(self) -> Columns | None:
        """The set that came last; None before the first."""
        return self._set.batch

    def receive(self, payload: bytes) -> None:
        """Receive the whole set of static transforms of the stream, in place of the former one."""
        try:
            message = self.stream.reader.read(payload)
        except DecodeError as error:
            self.stream.reject(error)
        else:
            self.accept(message, scheduler.time_ns(), self.receive, payload)

    def accept(
        self,
        message: TransformMessage,
        heard_ns: int,
        receive: Callable[[bytes], None] | None = None,
        payload: bytes = b"",
    ) -> None:
        """Receive a set that came at `heard_ns`; `receive` takes the payload again once its epoch
        is confirmed.
        """
        facts, around, epoch_ns = self._facts, self.stream.around, message.epoch_ns
        with facts.lock:
            if self._is_outdated(epoch_ns):
                facts.counts.outdated += 1
                return
            is_later = facts.epochs.present_ns is None or epoch_ns > facts.epochs.present_ns
        if is_later and not self.stream.admission.admit(epoch_ns, receive=receive, payload=payload):
            return
        with facts.lock:
            facts.counts.add(len(message.rows), len(payload), heard_ns)
            self._set.of_others += epoch_ns != facts.epochs.present_ns
            removed = self._set.replace(message, is_current=not facts.epochs.gone)
        if facts.epochs.gone:
            around.on_message_while_gone(facts.name)
        if removed is None:
            return
        # First, as a former one may be in the way of one of the set.
        self._remove(removed)
        if removed:
            around.on_overlap(facts.name, removed)
        self.apply(None)
        if epoch_ns != facts.epochs.present_ns:
            self.stream.marks.update()  # what the publisher does not list now is gone
        around.on_growth(facts.name)

    def apply(self, children: Collection[str] | None) -> None:
        """Put the static transforms of these children, None for all, into the buffer, as they were
        last received.
        """
        applied = None
        while (batch := self._set.batch) is not applied and batch is not None:
            if children is None:
                self._retries.keep_only(batch.children())
            rows = batch if children is None else batch.only(children)
            if len(rows):
                self._insert(rows)
            applied = batch

    def are_lacking(self) -> bool:
        """Whether the publisher is there and lists static transforms that have not come, or may
        have changed while it was gone.
        """
        with self._facts.lock:
            return not self._facts.epochs.gone and self._set.is_missing()

    def forget(self) -> None:
        """The static transforms are no longer read."""
        with self._facts.lock:
            self._set.clear()
        self._retries.clear()

    def close(self) -> None:
        """Put nothing into the buffer by itself from now on."""
        self._retries.close()

    def _is_outdated(self, epoch_ns: int) -> bool:
        """Whether static transforms of this epoch are outdated; with the lock held.

        Messages of an epoch before the present one may be the last: a stream whose clock went back
        keeps its statics, and may not send them again.
        """
        epochs, last_ns = self._facts.epochs, self._set.epoch_ns
        if last_ns is not None and epoch_ns < last_ns and not epochs.was_gone:
            return True
        return epoch_ns > (epochs.present_ns or 0) and epochs.is_outdated(epoch_ns)

    def _insert(self, rows: Columns) -> None:
        epoch_ns = self._set.epoch_ns or 0
        for _ in range(_STATIC_ATTEMPTS):
            are_taken = None
            while are_taken is None:
                permit = self._facts.permit
                are_taken = self.stream.store(rows, epoch_ns, True, permit)
            if are_taken:
                self._retries.forget(rows.children())
                return
        self._retries.watch(rows)

    def _retry(self) -> None:
        if not self._facts.epochs.gone:
            self.apply(None)

    def _remove(self, children: Collection[str]) -> None:
        if children:
            held = self._facts.buffer.sent_by(self._facts.name)
            # A frame with samples is dynamic now, and left the set for that reason.
            removed = [child for child in children if held.get(child) == 0]
            self._facts.buffer.remove_sent(removed, self._facts.name)
