"""The process of one peer: does what it is asked, and answers how long it took.

    python -m benchmarks.worker PEER

A line in is a measure and its argument, such as "lookup 3"; a line out is nanoseconds per
operation (or bytes, for "memory"), or "unavailable: " and why. A peer is a module of
benchmarks.peers with a function for each measure that it can do; the function answers a `Loop`.
"""

import ctypes
import gc
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from resource import getpagesize
from time import perf_counter_ns
from types import ModuleType
from typing import Any


@dataclass(frozen=True)
class Loop:
    """Operations to be timed: `run` does one for each item; `items` makes them, untimed."""

    items: Callable[[int], Any]
    run: Callable[[Any], None]
    # How many go in one call, where that is part of the measure; there are as many calls as fill
    # the time.
    count: int = 1
    fill_ns: int = 50_000_000
    # At most this many items are made at a time.
    at_once: int = sys.maxsize
    # What goes on meanwhile.
    beside: Callable[[], AbstractContextManager[Any]] = field(default=nullcontext)

    def time_ns(self, count: int) -> float:
        """How long one of `count` operations takes."""
        gc.collect()
        gc.disable()
        done = elapsed = 0
        while done < count:
            some = min(self.at_once, count - done)
            elapsed += self._elapsed_ns(self.items(some))
            done += some
        gc.enable()
        return elapsed / count

    def _elapsed_ns(self, items: Any) -> int:
        with self.beside():
            start = perf_counter_ns()
            self.run(items)
            return perf_counter_ns() - start


class Worker:
    """Keeps what it has made and warmed up for a measure until it gets the order to forget."""

    def __init__(self, peer: ModuleType):
        self._peer = peer
        self._warm: dict[str, tuple[Loop, int]] = {}

    def answer(self, request: str) -> str:
        """The answer to one line."""
        name, _, argument = request.partition(" ")
        if name == "forget":
            self._warm.clear()
            return "0"
        if name == "repeat":
            return self._repeat(*argument.split())
        if name == "count":
            return self._count(*argument.split())
        if not hasattr(self._peer, name):
            return "unavailable: not measured"
        if name == "version":
            return str(self._peer.version())
        if name == "memory":
            return str(self._bytes_per_sample(int(argument)))
        if request not in self._warm:
            loop = getattr(self._peer, name)(int(argument))
            self._warm[request] = (loop, _enough(loop))
        loop, count = self._warm[request]
        return str(loop.time_ns(count))

    def _repeat(self, measure: str, argument: str, count: str, of: str) -> str:
        """For a profiler: make the items of `of` operations, and run `count` of them."""
        loop = getattr(self._peer, measure)(int(argument))
        loop.items(int(of) - int(count))
        loop.run(loop.items(int(count)))
        return "0"

    def _count(self, measure: str, argument: str, count: str, rounds: str, library: str) -> str:
        """For callgrind: let it count `count` operations in each of some rounds, by the library of
        gate.py, after one that warms up.
        """
        callgrind = ctypes.CDLL(library)
        # Threads take turns as they wait for each other, not by the time, which valgrind stretches.
        sys.setswitchinterval(1000.0)
        loop = getattr(self._peer, measure)(int(argument))
        loop.run(loop.items(int(count)))
        for _ in range(int(rounds)):
            items = loop.items(int(count))
            gc.collect()
            gc.disable()
            callgrind.begin()
            loop.run(items)
            callgrind.end(f"{measure} {argument}".encode())
            gc.enable()
        return "0"

    def _bytes_per_sample(self, samples: int) -> float:
        before = _resident_bytes()
        kept = self._peer.memory(samples)
        grown = _resident_bytes() - before
        del kept
        return grown / samples


def _enough(loop: Loop) -> int:
    """How many operations fill the time; finding out warms up."""
    count = max(100, loop.count)
    while loop.time_ns(count) * count < loop.fill_ns:
        count *= 2
    return count


def _resident_bytes() -> int:
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * getpagesize()


def main() -> None:
    """Answer line by line, until the input ends."""
    try:
        worker = Worker(import_module(f"benchmarks.peers.{sys.argv[1]}"))
    except ImportError as error:
        print(f"unavailable: {error}", flush=True)
        return
    for line in sys.stdin:
        try:
            print(worker.answer(line.strip()), flush=True)
        except Exception as error:  # whatever a peer raises is what the table is to say
            print(f"unavailable: {type(error).__name__}: {error}".splitlines()[0], flush=True)


if __name__ == "__main__":
    main()
