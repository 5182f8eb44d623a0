"""A recording as the page shows it: the frames as they were at the cursor."""

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from tfbus.buffer.buffer import Buffer
from tfbus.errors import DecodeError
from tfbus.frames.moment import BusMoment
from tfbus.frames.recorded import RecordedFrames
from tfbus.recording.items import Item, TransformItem
from tfbus.recording.playhead import Playhead, stepped_ns
from tfbus.recording.reader import RecordingReader
from tfbus.runtime.clock import Clock
from tfbus.runtime.signals import StopSignals
from tfbus.view.timeline import known_timeline, whole_timeline
from tfbus.wire.fleet import Fleet

# How much of what came before the cursor is read on a seek, for rates and trails: as much as comes
# in this many messages, and these at the least and at the most.
_MESSAGES_BEFORE = 2500
_LEAST_BEFORE_S = 2.0
_MOST_BEFORE_S = 30.0

# Where frames are in the course of a recording, by this many moments.
_SAMPLES = 8
_SAMPLE_S = 0.5

# Where the cursor is this far ahead, nothing between is read.
_SKIP_S = 3.0

# A machine that sleeps lets the recording wait.
_MOST_STEP_S = 0.25


class Replay:
    """The host, the publishers and the buffer of a page that shows a recording.

    It is at `at_ns` first, and plays if it should. `move` is for the page's thread; the playhead
    is for any. The timeline has what the file says at
    once, and after `measure` what is only found by reading it, as gaps. `samples` are then the
    transforms at some moments, for a camera that sees where frames will be. With a `fleet` the
    frames of robots in namespaces below are there, too. `mistake` says why the
    recording cannot be read at the cursor, "" if it can.
    """

    def __init__(
        self,
        reader: RecordingReader,
        *,
        at_ns: int,
        plays: bool = False,
        start_ns: int | None = None,
        end_ns: int | None = None,
        namespace: str = "",
        fleet: Fleet | None = None,
    ) -> None:
        self.log = logging.getLogger("tfbus.view")
        self._error = ""
        self.samples: tuple[Buffer, ...] = ()
        self._reader = reader
        self._namespace = namespace
        self.fleet = fleet
        start_ns = reader.start_ns if start_ns is None else start_ns
        end_ns = reader.end_ns if end_ns is None else end_ns
        self.timeline = known_timeline(reader, start_ns, end_ns)
        # The time that has passed from picture to picture, while a browser watched.
        self._watched_ns = 0
        self.playhead = Playhead(
            start_ns, end_ns, at_ns=at_ns, paused=not plays, real_ns=lambda: self._watched_ns
        )
        self._ended = threading.Event()
        self._measuring: threading.Thread | None = None
        self._signals: StopSignals | None = None
        self._moved_s: float | None = None
        self._before_s = _before_s(reader)
        self._restart()
        self._try(self._seek, self._at_ns)

    # What a page needs

    @property
    def buffer(self) -> Buffer:
        """The transforms up to the cursor."""
        return self._frames.buffer

    @property
    def namespace(self) -> str:
        """The namespace that it shows."""
        return self._frames.namespace

    def moment(self) -> BusMoment:
        """The bus at the cursor."""
        return self._frames.moment()

    def hint(self, frame: str = "") -> str:
        """The place of a frame, or of any, elsewhere than at the cursor; "" if nowhere."""
        return self._frames.hint(frame)

    def wait(self, timeout_s: float | None, *, clock: Clock | None = None) -> bool:
        """Wait, at most until the end of the page; whether it goes on."""
        if self._signals is not None:
            return not self._signals.wait(timeout_s)
        return not self._ended.wait(timeout_s)

    def end(self) -> None:
        """End the page; from any thread."""
        self._ended.set()
        if self._signals is not None:
            self._signals.stop()

    def close(self) -> None:
        """Close the files, once the page has ended."""
        self._end_measuring()
        self._reader.close()

    @contextmanager
    def until_signal(self) -> Iterator[None]:
        """Ctrl-C and SIGTERM end the page from here to the end of the `with`."""
        self._signals = StopSignals()
        try:
            yield
        finally:
            self._end_measuring()
            self._signals.uninstall()
            self._signals = None

    def _end_measuring(self) -> None:
        # Python ends a process whose daemon thread is in the midst of C++ by an abort.
        self._ended.set()
        if self._measuring is not None:
            self._measuring.join()

    # How it moves

    def measure(self) -> None:
        """Complete the timeline by what is only found in the index of the files; on any thread."""
        try:
            with RecordingReader(*[part.path for part in self._reader.parts]) as reader:
                self.samples = tuple(self._samples(reader))
                found = whole_timeline(reader, self.timeline, self._ended.is_set)
        except (OSError, DecodeError) as error:
            self.log.warning("The timeline lacks what cannot be read: %s", error)
        else:
            self.timeline = found or self.timeline

    def _samples(self, reader: RecordingReader) -> Iterator[Buffer]:
        frames = self._frames_of(reader, _SAMPLE_S)
        start_ns, end_ns = self.playhead.start_ns, self.playhead.end_ns
        for part in range(_SAMPLES):
            if not self._ended.is_set():
                frames.seek(start_ns + (end_ns - start_ns) * (part + 1) // _SAMPLES)
                yield frames.buffer

    def measure_meanwhile(self) -> None:
        """`measure` on a thread of its own, which `end` ends."""
        self._measuring = threading.Thread(target=self.measure, name="tfbus timeline", daemon=True)
        self._measuring.start()

    def move(self, now_s: float, *, is_watched: bool, trail_s: float = 0.0) -> bool:
        """Bring buffer and streams to the cursor, which plays while a browser watches; `now_s` is
        the time of a steady clock. Whether it has jumped, or other browsers must follow it.

        At least `trail_s` of what came before are there.
        """
        passed_s = 0.0 if self._moved_s is None or not is_watched else now_s - self._moved_s
        self._moved_s = now_s
        return self._try(self._move, min(passed_s, _MOST_STEP_S), trail_s)

    def _move(self, passed_s: float, trail_s: float) -> bool:
        jumps = self.playhead.jumps
        if steps := self.playhead.take_steps():
            at_ns = stepped_ns(self._reader, self.playhead, steps, _moves)
            self.playhead.seek(self._at_ns if at_ns is None else at_ns)
        self._watched_ns += round(passed_s * 1e9)
        at_ns = self.playhead.advance().log_ns
        if trail_s > self._before_s:
            self._before_s = trail_s
            return self._seek(at_ns)
        return self._go_to(at_ns) or self.playhead.jumps != jumps

    def _go_to(self, at_ns: int) -> bool:
        """Whether it was a jump."""
        ahead_ns = at_ns - self._frames.at_ns
        if not ahead_ns:
            return False
        is_jump = not 0 < ahead_ns <= _SKIP_S * 1e9
        if is_jump:
            self._seek(at_ns)
        else:
            self._read_to(at_ns)
        self._error = ""
        return is_jump

    @property
    def mistake(self) -> str:
        """Why the files cannot be read at the cursor; "" if they can."""
        at_ns = self._at_ns
        for damage in self._reader.damage:
            from_ns, to_ns = damage.from_ns, damage.to_ns
            if from_ns is not None and to_ns is not None and from_ns <= at_ns <= to_ns:
                return f"Damaged: {damage.text(self._reader.start_ns)} cannot be read"
        return self._error

    def _seek(self, at_ns: int) -> bool:
        self._restart()
        # Were it damaged there, it is not tried again and again.
        self._frames.pass_time(at_ns)
        self._frames.seek(at_ns)
        return True

    def _restart(self) -> None:
        self._frames = self._frames_of(self._reader, self._before_s)
        self._rest: Iterator[Item] | None = None
        self._next: Item | None = None

    def _frames_of(self, reader: RecordingReader, cache_time_s: float) -> RecordedFrames:
        return RecordedFrames(
            reader, namespace=self._namespace, fleet=self.fleet, cache_time_s=cache_time_s
        )

    def _read_to(self, at_ns: int) -> None:
        # Kept from one picture to the next: to begin again costs a chunk each time.
        if self._rest is None:
            self._rest = self._reader.items(self._frames.at_ns + 1, None, self._frames.selection)
            self._next = next(self._rest, None)
        while self._next is not None and self._next.log_ns <= at_ns:
            self._frames.take(self._next)
            self._next = next(self._rest, None)
        self._frames.pass_time(at_ns)

    def _try(self, move: Callable[..., bool], *given: Any) -> bool:
        """Move; if the file is damaged it holds, and a seek to another place is possible."""
        try:
            return move(*given)
        except DecodeError as error:
            if str(error) != self._error:
                self.log.warning("%s", error)
            self._error = str(error)
            self.playhead.pause()
            # An iterator that has raised has ended.
            self._rest = None
            return True

    @property
    def _at_ns(self) -> int:
        return self.playhead.progress.log_ns


def _moves(item: Item) -> bool:
    return isinstance(item, TransformItem) and not item.static


def _before_s(reader: RecordingReader) -> float:
    messages = sum(stream.messages for stream in reader.streams)
    span_s = (reader.end_ns - reader.start_ns) / 1e9
    wanted_s = span_s * _MESSAGES_BEFORE / messages if messages else _MOST_BEFORE_S
    return min(max(wanted_s, _LEAST_BEFORE_S), _MOST_BEFORE_S)
