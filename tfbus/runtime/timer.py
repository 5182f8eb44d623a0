"""Timers: callbacks that run again and again."""

from collections.abc import Callable, Coroutine
from typing import Any

from tfbus.runtime import scheduler
from tfbus.runtime.callback_groups import CallbackGroup


class Timer:
    """A callback that runs every `period_s` seconds until it is cancelled.

    Ticks that another callback held up are not made up for: the next one comes a whole number of
    periods after the first. With `once` there is only the first.
    """

    def __init__(
        self,
        period_s: float,
        callback: Callable[[], Any],
        *,
        once: bool = False,
        group: CallbackGroup | None = None,
    ):
        if not 0 < period_s < scheduler.TIMEOUT_MAX:
            raise ValueError(
                "a timer's period must be more than 0 s and less than "
                f"{scheduler.TIMEOUT_MAX:.0f} s, not {period_s}"
            )
        self.period_s = period_s
        self.period_ns = max(1, round(period_s * 1e9))
        self.callback = callback
        self.once = once
        self.group = group
        self.cancelled = False
        self.what = timer_name(period_s, callback)
        # While a coroutine that the callback returned has not ended.
        self.is_awaited = False

    def fire(self) -> Any:
        """Run the callback, unless the coroutine of a former tick has not ended; returns what it
        returns, of a coroutine one to await in its place.
        """
        if self.is_awaited:
            return None
        answer = self.callback()
        if answer is not None and isinstance(answer, Coroutine):
            self.is_awaited = True
            return self._until_ended(answer)
        return answer

    async def _until_ended(self, coroutine: Coroutine[Any, Any, Any]) -> None:
        try:
            await coroutine
        finally:
            self.is_awaited = False

    def cancel(self) -> None:
        """End the timer; twice is fine."""
        self.cancelled = True


def timer_name(period_s: float, callback: Callable[[], Any]) -> str:
    """The name of a timer in the log: `timer of 50 ms (broadcast)`."""
    period = f"{period_s:g} s" if period_s >= 1.0 else f"{period_s * 1e3:g} ms"
    return f"timer of {period} ({getattr(callback, '__qualname__', repr(callback))})"
