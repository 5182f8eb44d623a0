"""Patterns of names, in which `*` and `**` stand for parts: as an identity's rights have them."""

import re
from functools import lru_cache

from tfbus.base.errors import SettingsError
from tfbus.base.wording import printable

_RESERVED = re.compile(r"[$?#\s]")


def check_pattern(pattern: str) -> str:
    """The pattern itself if it is valid.

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
    """Whether a pattern stands for a name; `arm/**` stands for `arm` too."""
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
    return "/".join(map(_as_part, pattern.split("/")))


def as_keys(pattern: str, kind: str) -> list[str]:
    """The key expressions of nodes or streams of a pattern: `arm` of the kind `@tfbus/node` is
    `@tfbus/node/arm`, and `robot7/arm` is `robot7/@tfbus/node/arm`.

    Its last part stands for the name, the parts before it for a namespace. Names of streams stand
    escaped, as they do in keys.
    """
    *around, name = pattern.split("/")
    if name != "**":
        return ["/".join([*map(_as_part, around), kind, _as_part(name)])]
    all_below = "/".join([*map(_as_part, around), "**", kind, "*"])
    # `arm/**` stands for `arm` too.
    return [all_below, *(as_keys("/".join(around), kind) if around else ())]


def _as_part(part: str) -> str:
    return part if part in ("*", "**") else "$*".join(part.split("*"))
