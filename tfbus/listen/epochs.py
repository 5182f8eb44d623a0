"""Messages of a stream that are outdated: the last of a dead process, or those of a living one."""

import math

# What was on its way from a dead process comes within a moment, so what is closer together is
# counted once.
_APART_S = 0.35
# A second of something that comes often, or a few periods of what comes seldom.
_ALONE = 4
# Two seconds of it.
_OF_A_LIVING = 7
# Those of several epochs belong together where they follow each other as closely as that.
_TOGETHER_S = 5.0


class Stragglers:
    """Judges by the outdated messages of one stream whether a process lives that sends them."""

    def __init__(self) -> None:
        self._epoch_ns: int | None = None
        self._heard = 0
        self._heard_s = -math.inf
        # Those since something that counts has come.
        self._alone = 0
        self._alone_s = -math.inf
        self._counted: int | None = None

    def hear(self, epoch_ns: int, counted: int, now_s: float) -> None:
        """Take note of one that comes now; so many messages of the stream have counted so far."""
        if epoch_ns != self._epoch_ns and now_s > self._heard_s + _TOGETHER_S:
            self._heard = 0
        self._epoch_ns = epoch_ns
        if now_s >= self._heard_s + _APART_S:
            self._heard, self._heard_s = self._heard + 1, now_s
        if counted != self._counted:
            self._counted = counted
            self._alone, self._alone_s = 1, now_s
        elif now_s >= self._alone_s + _APART_S:
            self._alone, self._alone_s = self._alone + 1, now_s

    def are_of_a_living(self) -> bool:
        """Whether they have come for too long to be the last of a dead process."""
        return self._heard >= _OF_A_LIVING

    def are_alone(self) -> bool:
        """Whether only they still come, and nothing that counts."""
        return self._alone >= _ALONE
