"""Ask again until an answer has come.

A question may be lost, come before the way to the publisher is open, or before it has anything to
answer. So it is asked again after a pause, each time on the thread of an executor.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

from tfbus.errors import BusError
from tfbus.runtime import scheduler
from tfbus.runtime.executor import Executor


class Pauses(NamedTuple):
    """The pauses between questions.

    `again_s` are the pauses in turn; with `forever` the last of them repeats, without it the
    questions end. A question that is open for longer than `lost_after_s` counts as unanswered, and
    the next pause begins; None waits for its end.
    """

    again_s: tuple[float, ...]
    forever: bool = False
    lost_after_s: float | None = None

    def after(self, turn: int) -> float | None:
        """The pause after the question of this turn, the first being 0; None: ask no further."""
        if turn < len(self.again_s):
            return self.again_s[turn]
        return self.again_s[-1] if self.forever else None


class AskUntil:
    """Asks until `is_settled()`, until `close()`, or until the pauses end.

    `ask(turn, on_end)` asks the question of a turn, the first being 0; `on_end` may be called on
    any thread. `is_settled()` is called before each question and at the end of each, also of one
    that counted as lost. `on_unanswered(turn)` is called once a question that settled nothing, and
    `on_over()` once. All but the first question and `close()` run on the executor's thread, and
    `what` names them in the log.
    """

    def __init__(
        self,
        executor: Executor,
        what: str,
        pauses: Pauses,
        *,
        ask: Callable[[int, Callable[[], None]], None],
        is_settled: Callable[[], bool],
        on_unanswered: Callable[[int], object] = lambda turn: None,
        on_over: Callable[[], object] = lambda: None,
    ) -> None:
        self._executor = executor
        self._what = what
        self._pauses = pauses
        self._ask = ask
        self._is_settled = is_settled
        self._on_unanswered = on_unanswered
        self._on_over = on_over
        self._lock = scheduler.Lock()
        self.is_over = False

    def start(self) -> None:
        """Ask the first question, on the calling thread."""
        self._take_turn(0)

    def close(self) -> None:
        """Ask no further. Twice is fine."""
        with self._lock:
            was_over, self.is_over = self.is_over, True
        if not was_over:
            self._on_over()

    def _take_turn(self, turn: int) -> None:
        if self._has_ended():
            return
        is_counted = False

        def end() -> None:
            nonlocal is_counted
            if not self._has_ended() and not is_counted:
                is_counted = True
                self._pause(turn)

        with suppress(BusError):  # the session is closed
            self._ask(turn, lambda: self._submit(end))
            if self._pauses.lost_after_s is not None:
                self._executor.after(self._pauses.lost_after_s, end)

    def _submit(self, job: Callable[[], None]) -> None:
        self._executor.submit(self._what, job)

    def _pause(self, turn: int) -> None:
        self._on_unanswered(turn)
        pause_s = self._pauses.after(turn)
        if pause_s is None:
            self.close()
        else:
            self._executor.after(pause_s, lambda: self._take_turn(turn + 1))

    def _has_ended(self) -> bool:
        if not self.is_over and self._is_settled():
            self.close()
        return self.is_over
