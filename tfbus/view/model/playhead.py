"""The cursor of a recording and its speed; moved by all browsers together."""

import threading
from dataclasses import dataclass, replace

# The speeds to choose from.
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True)
class Cursor:
    """The time `at_ns` of a recording, by its log times; whether it plays, how many times as fast
    as it was recorded, and whether it begins again at its end.
    """

    at_ns: int
    plays: bool = False
    speed: float = 1.0
    loops: bool = False

    def after(self, passed_s: float, start_ns: int, end_ns: int) -> "Cursor":
        """The cursor `passed_s` later, between the ends of the recording."""
        if not self.plays:
            return self
        at_ns = self.at_ns + round(passed_s * self.speed * 1e9)
        if at_ns < end_ns:
            return replace(self, at_ns=at_ns)
        # Of an empty span there is only the one moment.
        if self.loops and end_ns > start_ns:
            return replace(self, at_ns=start_ns)
        return replace(self, at_ns=end_ns, plays=False)


class Playhead:
    """The cursor of a recording from `start_ns` to `end_ns`; safe from any thread.

    `jumps` counts the changes that a browser cannot foresee from the cursor before.
    """

    def __init__(self, start_ns: int, end_ns: int, cursor: Cursor) -> None:
        self._lock = threading.Lock()
        self.start_ns, self.end_ns = start_ns, end_ns
        self.cursor = replace(cursor, at_ns=self._within(cursor.at_ns))
        self.jumps = 0
        self._steps = 0

    def play(self, plays: bool) -> None:
        """Play or pause; at the end it plays from the beginning."""
        with self._lock:
            again = plays and self.cursor.at_ns >= self.end_ns
            at_ns = self.start_ns if again else self.cursor.at_ns
            self._set(replace(self.cursor, plays=plays, at_ns=at_ns))

    def toggle(self) -> None:
        """Play if it is paused, else pause."""
        self.play(not self.cursor.plays)

    def seek(self, at_ns: int, plays: bool | None = None) -> None:
        """Go to a time, or the end that is nearer; play or pause there, or as before."""
        with self._lock:
            plays = self.cursor.plays if plays is None else plays
            self._set(replace(self.cursor, at_ns=self._within(at_ns), plays=plays))

    def seek_by(self, by_s: float) -> None:
        """Go that many seconds forward, or back."""
        with self._lock:
            at_ns = self._within(self.cursor.at_ns + round(by_s * 1e9))
            self._set(replace(self.cursor, at_ns=at_ns))

    def step(self, by: int) -> None:
        """Pause, and go to the next message, or with -1 to the one before; `take_steps` has it."""
        with self._lock:
            self._steps += by
            self._set(replace(self.cursor, plays=False))

    def take_steps(self) -> int:
        """How many messages to go forward, or back, since this was last asked."""
        with self._lock:
            steps, self._steps = self._steps, 0
            return steps

    def set_speed(self, speed: float) -> None:
        """Play at the speed of SPEEDS that is nearest to this one."""
        with self._lock:
            nearest = min(SPEEDS, key=lambda each: abs(each - speed))
            self._set(replace(self.cursor, speed=nearest))

    def change_speed(self, steps: int) -> None:
        """Take the next faster speed, or with -1 the next slower one."""
        row = SPEEDS.index(self.cursor.speed) + steps
        self.set_speed(SPEEDS[min(max(row, 0), len(SPEEDS) - 1)])

    def loop(self, loops: bool) -> None:
        """Whether to begin again at the end."""
        with self._lock:
            self._set(replace(self.cursor, loops=loops))

    def advance(self, passed_s: float) -> Cursor:
        """Let time pass, if it plays; the cursor then."""
        with self._lock:
            before = self.cursor
            self.cursor = before.after(passed_s, self.start_ns, self.end_ns)
            if self.cursor.at_ns < before.at_ns or self.cursor.plays != before.plays:
                self.jumps += 1
            return self.cursor

    def _within(self, at_ns: int) -> int:
        return min(max(at_ns, self.start_ns), self.end_ns)

    def _set(self, cursor: Cursor) -> None:
        self.cursor = cursor
        self.jumps += 1
