"""Log lines that could repeat without end: the first of a kind is logged, the rest counted."""

import logging
import threading
from collections import Counter
from collections.abc import Hashable

# Kinds may hold names from the bus: further kinds are neither logged nor counted.
_MOST_KINDS = 1000
_FURTHER = ". Further ones are counted, not logged"


class LogOnce:
    """Logs the first event of each kind; `counts` has how many there were.

    Safe from any thread.
    """

    def __init__(self, log: logging.Logger) -> None:
        self.counts: Counter[Hashable] = Counter()
        self._log = log
        self._lock = threading.Lock()

    def warning(self, kind: Hashable, text: str, *values: object) -> None:
        """Log the text if it is the first of its kind, its values filled in by logging."""
        if self._is_first(kind):
            self._log.warning(f"{text}{_FURTHER}", *values)

    def exception(self, kind: Hashable, text: str, *values: object) -> None:
        """Log the text as `warning` does, as an error and with the traceback of the exception that
        is being handled.
        """
        if self._is_first(kind):
            self._log.exception(f"{text}{_FURTHER}", *values)

    def _is_first(self, kind: Hashable) -> bool:
        with self._lock:
            if kind not in self.counts and len(self.counts) >= _MOST_KINDS:
                return False
            self.counts[kind] += 1
            return self.counts[kind] == 1
