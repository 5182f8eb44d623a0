"""Count the instructions of one lookup, or of another measure: no busy machine disturbs that.

    python -m benchmarks.instructions ["lookup 3" "insert 1" ...]

Needs valgrind. Each peer runs twice, with more lookups the second time and all else the same.
"""

import os
import re
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.processes import PEERS, Process, Unavailable, start

LESS, MORE = 1_000, 6_000
# What takes minutes under valgrind, and stands far behind, is left out.
LEFT_OUT = ("tf2_py", "pytransform3d")


def main() -> None:
    """Print a line for each peer."""
    measures = sys.argv[1:] or ["lookup 3"]
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # numpy's threads would spin meanwhile
    print("instructions of one", *measures, sep="\t")
    for peer in PEERS:
        if peer not in LEFT_OUT:
            try:
                counts = [f"{instructions(peer, measure):,.0f}" for measure in measures]
            except Unavailable as error:
                counts = [str(error)]
            print(peer, *counts, sep="\t", flush=True)


def instructions(peer: str, measure: str) -> float:
    """Of one operation of the measure."""
    few, many = (_collected(peer, f"repeat {measure} {count} {MORE}") for count in (LESS, MORE))
    return (many - few) / (MORE - LESS)


def _collected(peer: str, request: str) -> int:
    with TemporaryDirectory(prefix="tfbus-bench-") as folder:
        out = Path(folder) / "callgrind"
        Process.under = [
            "valgrind",
            "--tool=callgrind",
            f"--callgrind-out-file={out}",
        ]
        try:
            process = start(peer, Path(folder))
        except FileNotFoundError:
            sys.exit("there is no valgrind: apt-get install valgrind")
        process.ask(request)
        process.close()
        summary = re.search(r"^(?:summary|totals): (\d+)", out.read_text(), re.MULTILINE)
        if not summary:
            raise Unavailable("valgrind counted nothing")
        return int(summary[1])


if __name__ == "__main__":
    main()
