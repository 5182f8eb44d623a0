"""Where a thing stands in a launch file, and the error that says so."""

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches

from tfbus.errors import TfbusError


class LaunchError(TfbusError):
    """A launch file that cannot be found, read or started."""


class LaunchFileError(LaunchError):
    """A mistake in a launch file; `place` is the file, line and key at fault."""

    def __init__(self, place: "Place", reason: str) -> None:
        super().__init__(f"{place}: {reason}")
        self.place = place
        self.reason = reason


class LaunchArgumentError(LaunchError):
    """A launch file was given an argument that it does not know or allow, or lacks one.

    `argument` is the name of the argument at fault.
    """

    def __init__(self, argument: str, reason: str) -> None:
        super().__init__(reason)
        self.argument = argument


@dataclass(frozen=True, slots=True)
class Place:
    """A line (from 1) of a file and the key that stands there, `nodes[0].name`; "" for the file."""

    path: str
    line: int
    key: str = ""

    def __str__(self) -> str:
        return ": ".join(filter(None, (f"{self.path}:{self.line}", self.key)))

    def mistake(self, reason: str) -> LaunchFileError:
        """The error to raise for a mistake that stands here."""
        return LaunchFileError(self, reason)


def nearest(name: str, known: Iterable[str]) -> str:
    """The end of a sentence about a wrong name: "." or a question for the one that was meant."""
    close = get_close_matches(name, list(known), n=1)
    return f"; did you mean {close[0]!r}?" if close else "."
