"""What a buffer tells those who listen for changes."""

from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "added",
    "removed",
    "reparented",
    "became static",
    "became dynamic",
    "conflict",
    "too old",
    "publisher gone",
    "publisher back",
]


@dataclass(frozen=True)
class Change:
    """Something that changed about a frame.

    `kind` is "added"; "removed"; "reparented"; "became static" or "became dynamic", the history
    being kept; "conflict", a sample that replaced a different one of the same stamp; "too old", a
    sample that was refused because it is older than the cache; "publisher gone" or "publisher
    back", as a listener noticed. `parent` and `authority` are those of the transform that made
    the change, `former_parent` and `former_authority` those before. `stamp_ns` is the stamp of
    that transform.

    That two living publishers send one frame is a "conflict" too, told once by the listener:
    `authority` and `former_authority` are the two.
    """

    kind: Kind
    frame: str
    parent: str | None
    former_parent: str | None
    authority: str
    former_authority: str
    stamp_ns: int
