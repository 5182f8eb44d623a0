"""Receiving one stream: its payloads into the buffer, with its epochs, and counts of what came.

A message takes the short way through `DynamicReception.receive`: read, one look at the epoch,
inserted. Whatever is rare has methods of its own.

The lock of a stream is held for its own state only, never while the buffer is filled: who
listens to changes of the buffer may do as he likes. So a message may still be on its way into the
buffer when its epoch ends; whoever inserts looks at the epoch again afterwards.
"""

import logging
import threading
import time
from collections.abc import Callable, Collection

from tfbus.buffer.buffer import Buffer
from tfbus.errors import DecodeError
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.columns import Columns
from tfbus.listen.claims import Ruling
from tfbus.listen.epochs import Stragglers
from tfbus.wire.transforms import TransformMessage, TransformReader

# Of the delay of each message so much goes into the mean.
_SMOOTHING = 0.1

# What was kept of a removed frame may still be on its way. A publisher may go through any number
# of names: where so many are remembered, all but the last are forgotten.
_MOST_REMOVED = 10_000

# Node, process id and Zenoh's session: what one process is told from the next by.
Publisher = tuple[str, int, str]


class StreamReception:
    """One stream as a listener receives it.

    `excluded` are the frames of which another publisher has the right of way. `gone` is whether
    the publisher was there and is no more, by its token. `reader` is one for all streams of a
    namespace. `on_overlap(name, frames)` is called where transforms of these frames came to lie
    over those of another, who has just got the right of way.
    `on_takeover(name, epoch_ns)` is called where two processes send the stream, one fell silent,
    and the messages of the other count from now on. `now_s` is a clock that never goes back.
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
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = name
        self.buffer = buffer
        self.log = log
        self.now_ns = now_ns
        self.reader = reader
        self.on_overlap = on_overlap
        self.on_takeover = on_takeover
        self.now_s = now_s
        self.lock = threading.Lock()
        self.epoch_ns: int | None = None
        self.gone = False
        self.excluded: frozenset[str] = frozenset()
        self.statics: TransformBatch | None = None
        self.listed: frozenset[str] = frozenset()
        self.messages = self.transforms = self.bytes = 0
        self.missed = self.outdated = self.rejected = self.excluded_rows = 0
        self.last_heard_ns: int | None = None
        self.delay_s: float | None = None
        self._was_gone = False
        # The last that began with a process or a jump of its clock: no earlier one is new.
        self._newest_epoch_ns: int | None = None
        self._stragglers = Stragglers()
        # Frames of a former epoch, which this one has not sent so far.
        self._left: frozenset[str] = frozenset()
        # Counts what decides on who is gone.
        self._turns = 0
        self._static_epoch_ns: int | None = None
        self._static_seq: int | None = None
        # Whether none can have been missed since they last came.
        self._statics_are_current = True
        self._listed_statics: frozenset[str] = frozenset()
        self._listed_epoch_ns: int | None = None
        # Those that were in the list of this epoch, or of this process, and are no more.
        self._removed: frozenset[str] = frozenset()
        self._publisher: Publisher | None = None
        self._has_told_refused = self._has_told_two = False

    # What every message passes

    def admit(self, epoch_ns: int, *, live: bool = False) -> bool:
        """Whether a message of this epoch counts; a new epoch begins with its first message.

        An earlier one is outdated, unless the publisher was gone since the present one was last
        heard: then he was started again, on a host whose clock is not to be trusted. Where two
        processes send the stream, and only the outdated one is still heard, he counts again; by
        the messages that are `live`, as what is kept or retained may be of a dead process.
        """
        if epoch_ns == self.epoch_ns and not self._was_gone:
            return True
        with self.lock:
            former_ns = self.epoch_ns
            if epoch_ns == former_ns:
                self._was_gone &= self.gone
                return True
            is_outdated = self._is_outdated(epoch_ns)
            if is_outdated and not (live and self._is_left_alone(epoch_ns)):
                self.outdated += 1
                counts = False
            else:
                self._begin(epoch_ns, takes_over=is_outdated)
                counts = True
        if is_outdated and (counts or self._stragglers.are_of_a_living()):
            self._tell_two()
        if counts and former_ns is not None:
            self._begin_anew(takes_over=is_outdated)
            self.mark()
            if is_outdated:
                self.on_takeover(self.name, epoch_ns)
        return counts

    def _is_outdated(self, epoch_ns: int) -> bool:
        """Whether this is an epoch beside the present one that is not new; with the lock held."""
        newest_ns = self._newest_epoch_ns
        if newest_ns is None or self._was_gone or epoch_ns == self.epoch_ns:
            return False
        return epoch_ns <= newest_ns

    def _is_left_alone(self, epoch_ns: int) -> bool:
        """Whether only outdated messages still come, such as this one; with the lock held."""
        self._stragglers.hear(epoch_ns, self.messages, self.now_s())
        return self._stragglers.are_alone()

    def _begin(self, epoch_ns: int, *, takes_over: bool) -> None:
        """From now on this epoch counts; with the lock held."""
        self.epoch_ns = epoch_ns
        if takes_over:
            # The static transforms are those of the other process.
            self._static_epoch_ns = self._static_seq = None
            self._statics_are_current = False
        else:
            self._newest_epoch_ns = epoch_ns
        # A new epoch is heard of who is there, even before his token is.
        self.gone = self._was_gone = False
        self._turns += 1

    def insert(
        self, batch: TransformBatch | Columns, epoch_ns: int, *, static: bool = False
    ) -> None:
        """Put the transforms into the buffer, but for those that another has the right of."""
        excluded = self.excluded
        if excluded:
            batch = self._without(batch, excluded)
        buffer = self.buffer
        refused = buffer.rejected.rows
        taken = buffer.set_transforms(batch, static=static, authority=self.name)
        # Rows that are only too old are not taken either, but not refused.
        if taken < len(batch) and buffer.rejected.rows > refused:
            self._tell_refused()
        if self.gone:
            self.mark()
        elif self._left and not self._left.isdisjoint(batch.frames):
            self._find_again(batch)
        if epoch_ns != self.epoch_ns and not static:
            # The epoch ended in between: none of it may stay.
            buffer.forget(self.name)
        if self.excluded is not excluded:
            self._give_way(batch, self.excluded - excluded)

    def count(self, transforms: int, size: int) -> None:
        """Count one message of so many transforms and bytes; with the lock held."""
        self.messages += 1
        self.transforms += transforms
        self.bytes += size
        self.last_heard_ns = time.time_ns()

    def reject(self, error: DecodeError) -> None:
        """Count a message that cannot be read, and say so once."""
        with self.lock:
            self.rejected += 1
            first = self.rejected == 1
        if first:
            self.log.warning(
                "Dropped a message of stream %r: %s. More of them are only counted",
                self.name,
                error,
            )

    def _without(self, batch: TransformBatch | Columns, excluded: frozenset[str]) -> TransformBatch:
        whole = batch.as_batch() if isinstance(batch, Columns) else batch
        kept = whole.without(excluded)
        with self.lock:
            self.excluded_rows += len(whole) - len(kept)
        return kept

    def _give_way(self, batch: TransformBatch | Columns, lost: frozenset[str]) -> None:
        """Another got the right of way of these frames while the batch was inserted."""
        if not lost.isdisjoint(batch.frames):
            self.buffer.forget(self.name, lost)
            self.on_overlap(self.name, lost)

    def _begin_anew(self, *, takes_over: bool) -> None:
        self.buffer.forget(self.name)
        if takes_over:
            why = "of the two processes that send it one is silent, and the other counts now"
        else:
            why = "its publisher was started again, or its clock went back"
        self.log.info(
            "Stream %r begins anew: %s; what it sent before is forgotten, static transforms stay",
            self.name,
            why,
        )

    def _tell_two(self) -> None:
        if not self._has_told_two:
            self._has_told_two = True
            node = self._publisher[0] if self._publisher is not None else "its node"
            self.log.warning(
                "Two processes send stream %r: %s was started twice, and what one of them sends "
                "is dropped. End one, or give each a name of its own (--name)",
                self.name,
                node,
            )

    def _tell_refused(self) -> None:
        if not self._has_told_refused:
            self._has_told_refused = True
            self.log.warning(
                "Refused a transform of stream %r: %s. More of them are only counted",
                self.name,
                self.buffer.rejected.last,
            )

    # What comes once in a while

    def receive_kept(self, payload: bytes) -> None:
        """Take a message that the stream has kept, and that may have come before.

        Frames that the stream has listed, and lists no more, have been removed since. One that it
        has not listed so far may be newer than its list.
        """
        message = self.decode(payload)
        if message is None or not self.admit(message.epoch_ns):
            return
        batch = message.batch
        with self.lock:
            self.messages += 1
            self.transforms += len(batch)
            self.bytes += len(payload)
        removed = self._removed_in(message.epoch_ns)
        self.insert(batch.without(removed) if removed else batch, message.epoch_ns)
        if late := self._removed_in(message.epoch_ns) - removed:
            # Some were removed meanwhile.
            late &= {child for _, child in _edges(batch)}
            self.buffer.remove_sent(late, self.name)

    def _removed_in(self, epoch_ns: int) -> frozenset[str]:
        """The frames that the stream listed in this epoch, and lists no more."""
        with self.lock:
            return self._removed if self._listed_epoch_ns == epoch_ns else frozenset()

    def receive_static(self, payload: bytes) -> None:
        """Take the whole set of static transforms of the stream, in the place of the former."""
        message = self.decode(payload)
        if message is None:
            return
        epoch_ns = message.epoch_ns
        with self.lock:
            former, former_ns = self.statics, self._static_epoch_ns
            # A stream whose clock went back goes on with its statics, and may not send them again.
            is_older = former_ns is not None and epoch_ns < former_ns and not self._was_gone
            if is_older or (epoch_ns > (self.epoch_ns or 0) and self._is_outdated(epoch_ns)):
                self.outdated += 1
                return
            self.count(len(message.batch), len(payload))
            self._statics_are_current |= not self.gone
            if former_ns == epoch_ns and _is_before(message.seq, self._static_seq):
                return
            self.statics, self._static_epoch_ns = message.batch, epoch_ns
            self._static_seq = message.seq
            is_newer = self.epoch_ns is None or epoch_ns > self.epoch_ns
        if is_newer:
            self.admit(epoch_ns)
        self.apply_statics(None)
        if former is not None and former_ns == epoch_ns:
            children = {child for _, child in _edges(message.batch)}
            self._remove_static({child for _, child in _edges(former)} - children)

    def lacks_statics(self) -> bool:
        """Whether its publisher is there and lists static transforms that have not come, or may
        have changed while it was not there.
        """
        with self.lock:
            statics, listed = self.statics, self._listed_statics
            if self.gone or not listed:
                return False
            if not self._statics_are_current or statics is None:
                return True
        return not listed <= {child for _, child in _edges(statics)}

    def forget_statics(self) -> None:
        """The static transforms are not heard of any more."""
        with self.lock:
            self.statics = self._static_epoch_ns = self._static_seq = None

    def apply_statics(self, children: Collection[str] | None) -> None:
        """Put the static transforms of these frames, or all, into the buffer, as they were last
        received.
        """
        applied = None
        while (batch := self.statics) is not applied and batch is not None:
            rows = batch if children is None else batch.only(children)
            if len(rows):
                self.insert(rows, self._static_epoch_ns or 0, static=True)
            applied = batch

    def _remove_static(self, children: Collection[str]) -> None:
        if children:
            held = self.buffer.sent_by(self.name)
            # One that has samples moves now, and is no longer static for that reason.
            gone = [child for child in children if held.get(child) == 0]
            self.buffer.remove_sent(gone, self.name)

    def describe(
        self,
        epoch_ns: int,
        children: frozenset[str],
        statics: frozenset[str] = frozenset(),
        publisher: Publisher | None = None,
    ) -> None:
        """Take what the stream says its frames are, and which of them are static; one that the same
        publisher had in the list and has no more was removed.
        """
        with self.lock:
            if self._is_outdated(epoch_ns):
                return
        self.admit(epoch_ns)
        with self.lock:
            former, former_ns = self.listed, self._listed_epoch_ns
            self.listed, self._listed_epoch_ns = children, epoch_ns
            self._listed_statics = statics
            # Its clock may have gone back just then; who was started again leaves frames behind.
            is_same = publisher is not None and publisher == self._publisher
            self._publisher = publisher
            self._turns += 1
            dropped = former - children if former_ns == epoch_ns or is_same else frozenset()
            goes_on = former_ns == epoch_ns and len(self._removed) < _MOST_REMOVED
            self._removed = ((self._removed if goes_on else frozenset()) | dropped) - children
        if dropped:
            self.buffer.remove_sent(dropped, self.name)
        self.mark()

    def appear(self) -> None:
        """The publisher is there, for the first time or again."""
        with self.lock:
            self.gone = False
            self._turns += 1
        self.mark()

    def vanish(self) -> None:
        """The publisher is there no more."""
        with self.lock:
            self.gone = self._was_gone = True
            self._statics_are_current = False
            self._turns += 1
        self.mark()

    def mark(self) -> None:
        """Say of each frame in the buffer whether it is gone.

        All are where the publisher is. Else those are that a former epoch left behind: not in
        the stream's list, and without a sample of this epoch. Before there is a list of this
        epoch, those that were gone stay so until they are sent.
        """
        marked = -1
        while marked != self._turns:
            marked = self._turns
            held = self.buffer.sent_by(self.name)
            if self.gone:
                self._left = frozenset()
                self.buffer.mark_gone(held, True, self.name)
                continue
            self._left = self._left_behind(held)
            if self._listed_epoch_ns == self.epoch_ns:
                self.buffer.mark_gone(self._left, True, self.name)
            self.buffer.mark_gone(held.keys() - self._left, False, self.name)

    def _left_behind(self, held: dict[str, int]) -> frozenset[str]:
        current: set[str] = set()
        if self._listed_epoch_ns == self.epoch_ns:
            current |= self.listed
        if self.statics is not None and self._static_epoch_ns == self.epoch_ns:
            current |= {child for _, child in _edges(self.statics)}
        return frozenset({frame for frame, samples in held.items() if not samples} - current)

    def _find_again(self, batch: TransformBatch | Columns) -> None:
        """Frames that were left behind, and are sent again."""
        whole = batch.as_batch() if isinstance(batch, Columns) else batch
        found = self._left & {child for _, child in _edges(whole)}
        self._left -= found
        self.buffer.mark_gone(found, False, self.name)

    def exclude(self, ruling: Ruling) -> bool:
        """Take from now on what it has won, and not what it has lost; whether that is new."""
        former = self.excluded
        self.excluded = (former - ruling.won) | ruling.lost
        # What it sent before lies between the winner's samples, or in its future.
        self.buffer.forget(self.name, self.excluded - former)
        return self.excluded != former

    def decode(self, payload: bytes) -> TransformMessage | None:
        """The message in a payload; None, and counted, where there is none."""
        try:
            return self.reader.read(payload)
        except DecodeError as error:
            self.reject(error)
            return None


class DynamicReception:
    """One key of a stream that carries what moves; its messages are numbered."""

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
        columns, epoch_ns = message.rows, message.epoch_ns
        if not stream.admit(epoch_ns, live=True):
            return
        # First of all, so that no lookup waits for the rest.
        stream.insert(columns, epoch_ns)
        stamp_ns = columns.last_stamp_ns()
        with stream.lock:
            stream.count(columns.count, len(payload))
            if message.seq is not None:
                self._count_missed(epoch_ns, message.seq)
            if stamp_ns is not None:
                delay_s = (stream.now_ns() - stamp_ns) / 1e9
                former_s = delay_s if stream.delay_s is None else stream.delay_s
                stream.delay_s = former_s + _SMOOTHING * (delay_s - former_s)

    def _count_missed(self, epoch_ns: int, seq: int) -> None:
        next_seq = self._next_seq
        if epoch_ns != self._epoch_ns:
            # What was sent before we could hear it was not missed.
            self._epoch_ns, self._next_seq = epoch_ns, seq + 1
        elif seq >= next_seq:
            self.stream.missed += seq - next_seq
            self._next_seq = seq + 1


class StaticReception:
    """The key of a stream that carries its static transforms."""

    def __init__(self, stream: StreamReception) -> None:
        self.stream = stream

    def receive(self, payload: bytes) -> None:
        """Take one message as it comes."""
        self.stream.receive_static(payload)


def _is_before(seq: int | None, other: int | None) -> bool:
    return seq is not None and other is not None and seq < other


def _edges(batch: TransformBatch) -> list[tuple[str, str]]:
    """Parent and child of each row."""
    frames = batch.frames
    return [(frames[parent], frames[child]) for parent, child in batch.edges.tolist()]
