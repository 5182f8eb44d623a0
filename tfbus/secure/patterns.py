"""Patterns of names in rights: `arm`, `arm_*`, `turtle1/*`, `**`."""

import re
from functools import lru_cache

from tfbus.errors import SettingsError
from tfbus.wire.keys import escape
from tfbus.wording import printable

_RESERVED = re.compile(r"[$?#\s]")


def check_pattern(pattern: str) -> str:
    """The pattern itself where it is valid.

    `*` stands for any letters of one part of a name, `**` for any number of parts. Raises
    SettingsError for anything else than names and these.
    """
    shown = f"'{printable(pattern, 60)}'"
    parts = pattern.removeprefix("/").split("/")
    if not all(parts) or not pattern.isprintable() or _RESERVED.search(pattern):
        raise SettingsError(
            f"{shown} is not a pattern of names: use parts joined by '/', with * for any letters "
            "of a part and ** for any parts"
        )
    if any("**" in part and part != "**" for part in parts):
        raise SettingsError(f"{shown}: ** stands for whole parts, as in arm/**; * for letters")
    if any(part.startswith("@") for part in parts):
        raise SettingsError(f"{shown}: names that begin with '@' are tfbus's own")
    return pattern.removeprefix("/")


def matches(pattern: str, name: str) -> bool:
    """Whether a name is one of those that a pattern stands for; `arm/**` stands for `arm` too."""
    return _are_matched(pattern.split("/"), name.split("/"))


def _are_matched(patterns: list[str], parts: list[str]) -> bool:
    if not patterns:
        return not parts
    first, *rest = patterns
    if first == "**":
        return any(_are_matched(rest, parts[at:]) for at in range(len(parts) + 1))
    return (
        bool(parts)
        and _letters(first).fullmatch(parts[0]) is not None
        and _are_matched(rest, parts[1:])
    )


@lru_cache(maxsize=1000)
def _letters(part: str) -> re.Pattern[str]:
    return re.compile(".*".join(map(re.escape, part.split("*"))))


def as_path(pattern: str) -> str:
    """The key expression of a pattern of topics or services, which are paths of keys."""
    return "/".join(part if part == "**" else _chunk(part) for part in pattern.split("/"))


def as_chunk(pattern: str) -> str:
    """The key expression of a pattern of nodes or streams, whose names are one chunk of a key."""
    return "*" if pattern == "**" else _chunk(pattern)


def _chunk(part: str) -> str:
    if part == "*":
        return part
    return "$*".join(escape(letters) for letters in part.split("*"))
