"""The names of frames in a fleet of robots.

Each robot has a namespace; in it, frames have the same names as in all others: `base_link`. In the
fleet they are `robot7/base_link`, except frames that the robots share, such as `map`.
"""

import re
from collections.abc import Iterable, Iterator

from tfbus.base.errors import InvalidArgumentException, InvalidNameError
from tfbus.base.structs import replace
from tfbus.base.wording import natural_order, printable
from tfbus.geometry.transform import check_frame_id
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.keys import check_namespace

# A stream repeats a few tables of names; after this many, or this many names, the cache starts
# again.
_MOST_TABLES = 64
_MOST_NAMES = 10_000


class FrameNames:
    """The names of one robot's frames as seen from outside of its namespace.

    Invalid names stay as they are, for the buffer to refuse.
    """

    def __init__(self, namespace: str, shared_frames: Iterable[str] = ()) -> None:
        self.namespace = namespace
        self.shared_frames = frozenset(shared_frames)
        self._tables: dict[tuple[str, ...], tuple[str, ...]] = {}
        self._count = 0

    def outside(self, frame: str) -> str:
        """A frame's name from outside: `robot7/base_link`, or `map` if it is shared."""
        if not self.namespace or not frame or frame[0] == "/" or frame in self.shared_frames:
            return frame
        return f"{self.namespace}/{frame}"

    def all_outside(self, frames: tuple[str, ...]) -> tuple[str, ...]:
        """The names of a message's frames from outside."""
        if not self.namespace:
            return frames
        outside = self._tables.get(frames)
        if outside is None:
            outside = tuple(map(self.outside, frames))
            self._count += len(frames)
            if len(self._tables) >= _MOST_TABLES or self._count > _MOST_NAMES:
                self._tables.clear()
                self._count = len(frames)
            if self._count <= _MOST_NAMES:
                self._tables[frames] = outside
        return outside

    def description_outside(self, description: StreamDescription) -> StreamDescription:
        """The description of a stream with the names from outside."""
        if not self.namespace:
            return description
        frames = (
            (self.outside(parent), self.outside(child), static)
            for parent, child, static in description.frames
        )
        return replace(description, frames=tuple(frames))


def has_name(frame: str, namespace: str, name: str) -> bool:
    """Whether a frame of a robot in this namespace has a name: its own there, `base_link`, or the
    one in a fleet, `robot7/base_link`, as seen from any namespace above.
    """
    if name == frame:
        return True
    above = name.removesuffix(f"/{frame}")
    return above != name and f"/{namespace}".endswith(f"/{above}")


class Fleet:
    """All robots in the namespaces below a node's own, and the frames that they share."""

    def __init__(self, shared_frames: Iterable[str] = ()) -> None:
        if isinstance(shared_frames, str):
            raise InvalidArgumentException(
                f"shared_frames must be several names, not a str: write ({shared_frames!r},)"
            )
        self.shared_frames = frozenset(check_frame_id(frame) for frame in shared_frames)

    def names(self, namespace: str) -> FrameNames:
        """The names of one robot's frames, by its namespace relative to ours."""
        return FrameNames(namespace, self.shared_frames)

    def namespaces_of(self, frame: str) -> set[str]:
        """The namespaces whose robots may have a frame of this name from outside, relative to ours;
        empty for any, as it is a shared one.
        """
        if frame in self.shared_frames:
            return set()
        return {"", *(frame[:at] for at, letter in enumerate(frame) if letter == "/" and at)}


def shared_name(first: str, second: str) -> str:
    """The shared name of `robot7/world` and `robot8/world`: `world`; "" if the names differ."""
    (a, _, name), (b, _, other) = first.rpartition("/"), second.rpartition("/")
    return name if a and b and a != b and name == other else ""


# A longer roster is a mistake in its range.
_MOST_ROBOTS = 10_000

_RANGES = r"\[([^\[\]]*)\]"


def roster_of(names: Iterable[str]) -> tuple[str, ...]:
    """The names of robots, in natural order: `robot[1-3]` are robot1, robot2 and robot3; `[a,c]`
    lists, `[01-10]` keeps its zeros.

    Raises InvalidArgumentException for a range that is none, a name that cannot be a namespace, and
    more than 10,000 robots.
    """
    found: set[str] = set()
    for name in names:
        for each in _expanded(name):
            try:
                found.add(check_namespace(each))
            except InvalidNameError as error:
                raise InvalidArgumentException(f"robot {printable(each, 60)!r}: {error}") from error
            if len(found) > _MOST_ROBOTS:
                raise InvalidArgumentException(f"at most {_MOST_ROBOTS:,} robots may be expected")
    found.discard("")
    return tuple(sorted(found, key=natural_order))


def _expanded(name: str) -> Iterator[str]:
    """The names of a pattern: of its first range, then of the others."""
    ranges = re.search(_RANGES, name)
    if ranges is None:
        if "[" in name or "]" in name:
            raise _no_range(name)
        yield name
        return
    before, after = name[: ranges.start()], name[ranges.end() :]
    for part in ranges[1].split(","):
        for each in _parts(part.strip(), name):
            yield from _expanded(f"{before}{each}{after}")


def _no_range(name: str) -> InvalidArgumentException:
    return InvalidArgumentException(
        f"{printable(name, 60)!r} is no range of robots: write robot[1-30], or robot[1,4,7]"
    )


def _parts(part: str, name: str) -> Iterator[str]:
    bounds = re.fullmatch(r"([0-9]{1,9})-([0-9]{1,9})", part)
    if bounds is None:
        if not part or "-" in part:
            raise _no_range(name)
        yield part
        return
    first, last = int(bounds[1]), int(bounds[2])
    if not first <= last < first + _MOST_ROBOTS:
        raise InvalidArgumentException(
            f"{printable(name, 60)!r}: a range goes up, by at most {_MOST_ROBOTS:,} robots"
        )
    digits = len(bounds[1]) if bounds[1].startswith("0") else 0
    for number in range(first, last + 1):
        yield f"{number:0{digits}}"
