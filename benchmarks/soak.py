"""An hour of faults on one machine: python -m benchmarks.soak --minutes 60

Publishers are killed and started again every few seconds, the router now and then, while three
listeners go on: two peers, and a client of the router. Writes docs/reference/soak.svg.
"""

import argparse
import json
import random
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks import machine
from benchmarks.bus.place import free_port
from benchmarks.report import markdown_table

ROOT = Path(__file__).parent.parent
PROGRAMS = ROOT / "tests" / "hosts"
DOCS = ROOT / "docs" / "reference"

PUBLISHERS = [f"robot{number}" for number in range(6)]
LISTENERS = {"peer": False, "other peer": False, "client of the router": True}
KILL_EVERY_S = 5.0
KILL_ROUTER_EVERY_S = 120.0
SAMPLE_EVERY_S = 5.0


@dataclass(frozen=True)
class Sample:
    """What a listener reported of itself, at a time since the start."""

    at_s: float
    resident_mb: float
    handles: int
    threads: int


class Listener:
    """A listener that reports five times a second; the last report is kept."""

    def __init__(self, process: "subprocess.Popen[str]"):
        self.process = process
        self._last: dict[str, Any] = {}
        threading.Thread(target=self._read, daemon=True).start()

    def sample(self, start_s: float) -> Sample | None:
        """Its last report; None before the first."""
        if self.process.poll() is not None:
            raise RuntimeError(f"a listener has ended with {self.process.returncode}")
        last, at_s = self._last, time.monotonic() - start_s
        if not last:
            return None
        return Sample(at_s, last["resident_kb"] / 1e3, last["handles"], last["threads"])

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._last = json.loads(line)


class Soak:
    """The processes, and what was done to them."""

    def __init__(self, folder: Path):
        self.killed = {"publisher": 0, "router": 0}
        self._folder = folder
        self._peers = f"tcp/127.0.0.1:{free_port()}"
        self._routed = f"tcp/127.0.0.1:{free_port()}"
        self._config = folder / "zenoh.json5"
        self._config.write_text(
            "{scouting: {multicast: {enabled: false}}, timestamping: {enabled: true}}"
        )
        self._router = self._start_router()
        self._listeners = {
            name: Listener(
                self._start("fault_witness.py", f"listener{number}", client, subprocess.PIPE)
            )
            for number, (name, client) in enumerate(LISTENERS.items())
        }
        self._publishers = {name: self._publish(name) for name in PUBLISHERS}
        self._random = random.Random(1)

    def close(self) -> None:
        """End all."""
        listeners = [listener.process for listener in self._listeners.values()]
        for process in (*listeners, *self._publishers.values(), self._router):
            process.kill()
            process.wait()

    def kill_publisher(self) -> None:
        """Kill one, and start it again."""
        name = self._random.choice(PUBLISHERS)
        self._publishers[name].kill()
        self._publishers[name].wait()
        self._publishers[name] = self._publish(name)
        self.killed["publisher"] += 1

    def kill_router(self) -> None:
        """Kill it, and start it again."""
        self._router.kill()
        self._router.wait()
        self._router = self._start_router()
        self.killed["router"] += 1

    def samples(self, start_s: float) -> dict[str, Sample]:
        """The last report of each listener."""
        reported = {name: listener.sample(start_s) for name, listener in self._listeners.items()}
        return {name: sample for name, sample in reported.items() if sample is not None}

    def _start_router(self) -> "subprocess.Popen[str]":
        command = [sys.executable, "-m", "tfbus", "router", "--config", str(self._config)]
        endpoints = ["--listen", self._routed, "--listen", self._peers]
        return subprocess.Popen([*command, *endpoints], stderr=subprocess.DEVNULL, text=True)

    def _publish(self, name: str) -> "subprocess.Popen[str]":
        return self._start("fault_publisher.py", name, False, subprocess.DEVNULL)

    def _start(self, program: str, name: str, client: bool, out: Any) -> "subprocess.Popen[str]":
        joins = {"TFBUS_CONFIG": str(self._config), "TFBUS_CONNECT": self._peers}
        if client:
            joins |= {"TFBUS_MODE": "client", "TFBUS_CONNECT": self._routed}
        return subprocess.Popen(
            [sys.executable, str(PROGRAMS / program), name],
            env={"PATH": "/usr/bin:/bin", **joins},
            stdout=out,
            stderr=subprocess.DEVNULL,
            text=True,
        )


def soak(minutes: float) -> tuple[dict[str, list[Sample]], dict[str, int]]:
    """What the listeners reported, and how many processes were killed."""
    reported: dict[str, list[Sample]] = {name: [] for name in LISTENERS}
    with TemporaryDirectory() as folder:
        world = Soak(Path(folder))
        start_s = time.monotonic()
        due = {"publisher": start_s + 20.0, "router": start_s + KILL_ROUTER_EVERY_S}
        try:
            while (now_s := time.monotonic()) < start_s + minutes * 60:
                if now_s >= due["publisher"]:
                    world.kill_publisher()
                    due["publisher"] = now_s + KILL_EVERY_S
                if now_s >= due["router"]:
                    world.kill_router()
                    due["router"] = now_s + KILL_ROUTER_EVERY_S
                for name, sample in world.samples(start_s).items():
                    reported[name].append(sample)
                time.sleep(SAMPLE_EVERY_S)
        finally:
            world.close()
    return reported, world.killed


def write(reported: dict[str, list[Sample]], killed: dict[str, int], minutes: float) -> None:
    """Write the plot, and print the table."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6))
    axes = figure.subplots(3, 1, sharex=True)
    for name, samples in reported.items():
        minutes_in = [sample.at_s / 60 for sample in samples]
        for one, field in zip(axes, ("resident_mb", "handles", "threads"), strict=True):
            one.plot(minutes_in, [getattr(s, field) for s in samples], label=name, linewidth=1)
    for one, text in zip(axes, ("memory (MB)", "open files", "Python's threads"), strict=True):
        one.set_ylabel(text)
        one.set_ylim(bottom=0)
        one.grid(visible=True, linewidth=0.4)
    axes[0].legend(loc="lower right", fontsize=8)
    axes[2].set_xlabel("minutes")
    figure.savefig(DOCS / "soak.svg", bbox_inches="tight")
    rows = []
    for name, samples in reported.items():
        early, late = samples[len(samples) // 10], samples[-1]
        rows.append(
            [
                name,
                *(f"{sample.resident_mb:.1f} MB" for sample in (early, late)),
                *(str(sample.handles) for sample in (early, late)),
                *(str(sample.threads) for sample in (early, late)),
            ]
        )
    headings = ["listener", "memory after the start", "at the end"]
    headings += [
        "open files after the start",
        "at the end",
        "threads after the start",
        "at the end",
    ]
    print(
        f"{minutes:.0f} minutes, {machine.describe()}\n"
        f"killed: {killed['publisher']} publishers, {killed['router']} routers\n"
        "After the start: after a tenth of the time, when every name has been seen.\n"
    )
    print(markdown_table(headings, rows, words=1))


def main() -> None:
    """Soak for as long as is asked for."""
    parser = argparse.ArgumentParser(prog="benchmarks.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="how long; 60")
    minutes = parser.parse_args().minutes
    write(*soak(minutes), minutes)


if __name__ == "__main__":
    main()
