"""Ends all process groups: SIGINT, after a while SIGTERM, then SIGKILL."""

import asyncio
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tfbus.launch.run.child import Child
from tfbus.launch.run.console import Console

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


@dataclass(frozen=True, slots=True)
class Timeouts:
    """How long a supervisor waits, in seconds: after each signal, and between two notices."""

    after_sigint_s: float = 5.0
    after_sigterm_s: float = 5.0
    after_sigkill_s: float = 5.0
    notice_s: float = 3.0

    def after(self, number: signal.Signals) -> float:
        """How long to wait after this signal."""
        waits = (self.after_sigint_s, self.after_sigterm_s, self.after_sigkill_s)
        return waits[SIGNALS.index(number)]


class Escalation:
    """Sends one signal after another until `children` is empty: by itself, or sooner if asked.

    Calls `give_up` if some survive SIGKILL, stuck in the kernel.
    """

    def __init__(
        self,
        children: Sequence[Child],
        console: Console,
        timeouts: Timeouts,
        give_up: Callable[[], None],
    ) -> None:
        self._children = children
        self._console = console
        self._timeouts = timeouts
        self._give_up = give_up
        self._sent: signal.Signals | None = None
        self._timer: asyncio.TimerHandle | None = None

    @property
    def has_begun(self) -> bool:
        """Whether the first signal was sent."""
        return self._sent is not None

    def explains(self, exit_code: int) -> bool:
        """Whether a process ends so by a signal that was sent: killed by it, or as a shell says."""
        sent = SIGNALS[: 0 if self._sent is None else SIGNALS.index(self._sent) + 1]
        return any(exit_code in (-number, 128 + number) for number in sent)

    def escalate(self, at_least: signal.Signals = signal.SIGINT) -> None:
        """Send the next signal, at least `at_least`, and start the timer for the one after it."""
        lowest = 0 if self._sent is None else SIGNALS.index(self._sent) + 1
        number = SIGNALS[min(max(lowest, SIGNALS.index(at_least)), len(SIGNALS) - 1)]
        self._sent = number
        for child in self._children:
            name = child.program.name
            self._console.say("INFO", name, f"sending signal '{number.name}' to process[{name}]")
            child.send(number)
        self.cancel()
        self._timer = asyncio.get_running_loop().call_later(
            self._timeouts.after(number), self._time_out, number
        )

    def cancel(self) -> None:
        """Stop the timer for the next signal."""
        if self._timer:
            self._timer.cancel()

    def _time_out(self, number: signal.Signals) -> None:
        """Send the signal after `number`, which some processes did not obey in time."""
        text = f"'{self._timeouts.after(number):g}' seconds after receiving '{number.name}'"
        following = SIGNALS[SIGNALS.index(number) + 1 :]
        then = f"escalating to '{following[0].name}'" if following else "giving up"
        for child in self._children:
            name = child.program.name
            self._console.say("ERROR", name, f"process[{name}] failed to terminate {text}, {then}")
        if following:
            self.escalate()
        else:
            self._give_up()
