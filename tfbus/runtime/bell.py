"""A bell: what one thread sleeps on until another rings it."""

from tfbus.runtime import scheduler


class Bell:
    """A bell that one thread sleeps on until another rings it: an Event whose `ring` may interrupt
    its own
    `wait`, as in a signal handler.
    """

    __slots__ = ("_silent",)

    def __init__(self) -> None:
        self._silent = scheduler.Lock()
        self._silent.acquire()

    def ring(self) -> None:
        """End the `wait` of now, or else the next one."""
        try:  # noqa: SIM105  # `suppress` would be a third of this
            self._silent.release()
        except RuntimeError:
            pass

    def wait(self, timeout_s: float | None) -> None:
        """Sleep until it is rung, at most this long; None: for as long as it takes."""
        if timeout_s is None or timeout_s > scheduler.TIMEOUT_MAX:
            timeout_s = scheduler.TIMEOUT_MAX
        self._silent.acquire(timeout=timeout_s if timeout_s > 0.0 else 0.0)
