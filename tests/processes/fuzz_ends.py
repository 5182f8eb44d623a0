"""Signals at random moments of a process's life: each ends soon, and not by an abort.

python -m tests.processes.fuzz_ends --count 1000
"""

import argparse
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from signal import SIGINT, SIGTERM

from tests.buses import DEADLINE_S
from tests.live_bus import Bus, Process, free_port

# A script without `with`, whose timer sends.
_SCRIPT = """
import tfbus
node = tfbus.Node("script")
sender = tfbus.TransformBroadcaster(node)
still = tfbus.Transform.identity()
def send() -> None:
    sender.send_transform(tfbus.TransformStamped(node.now_ns(), "map", "base", still))
node.create_timer(0.001, send)
node.spin()
"""

_TFBUS = (sys.executable, "-m", "tfbus")

# Tools, nodes, and a script.
_COMMANDS = (
    (*_TFBUS, "follow"),
    (*_TFBUS, "foxglove", "--port", str(free_port())),
    (*_TFBUS, "simulator"),
    (*_TFBUS, "carrot"),
    (*_TFBUS, "echo", "a", "b"),
    (*_TFBUS, "doctor", "--for", "0.5"),
    (*_TFBUS, "static", "a", "b"),
    (sys.executable, "-c", _SCRIPT),
)

# The codes of a clean end, of one before the answer, and of one while Python or the tool loads.
_FINE = (0, 130, -SIGINT, -SIGTERM)

# What Python prints that is interrupted before it runs any of ours.
_PYTHON_STARTS = ("Fatal Python error: init_", "Could not import runpy module")

# Until each has begun its work, on a busy machine.
_LATEST_S = 4.0


class Failure(Exception):
    """A process that hung, or ended otherwise than it should."""


def end_at_random(bus: Bus, chance: random.Random) -> str:
    """Start a process, send a signal at a random moment; how it ended. Raises Failure."""
    command = chance.choice(_COMMANDS)
    number, after_s = chance.choice((SIGINT, SIGTERM)), chance.uniform(0.0, _LATEST_S)
    process = bus.start_command(command)
    what = f"{' '.join(command[1:])[:30]!r}, {number.name} after {after_s:.3f} s"
    try:
        process.popen.wait(after_s)
    except subprocess.TimeoutExpired:
        process.signal(number)
    try:
        code = process.wait()
    except subprocess.TimeoutExpired:
        raise Failure(f"{what}: not gone after {DEADLINE_S:g} s (pid {process.pid})") from None
    is_fine = code in _FINE or (code == 1 and "doctor" in command)
    if any(start in line for line in process.err for start in _PYTHON_STARTS):
        return "while Python itself starts"
    if not is_fine or not_known(process.err):
        raise Failure(f"{what}: code {code}, {process.err}")
    return f"{number.name} {code}"


def not_known(lines: list[str]) -> list[str]:
    """What it printed, where it has a traceback of another error than KeyboardInterrupt, which a
    script without a `with` gets outside of its `spin`.
    """
    is_traceback = any("Traceback" in line for line in lines)
    return lines if is_traceback and "KeyboardInterrupt" not in lines else []


def _pause(process: Process) -> None:
    while process.popen.poll() is None:
        time.sleep(1.0)


def main() -> None:
    """Run, and say how they ended; exit code 1 where one hung or aborted."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=time.time_ns() % 2**32)
    parser.add_argument("--keep", action="store_true", help="leave what hangs, to look at it")
    arguments = parser.parse_args()
    print(f"seed {arguments.seed}", flush=True)
    chance = random.Random(arguments.seed)
    ends: Counter[str] = Counter()
    failures = 0
    with tempfile.TemporaryDirectory() as folder:
        bus = Bus(Path(folder))
        try:
            for _ in range(arguments.count):
                try:
                    ends[end_at_random(bus, chance)] += 1
                except Failure as failure:
                    failures += 1
                    print(failure, flush=True)
                    if arguments.keep:
                        _pause(bus.processes[-1])
        finally:
            bus.close()
    for how, count in sorted(ends.items()):
        print(f"{how}: {count}")
    sys.exit(f"{failures} of {arguments.count} hung or aborted" if failures else 0)


if __name__ == "__main__":
    main()
