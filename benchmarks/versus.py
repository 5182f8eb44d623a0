"""This tree beside another one: `python -m benchmarks.versus ../other`.

Both are measured in turns, so that both have the quiet hours and the busy ones, and the best of the
runs counts. In each folder `make bench ARGS=--help` has made the environment, `.venv-bench`.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measures import comparisons
from benchmarks.processes import TFBUS, Process

HERE = Path(__file__).parents[1]

# One row of the table is what is measured and how it is done once in a tree.
Measure = Callable[["Tree"], float]

_BUS = """
import json
from benchmarks.bus import intake, latency
single, fifty = intake.measure(1, 1), intake.measure(50, 1)
ours, _ = latency.measure(1000, 1)
print(json.dumps({
    "CPU of a message of one transform, in a row": single.cpu_ns,
    "CPU of a transform in messages of 50": fifty.cpu_ns,
    "latency between two processes, median": ours.p50_us * 1e3,
}))
"""


class Tree:
    """A checkout of tfbus with its bench environment."""

    def __init__(self, root: Path, folder: Path) -> None:
        self._root = root
        self._python = str(root / ".venv-bench" / "bin" / "python")
        (folder / "benchmarks").symlink_to(root / "benchmarks")
        self._worker = Process([self._python, "-m", "benchmarks.worker", "tfbus"], folder)

    def ask(self, request: str) -> float:
        """What the tree's worker answers: nanoseconds, or bytes."""
        return self._worker.measure(request)

    def bus(self) -> dict[str, float]:
        """What one round on a bus of the tree's own takes, in nanoseconds."""
        done = subprocess.run(
            [self._python, "-c", _BUS], cwd=self._root, capture_output=True, text=True, check=True
        )
        measured: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
        return measured

    def close(self) -> None:
        """End its worker."""
        self._worker.close()


def main() -> None:
    """Print a row for each thing that is measured: there, here, and here over there."""
    parser = argparse.ArgumentParser(prog="benchmarks.versus", description=__doc__)
    parser.add_argument("other", type=Path, help="the folder of the other tree")
    parser.add_argument("--runs", type=int, default=9, help="of which the best counts (9)")
    parser.add_argument("--no-bus", action="store_true", help="only the buffer")
    arguments = parser.parse_args()
    with ExitStack() as stack:
        there, here = (
            Tree(root.resolve(), Path(stack.enter_context(TemporaryDirectory())))
            for root in (arguments.other, HERE)
        )
        stack.callback(there.close)
        stack.callback(here.close)
        for request in _requests():
            pairs = [(there.ask(request), here.ask(request)) for _ in range(arguments.runs)]
            _tell(request, *(min(side) for side in zip(*pairs, strict=True)))
            there.ask("forget")
            here.ask("forget")
        if not arguments.no_bus:
            rounds = [(there.bus(), here.bus()) for _ in range(arguments.runs)]
            for what in rounds[0][0]:
                _tell(what, min(a[what] for a, _ in rounds), min(b[what] for _, b in rounds))


def _requests() -> list[str]:
    """What the table of `make bench` asks tfbus for."""
    asked = (row.ours for row in comparisons() if row.subject == TFBUS)
    return [request for request in dict.fromkeys(asked) if not request.startswith("memory")]


def _tell(what: str, there: float, here: float) -> None:
    print(f"{what:45} {there:12,.1f} {here:12,.1f} {here / there:7.3f}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
