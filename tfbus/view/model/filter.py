"""Which frames are shown: by regular expressions on their names, and by their boxes."""

import re
from dataclasses import dataclass
from functools import lru_cache

from tfbus import SettingsError


class PatternError(SettingsError):
    """A regular expression that cannot be read; the message says what is wrong with it."""


@dataclass(frozen=True)
class NameFilter:
    """Takes names in which `only` is found and `never` is not, anywhere in the name.

    An empty `only` is found in every name, an empty `never` in none. Raises PatternError for one
    that is no regular expression.
    """

    only: str = ""
    never: str = ""

    def __post_init__(self) -> None:
        for pattern in (self.only, self.never):
            _compiled(pattern)

    def takes(self, name: str) -> bool:
        """Whether a frame of this name is shown."""
        if self.never and _compiled(self.never).search(name):
            return False
        return not self.only or bool(_compiled(self.only).search(name))


@lru_cache(maxsize=64)
def _compiled(pattern: str) -> re.Pattern[str]:
    try:
        return re.compile(pattern)
    except re.error as error:
        place = "" if error.pos is None else f" at character {error.pos + 1}"
        raise PatternError(
            f"{pattern!r} is no regular expression: {error.msg}{place}; "
            r"write \. for a point and \( for a bracket"
        ) from error
