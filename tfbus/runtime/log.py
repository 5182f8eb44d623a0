"""A node's log: one line for each event on stderr, `[INFO] [1670400305.709085308] [sim]: text`.

The parts of a line on others (names, errors, values) comes from the bus. So no record has a control
character: each is escaped before any handler sees it.
"""

import logging
import sys
from collections.abc import Mapping
from typing import Any

from tfbus.runtime import scheduler
from tfbus.wording import printable

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
        return f"{line}\n{record.exc_text}" if record.exc_text else line


class _StandardError(logging.StreamHandler):  # type: ignore[type-arg]  # generic in stubs only
    """Writes to the current sys.stderr; a broken pipe is no error."""

    def emit(self, record: logging.LogRecord) -> None:
        self.stream = sys.stderr
        super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:
        if not isinstance(sys.exc_info()[1], BrokenPipeError):
            super().handleError(record)
