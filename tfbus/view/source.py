"""The program as the page needs it: a node and its listener, or a buffer."""

import logging
from collections.abc import Sequence
from typing import Protocol

from tfbus.listen.info import StreamInfo
from tfbus.runtime.clock import Clock


class Host(Protocol):
    """The time, the log and the end of the page; a Node is one."""

    @property
    def log(self) -> logging.Logger:
        """The log for warnings."""

    def now_ns(self) -> int:
        """The time that ages are judged by, in nanoseconds since the Unix epoch."""

    def wait(self, timeout_s: float | None, *, clock: Clock | None = None) -> bool:
        """Wait, at most until the end of the page; whether it goes on."""


class Publishers(Protocol):
    """The publishers of frames; a TransformListener is one."""

    def streams(self) -> Sequence[StreamInfo]:
        """The streams of all of them."""
