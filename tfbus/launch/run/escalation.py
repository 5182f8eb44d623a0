"""The stop ladder: SIGINT to every process group, after a while SIGTERM, then SIGKILL."""

import asyncio
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tfbus.launch.run.child import Child
from tfbus.launch.run.console import Console

RUNGS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


@dataclass(frozen=True, slots=True)
class Patience:
    """How long a supervisor waits, in seconds: after each signal, and between two notices."""

    after_sigint_s: float = 5.0
    after_sigterm_s: float = 5.0
    after_sigkill_s: float = 5.0
    notice_s: float = 3.0

    def after(self, number: signal.Signals) -> float:
        """How long to wait after this signal before the next thing is tried."""
        waits = (self.after_sigint_s, self.after_sigterm_s, self.after_sigkill_s)
        return waits[RUNGS.index(number)]


class StopLadder:
    """Climbed once in a launch, by itself or hurried, until `children` is empty.

    `give_up` is called when some live on even after SIGKILL (in the kernel's hands).
    """

    def __init__(
        self,
        children: Sequence[Child],
        console: Console,
        patience: Patience,
        give_up: Callable[[], None],
    ) -> None:
        self._children = children
        self._console = console
        self._patience = patience
        self._give_up = give_up
        self._rung: signal.Signals | None = None  # the last signal that all were sent
        self._escalation: asyncio.TimerHandle | None = None

    @property
    def is_climbed(self) -> bool:
        """Whether the first signal was sent."""
        return self._rung is not None

    def climb(self, at_least: signal.Signals = signal.SIGINT) -> None:
        """Send the next signal, none before `at_least`, and set the time of the one after it."""
        lowest = 0 if self._rung is None else RUNGS.index(self._rung) + 1
        number = RUNGS[min(max(lowest, RUNGS.index(at_least)), len(RUNGS) - 1)]
        self._rung = number
        for child in self._children:
            name = child.program.name
            self._console.say("INFO", name, f"sending signal '{number.name}' to process[{name}]")
            child.send(number)
        self.leave()
        self._escalation = asyncio.get_running_loop().call_later(
            self._patience.after(number), self._escalate, number
        )

    def leave(self) -> None:
        """Climb no further by itself."""
        if self._escalation:
            self._escalation.cancel()

    def _escalate(self, number: signal.Signals) -> None:
        """Go on to the signal after `number`, which some did not obey in time."""
        text = f"'{self._patience.after(number):g}' seconds after receiving '{number.name}'"
        following = RUNGS[RUNGS.index(number) + 1 :]
        then = f"escalating to '{following[0].name}'" if following else "giving up"
        for child in self._children:
            name = child.program.name
            self._console.say("ERROR", name, f"process[{name}] failed to terminate {text}, {then}")
        if following:
            self.climb()
        else:
            self._give_up()
