"""Sentences on stderr fit into its terminal, and stay whole for programs."""

import fcntl
import os
import struct
import sys
import termios
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr

from tfbus.base.log import open_log
from tfbus.base.standard_error import for_stderr

SENTENCE = "The stamps of 'arm' are of another clock than those of 'base': their ages say nothing"


@contextmanager
def terminal_of(columns: int) -> Iterator[int]:
    """The other end of a terminal of this width that is stderr."""
    ours, theirs = os.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 24, columns, 0, 0))
    with os.fdopen(theirs, "w") as stderr, redirect_stderr(stderr):
        yield ours
    os.close(ours)


def test_a_line_in_a_terminal_is_no_wider_than_it() -> None:
    """It is broken at spaces alone, and no word is lost; so is a line of the log."""
    with terminal_of(40) as terminal:
        lines = for_stderr(f"{SENTENCE}\nA short line").split("\n")
        open_log("/sim", "sim", "info").info(SENTENCE)
        sys.stderr.flush()
        shown = os.read(terminal, 10_000).decode().splitlines()
    assert lines[-1] == "A short line" and " ".join(" ".join(lines[:-1]).split()) == SENTENCE
    assert max(map(len, [*lines, *shown])) <= 40
    assert len(shown) > 2 and all(line.startswith("  ") for line in shown[1:])


def test_a_word_that_is_too_wide_stays_whole() -> None:
    """A path can be copied."""
    path = "/srv/recordings/" + "run/" * 20
    with terminal_of(40):
        assert path in for_stderr(f"There is no recording at {path}").split()


def test_a_line_that_is_no_terminals_stays_whole() -> None:
    """Programs read it as a line."""
    assert for_stderr(SENTENCE * 10) == SENTENCE * 10
