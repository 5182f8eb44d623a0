"""Spreads of numbers, and windows of the last messages."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from tfbus.base import scheduler


@dataclass(frozen=True)
class Spread:
    """The spread of `count` numbers; `std_dev` divides by n, not n - 1.

    `p50`, `p95` and `p99` are percentiles, each one of the numbers.
    """

    count: int
    mean: float
    min: float
    max: float
    std_dev: float
    p50: float
    p95: float
    p99: float


def spread_of(numbers: Sequence[float]) -> Spread | None:
    """The spread of the numbers; None for no numbers."""
    if not numbers:
        return None
    ordered = sorted(numbers)
    count = len(ordered)
    mean = math.fsum(ordered) / count
    std_dev = math.sqrt(math.fsum((number - mean) ** 2 for number in ordered) / count)
    middle, most, nearly_all = (ordered[math.ceil(count * part) - 1] for part in (0.5, 0.95, 0.99))
    return Spread(count, mean, ordered[0], ordered[-1], std_dev, middle, most, nearly_all)


class MessageWindow:
    """The last `size` messages of a topic: the arrival (in s) and a number of each."""

    def __init__(self, size: int):
        self._lock = scheduler.Lock()
        self._messages: deque[tuple[float, float]] = deque(maxlen=size)
        self._total = 0

    def add(self, at_s: float, number: float, *, grow: bool = True) -> bool:
        """Add a message; from any thread. Whether the window has grown: with `grow` False it takes
        the place of the oldest.
        """
        with self._lock:
            before = len(self._messages)
            if before and not grow:
                self._messages.popleft()
            self._messages.append((at_s, number))
            self._total += 1
            return len(self._messages) > before

    @property
    def last_s(self) -> float:
        """When the last message came; minus infinity before the first."""
        return self._messages[-1][0] if self._messages else -math.inf

    def __len__(self) -> int:
        return len(self._messages)

    def read(self) -> "WindowReading":
        """The window as it is now."""
        with self._lock:
            messages, total = list(self._messages), self._total
        return WindowReading(
            tuple(at_s for at_s, _ in messages), tuple(number for _, number in messages), total
        )


@dataclass(frozen=True)
class WindowReading:
    """A window at one time: arrivals, numbers, and the count of all messages so far."""

    arrivals_s: tuple[float, ...]
    numbers: tuple[float, ...]
    total: int

    @property
    def intervals_s(self) -> list[float]:
        """The times between arrivals, in seconds."""
        return [
            later - earlier
            for earlier, later in zip(self.arrivals_s, self.arrivals_s[1:], strict=False)
        ]
