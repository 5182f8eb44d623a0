"""A node's log: one line for each event on stderr, `[INFO] [1670400305.709085308] [sim]: text`."""

import logging
import sys
import time

_LEVEL_NAMES = {logging.WARNING: "WARN"}


class _LineFormatter(logging.Formatter):
    def __init__(self, node: str):
        super().__init__()
        self._node = node

    def format(self, record: logging.LogRecord) -> str:
        level = _LEVEL_NAMES.get(record.levelno, record.levelname)
        seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
        line = f"[{level}] [{seconds}.{nanoseconds:09}] [{self._node}]: {record.getMessage()}"
        return f"{line}\n{self.formatException(record.exc_info)}" if record.exc_info else line


class _StandardError(logging.StreamHandler):  # type: ignore[type-arg]  # generic in stubs only
    """Writes to the current sys.stderr; a broken pipe is no error."""

    def emit(self, record: logging.LogRecord) -> None:
        self.stream = sys.stderr
        super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:
        if not isinstance(sys.exc_info()[1], BrokenPipeError):
            super().handleError(record)


def open_log(full_name: str, node: str, level: str) -> logging.Logger:
    """The logger of the node; it writes lines of at least this level."""
    logger = logging.Logger(f"tfbus{full_name}", level.upper())
    handler = _StandardError()
    handler.setFormatter(_LineFormatter(node))
    logger.addHandler(handler)
    return logger
