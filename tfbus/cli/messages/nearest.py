"""The end of a sentence about a name that is not there."""

from collections.abc import Iterable
from difflib import get_close_matches

# Of more names than that only the first are told.
_TOLD = 20


def nearest(name: str, known: Iterable[str], *, none: str) -> str:
    """`; did you mean ...?`, or `; there are: ...`; `none` where there are no names at all."""
    names = sorted(known)
    if not names:
        return none
    close = get_close_matches(name, names, n=1)
    if close:
        return f"; did you mean {close[0]!r}?"
    more = f" and {len(names) - _TOLD} more" if len(names) > _TOLD else ""
    return f"; there are: {', '.join(names[:_TOLD])}{more}"
