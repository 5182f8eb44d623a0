"""Parts of a page that are measured by themselves: each from its mark to the next one.

A mark is a line `<!-- the bus -->`. What is before the first belongs to the page itself.
"""

import re
from pathlib import Path

_NEXT = re.compile(r"^<!-- the \w+ -->$", re.MULTILINE)


def put_in(page: Path, mark: str, part: str) -> None:
    """Write the part, which begins with its mark, in the place of the former, or at the end."""
    before, _, after = page.read_text().partition(mark)
    following = _NEXT.search(after)
    kept = f"\n{after[following.start() :]}" if following else ""
    page.write_text(f"{before.rstrip()}\n\n{part.rstrip()}\n{kept}")


def former(page: Path) -> str:
    """All parts that the page has now, to be kept where only the rest is measured."""
    text = page.read_text() if page.exists() else ""
    first = _NEXT.search(text)
    return f"\n{text[first.start() :]}" if first else ""
