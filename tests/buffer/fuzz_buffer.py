"""Random changes of a compiled buffer and lookups in it, with the most extreme numbers there are.

python fuzz_buffer.py [--seconds 15] [--seed N]

Anything but an answer or an error of transforms ends it. tests/sanitized.py runs it in a build in
which an undefined operation of C does, too.
"""

import argparse
import asyncio
import logging
import random
import sys
import time
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from tfbus import (
    Buffer,
    Sampling,
    Transform,
    TransformBatch,
    TransformException,
    TransformStamped,
)
from tfbus.buffer.buffer import COMPILED
from tfbus.buffer.formats import as_text, as_yaml

FARTHEST_NS = 2**62 - 1
SECOND_NS = 10**9
CACHES_S = (0.0, 1e-9, 1.0, 10.0, 1e9, float("inf"))
SAMPLINGS = (
    Sampling(),
    Sampling("screw"),
    Sampling("nearest"),
    Sampling("nearest", tolerance_s=1e6),
    Sampling(extrapolation_s=1e6),
    Sampling("screw", extrapolation_s=1e-9),
)


class Fuzz:
    """One buffer, and everything that can be done to it."""

    def __init__(self, chance: random.Random) -> None:
        self.chance = chance
        self.buffer = Buffer(chance.choice(CACHES_S), max_samples=chance.choice((None, 1, 2, 50)))
        self.names = [f"f{i}" for i in range(chance.choice((2, 4, 30)))]
        self.stamp_ns = chance.choice((0, -FARTHEST_NS, FARTHEST_NS - 50 * SECOND_NS, 10**18))
        self.steps: list[Callable[[], object]] = [
            *[self.insert] * 8,
            *[self.insert_many] * 4,
            *[self.look_up] * 8,
            *[self.look_up_many] * 3,
            self.look_around,
            self.change,
        ]

    def step(self) -> None:
        """One of the steps."""
        with suppress(TransformException):
            self.chance.choice(self.steps)()

    def frame(self) -> str:
        return self.chance.choice(self.names)

    def stamp(self) -> int:
        """Mostly near the last; some as far away as stamps can be."""
        if self.chance.random() < 0.02:
            return self.chance.choice((0, FARTHEST_NS, -FARTHEST_NS, 1, -1))
        self.stamp_ns += round(self.chance.uniform(-1, 2) * SECOND_NS * self.chance.random() ** 4)
        self.stamp_ns = min(max(self.stamp_ns, -FARTHEST_NS), FARTHEST_NS)
        return self.stamp_ns

    def asked(self) -> int:
        """A stamp to ask for, which may be none that a sample can have."""
        if self.chance.random() < 0.05:
            return self.chance.choice((2**63 - 1, -(2**63), 2**62, -(2**62)))
        return self.stamp()

    def pose(self) -> tuple[float, ...]:
        """A pose, now and then with numbers that are none."""
        size = self.chance.choice((1.0, 1.0, 1e-300, 1e300))
        xyz = [self.chance.uniform(-size, size) for _ in range(3)]
        quat = np.array([self.chance.gauss(0, 1) for _ in range(4)])
        return (*xyz, *(quat / np.linalg.norm(quat)).tolist())

    def insert(self) -> None:
        pose = self.pose()
        transform = TransformStamped(
            self.stamp(), self.frame(), self.frame(), Transform(pose[:3], pose[3:])
        )
        static = self.chance.random() < 0.1
        self.buffer.set_transform(transform, static=static, authority=self.authority())

    def insert_many(self) -> None:
        count = self.chance.choice((1, 4, 20))
        edges = [[self.chance.randrange(len(self.names)) for _ in "pc"] for _ in range(count)]
        if self.chance.random() < 0.7:
            # The same edges again and again, as publishers have them.
            edges = [[0, 1 + i % (len(self.names) - 1)] for i in range(count)]
        poses = np.array([self.pose() for _ in range(count)])
        if self.chance.random() < 0.05:
            poses[0, self.chance.randrange(7)] = self.chance.choice((np.nan, np.inf, 3.0))
        batch = TransformBatch(
            tuple(self.names),
            np.array(edges, np.uint32),
            np.array([self.stamp() for _ in range(count)], np.int64),
            poses,
        )
        static = self.chance.random() < 0.05
        self.buffer.set_transforms(batch, static=static, authority=self.authority())

    def authority(self) -> str:
        return self.chance.choice(("", "one", "two"))

    def look_up(self) -> None:
        stamp = None if self.chance.random() < 0.2 else self.asked()
        target, source = self.frame(), self.frame()
        sampling = self.chance.choice(SAMPLINGS)
        if self.chance.random() < 0.9:
            self.buffer.lookup_transform(target, source, stamp, sampling=sampling)
        else:
            self.buffer.lookup_transform_full(
                target, stamp, source, self.asked(), self.frame(), sampling=sampling
            )

    def look_up_many(self) -> None:
        count = self.chance.choice((0, 1, 70, 1500))
        stamps = np.array([self.asked() for _ in range(count)], np.int64)
        self.buffer.lookup_known_transforms(
            self.frame(), self.frame(), stamps, sampling=self.chance.choice(SAMPLINGS)
        )

    def look_around(self) -> None:
        as_yaml(self.buffer.all_frames())
        as_text(self.buffer.all_frames())
        self.buffer.frame(self.frame())
        self.buffer.path(self.frame(), self.frame())
        self.buffer.can_transform(self.frame(), self.frame(), max_age_s=1.0, living=True)
        self.buffer.lookup_twist(self.frame(), self.frame())
        waits = self.buffer.wait_for_transform(self.frame(), self.frame(), timeout_s=0.0)
        asyncio.run(waits)

    def change(self) -> None:
        buffer, authority = self.buffer, self.authority()
        some = self.chance.sample(self.names, 2)
        changes: list[Callable[[], object]] = [
            lambda: buffer.remove(some[0]),
            lambda: buffer.remove_sent(some, authority),
            lambda: buffer.forget(authority),
            lambda: buffer.mark_gone(self.names, self.chance.random() < 0.5, authority),
            lambda: buffer.clear(after_ns=self.stamp()),
            buffer.clear,
        ]
        self.chance.choice(changes)()


def main() -> None:
    """Until the time is up."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--seed", type=int, default=random.randrange(10**6))
    asked = parser.parse_args()
    logging.disable()
    end = time.monotonic() + asked.seconds
    seed, steps = asked.seed, 0
    while time.monotonic() < end:
        print(f"\rseed {seed}", end="", flush=True)
        fuzz = Fuzz(random.Random(seed))
        for _ in range(2_000):
            fuzz.step()
        seed, steps = seed + 1, steps + 2_000
    kind = "compiled" if COMPILED else "interpreted"
    print(f"\r{steps:,} steps on buffers ({kind}), seeds {asked.seed} to {seed - 1}: no fault")


if __name__ == "__main__":
    sys.exit(main())
