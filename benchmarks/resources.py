"""What each kind of process takes of a small machine: python -m benchmarks.resources.

CPU, memory, threads, how often it wakes up, and how long it takes to start, of processes at rest
and of those that receive 50 frames at 50 Hz; beside bare Zenoh, and rospy from Debian's packages
where it is. With --write the part of docs/reference/performance.md is written.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks import machine
from benchmarks.bus import ros
from benchmarks.bus.at_rest import FRAMES, RATE_HZ
from benchmarks.bus.place import Place, Process, free_port, place
from benchmarks.parts import Part, Table

_SETTLE_S = 4.0
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Taken:
    """What a process takes: CPU as a share of a core, wake-ups a second, bytes, threads, and
    seconds to start, real and of CPU.
    """

    cpu: float
    wakeups: float
    memory: float
    threads: int
    start_s: float
    start_cpu_s: float


@dataclass(frozen=True)
class Kind:
    """A kind of process: a function of `bus.at_rest`, or a command of tfbus."""

    title: str
    function: str = ""
    command: tuple[str, ...] = ()
    with_frames: bool = False


KINDS = (
    Kind("bare Zenoh session", "bare_session"),
    Kind("`tfbus.Node`", "node"),
    Kind("bare Zenoh, a callback for the frames", "bare_subscriber", with_frames=True),
    Kind("`Node` with a `TransformListener`", "listener", with_frames=True),
    Kind(
        "`tfbus bag record`", command=("bag", "record", "-o", "{folder}/out.mcap"), with_frames=True
    ),
    Kind("`tfbus view`", command=("view", "--port", "{port}"), with_frames=True),
)


def measure(kind: Kind, seconds: float) -> Taken:
    """One process of a kind, for this many seconds."""
    with place() as at, ExitStack() as running:
        if kind.with_frames:
            publisher = running.enter_context(Process(at, "at_rest:publish", at.listening()))
            publisher.hear()
        env = at.connecting() if kind.with_frames else at.env
        return running.enter_context(_started(kind, at, env))(seconds)


@contextmanager
def _started(kind: Kind, at: Place, env: Mapping[str, str]) -> Iterator["_Watch"]:
    began_s = time.monotonic()
    if kind.function:
        with Process(at, f"at_rest:{kind.function}", {**env, "TFBUS_LISTEN": ""}) as process:
            process.hear()
            yield _Watch(process.pid, time.monotonic() - began_s)
        return
    words = [word.format(folder=at.folder, port=free_port()) for word in kind.command]
    with subprocess.Popen(
        [sys.executable, "-m", "tfbus", *words],
        env={**env, "TFBUS_LOG_LEVEL": "info"},
        cwd=at.folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as command:
        assert command.stderr is not None
        try:
            command.stderr.readline()
            yield _Watch(command.pid, time.monotonic() - began_s)
        finally:
            command.terminate()
            command.stderr.read()


class _Watch:
    """Reads of a process what the kernel counts."""

    def __init__(self, pid: int, start_s: float) -> None:
        self._proc = Path(f"/proc/{pid}")
        self._start_s, self._start_cpu_s = start_s, self._cpu_s()

    def __call__(self, seconds: float) -> Taken:
        """What it takes over this time, once it has settled."""
        time.sleep(_SETTLE_S)
        began_s, cpu_s, wakeups = time.monotonic(), self._cpu_s(), self._wakeups()
        time.sleep(seconds)
        passed_s = time.monotonic() - began_s
        return Taken(
            cpu=(self._cpu_s() - cpu_s) / passed_s,
            wakeups=(self._wakeups() - wakeups) / passed_s,
            memory=self._memory(),
            threads=len(list((self._proc / "task").iterdir())),
            start_s=self._start_s,
            start_cpu_s=self._start_cpu_s,
        )

    def _cpu_s(self) -> float:
        fields = (self._proc / "stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / _TICKS

    def _wakeups(self) -> int:
        texts = [(task / "status").read_text() for task in (self._proc / "task").iterdir()]
        return sum(int(text.split("\nvoluntary_ctxt_switches:")[1].split()[0]) for text in texts)

    def _memory(self) -> float:
        rollup = (self._proc / "smaps_rollup").read_text()
        private = [line.split()[1] for line in rollup.splitlines() if line.startswith("Private_")]
        return 1e3 * sum(map(int, private))


def measure_rospy(seconds: float) -> Taken:
    """A node of rospy at rest. Raises ros.NotInstalled."""
    with place() as at, ros.master(at) as env:
        began_s = time.monotonic()
        with Process(at, "at_rest:rospy_node", env, python=ros.PYTHON) as process:
            process.hear()
            return _Watch(process.pid, time.monotonic() - began_s)(seconds)


def table(results: Mapping[str, Taken]) -> Table:
    """A row for each process."""
    rows = [
        [
            title,
            f"{100 * taken.cpu:.2f} %",
            f"{taken.wakeups:.0f}",
            f"{taken.memory / 1e6:.0f} MB",
            str(taken.threads),
            f"{taken.start_s:.2f} s ({taken.start_cpu_s:.2f} s)",
        ]
        for title, taken in results.items()
    ]
    return Table(["process", "CPU", "wake-ups", "memory", "threads", "start"], rows)


def main() -> None:
    """Measure, and print the part."""
    parser = argparse.ArgumentParser(prog="benchmarks.resources", description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each process (20)")
    parser.add_argument("--write", action="store_true", help="write the pages about speed")
    arguments = parser.parse_args()
    where = machine.describe()
    results = {kind.title: measure(kind, arguments.seconds) for kind in KINDS}
    try:
        results["rospy node"] = measure_rospy(arguments.seconds)
    except ros.NotInstalled as error:
        print(f"The table will do without rospy: {error}", file=sys.stderr)
    part = Part(
        where,
        {"processes": table(results)},
        facts={
            "seconds": f"{arguments.seconds:g}",
            "frames": str(FRAMES),
            "rate": f"{RATE_HZ:g}",
        },
    )
    part.show()
    if arguments.write:
        part.keep("resources")


if __name__ == "__main__":
    main()
