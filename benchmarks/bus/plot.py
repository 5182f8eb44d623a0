"""The plot of how the bus grows."""

from collections.abc import Sequence

from benchmarks.bus.growth import Size


def draw(publishers: Sequence[Size], frames: Sequence[Size], file: str) -> None:
    """The CPU for a transform by publishers and by frames, both axes logarithmic."""
    import matplotlib

    matplotlib.use("svg")
    # Letters stay letters, and the same numbers make the same file.
    matplotlib.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "tfbus"}
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(1, 2, figsize=(8, 3.4), sharey=True)
    for panel, sizes, label in zip(
        panels,
        (publishers, frames),
        ("publishers, one transform to a message", "frames, up to 1,000 to a message"),
        strict=True,
    ):
        panel.loglog(
            [size.size for size in sizes],
            [size.intake.cpu_ns for size in sizes],
            marker="o",
            markersize=4,
        )
        panel.set_xlabel(label)
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("CPU of a listener, a transform [ns]")
    figure.tight_layout()
    figure.savefig(file, metadata={"Date": None})
