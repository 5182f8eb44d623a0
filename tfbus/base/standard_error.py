"""Sentences on stderr: as long as they are in a file or a pipe, which programs read line by line;
no wider than it in a terminal.
"""

import os
import sys
from contextlib import suppress

from tfbus.base.wording import wrapped

_INDENT = "  "


def for_stderr(text: str) -> str:
    """The text as stderr has it: in a terminal, lines that are too wide are broken at spaces, and
    go on indented.
    """
    wide = _width()
    if wide is None or len(text) <= wide:
        return text
    return "\n".join(
        line if len(line) <= wide else "\n".join(_broken(line, wide)) for line in text.split("\n")
    )


def _broken(line: str, wide: int) -> list[str]:
    return wrapped(line, wide, after=_INDENT, break_words=False)


def _width() -> int | None:
    """The width of the terminal that stderr is; None if it is none, or does not say."""
    # Without a console there is no stderr; a test may have one without a descriptor.
    with suppress(OSError, ValueError, AttributeError):
        if sys.stderr.isatty():
            columns = os.get_terminal_size(sys.stderr.fileno()).columns
            return columns if columns > len(_INDENT) else None
    return None
