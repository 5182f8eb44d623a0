"""ROS's std_srvs.srv."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tfbus.compat.missing import missing_messages

__all__ = ["Empty"]

if not TYPE_CHECKING:  # type checkers find what is missing themselves
    __getattr__ = missing_messages(__name__)


class Empty:
    """A service without values."""

    @dataclass(slots=True, kw_only=True)
    class Request:
        """No values."""

    @dataclass(slots=True, kw_only=True)
    class Response:
        """No values."""
