"""ROS's rclpy.logging: the log of a node, one line for each event on stderr."""

import logging
import sys
import time
from enum import IntEnum
from typing import Any

from tfbus.base.log import open_log

__all__ = [
    "LoggingSeverity",
    "RcutilsLogger",
    "get_logger",
    "get_logging_severity_from_string",
    "set_logger_level",
]


class LoggingSeverity(IntEnum):
    """Levels of a log."""

    UNSET = 0
    DEBUG = 10
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50


class RosLogger:
    """A log with ROS's methods; its lines are as tfbus's."""

    def __init__(self, name: str, log: logging.Logger) -> None:
        self.name = name
        self._log = log
        # By the place of the call in the program: how often, and when last.
        self._calls: dict[tuple[str, int], tuple[int, float]] = {}

    def debug(self, message: object, **conditions: Any) -> bool:
        """Log details."""
        return self._write(logging.DEBUG, message, conditions)

    def info(self, message: object, **conditions: Any) -> bool:
        """Log normal events.

        `once`, `skip_first` and `throttle_duration_sec` (seconds) leave out lines of the same place
        in the program. Returns whether it was logged.
        """
        return self._write(logging.INFO, message, conditions)

    def warning(self, message: object, **conditions: Any) -> bool:
        """Log a possible fault."""
        return self._write(logging.WARNING, message, conditions)

    def warn(self, message: object, **conditions: Any) -> bool:
        """As `warning`."""
        return self._write(logging.WARNING, message, conditions)

    def error(self, message: object, **conditions: Any) -> bool:
        """Log a fault."""
        return self._write(logging.ERROR, message, conditions)

    def fatal(self, message: object, **conditions: Any) -> bool:
        """Log a fault that ends the program; an error in the log."""
        return self._write(logging.ERROR, message, conditions)

    def set_level(self, level: int) -> None:
        """Log lines of this level and above."""
        self._log.setLevel(int(level))
        # Loggers that no manager knows, as the loggers of nodes, remember their former answers.
        vars(self._log).get("_cache", {}).clear()

    def get_effective_level(self) -> LoggingSeverity:
        """The least level that is logged."""
        return LoggingSeverity(self._log.getEffectiveLevel())

    def is_enabled_for(self, severity: int) -> bool:
        """Whether lines of this level are logged."""
        return self._log.isEnabledFor(int(severity))

    def _write(self, level: int, message: object, conditions: dict[str, Any]) -> bool:
        if conditions and not self._is_due(conditions):
            return False
        # As a message, not as a value, so that its lines stay lines.
        self._log.log(level, str(message))
        return self._log.isEnabledFor(level)

    def _is_due(self, conditions: dict[str, Any]) -> bool:
        conditions = dict(conditions)
        once = conditions.pop("once", False)
        skip_first = conditions.pop("skip_first", False)
        every_s = conditions.pop("throttle_duration_sec", None)
        conditions.pop("throttle_time_source_type", None)
        if conditions:
            raise TypeError(
                f"a log takes once, skip_first and throttle_duration_sec, not {list(conditions)}"
            )
        caller = sys._getframe(3)
        place = (caller.f_code.co_filename, caller.f_lineno)
        count, last_s = self._calls.get(place, (0, float("-inf")))
        now_s = time.monotonic()
        is_due = not (
            (skip_first and count == 0)
            or (once and count > skip_first)
            or (every_s is not None and now_s < last_s + every_s)
        )
        self._calls[place] = count + 1, now_s if is_due else last_s
        return is_due


RcutilsLogger = RosLogger


def get_logging_severity_from_string(log_severity: str) -> LoggingSeverity:
    """The level of this name. Raises RuntimeError if there is none."""
    try:
        return LoggingSeverity[log_severity.upper()]
    except KeyError:
        known = ", ".join(LoggingSeverity.__members__)
        raise RuntimeError(f"{log_severity!r} is no level: they are {known}") from None


def set_logger_level(name: str, level: int) -> None:
    """Log lines of this level and above, of a log without a node."""
    get_logger(name).set_level(level)


def get_logger(name: str) -> RosLogger:
    """A log without a node."""
    return RosLogger(name, open_log(f"/{name}", name, "info"))
