"""How the cost of a lookup grows: with depth, with frames, with samples."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from benchmarks.measure import Bench, medians_of
from benchmarks.parts import Table
from benchmarks.processes import TFBUS, Unavailable
from benchmarks.report import amount

PEERS = (TFBUS, "tf2 from C++")


@dataclass(frozen=True)
class Axis:
    """One thing that grows: the measure of the peers, and how it is said."""

    measure: str
    label: str
    title: str
    sizes: tuple[int, ...]


AXES = (
    Axis("deep", "edges", "One lookup along a chain", (1, 3, 10, 30, 100, 300, 1_000)),
    Axis(
        "frames", "frames", "One lookup between any two frames", (10, 100, 1_000, 10_000, 100_000)
    ),
    Axis(
        "samples",
        "samples of the edge",
        "One lookup at any time of one edge",
        (10, 100, 1_000, 10_000, 100_000, 1_000_000),
    ),
)


@dataclass(frozen=True)
class Curve:
    """The time of one lookup in ns at each size of an axis, by peer; None where not measured."""

    axis: Axis
    times: dict[str, list[float | None]]


def grow(bench: Bench, runs: int, tell: Callable[[str], None]) -> list[Curve]:
    """Measure all axes."""
    return [_curve(bench, axis, runs, tell) for axis in AXES]


def _curve(bench: Bench, axis: Axis, runs: int, tell: Callable[[str], None]) -> Curve:
    times: dict[str, list[float | None]] = {peer: [] for peer in PEERS}
    for size in axis.sizes:
        tell(f"{axis.title}, {size:,} {axis.label}")
        request = f"{axis.measure} {size}"
        medians = medians_of(bench, [(peer, request) for peer in PEERS], runs)
        for peer in PEERS:
            taken = medians[peer, request]
            times[peer].append(None if isinstance(taken, Unavailable) else taken)
            bench.forget(peer)
    return Curve(axis, times)


def as_table(curve: Curve) -> Table:
    """A row for each size."""
    cells = [
        [f"{size:,}", *(amount(curve.times[peer][row]) for peer in PEERS)]
        for row, size in enumerate(curve.axis.sizes)
    ]
    return Table([curve.axis.label, *PEERS], cells, words=0)


def plot(curves: Sequence[Curve], file: str) -> None:
    """All curves side by side, both axes logarithmic."""
    import matplotlib

    matplotlib.use("svg")
    # Letters stay letters, and the same numbers make the same file.
    matplotlib.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "tfbus"}
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(1, len(curves), figsize=(4 * len(curves), 3.4), sharey=True)
    for panel, curve in zip(panels, curves, strict=True):
        for peer, times in curve.times.items():
            drawn = [
                (size, time)
                for size, time in zip(curve.axis.sizes, times, strict=True)
                if time is not None
            ]
            if drawn:
                panel.loglog(*zip(*drawn, strict=True), marker="o", markersize=4, label=peer)
        panel.set_title(curve.axis.title, fontsize=10)
        panel.set_xlabel(curve.axis.label)
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("one lookup [ns]")
    panels[0].legend()
    figure.tight_layout()
    figure.savefig(file, metadata={"Date": None})
