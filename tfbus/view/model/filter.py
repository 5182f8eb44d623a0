"""Which frames are shown, by regular expressions on their names."""

import re
from dataclasses import dataclass
from functools import lru_cache

from tfbus.errors import SettingsError


class PatternError(SettingsError):
    """A malformed regular expression; the message says what is wrong and where."""


@dataclass(frozen=True)
class NameFilter:
    """Takes names that `only` matches and `never` does not, anywhere in the name.

    An empty `only` matches every name, an empty `never` none. Raises PatternError for a malformed
    regular expression.
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
            f"{pattern!r} is not a regular expression: {error.msg}{place}; "
            r"escape a point as \. and a bracket as \("
        ) from error
