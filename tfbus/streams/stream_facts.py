"""The state of one stream that the stages of its reception share, and the listener around it.

A publisher puts its epoch into each message: when it started, or when its clock went back. The
newest epoch counts. Late messages of a dead process end soon; a second live one's go on.

Any peer can put any number into a message. So once the session that publishes the stream has
confirmed its epoch, by a description that came from it, another epoch counts only when a
description confirms that one. Before that, an epoch from the future ends none from the past.
"""

import logging
import math
from collections import deque
from collections.abc import Callable
from enum import Enum

from tfbus.base import scheduler
from tfbus.base.log import LogOnce
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.insert_many import Permit
from tfbus.geometry.columns import Columns
from tfbus.streams.info import StreamCounts
from tfbus.wire.transforms import TransformMessage

# Late messages of a dead process come within a moment: messages closer together count once.
_APART_S = 0.35
# About 1 s of frequent messages, or four periods of rare ones.
_ALONE = 4
# About 2 s of them.
_OF_LIVE_PUBLISHER = 7
# Outdated messages of several epochs belong together where at most this lies between them.
_TOGETHER_S = 5.0

# Clocks differ. An epoch further ahead of ours is from the future.
_MOST_SKEW_NS = 60 * 10**9

# A description follows its stream's new epoch within a second. Any peer can send such messages, so
# the listener keeps few of them, of all streams together.
MOST_PENDING_BYTES = 4 * 2**20
_OVERHEAD_BYTES = 300

Receive = Callable[[bytes], None]
# A stream, the epoch of a message of it, its receiver, its bytes, and `OF_EPOCH` or `OF_NAMES`.
_Pending = tuple[str, int, Receive, bytes, str]

# The description that a message waits for.
OF_EPOCH, OF_NAMES = "of their epoch", "with the names of their frames"


class Verdict(Enum):
    """The kind of a message by its epoch."""

    PRESENT = "of the epoch that counts"
    FIRST = "the first of the stream"
    RESTART = "of a new epoch, which counts from now on"
    TAKEOVER = "of an outdated epoch, which counts again, since only its messages still come"
    OUTDATED = "outdated"
    DISPUTED = "of an epoch that the publisher has to confirm first"
    FUTURE = "of an epoch in the future, while one that is not counts"

    @property
    def counts(self) -> bool:
        """Whether the message is taken."""
        return self in _THAT_COUNT


_THAT_COUNT = frozenset({Verdict.PRESENT, Verdict.FIRST, Verdict.RESTART, Verdict.TAKEOVER})


class Epochs:
    """The epochs of one stream, and whether its publisher is gone.

    Not safe by itself: hold the stream's lock around each method. The attributes may be read
    without it, `present_ns` and `was_gone` for a quick look at a message.
    """

    def __init__(self) -> None:
        self.present_ns: int | None = None
        # The epoch that the publisher's own session says it is in; None before its description.
        self.confirmed_ns: int | None = None
        # By the token: whether the publisher was there and is gone; and whether it was gone since
        # the last message of the present epoch.
        self.gone = self.was_gone = False
        # The last that began with a process or a jump of its clock: no earlier one is new.
        self._newest_ns: float | None = None
        self._newest_confirmed_ns: float = -math.inf
        self._outdated = _OutdatedMessages()
        # How far the present epoch was in the future when it began: its publisher's clock.
        self._ahead_ns = 0

    @property
    def second_publisher_is_alive(self) -> bool:
        """Whether outdated messages come for too long to be the last of a dead process."""
        return self._outdated.runs >= _OF_LIVE_PUBLISHER

    def appear(self) -> None:
        """The publisher is there, for the first time or again."""
        self.gone = False

    def vanish(self) -> None:
        """The publisher is gone."""
        self.gone = self.was_gone = True
        self.confirmed_ns = None
        self._newest_confirmed_ns = -math.inf

    def confirm(self, epoch_ns: int) -> Verdict:
        """The publisher's own session says that it is in this epoch, which counts from now on."""
        self.confirmed_ns = epoch_ns
        self._newest_confirmed_ns = max(epoch_ns, self._newest_confirmed_ns)
        if epoch_ns == self.present_ns:
            self.was_gone &= self.gone
            return Verdict.PRESENT
        is_first = self.present_ns is None
        # The former newest epoch may have been made up, unless it was confirmed too.
        self._newest_ns = self._newest_confirmed_ns
        self._begin(epoch_ns)
        return Verdict.FIRST if is_first else Verdict.RESTART

    def is_outdated(self, epoch_ns: int) -> bool:
        """Whether an epoch is not the present one, and not new.

        After the publisher was gone an earlier epoch is new too: it was restarted on a host whose
        clock is wrong.
        """
        if self._newest_ns is None or self.was_gone or epoch_ns == self.present_ns:
            return False
        return epoch_ns <= self._newest_ns

    def judge(self, epoch_ns: int) -> Verdict:
        """Judge a message of this epoch; a new epoch begins with its first message."""
        if epoch_ns == self.present_ns:
            self.was_gone &= self.gone
            return Verdict.PRESENT
        if self.is_outdated(epoch_ns):
            return Verdict.OUTDATED
        if self.confirmed_ns is not None and not self.was_gone:
            return Verdict.DISPUTED
        is_first = self.present_ns is None
        if not is_first and not self.was_gone and is_from_future(epoch_ns - self._ahead_ns):
            return Verdict.FUTURE
        self._newest_ns = epoch_ns
        self._begin(epoch_ns)
        return Verdict.FIRST if is_first else Verdict.RESTART

    def judge_live(self, epoch_ns: int, counted: int, now_s: float) -> Verdict:
        """Judge a message that was sent just now, not kept or retained: such messages show that
        their publisher is alive, so an outdated epoch counts again if only they still come.

        `counted` messages of present epochs have come so far; `now_s` is a clock that never goes
        back.
        """
        verdict = self.judge(epoch_ns)
        if verdict is not Verdict.OUTDATED:
            return verdict
        self._outdated.add(epoch_ns, counted, now_s)
        if self._outdated.runs_alone < _ALONE:
            return Verdict.OUTDATED
        if self.confirmed_ns is not None:
            return Verdict.DISPUTED
        self._begin(epoch_ns)
        return Verdict.TAKEOVER

    def _begin(self, epoch_ns: int) -> None:
        self.present_ns = epoch_ns
        self._ahead_ns = max(0, epoch_ns - scheduler.time_ns())
        # A message may precede its publisher's token.
        self.gone = self.was_gone = False


def is_from_future(epoch_ns: int) -> bool:
    """Whether an epoch is further ahead of our system's clock than clocks differ."""
    return epoch_ns > scheduler.time_ns() + _MOST_SKEW_NS


class _OutdatedMessages:
    """Counts runs of outdated messages: all within `_APART_S` are one run.

    `runs_alone` are the runs since the last message that counts.
    """

    def __init__(self) -> None:
        self.runs = self.runs_alone = 0
        self._run_s = self._run_alone_s = -math.inf
        self._epoch_ns: int | None = None
        self._counted: int | None = None

    def add(self, epoch_ns: int, counted: int, now_s: float) -> None:
        """Add a message that comes now, after `counted` messages that count."""
        if epoch_ns != self._epoch_ns and now_s > self._run_s + _TOGETHER_S:
            self.runs = 0
        self._epoch_ns = epoch_ns
        if now_s >= self._run_s + _APART_S:
            self.runs, self._run_s = self.runs + 1, now_s
        if counted != self._counted:
            self._counted = counted
            self.runs_alone, self._run_alone_s = 1, now_s
        elif now_s >= self._run_alone_s + _APART_S:
            self.runs_alone, self._run_alone_s = self.runs_alone + 1, now_s


class PendingMessages:
    """Messages of disputed epochs, and of frames without names, at most `most_bytes` of all
    streams; safe from any thread.

    The oldest go first.
    """

    def __init__(self, most_bytes: int = MOST_PENDING_BYTES) -> None:
        self._most_bytes = most_bytes
        self._lock = scheduler.Lock()
        self._messages: deque[_Pending] = deque()
        self._bytes = 0

    def add(
        self, stream: str, epoch_ns: int, receive: Receive, payload: bytes, of: str = OF_EPOCH
    ) -> str:
        """Add a message of this epoch, which `receive` takes once the stream is described; `of` is
        the description that it waits for. Of the last message that had to go its own, "" if none.
        """
        dropped = ""
        with self._lock:
            self._messages.append((stream, epoch_ns, receive, payload, of))
            self._bytes += len(payload) + _OVERHEAD_BYTES
            while self._bytes > self._most_bytes:
                *_, old, dropped = self._messages.popleft()
                self._bytes -= len(old) + _OVERHEAD_BYTES
        return dropped

    def has(self, stream: str) -> bool:
        """Whether messages of a stream wait."""
        with self._lock:
            return any(message[0] == stream for message in self._messages)

    def release(self, stream: str, epoch_ns: int, *, is_last: bool = True) -> None:
        """The stream is in this epoch: have its messages received, and forget all of others; of
        later epochs only if it `is_last`.
        """
        with self._lock:
            mine: deque[_Pending] = deque()
            others: deque[_Pending] = deque()
            for message in self._messages:
                is_over = message[0] == stream and (is_last or message[1] <= epoch_ns)
                (mine if is_over else others).append(message)
            if not mine:
                return
            self._messages = others
            self._bytes -= sum(len(payload) + _OVERHEAD_BYTES for *_, payload, _ in mine)
        for _, its_epoch_ns, receive, payload, _ in mine:
            if its_epoch_ns == epoch_ns:
                receive(payload)


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
        # Sets of earlier epochs are of former processes; None once the present one's has come.
        self._own_from_ns: int | None = None

    def replace(self, message: TransformMessage, *, is_current: bool) -> frozenset[str] | None:
        """Take the set of a message; `is_current` if its publisher is not gone.

        Returns the children that the former set of this epoch had and the new one does not; None,
        with nothing replaced, if a later set of this epoch is there.
        """
        if self._own_from_ns is None or message.epoch_ns >= self._own_from_ns:
            self._is_current |= is_current
            self._own_from_ns = None
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
        even if it comes only now.
        """
        if self.epoch_ns is None or self.epoch_ns < started_ns:
            self._is_current, self._own_from_ns = False, started_ns

    def accept_any(self) -> None:
        """Another process publishes the stream: take its set, whatever its epoch and number."""
        self.epoch_ns = self._seq = self._own_from_ns = None
        self._is_current = False

    def clear(self) -> None:
        """Forget the set: it is no longer read."""
        self.batch = self.epoch_ns = self._seq = None


def _is_before(seq: int | None, other: int | None) -> bool:
    return seq is not None and other is not None and seq < other


def lines_of(log: logging.Logger) -> LogOnce:
    """The log for repeated events of streams."""
    return LogOnce(log, again_s=_LINES_APART_S, most=_MOST_LINES)


class ReceptionHooks:
    """A listener as the receptions of its streams see it; by itself it does nothing.

    `once` logs faults of a stream whose publisher has confirmed it, `once_of_unconfirmed` faults of
    others: any process can make up their names, and so fill its log. `lines` is for repeated
    events. `pending` are the messages of all streams whose epochs are not confirmed.
    """

    def __init__(self, log: logging.Logger) -> None:
        self.once = LogOnce(log)
        self.once_of_unconfirmed = LogOnce(log)
        self.lines = lines_of(log)
        self.pending = PendingMessages()

    def claimed_by_others(self, stream: str, children: frozenset[str]) -> frozenset[str]:
        """The frames among these, which the stream sends and does not list, that others list.
        When that changes, the stream's permit is taken back.
        """
        return frozenset()

    def on_overlap(self, stream: str, frames: frozenset[str]) -> None:
        """The stream has removed these frames, which may have covered frames of another."""

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

    def on_unnamed(self, stream: str, epoch_ns: int) -> None:
        """A message has come with numbers that the stream has not described."""

    def on_growth(self, stream: str) -> None:
        """The stream may take more memory."""

    def on_gap(self, stream: str, silent_s: float) -> None:
        """Messages are missing before one that has come after a silence."""

    def on_message_while_gone(self, stream: str) -> None:
        """A message has come though the publisher is gone."""


class StreamFacts:
    """The state of one stream that the stages of its reception share.

    The lock guards it, and is never held while the buffer is filled: callbacks for changes of the
    buffer may do anything. A judgement of rows in between may no longer be true when they are
    stored. So they are stored with the `permit` of before, which is taken back by each change that
    forbids rows: rows under way are in the buffer by then, or come through all stages again.
    """

    def __init__(
        self, name: str, buffer: Buffer, log: logging.Logger, around: ReceptionHooks
    ) -> None:
        self.name = name
        self.buffer = buffer
        self.log = log
        self.lock = scheduler.Lock()
        self.epochs = Epochs()
        self.static_set = StaticSet()
        self.listing = Listing()
        self.counts = StreamCounts()
        self.permit = Permit()
        self._around = around

    def revoke_permit(self) -> None:
        """Store no rows that were judged before this; with the lock held."""
        former, self.permit = self.permit, Permit()
        former.is_valid = False

    def warn_once(self, kind: str, text: str, *values: object) -> None:
        """Log the first of a kind of this stream."""
        of_stream = kind, self.name
        logs = self._around.once, self._around.once_of_unconfirmed
        of_now = logs[0] if self.epochs.confirmed_ns is not None else logs[1]
        once = next((log for log in logs if of_stream in log.counts), of_now)
        once.warning(of_stream, text, *values)
