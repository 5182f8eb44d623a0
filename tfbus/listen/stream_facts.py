"""The state of one stream that the stages of its reception share, and the listener around it."""

import logging

from tfbus.buffer.buffer import Buffer
from tfbus.buffer.insert_many import Permit
from tfbus.geometry.columns import Columns
from tfbus.listen.epochs import Epochs, PendingMessages
from tfbus.listen.info import Counts
from tfbus.runtime import scheduler
from tfbus.runtime.log_once import LogOnce
from tfbus.wire.transforms import TransformMessage

# Kept messages of a removed frame may still be on their way. Frame names come from the bus: at
# most this many removed ones are remembered, then all but the last are forgotten.
_MOST_REMOVED = 10_000

# Lines that a stream could cause without end come again after this time, with their number; in that
# time of at most this many streams.
_LINES_APART_S = 60.0
_MOST_LINES = 50

# Node, process id and Zenoh's session: they tell one process from the next.
Publisher = tuple[str, int, str]


class Listing:
    """The frames that one stream lists. Not safe by itself: hold the stream's lock around methods.

    The attributes may be read without it.
    """

    def __init__(self) -> None:
        self.children: frozenset[str] = frozenset()
        self.epoch_ns: int | None = None
        self.publisher: Publisher | None = None
        self._removed: frozenset[str] = frozenset()

    def replace(
        self, epoch_ns: int, children: frozenset[str], publisher: Publisher | None
    ) -> frozenset[str]:
        """Take a new list; returns the frames that the publisher has removed since the last one.

        A restarted publisher removes nothing: frames that it does not list are gone. A stream
        whose clock went back has a new epoch too, and is the same publisher.
        """
        is_same_epoch = epoch_ns == self.epoch_ns
        is_same = is_same_epoch or (publisher is not None and publisher == self.publisher)
        dropped = self.children - children if is_same else frozenset()
        kept = is_same_epoch and len(self._removed) < _MOST_REMOVED
        self._removed = ((self._removed if kept else frozenset()) | dropped) - children
        self.children, self.epoch_ns, self.publisher = children, epoch_ns, publisher
        return dropped

    def removed_in(self, epoch_ns: int) -> frozenset[str]:
        """The frames that the stream listed in this epoch, and no longer lists."""
        return self._removed if self.epoch_ns == epoch_ns else frozenset()


class StaticSet:
    """The static transforms of one stream; each message of them is the whole set.

    Not safe by itself: hold the stream's lock around each method. `batch` and `epoch_ns` may be
    read without it; a batch is never changed, only replaced.
    """

    def __init__(self) -> None:
        self.batch: Columns | None = None
        self.epoch_ns: int | None = None
        # The frames that the stream lists as static.
        self.listed: frozenset[str] = frozenset()
        # How many sets have come of an epoch that does not count: of another process, or of this
        # one before its clock went back.
        self.of_others = 0
        self._seq: int | None = None
        # False where the set may have changed since it last came.
        self._is_current = True
        # The epoch of the set of a former process, which another one has taken over from.
        self._former_ns: int | None = None

    def replace(self, message: TransformMessage, *, is_current: bool) -> frozenset[str] | None:
        """Take the set of a message; `is_current` if its publisher is not gone.

        Returns the children that the former set of this epoch had and the new one does not; None,
        with nothing replaced, if a later set of this epoch is there.
        """
        if message.epoch_ns != self._former_ns:
            self._is_current |= is_current
            self._former_ns = None
        is_same_epoch = message.epoch_ns == self.epoch_ns
        if is_same_epoch and _is_before(message.seq, self._seq):
            return None
        former = self.batch.children() if self.batch is not None and is_same_epoch else frozenset()
        self.batch, self.epoch_ns, self._seq = message.rows, message.epoch_ns, message.seq
        return former - message.rows.children()

    def is_missing(self) -> bool:
        """Whether a listed transform has not come, or may have changed since."""
        if not self.listed:
            return False
        if self.batch is None or not self._is_current:
            return True
        return not self.listed <= self.batch.children()

    def expire(self) -> None:
        """The set may change unnoticed: its publisher is gone."""
        self._is_current = False

    def expire_before(self, started_ns: int) -> None:
        """Another process publishes the stream, which began then: a set of before is not its own,
        even if it comes again.
        """
        if self.epoch_ns is not None and self.epoch_ns < started_ns:
            self._is_current, self._former_ns = False, self.epoch_ns

    def accept_any(self) -> None:
        """Another process publishes the stream: take its set, whatever its epoch and number."""
        self.epoch_ns = self._seq = self._former_ns = None
        self._is_current = False

    def clear(self) -> None:
        """Forget the set: it is no longer read."""
        self.batch = self.epoch_ns = self._seq = None


def _is_before(seq: int | None, other: int | None) -> bool:
    return seq is not None and other is not None and seq < other


def lines_of(log: logging.Logger) -> LogOnce:
    """The log for what streams do again and again."""
    return LogOnce(log, again_s=_LINES_APART_S, most=_MOST_LINES)


class Listening:
    """A listener as the receptions of its streams see it; by itself it does nothing.

    `once` logs what is wrong with a stream whose publisher has confirmed it, `once_of_unconfirmed`
    what is wrong with others: any process can make up their names, and so fill its log. `lines` is
    for what happens again. `pending` are the messages of all streams whose epochs are not
    confirmed.
    """

    def __init__(self, log: logging.Logger) -> None:
        self.once = LogOnce(log)
        self.once_of_unconfirmed = LogOnce(log)
        self.lines = lines_of(log)
        self.pending = PendingMessages()

    def claimed_by_others(self, stream: str, children: frozenset[str]) -> frozenset[str]:
        """The frames among these, which the stream sends and does not list, that others list.
        Where that changes, the stream's `revoke_permit` is called.
        """
        return frozenset()

    def on_overlap(self, stream: str, frames: frozenset[str]) -> None:
        """The stream has removed these frames, which may have covered those of another."""

    def on_unlisted(self, stream: str, frames: frozenset[str]) -> None:
        """The stream has sent these frames and does not list them, at each message and list:
        `drop_unlisted` drops them once they are silent.
        """

    def on_takeover(self, stream: str, epoch_ns: int) -> None:
        """Two processes publish the stream, one fell silent, and the messages of the other count
        from now on.
        """

    def on_dispute(self, stream: str, epoch_ns: int) -> None:
        """Messages of an epoch come that the publisher has to confirm."""

    def on_growth(self, stream: str) -> None:
        """The stream may take more memory."""

    def on_message_while_gone(self, stream: str) -> None:
        """A message has come though the publisher is gone."""


class StreamFacts:
    """The state of one stream that the stages of its reception share.

    The lock guards it, and is never held while the buffer is filled: callbacks for changes of the
    buffer may do anything. What was found of rows in between may no longer be true when they are
    stored. So they are stored with the `permit` of before, which is taken back by each change that
    forbids rows: what is under way is in the buffer by then, or comes through all stages again.
    """

    def __init__(self, name: str, buffer: Buffer, log: logging.Logger, around: Listening) -> None:
        self.name = name
        self.buffer = buffer
        self.log = log
        self.lock = scheduler.Lock()
        self.epochs = Epochs()
        self.static_set = StaticSet()
        self.listing = Listing()
        self.counts = Counts()
        self.permit = Permit()
        self._around = around

    def revoke_permit(self) -> None:
        """Store no rows that were judged by what was known before; with the lock held."""
        former, self.permit = self.permit, Permit()
        former.is_valid = False

    def warn_once(self, kind: str, text: str, *values: object) -> None:
        """Log the first of a kind of this stream."""
        of_stream = kind, self.name
        logs = self._around.once, self._around.once_of_unconfirmed
        of_now = logs[0] if self.epochs.confirmed_ns is not None else logs[1]
        once = next((log for log in logs if of_stream in log.counts), of_now)
        once.warning(of_stream, text, *values)
