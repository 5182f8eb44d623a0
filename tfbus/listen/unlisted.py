"""Drops frames that a publisher has sent, does not list, and sends no more: it has removed them.

A list that comes after a message of a frame, and does not have it, may be older than the message or
newer than the frame's end. Only time tells: a publisher lists a frame within a second of its first
message.
"""

from collections.abc import Callable, Iterable

from tfbus.runtime import scheduler
from tfbus.runtime.executor import Executor

# A frame that is neither listed nor sent for so long has been removed.
SILENT_S = 2.0


class UnlistedFrames:
    """Frames of streams that do not list them, and when each was last sent; safe from any thread.

    `drop(stream, frames)` is called on the executor's thread for those that are silent.
    """

    def __init__(self, executor: Executor, drop: Callable[[str, frozenset[str]], object]) -> None:
        self._executor = executor
        self._drop = drop
        self._lock = scheduler.Lock()
        self._heard_s: dict[str, dict[str, float]] = {}

    def hear(self, stream: str, frames: Iterable[str]) -> None:
        """A stream that does not list these frames has sent them."""
        now_s = scheduler.monotonic()
        with self._lock:
            is_new = stream not in self._heard_s
            self._heard_s.setdefault(stream, {}).update(dict.fromkeys(frames, now_s))
        if is_new:
            self._look_later(stream)

    def _look_later(self, stream: str) -> None:
        self._executor.after(SILENT_S, lambda: self._look(stream))

    def _look(self, stream: str) -> None:
        since_s = scheduler.monotonic() - SILENT_S
        with self._lock:
            heard_s = self._heard_s.pop(stream)
            silent = frozenset(frame for frame, at_s in heard_s.items() if at_s <= since_s)
            for frame in silent:
                del heard_s[frame]
            if heard_s:
                self._heard_s[stream] = heard_s
        if heard_s:
            self._look_later(stream)
        self._drop(stream, silent)
