"""Epochs: which messages of a stream count.

A publisher puts its epoch into each message: when it started, or when its clock went back. The
newest epoch counts. Late messages of a dead process end soon; those of a second live one go on.
"""

import math
from enum import Enum

# Late messages of a dead process come within a moment: those closer together are counted once.
_APART_S = 0.35
# About 1 s of frequent messages, or four periods of rare ones.
_ALONE = 4
# About 2 s of them.
_OF_LIVE_PUBLISHER = 7
# Outdated messages of several epochs belong together where at most this lies between them.
_TOGETHER_S = 5.0


class Verdict(Enum):
    """What a message is by its epoch."""

    PRESENT = "of the epoch that counts"
    FIRST = "the first of the stream"
    RESTART = "of a new epoch, which counts from now on"
    TAKEOVER = "of an outdated epoch, which counts again, since only its messages still come"
    OUTDATED = "outdated"

    @property
    def counts(self) -> bool:
        """Whether the message is taken."""
        return self is not Verdict.OUTDATED


class Epochs:
    """The epochs of one stream, and whether its publisher is gone.

    Not safe by itself: hold the stream's lock around each method. The attributes may be read
    without it, `present_ns` and `was_gone` for a quick look at a message.
    """

    def __init__(self) -> None:
        self.present_ns: int | None = None
        # By the token: whether the publisher was there and is gone; and whether it was gone since
        # the last message of the present epoch.
        self.gone = self.was_gone = False
        # The last that began with a process or a jump of its clock: no earlier one is new.
        self._newest_ns: int | None = None
        self._outdated = _OutdatedMessages()

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
        is_first = self.present_ns is None
        self._newest_ns = epoch_ns
        self._begin(epoch_ns)
        return Verdict.FIRST if is_first else Verdict.RESTART

    def judge_live(self, epoch_ns: int, counted: int, now_s: float) -> Verdict:
        """Judge a message that was sent just now, not kept or retained: such messages show that
        their publisher is alive, so an outdated epoch counts again where only they still come.

        `counted` messages of the stream have counted so far; `now_s` is a clock that never goes
        back.
        """
        verdict = self.judge(epoch_ns)
        if verdict.counts:
            return verdict
        self._outdated.add(epoch_ns, counted, now_s)
        if self._outdated.runs_alone < _ALONE:
            return Verdict.OUTDATED
        self._begin(epoch_ns)
        return Verdict.TAKEOVER

    def _begin(self, epoch_ns: int) -> None:
        self.present_ns = epoch_ns
        # A message may precede its publisher's token.
        self.gone = self.was_gone = False


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
