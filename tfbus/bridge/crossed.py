"""Loop prevention: drops transforms that crossed before."""

import threading
from collections.abc import Callable, Iterable
from typing import Literal

from tfbus.geometry.columns import Columns
from tfbus.runtime import scheduler

Way = Literal["to ROS", "from ROS"]
_OTHER: dict[Way, Way] = {"to ROS": "from ROS", "from ROS": "to ROS"}

# Of a frame that goes both ways this many stamps are remembered: 2.5 s at 100 Hz.
_MOST_STAMPS = 256

# Names come from the network: at most this many are remembered in each direction.
_MOST_FRAMES = 100_000

# When a frame begins to come from the other side too, its last stamps are not known yet: until they
# are, it does not go that way.
_LEARNING_S = 1.0


class Crossed:
    """Remembers the stamps of frames that go both ways, by the names of the bus; safe from any
    thread.

    `on_contested` is called when a frame begins to go both ways.
    """

    def __init__(
        self,
        on_contested: Callable[[], object],
        clock_s: Callable[[], float] = lambda: scheduler.monotonic(),
    ) -> None:
        self._on_contested = on_contested
        self._clock_s = clock_s
        self._lock = threading.Lock()
        self._going: dict[Way, set[str]] = {"to ROS": set(), "from ROS": set()}
        # Of each frame that goes both ways: its stamps by direction, and which direction came
        # second, and when.
        self._stamps: dict[str, dict[Way, dict[int, None]]] = {}
        self._second: dict[str, tuple[Way, float]] = {}

    def note(self, way: Way, children: Iterable[str]) -> bool:
        """Note that frames go this way; whether any of them goes the other way too."""
        begins = is_contested = False
        with self._lock:
            going, back = self._going[way], self._going[_OTHER[way]]
            for child in children:
                if child not in going and len(going) < _MOST_FRAMES:
                    going.add(child)
                    if child in back:
                        begins = True
                        self._stamps[child] = {way: {}, _OTHER[way]: {}}
                        self._second[child] = way, self._clock_s() + _LEARNING_S
                is_contested |= child in self._stamps
        if begins:
            self._on_contested()
        return is_contested

    def stays(self, way: Way, children: Iterable[str]) -> None:
        """These frames go this way no longer."""
        with self._lock:
            for child in children:
                self._going[way].discard(child)
                self._stamps.pop(child, None)
                self._second.pop(child, None)

    def crosses(self, way: Way, rows: Columns) -> list[int]:
        """Which rows have not come the other way, of rows with the names of the bus."""
        frames = rows.frames
        stamps = rows.stamps_as_ints()
        with self._lock:
            return [
                at
                for at, (_, child) in enumerate(rows.pairs())
                if self._crosses(way, frames[child], stamps[at])
            ]

    def _crosses(self, way: Way, child: str, stamp_ns: int) -> bool:
        stamps = self._stamps.get(child)
        if stamps is None:
            return True
        if stamp_ns in stamps[_OTHER[way]]:
            return False
        second, until_s = self._second[child]
        if way == second and self._clock_s() < until_s:
            return False
        own = stamps[way]
        own[stamp_ns] = None
        if len(own) > _MOST_STAMPS:
            del own[next(iter(own))]
        return True
