"""Random trees, their transforms in time, and questions about them. Not a test itself.

Everything comes from one `random.Random`, so that a seed is a case. The subjects of the list of
deliberate differences are left out here (tests/test_tf2_differences.py has it): names with a
leading slash, stamp 0, quaternions that are not unit, a child that changes between static and
dynamic.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from math import cos, sin
from random import Random

from tests.tf2.steps import (
    CanTransform,
    Clear,
    Frames,
    Insert,
    LatestCommonTime,
    Lookup,
    LookupFull,
    Pose,
    Step,
)

MS = 1_000_000
CACHE_NS = 10_000 * MS


def random_case(rng: Random, lookups: int) -> list[Step]:
    """A few runs of inserts, each followed by its share of the lookups."""
    scene = _random_scene(rng)
    runs = _runs(rng, scene.arrivals(rng))
    steps: list[Step] = []
    for run in runs:
        if steps and rng.random() < 0.05:
            steps.append(Clear())
        steps += _with_repeats(rng, run)
        inserts = [step for step in steps if isinstance(step, Insert)]
        known = sorted({name for insert in inserts for name in (insert.parent, insert.child)})
        steps += _questions(rng, scene, known, max(1, lookups // len(runs)))
    return steps


@dataclass
class _Scene:
    """A tree: the frame at index i hangs under `parents[i]`, an index below i, or is a root."""

    names: list[str]
    parents: list[int | None]
    static: list[bool]
    start_ns: int
    span_ns: int
    reparenting: float
    # Under any frame, be it one below: what would close a loop is refused.
    under_any: bool
    shuffle_ns: int
    stamps: list[int] = field(default_factory=list)

    def arrivals(self, rng: Random) -> list[Insert]:
        """All transforms in the order in which they arrive."""
        ticks = sorted(_stamps(rng, self.start_ns, self.span_ns))
        inserts = [
            insert
            for child in range(len(self.names))
            if self.parents[child] is not None
            for insert in self._samples(rng, child, ticks)
        ]
        self.stamps = [insert.stamp_ns for insert in inserts]
        return sorted(inserts, key=lambda insert: insert.stamp_ns + rng.uniform(0, self.shuffle_ns))

    def _samples(self, rng: Random, child: int, ticks: list[int]) -> Iterator[Insert]:
        if self.static[child]:
            stamps = [rng.randrange(self.start_ns, self.start_ns + self.span_ns)]
            stamps *= rng.choice((1, 1, 1, 2))
        elif rng.random() < 0.3:
            stamps = rng.sample(ticks, rng.randint(1, len(ticks)))
        else:
            stamps = _stamps(rng, self.start_ns, self.span_ns)
        motion = _Motion(rng)
        parent = self.parents[child]
        assert parent is not None
        for stamp_ns in sorted(stamps):
            if rng.random() < self.reparenting:
                parent = self._new_parent(rng, child)
            yield Insert(
                self.names[parent],
                self.names[child],
                stamp_ns,
                motion.at(stamp_ns - self.start_ns),
                self.static[child],
            )

    def _new_parent(self, rng: Random, child: int) -> int:
        if self.under_any:
            return rng.choice([other for other in range(len(self.names)) if other != child])
        return rng.randrange(child)


class _Motion:
    """Where one child is, at a time: on a smooth way, still, or anywhere."""

    def __init__(self, rng: Random):
        self._rng = rng
        self._kind = rng.choice(("smooth", "smooth", "still", "anywhere"))
        self._start = _random_pose(rng)
        self._speed = rng.uniform(0.2, 2.0)

    def at(self, elapsed_ns: int) -> Pose:
        if self._kind == "still":
            return self._start
        if self._kind == "anywhere":
            return _random_pose(self._rng)
        x, y, z, *_ = self._start
        angle = self._speed * elapsed_ns / 1e9
        axis = (0.6, 0.0, 0.8)
        quaternion = [sin(angle / 2) * a for a in axis]
        return (x + cos(angle), y + sin(angle), z + angle / 10, *quaternion, cos(angle / 2))


def _random_scene(rng: Random) -> _Scene:
    parents = rng.choice((_chain, _star, _deep, _tree, _forest))(rng)
    static_share = rng.choice((0.0, 0.3, 0.8, 1.0))
    start_ns = rng.choice((1, 250_000, 1_700_000_000_123)) * MS + rng.randrange(MS)
    span_ns = rng.choice((100, 2_000, 9_000, 30_000)) * MS
    return _Scene(
        names=[f"f{i}" for i in range(len(parents))],
        parents=parents,
        static=[rng.random() < static_share for _ in parents],
        start_ns=start_ns,
        span_ns=span_ns,
        reparenting=rng.choice((0.0, 0.0, 0.02, 0.2)),
        under_any=rng.random() < 0.2,
        shuffle_ns=rng.choice((0, 0, span_ns // 20, span_ns // 2, span_ns)),
    )


def _chain(rng: Random) -> list[int | None]:
    return [None, *range(rng.randint(1, 12))]


def _star(rng: Random) -> list[int | None]:
    return [None, *([0] * rng.randint(2, 12))]


def _deep(rng: Random) -> list[int | None]:
    return [None, *(max(0, i - rng.choice((0, 0, 0, 3))) for i in range(rng.randint(20, 60)))]


def _tree(rng: Random) -> list[int | None]:
    return [None, *(rng.randint(0, i) for i in range(rng.randint(2, 25)))]


def _forest(rng: Random) -> list[int | None]:
    others = range(1, rng.randint(4, 25))
    return [None, 0, *(rng.choice((None, rng.randint(0, i), i)) for i in others)]


def _stamps(rng: Random, start_ns: int, span_ns: int) -> list[int]:
    """Regular, with jitter, irregular with gaps, or only one; each stamp once."""
    count = rng.choice((1, 2, 5, 20))
    period_ns = max(1, span_ns // count)
    jitter_ns = rng.choice((0, period_ns // 5))
    if rng.random() < 0.2:
        return sorted({start_ns + rng.randrange(span_ns) for _ in range(count)})
    return [start_ns + i * period_ns + (rng.randint(0, jitter_ns)) for i in range(count)]


def _random_pose(rng: Random) -> Pose:
    """Anywhere within ten metres; of rotations none, half turns and any."""
    xyz = [rng.uniform(-10, 10) for _ in range(3)]
    rotation = rng.random()
    if rotation < 0.1:
        quaternion = [0.0, 0.0, 0.0, 1.0]
    elif rotation < 0.15:
        quaternion = rng.sample([1.0, 0.0, 0.0, 0.0], 4)
    else:
        numbers = [rng.gauss(0, 1) for _ in range(4)]
        norm = sum(number * number for number in numbers) ** 0.5
        quaternion = [number / norm for number in numbers]
    return (*xyz, *quaternion)


def _runs(rng: Random, inserts: list[Insert]) -> list[list[Insert]]:
    cuts = sorted(rng.randint(1, len(inserts)) for _ in range(rng.randint(0, 3)))
    bounds = [0, *cuts, len(inserts)]
    return [inserts[start:end] for start, end in pairwise(bounds) if start < end]


def _with_repeats(rng: Random, run: list[Insert]) -> list[Insert]:
    """Some arrive again in the same run, with the stamp that they had and another pose."""
    if rng.random() < 0.6:
        return run
    repeated = list(run)
    for insert in rng.sample(run, len(run) // 10):
        pose = rng.choice((insert.pose, _random_pose(rng)))
        again = Insert(insert.parent, insert.child, insert.stamp_ns, pose, insert.static)
        repeated.insert(rng.randint(repeated.index(insert) + 1, len(repeated)), again)
    return repeated


def _questions(rng: Random, scene: _Scene, known: list[str], count: int) -> Iterator[Step]:
    yield Frames()
    for _ in range(count):
        target, source = (_name(rng, scene, known) for _ in range(2))
        if target == source and target not in known:
            continue  # tf2 sees any frame, even an unknown one, from itself
        kind = rng.random()
        if kind < 0.5:
            yield Lookup(target, source, _moment(rng, scene))
        elif kind < 0.75:
            fixed = _name(rng, scene, known)
            yield LookupFull(target, _moment(rng, scene), source, _moment(rng, scene), fixed)
        elif kind < 0.9:
            yield CanTransform(target, source, _moment(rng, scene))
        else:
            yield LatestCommonTime(target, source)


def _name(rng: Random, scene: _Scene, known: list[str]) -> str:
    """Nearly always a known frame; at times one that has not arrived, never will, or cannot be."""
    if rng.random() < 0.97:
        return rng.choice(known)
    return rng.choice((*scene.names, "nowhere", "", "/f0"))


def _moment(rng: Random, scene: _Scene) -> int | None:
    """The latest; a stamp of some sample, or just beside it; any time, also a little outside."""
    kind = rng.random()
    if kind < 0.15:
        return None
    if kind < 0.4:
        return max(1, rng.choice(scene.stamps) + rng.choice((-1, 0, 0, 0, 1)))
    slack_ns = rng.choice((0, 0, scene.span_ns // 5))
    return max(1, scene.start_ns + rng.randint(-slack_ns, scene.span_ns + slack_ns))
