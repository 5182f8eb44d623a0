"""Keys from the bytes that a terminal sends.

A key is a name: the character itself (`g`, `Q`), an arrow (`up`, `down`, `left`, `right`),
`escape`, or `other` for every other key. An escape sequence is always read as a whole, so that no
letter in it is taken for a typed one.
"""

import re

# Where sequences end: ECMA-48, section 5.4 (CSI), and xterm's ctlseqs (SS3, strings).
_KEY = re.compile(
    rb"""
      \x1b\[\[ .                                 # function keys of the Linux console
    | \x1b\[ [0-?]* [ -/]* (?P<csi> [@-Z\\-~] )  # CSI; its last byte says which key
    | \x1bO [0-?]* (?P<ss3> [@-~] )              # SS3: the arrows in application mode
    | \x1b[PX\]^_] [^\x1b\x07]* (?: \x07 | \x1b\\ | (?= \x1b[^\\] ) )  # the terminal's own answers
    | \x1b[\[O] [ -?]* (?= [^\x20-\x7e] )        # a sequence broken off by another key
    | (?P<escape> \x1b (?= \x1b ) )
    | \x1b [^\[OPX\]^_\x1b]                      # Alt and a character
    | (?P<character> [\x00-\x1a\x1c-\x7f] )
    | [\xc0-\xff] [\x80-\xbf]*                   # a character beyond ASCII, in UTF-8
    | [\x80-\xbf]
    """,
    re.VERBOSE | re.DOTALL,
)
_ARROWS = {b"A": "up", b"B": "down", b"C": "right", b"D": "left"}


class KeyReader:
    """Turns bytes into keys; keeps the pieces of a sequence until it is complete."""

    def __init__(self) -> None:
        self._pending = b""

    def feed(self, data: bytes) -> list[str]:
        """The keys that these bytes complete, in the order they were typed."""
        keys = []
        self._pending += data
        while match := _KEY.match(self._pending):
            self._pending = self._pending[match.end() :]
            keys.append(_key(match))
        return keys

    def flush(self) -> list[str]:
        """The key that the pending bytes stand for if nothing follows them."""
        pending, self._pending = self._pending, b""
        return ["escape" if pending == b"\x1b" else "other"] if pending else []


def _key(match: re.Match[bytes]) -> str:
    if match["character"] is not None:
        return match["character"].decode("ascii")
    if match["escape"] is not None:
        return "escape"
    return _ARROWS.get(match["csi"] or match["ss3"] or b"", "other")
