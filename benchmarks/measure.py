"""Ask all peers for all that is compared, in turns, and take the median of each."""

from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from benchmarks.measures import Comparison
from benchmarks.processes import LIMIT, PEERS, Process, Unavailable, start


@dataclass(frozen=True)
class Result:
    """A measured row; a number is None where it could not be had, and `missing` says why."""

    comparison: Comparison
    ours: float | None
    theirs: float | None
    missing: str = ""

    @property
    def ratio(self) -> float | None:
        """How many times more the peer takes."""
        return self.theirs / self.ours if self.ours and self.theirs else None


class Bench:
    """The processes of the peers, each started when first asked; a context manager."""

    def __init__(self) -> None:
        self._folder = Path()
        self._numbers = count()
        self._processes: dict[str, Process | Unavailable] = {}
        self._stack = ExitStack()

    def __enter__(self) -> "Bench":
        self._folder = Path(self._stack.enter_context(TemporaryDirectory(prefix="tfbus-bench-")))
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def process(self, peer: str) -> Process:
        """The peer's process. Raises Unavailable."""
        if peer not in self._processes:
            self._processes[peer] = self._started(peer)
        process = self._processes[peer]
        if isinstance(process, Unavailable):
            raise process
        return process

    def fresh(self, peer: str) -> Process:
        """One more process of the peer, whose memory nothing has touched. Raises Unavailable."""
        process = self._started(peer)
        if isinstance(process, Unavailable):
            raise process
        return process

    def forget(self, peer: str) -> None:
        """Let go of what the peer has made for its measures."""
        with suppress(Unavailable):  # then there is nothing that it remembers
            self.process(peer).ask("forget")

    def _started(self, peer: str) -> Process | Unavailable:
        folder = self._folder / str(next(self._numbers))
        folder.mkdir()
        try:
            process = start(peer, folder)
        except Unavailable as error:
            return error
        self._stack.callback(process.close)
        return process

    def versions(self) -> dict[str, str]:
        """What each peer says that it is, or why it is not there."""
        said = {}
        for peer in PEERS:
            try:
                said[peer] = self.process(peer).ask("version")
            except Unavailable as error:
                said[peer] = f"not measured: {error}"
        return said


def measure(
    bench: Bench, comparisons: list[Comparison], runs: int, tell: Callable[[str], None]
) -> list[Result]:
    """The rows with their medians. Those of a group take turns, lest one has the quiet hour."""
    medians: dict[tuple[str, str], float | Unavailable] = {}
    for what in dict.fromkeys(comparison.group for comparison in comparisons):
        tell(what)
        asked = dict.fromkeys(
            side
            for comparison in comparisons
            if comparison.group == what
            for side in (
                (comparison.subject, comparison.ours),
                (comparison.peer, comparison.theirs),
            )
        )
        medians |= medians_of(bench, asked, runs)
        for peer in {peer for peer, _ in asked} - {LIMIT}:
            bench.forget(peer)
    return [_result(comparison, medians) for comparison in comparisons]


def medians_of(
    bench: Bench, asked: Iterable[tuple[str, str]], runs: int
) -> dict[tuple[str, str], float | Unavailable]:
    """The median of each (peer, request); the runs alternate, the first of each is warm already."""
    taken: dict[tuple[str, str], list[float]] = {side: [] for side in asked}
    failed: dict[tuple[str, str], Unavailable] = {}
    for _ in range(runs):
        for side in taken:
            if side in failed:
                continue
            try:
                taken[side].append(_once(bench, *side))
            except Unavailable as error:
                failed[side] = error
    return {side: failed.get(side) or median(taken[side]) for side in taken}


def _once(bench: Bench, peer: str, request: str) -> float:
    if peer == LIMIT:
        return float(request)
    if not request.startswith("memory"):
        return bench.process(peer).measure(request)
    process = bench.fresh(peer)
    try:
        return process.measure(request)
    finally:
        process.close()


def _result(comparison: Comparison, medians: dict[tuple[str, str], float | Unavailable]) -> Result:
    ours = medians[comparison.subject, comparison.ours]
    theirs = medians[comparison.peer, comparison.theirs]
    reasons = [str(side) for side in (ours, theirs) if isinstance(side, Unavailable)]
    return Result(
        comparison,
        None if isinstance(ours, Unavailable) else ours,
        None if isinstance(theirs, Unavailable) else theirs,
        "; ".join(reasons),
    )
