"""What is known of all frames at one moment: the state of each, in the order of their trees."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from tfbus import Buffer, FrameInfo, TransformException
from tfbus.view.model.status import FrameState, judge, opacity_of

# A stream's rows of parent, child and whether it is static, as a listener tells them.
Rows = Iterable[tuple[str, str, bool]]


class Frames:
    """The frames at one moment, trees from their roots down, children by name."""

    def __init__(self, states: Sequence[FrameState] = ()) -> None:
        self.states = {state.name: state for state in states}

    def __len__(self) -> int:
        return len(self.states)

    def __iter__(self) -> Iterator[FrameState]:
        return iter(self.states.values())

    def __contains__(self, name: str) -> bool:
        return name in self.states

    def get(self, name: str) -> FrameState | None:
        """The state of a frame; None where it is not known."""
        return self.states.get(name)

    @property
    def roots(self) -> list[str]:
        """The roots, that of the largest tree first."""
        sizes: dict[str, int] = defaultdict(int)
        for state in self:
            sizes[state.root] += 1
        return sorted(sizes, key=lambda root: (-sizes[root], root))

    def tree_of(self, name: str) -> list[str]:
        """The frames of the tree that a frame is in; none where it is not known."""
        if name not in self.states:
            return []
        root = self.states[name].root
        return [state.name for state in self if state.root == root]

    def natural_fixed_frame(self) -> str:
        """What to see everything from where nobody has chosen: world, or the largest tree's
        root; "" where there is no frame.
        """
        if "world" in self.states:
            return "world"
        return next(iter(self.roots), "")


class FrameWatch:
    """Follows the frames of a buffer: for how long each has been silent, by our own clock.

    Clocks of several machines differ, so that silence is measured from when a new stamp was first
    seen here.
    """

    def __init__(self, buffer: Buffer, clock: Callable[[], float] = time.monotonic) -> None:
        self._buffer = buffer
        self._clock = clock
        self._heard: dict[str, tuple[int | None, float]] = {}

    def look(self, sent: Mapping[str, Rows], fixed_frame: str) -> Frames:
        """The frames now. `sent` has for each living stream the rows that it describes."""
        infos = self._buffer.all_frames()
        now_s = self._clock()
        silent = self._listen(infos, now_s)
        publishers = _publishers(sent)
        by_name = {info.name: info for info in infos}
        unplaced: dict[str, str] = {}
        states = []
        for info, root, depth in in_tree_order(by_name):
            senders = publishers.get(info.name, ())
            status = judge(info, silent[info.name], len(senders))
            if root not in unplaced:
                unplaced[root] = self._why_apart(fixed_frame, root)
            states.append(
                FrameState(
                    info,
                    status,
                    silent[info.name],
                    opacity_of(status, silent[info.name], info.rate_hz),
                    senders or ((info.authority,) if info.authority else ()),
                    root,
                    depth,
                    unplaced[root],
                )
            )
        return Frames(states)

    def _listen(self, infos: Sequence[FrameInfo], now_s: float) -> dict[str, float]:
        heard = {}
        for info in infos:
            before = self._heard.get(info.name)
            is_known = before is not None and before[0] == info.newest_ns
            heard[info.name] = before if before and is_known else (info.newest_ns, now_s)
        self._heard = heard
        return {name: now_s - since_s for name, (_, since_s) in heard.items()}

    def _why_apart(self, fixed_frame: str, root: str) -> str:
        """Why a whole tree has no place, in the buffer's words; "" where it has."""
        if not fixed_frame:
            return ""
        try:
            self._buffer.path(fixed_frame, root)
        except TransformException as error:
            return str(error)
        return ""


def in_tree_order(infos: dict[str, FrameInfo]) -> Iterator[tuple[FrameInfo, str, int]]:
    """Each frame with its root and its depth: whole trees, the largest first, parents before
    their children.
    """
    roots = [info.name for info in infos.values() if info.parent not in infos]
    trees = [list(_below(infos, root)) for root in sorted(roots)]
    for tree in sorted(trees, key=len, reverse=True):
        yield from tree


def _below(infos: dict[str, FrameInfo], root: str) -> Iterator[tuple[FrameInfo, str, int]]:
    pending = [(root, 0)]
    while pending:
        name, depth = pending.pop()
        yield infos[name], root, depth
        pending += [(child, depth + 1) for child in reversed(infos[name].children)]


def _publishers(sent: Mapping[str, Rows]) -> dict[str, tuple[str, ...]]:
    publishers: dict[str, tuple[str, ...]] = {}
    for stream, rows in sorted(sent.items()):
        for _, child, _ in rows:
            publishers[child] = (*publishers.get(child, ()), stream)
    return publishers
