"""The two streams of a launch: whole lines, each with the name of its process.

A stopped terminal (Ctrl-S) or a slow reader must not block Ctrl-C. So each stream has a thread
that writes: output of processes waits for it, log lines of launch never do.
"""

import os
import re
import threading
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from typing import IO

from tfbus.base.wording import printable
from tfbus.launch.service_manager import is_journal, journal_level

_LONGEST_LINE = 65536
_MOST_LINES_WAITING = 1000
# Colours and weights of letters, the only control sequences that go on to a terminal.
_STYLE = re.compile(r"(\x1b\[[0-9;:]*m)")
_UNSTYLED = "\x1b[0m"
_COLOURS = (36, 32, 33, 35, 34, 96, 92, 93, 95, 94)


class Lines:
    """Splits output into whole lines, without their ends.

    A line longer than 64 KiB comes in parts of that size.
    """

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        """The lines that this chunk completes."""
        *whole, self._rest = (self._rest + chunk).split(b"\n")
        for line in whole:
            yield line.removesuffix(b"\r")
        while len(self._rest) >= _LONGEST_LINE:
            end = _end_of_letter(self._rest, _LONGEST_LINE)
            yield self._rest[:end]
            self._rest = self._rest[end:]

    def end(self) -> Iterator[bytes]:
        """The last line, if it had no end."""
        if self._rest:
            yield self._rest
        self._rest = b""


def _end_of_letter(data: bytes, at: int) -> int:
    """At most three bytes before a place, so that no letter of UTF-8 is cut there."""
    begins = (end for end in range(at, at - 4, -1) if end >= len(data) or data[end] & 0xC0 != 0x80)
    return next(begins, at)


def safe_line(line: bytes, *, styled: bool) -> bytes:
    """A line of a program as a terminal may get it: sequences that would move the cursor, set a
    title or answer in the user's name are escaped, as in tfbus's own log. Colours stay if it is
    `styled`, to the end of the line, and are left out elsewhere.
    """
    text = line.decode(errors="surrogateescape")
    if text.isprintable():
        return line
    words = _STYLE.split(text)
    shown = [_printable(word) for word in words[::2]]
    if not styled or len(words) == 1:
        return "".join(shown).encode()
    parts = [part for pair in zip(shown, [*words[1::2], _UNSTYLED], strict=True) for part in pair]
    return "".join(parts).encode()


def _printable(text: str) -> str:
    # A byte that is no UTF-8 is shown as itself, a tab stays.
    text = text.encode(errors="surrogateescape").decode(errors="backslashreplace")
    return "\t".join(printable(part, len(part)) for part in text.split("\t"))


class OutputStream:
    """A file descriptor to which many threads write whole lines.

    `on_gone` is called once, from the writing thread, when its reader is gone; further lines are
    dropped.
    """

    def __init__(self, descriptor: int, on_gone: Callable[[], None] = lambda: None) -> None:
        self.descriptor = descriptor
        self.on_gone = on_gone
        self._waiting: deque[bytes] = deque()
        self._changed = threading.Condition()
        self._is_closed = self._is_gone = self._is_writing = False
        self._thread = threading.Thread(target=self._write_all, daemon=True)
        self._thread.start()

    @property
    def is_terminal(self) -> bool:
        return os.isatty(self.descriptor)

    def write(self, line: bytes, *, wait: bool = True) -> None:
        """Write a line; with `wait`, first wait until at most 1000 lines are pending."""
        with self._changed:
            if wait:
                self._changed.wait_for(self._has_room)
            if not self._is_gone:
                self._waiting.append(line + b"\n")
                self._changed.notify_all()

    def close(self, timeout_s: float) -> None:
        """Write the pending lines within `timeout_s`, then stop."""
        with self._changed:
            self._changed.wait_for(lambda: not self._waiting and not self._is_writing, timeout_s)
            self._is_closed = True
            self._changed.notify_all()

    def _has_room(self) -> bool:
        return len(self._waiting) < _MOST_LINES_WAITING or self._is_gone or self._is_closed

    def _write_all(self) -> None:
        while lines := self._next_lines():
            try:
                _write_whole(self.descriptor, lines)
            except OSError:
                self._lose_reader()
                return

    def _next_lines(self) -> bytes:
        with self._changed:
            self._is_writing = False
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._waiting or self._is_closed)
            if self._is_closed:
                return b""
            lines = b"".join(self._waiting)
            self._waiting.clear()
            self._is_writing = True
            self._changed.notify_all()
            return lines

    def _lose_reader(self) -> None:
        with self._changed:
            self._is_gone, self._is_writing = True, False
            self._waiting.clear()
            self._changed.notify_all()
        self.on_gone()


class Console:
    """Standard output and standard error of a launch."""

    def __init__(self, output: OutputStream, errors: OutputStream) -> None:
        self.output = output
        self.errors = errors
        in_colour = "NO_COLOR" not in os.environ and os.environ.get("TERM") != "dumb"
        self._is_journal = {stream: is_journal(stream.descriptor) for stream in (output, errors)}
        self._coloured = {stream: stream.is_terminal and in_colour for stream in (output, errors)}

    def relay(self, name: str, source: IO[bytes], stream: OutputStream) -> None:
        """Copy the lines of an unbuffered pipe until it ends, and close the pipe."""
        prefix, styled = self._prefix(name, stream), self._coloured[stream]
        says_level = self._is_journal[stream]
        lines = Lines()

        def write(line: bytes) -> None:
            level = journal_level(line) if says_level else b""
            stream.write(level + prefix + safe_line(line, styled=styled))

        with source:
            while chunk := source.read(65536):
                for line in lines.feed(chunk):
                    write(line)
        for line in lines.end():
            write(line)

    def say(self, level: str, name: str, text: str) -> None:
        """Log an event to standard error, `[INFO] [sim]: text`; never waits."""
        prefix = self._prefix(name, self.errors).decode()
        line = f"[{level}] {prefix.strip()}: {printable(text, _LONGEST_LINE)}"
        encoded = line.encode()
        if self._is_journal[self.errors]:
            encoded = journal_level(encoded) + encoded
        self.errors.write(encoded, wait=False)

    def close(self, timeout_s: float = 1.0) -> None:
        """Write the pending lines of both, within `timeout_s` each."""
        for stream in (self.output, self.errors):
            stream.close(timeout_s)

    def _prefix(self, name: str, stream: OutputStream) -> bytes:
        if not self._coloured[stream]:
            return f"[{name}] ".encode()
        # Not hash(): a name keeps its colour from run to run.
        colour = _COLOURS[zlib.crc32(name.encode()) % len(_COLOURS)]
        return f"\x1b[{colour}m[{name}]\x1b[0m ".encode()


def _write_whole(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]
