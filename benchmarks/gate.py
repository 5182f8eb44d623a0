"""A gate of the hot paths: the instructions of each, compared with those in gate.json.

    python -m benchmarks.gate            fails where one takes 3 % more
    python -m benchmarks.gate --update   writes gate.json

Takes half a minute, valgrind and a C compiler; no busy machine disturbs it. The numbers hold for
one minor version of Python, in proportion to what Python itself takes (`calibrate`); where that is
built otherwise, 10 % more are allowed.
"""

import json
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.processes import Process, Unavailable, start_worker
from tfbus.buffer.buffer import COMPILED

NUMBERS = Path(__file__).with_suffix(".json")
TOLERANCE = 0.03

# Python is built otherwise where its own part differs by more than this; then the tolerance is
# another.
SAME_BUILD = 0.02
TOLERANCE_OF_OTHERS = 0.1

CALIBRATION = "calibrate 1"
MEASURES = (
    CALIBRATION,
    "lookup 1",
    "lookup 3",
    "lookup_anywhere 3",
    "insert 1",
    "insert_columns 50",
    "send 1",
    "send 50",
    "receive 1",
    "receive 50",
    "receive_compact 1",
    "receive_compact 50",
    "receive_unlisted 1",
    "receive_unlisted 50",
    "subscribe 1",
    "record 50",
)

# The least of all rounds but the first: where the machine is busy a round takes longer, and more of
# what other threads do falls into it.
ROUNDS, OPERATIONS = 6, 200

_LIBRARY = """
#include <valgrind/callgrind.h>
void begin(void) { CALLGRIND_START_INSTRUMENTATION; CALLGRIND_ZERO_STATS; }
void end(const char *label) { CALLGRIND_DUMP_STATS_AT(label); CALLGRIND_STOP_INSTRUMENTATION; }
"""


def main() -> None:
    """Compare, or write the numbers."""
    if missing := [program for program in ("valgrind", "cc") if shutil.which(program) is None]:
        print(f"skipped: there is no {' and no '.join(missing)} to count instructions with")
        return
    if not COMPILED:
        print("skipped: the kernel is interpreted")
        return
    here = {"python": ".".join(platform.python_version_tuple()[:2]), "machine": platform.machine()}
    if sys.argv[1:] == ["--update"]:
        NUMBERS.write_text(json.dumps({**here, "instructions": counts()}, indent=2) + "\n")
        return
    numbers: dict[str, Any] = json.loads(NUMBERS.read_text())
    if {name: numbers[name] for name in here} != here:
        print(
            f"skipped: the numbers are of Python {numbers['python']} on {numbers['machine']}, this "
            f"is {here['python']} on {here['machine']}"
        )
        return
    before, now = numbers["instructions"], counts()
    mistakes = list(compare(before, now))
    if mistakes:
        # Of equal code one process takes up to 4 % more than another to receive.
        print("Once more, in another process, for the least of both:")
        again = counts()
        least = {name: min(count, again[name]) for name, count in now.items()}
        mistakes = list(compare(before, least))
    if mistakes:
        sys.exit("\n".join([*mistakes, "If it has to be: python -m benchmarks.gate --update"]))


def compare(before: dict[str, int], now: dict[str, int]) -> Iterator[str]:
    """Print each number; iterate over those that are too large, or have none to compare with."""
    scale = now[CALIBRATION] / before[CALIBRATION]
    tolerance = TOLERANCE if abs(scale - 1.0) < SAME_BUILD else TOLERANCE_OF_OTHERS
    print(f"Python itself takes {scale:.3f} of what it took; instructions of one:")
    for name, count in now.items():
        expected = before.get(name, 0) * scale
        change = count / expected - 1 if expected else 0.0
        print(f"  {name:20} {count:9,}  {change:+.1%}")
        if change > tolerance or not expected:
            yield f"{name}: {count:,} instructions, {expected:,.0f} before"


def counts() -> dict[str, int]:
    """The instructions of one operation of each measure."""
    with TemporaryDirectory(prefix="tfbus-bench-") as folder:
        return _counts(Path(folder))


def _counts(folder: Path) -> dict[str, int]:
    library = folder / "callgrind.so"
    subprocess.run(
        ["cc", "-shared", "-fPIC", "-x", "c", "-", "-o", library],
        input=_LIBRARY.encode(),
        check=True,
    )
    Process.under = [
        "valgrind",
        "--tool=callgrind",
        "--instr-atstart=no",
        f"--callgrind-out-file={folder / 'counted'}",
    ]
    Process.more_env = {"PYTHONHASHSEED": "0", "OPENBLAS_NUM_THREADS": "1"}
    process = start_worker("tfbus_bus", folder)
    for measure in MEASURES:
        try:
            process.ask(f"count {measure} {OPERATIONS} {ROUNDS} {library}")
        except Unavailable as error:
            sys.exit(f"{measure}: {error}")
    process.close()
    counted: dict[str, list[int]] = {measure: [] for measure in MEASURES}
    for path in sorted(folder.glob("counted.*"), key=lambda path: int(path.suffix[1:])):
        text = path.read_text()
        label = re.search(r"^desc: Trigger: Client Request: (.*)", text, re.MULTILINE)
        total = re.search(r"^(?:summary|totals): (\d+)", text, re.MULTILINE)
        if label and total:
            counted[label[1]].append(int(total[1]))
    return {name: round(min(rounds[1:]) / OPERATIONS) for name, rounds in counted.items()}


if __name__ == "__main__":
    main()
