"""Epochs: which messages of a stream count.

A publisher puts its epoch into each message: when it started, or when its clock went back. The
newest epoch counts. Late messages of a dead process end soon; those of a second live one go on.

Any peer can put any number into a message. So once the session that publishes the stream has
confirmed its epoch, by a description that came from it, another epoch counts only when a
description confirms that one. Before that, an epoch from the future ends none from the past.
"""

import math
from collections import deque
from collections.abc import Callable
from enum import Enum

from tfbus.runtime import scheduler

# Late messages of a dead process come within a moment: those closer together are counted once.
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
        # What counted before may have been made up, unless it was confirmed too.
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
    """Counts runs of outdated messages: those within `_APART_S` are one run.

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
    """Messages of disputed epochs, at most `most_bytes` of all streams; safe from any thread.

    The oldest go first.
    """

    def __init__(self, most_bytes: int = MOST_PENDING_BYTES) -> None:
        self._most_bytes = most_bytes
        self._lock = scheduler.Lock()
        self._messages: deque[tuple[str, int, Receive, bytes]] = deque()
        self._bytes = 0

    def add(self, stream: str, epoch_ns: int, receive: Receive, payload: bytes) -> None:
        """Add a message of this epoch, which `receive` takes once the epoch is confirmed."""
        with self._lock:
            self._messages.append((stream, epoch_ns, receive, payload))
            self._bytes += len(payload) + _OVERHEAD_BYTES
            while self._bytes > self._most_bytes:
                self._bytes -= len(self._messages.popleft()[3]) + _OVERHEAD_BYTES

    def release(self, stream: str, epoch_ns: int) -> None:
        """The stream is in this epoch: have its messages received, and forget those of others."""
        with self._lock:
            mine = [message for message in self._messages if message[0] == stream]
            if not mine:
                return
            self._messages = deque(message for message in self._messages if message[0] != stream)
            self._bytes -= sum(len(payload) + _OVERHEAD_BYTES for *_, payload in mine)
        for _, its_epoch_ns, receive, payload in mine:
            if its_epoch_ns == epoch_ns:
                receive(payload)
