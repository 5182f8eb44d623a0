"""The bus at the moments of a recording, for programs, and the changes from one to the next."""

import os
from collections.abc import Callable, Iterator

from tfbus.errors import InvalidArgumentException
from tfbus.frames.changes import BusChange, Changes
from tfbus.frames.moment import BusMoment
from tfbus.frames.recorded import RecordedFrames
from tfbus.recording.items import EventItem
from tfbus.recording.reader import RecordingReader
from tfbus.wire.fleet import Fleet


class Recorded:
    """The bus at the moments of a recording, as a listener in a namespace, or with a fleet, had it.

    `paths` are the files of one recording. `start_ns` and `end_ns` are its first and last log time,
    in ns since the Unix epoch. Use it in a `with`, or `close()` it. Raises DecodeError if a file is
    no recording, OSError if it cannot be opened.
    """

    def __init__(
        self,
        *paths: str | os.PathLike[str],
        namespace: str = "",
        fleet: Fleet | None = None,
    ) -> None:
        if not paths:
            raise InvalidArgumentException("name at least one file of the recording")
        self._reader = RecordingReader(*paths)
        self._namespace, self._fleet = namespace, fleet
        self._sought = self._frames()
        self.start_ns, self.end_ns = self._reader.start_ns, self._reader.end_ns

    def __enter__(self) -> "Recorded":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files. Twice is fine."""
        self._reader.close()

    def at(self, at_ns: int) -> BusMoment:
        """The bus at a log time. Raises InvalidArgumentException outside of the recording."""
        self._check(at_ns)
        self._sought.seek(at_ns)
        return self._sought.moment()

    def changes(
        self, from_ns: int | None = None, to_ns: int | None = None, period_s: float = 0.2
    ) -> Iterator[BusChange]:
        """The changes between two log times, by default of the whole recording: first of all that
        is there, then each at an event, or at most `period_s` later.
        """
        first_ns = self.start_ns if from_ns is None else self._check(from_ns)
        last_ns = self.end_ns if to_ns is None else self._check(to_ns)
        frames, changes, found = self._frames(), Changes(), list[BusChange]()
        frames.seek(first_ns)

        def look(log_ns: int) -> None:
            found.extend(changes.to(frames.moment()))

        look(first_ns)
        ticks = Ticks(frames, first_ns, round(period_s * 1e9), look)
        for item in frames.play(last_ns, ticks.before):
            if isinstance(item, EventItem):
                look(item.log_ns)
            yield from found
            found.clear()
        look(last_ns)
        yield from found

    def _frames(self) -> RecordedFrames:
        return RecordedFrames(self._reader, namespace=self._namespace, fleet=self._fleet)

    def _check(self, at_ns: int) -> int:
        if not self._reader.start_ns <= at_ns <= self._reader.end_ns:
            raise InvalidArgumentException(
                f"at_ns: {at_ns} is not in the recording, which is of the log times "
                f"{self._reader.start_ns} to {self._reader.end_ns}"
            )
        return at_ns


class Ticks:
    """Calls `look(log_ns)` at regular log times of a span, with `frames` as they are then.

    `before` is for `RecordedFrames.play`.
    """

    def __init__(
        self, frames: RecordedFrames, from_ns: int, every_ns: int, look: Callable[[int], object]
    ) -> None:
        self._frames, self._every_ns, self._look = frames, every_ns, look
        self._next_ns = from_ns + every_ns

    def before(self, log_ns: int) -> None:
        """Look at all times before the next item."""
        while self._next_ns < log_ns:
            self._frames.pass_time(self._next_ns)
            self._look(self._next_ns)
            self._next_ns += self._every_ns
