"""The pauses of this process itself: stopped, suspended, or without a CPU, it hears nobody.

After one its links are lost, since others have not heard it either, and are there again seconds
later. So the silence of others in that time, and until then, says nothing about them.
"""

import math
from collections.abc import Callable

from tfbus.base import scheduler
from tfbus.base.callbacks import Given
from tfbus.base.executor import Executor

# The process looks so often whether it runs, and has not run if that comes so much later: a link
# outlives a pause of less than about a second.
_LOOK_EVERY_S = 0.5
_LATE_S = 0.5

# Links that were lost by a pause are there again within this time.
_LINKED_WITHIN_S = 5.0

# A process that pauses over and over waits for others so many times, and then judges them.
MOST_TIMES = 3


class OwnPauses:
    """Notices the pauses of its process, by the looks of `watch`; safe from any thread."""

    def __init__(self) -> None:
        self._looked_s = math.inf
        self._began_s = self._ended_s = -math.inf

    def watch(self, executor: Executor) -> None:
        """Look from now on, until the executor is closed; one look of several is enough."""
        self._looked_s = scheduler.boot_time()
        executor.every(_LOOK_EVERY_S, self._look)

    def left_s(self) -> float:
        """For how many seconds others have to be heard yet before they can be judged; mostly 0."""
        now_s = scheduler.boot_time()
        if now_s - self._looked_s > _LOOK_EVERY_S + _LATE_S:
            self._began_s, self._ended_s = self._looked_s, now_s
        since_s = now_s - self._ended_s
        return _LINKED_WITHIN_S - since_s if 0.0 <= since_s < _LINKED_WITHIN_S else 0.0

    def since_s(self) -> float:
        """How many seconds ago the last pause began, while others have to be heard yet; else 0."""
        return scheduler.boot_time() - self._began_s if self.left_s() else 0.0

    def after(
        self,
        executor: Executor,
        delay_s: float,
        judge: Callable[[*Given], object],
        *given: *Given,
        times: int = MOST_TIMES,
    ) -> None:
        """Call `judge(*given)` on this executor after so many seconds, and later after a pause."""

        def look() -> None:
            if (left_s := self.left_s()) and times:
                self.after(executor, left_s, judge, *given, times=times - 1)
            else:
                judge(*given)

        executor.after(max(delay_s, self.left_s()), look)

    def _look(self) -> None:
        self.left_s()  # notices a pause
        self._looked_s = scheduler.boot_time()


def own_pauses() -> OwnPauses:
    """The pauses of this process."""
    return scheduler.of_process(OwnPauses)
