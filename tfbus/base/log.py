"""A node's log: one line for each event on stderr, `[INFO] [1670400305.709085308] [sim]: text`.

Names, errors and values in a line may come from the bus. So no record has a control character: each
is escaped before any handler sees it. A line that could repeat without end is
logged once, and counted.
"""

import logging
import math
import sys
from collections import Counter
from collections.abc import Callable, Hashable, Mapping
from typing import Any

from tfbus.base import scheduler
from tfbus.base.standard_error import for_stderr
from tfbus.base.wording import printable

_LEVEL_NAMES = {logging.WARNING: "WARN"}

# The most letters of a value in a message, and of a message or traceback as a whole.
_MOST_OF_A_VALUE = 1_000
_MOST = 20_000


class Printable(logging.Filter):
    """Makes records printable: control characters are escaped, and long values cut.

    In a value the end of a line is escaped too. The lines of a message or traceback stay, and none
    but the first begins as a line of the log does.
    """

    def filter(self, record: logging.LogRecord) -> bool:
        """Change the record; it is always logged."""
        if isinstance(record.args, Mapping):
            record.args = {name: _shown(value) for name, value in record.args.items()}
        elif record.args:
            record.args = tuple(map(_shown, record.args))
        record.msg = _lines(str(record.msg))
        if record.exc_info and not record.exc_text:
            record.exc_text = logging.Formatter().formatException(record.exc_info)
        if record.exc_text:
            record.exc_text = _lines(record.exc_text)
        return True


def library_log(name: str) -> logging.Logger:
    """The logger of a module that has no node; its records are printable."""
    logger = logging.getLogger(name)
    logger.addFilter(_PRINTABLE)
    return logger


def open_log(full_name: str, node: str, level: str) -> logging.Logger:
    """The logger of the node; it writes lines of at least this level."""
    logger = logging.Logger(f"tfbus{full_name}", level.upper())
    logger.addFilter(_PRINTABLE)
    handler = _StandardError()
    handler.setFormatter(_LineFormatter(node))
    logger.addHandler(handler)
    return logger


_PRINTABLE = Printable()


class _Shown:
    """A value in a message, printed when the message is."""

    def __init__(self, value: object) -> None:
        self._value = value

    def __str__(self) -> str:
        return printable(str(self._value), _MOST_OF_A_VALUE)

    def __repr__(self) -> str:
        return printable(repr(self._value), _MOST_OF_A_VALUE)


def _shown(value: Any) -> Any:
    # Numbers are formatted by `%d` and `%.3f`, which want the number itself.
    return value if hasattr(value, "__float__") or hasattr(value, "__index__") else _Shown(value)


def _lines(text: str) -> str:
    if text.isprintable() and len(text) <= _MOST:
        return text
    first, *others = text[:_MOST].split("\n")
    return "\n".join([_escaped(first), *map(_continued, others)])


def _continued(line: str) -> str:
    return f" {_escaped(line)}" if line.startswith("[") else _escaped(line)


def _escaped(line: str) -> str:
    return printable(line.expandtabs(), _MOST)


class _LineFormatter(logging.Formatter):
    def __init__(self, node: str):
        super().__init__()
        self._node = node

    def format(self, record: logging.LogRecord) -> str:
        level = _LEVEL_NAMES.get(record.levelno, record.levelname)
        seconds, nanoseconds = divmod(scheduler.time_ns(), 1_000_000_000)
        line = f"[{level}] [{seconds}.{nanoseconds:09}] [{self._node}]: {record.getMessage()}"
        line = for_stderr(line)
        return f"{line}\n{record.exc_text}" if record.exc_text else line


class _StandardError(logging.StreamHandler):  # type: ignore[type-arg]  # generic in stubs only
    """Writes to the current sys.stderr; a broken pipe is no error."""

    def emit(self, record: logging.LogRecord) -> None:
        self.stream = sys.stderr
        super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:
        if not isinstance(sys.exc_info()[1], BrokenPipeError):
            super().handleError(record)


# Kinds may hold names from the bus: where there are this many, the oldest makes room once its line
# is as old as this. Until then further kinds are neither logged nor counted.
_MOST_KINDS = 1000
_MAKES_ROOM_AFTER_S = 600.0
_FURTHER = "Further ones are counted, not logged"


class LogOnce:
    """Logs the first event of each kind; `counts` has how many there were.

    With `again_s` an event of the same kind is logged again if the last line is that old, with
    the number of events in between. Of more than `most` kinds in that time, or in 10 minutes, the
    rest is left out, which one line says. Safe from any thread.
    """

    def __init__(
        self,
        log: logging.Logger,
        *,
        again_s: float = math.inf,
        most: int = _MOST_KINDS,
        clock: Callable[[], float] = lambda: scheduler.monotonic(),
    ) -> None:
        self.counts: Counter[Hashable] = Counter()
        self._log = log
        self._again_s = again_s
        self._makes_room_after_s = min(again_s, _MAKES_ROOM_AFTER_S)
        self._most = most
        self._clock = clock
        self._lock = scheduler.Lock()
        # When a line of each kind was logged, the oldest first, and the count of events then.
        self._logged: dict[Hashable, tuple[float, int]] = {}
        self._crowded_until_s = -math.inf

    def info(self, kind: Hashable, text: str, *values: object) -> None:
        """Log the text as `warning` does, as an information."""
        self._write(logging.INFO, kind, text, values)

    def warning(self, kind: Hashable, text: str, *values: object) -> None:
        """Log the text if it is the first of its kind, its values filled in by logging."""
        self._write(logging.WARNING, kind, text, values)

    def exception(self, kind: Hashable, text: str, *values: object) -> None:
        """Log the text as `warning` does, as an error and with the traceback of the exception that
        is being handled.
        """
        self._write(logging.ERROR, kind, text, values, exc_info=True)

    def _write(
        self,
        level: int,
        kind: Hashable,
        text: str,
        values: tuple[object, ...],
        *,
        exc_info: bool = False,
    ) -> None:
        with self._lock:
            since = self._count(kind)
            begins_to_crowd = since is None and self._is_crowded_since_now(kind)
        if since is not None:
            self._log.log(
                level, f"{text}{self._ending(since, text, values)}", *values, exc_info=exc_info
            )
        elif begins_to_crowd:
            self._log.warning(
                "More than %d lines like the last ones within %g s: the rest is left out",
                self._most,
                self._makes_room_after_s,
            )

    def _count(self, kind: Hashable) -> int | None:
        """Count an event: how many of its kind there were since the last line, None for no line."""
        now_s = self._clock()
        former = self._logged.get(kind)
        if former is None and not self._has_room(now_s):
            return None
        self.counts[kind] += 1
        if former is not None and now_s < former[0] + self._again_s:
            return None
        since = 0 if former is None else self.counts[kind] - former[1]
        self._logged.pop(kind, None)
        self._logged[kind] = now_s, self.counts[kind]
        return since

    def _has_room(self, now_s: float) -> bool:
        if len(self._logged) < self._most:
            return True
        oldest = next(iter(self._logged))
        if now_s < self._logged[oldest][0] + self._makes_room_after_s:
            return False
        del self._logged[oldest], self.counts[oldest]
        return True

    def _is_crowded_since_now(self, kind: Hashable) -> bool:
        now_s = self._clock()
        if kind in self._logged or now_s < self._crowded_until_s:
            return False
        self._crowded_until_s = now_s + self._makes_room_after_s
        return True

    def _ending(self, since: int, text: str, values: tuple[object, ...]) -> str:
        if self._again_s == math.inf:
            # The mark may be the last value's, as of "did you mean 'lidar'?".
            said = _filled(text, values)
            return f" {_FURTHER}" if said.endswith((".", "?", "!")) else f". {_FURTHER}"
        return f" ({since} times since the last line)" if since > 1 else ""


def _filled(text: str, values: tuple[object, ...]) -> str:
    """The text with its values; as it is if they do not fit, of which logging tells by itself."""
    try:
        return text % values if values else text
    except Exception:  # also one of a value's own
        return text
