# cython: boundscheck=False, wraparound=False
"""The kernel: the arithmetic of poses, their history on one edge, and paths of edges.

It is one module because what runs in it millions of times a second is to be compiled as one.
The same source runs compiled, where there was a C compiler when it was installed, and else
interpreted; `kernel.pxd` beside it says the C types. Nothing here locks: the buffer holds its
lock around every call.

A pose is seven numbers x y z qx qy qz qw, a plain tuple (compiled: a struct), and takes points of
a child frame into its parent.
"""

import math
from array import array
from collections.abc import MutableSequence, Sequence

from tfbus.core import packed
from tfbus.core.outcome import (
    ALL_STATIC,
    CONFLICT,
    KEPT,
    LONGEST_NS,
    NO_DATA,
    QUATERNION_TOLERANCE,
    REPEATED,
    TOO_OLD,
    UNIT_TO_THE_LAST_BIT,
)
from tfbus.core.packed import POSE_SIZE, STAMP_SIZE
from tfbus.core.sampling import Sampling

try:
    import cython
except ImportError:
    from tfbus.core import cython_stub as cython

Pose = tuple[float, float, float, float, float, float, float]

IDENTITY: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

# Below this distance of the cosine from one (rotations of 5 degrees between the samples) four
# terms of the series of slerp's weights are exact to 1e-14, and four times as fast.
_SERIES_BELOW = 1e-3
# Where sines of so small an angle would lose digits.
_SMALL_ANGLE = 1e-3

# Said by `locate` of a time that is not between samples.
OUTSIDE = -1.0

_FIRST_CAPACITY = 4
_NO_STAMPS = array("q")
_NO_POSES = array("d")


def compose(a: Pose, b: Pose) -> Pose:
    """First `b`, then `a`."""
    ax, ay, az, apx, apy, apz, apw = a
    bx, by, bz, bpx, bpy, bpz, bpw = b
    # v + 2w (q x v) + 2 q x (q x v)
    tx = 2.0 * (apy * bz - apz * by)
    ty = 2.0 * (apz * bx - apx * bz)
    tz = 2.0 * (apx * by - apy * bx)
    return (
        ax + bx + apw * tx + apy * tz - apz * ty,
        ay + by + apw * ty + apz * tx - apx * tz,
        az + bz + apw * tz + apx * ty - apy * tx,
        apw * bpx + apx * bpw + apy * bpz - apz * bpy,
        apw * bpy - apx * bpz + apy * bpw + apz * bpx,
        apw * bpz + apx * bpy - apy * bpx + apz * bpw,
        apw * bpw - apx * bpx - apy * bpy - apz * bpz,
    )


def invert(a: Pose) -> Pose:
    """The motion back."""
    x, y, z, qx, qy, qz, qw = a
    tx = 2.0 * (qy * z - qz * y)
    ty = 2.0 * (qz * x - qx * z)
    tz = 2.0 * (qx * y - qy * x)
    return (
        qw * tx - x - qy * tz + qz * ty,
        qw * ty - y - qz * tx + qx * tz,
        qw * tz - z - qx * ty + qy * tx,
        -qx,
        -qy,
        -qz,
        qw,
    )


def between(a: Pose, b: Pose) -> Pose:
    """The motion from `a` to `b`, seen from `a`: the inverse of `a`, composed with `b`."""
    return compose(invert(a), b)


def normalised(a: Pose) -> Pose:
    """With the rounding of many products taken off the norm again, by one step of Newton's."""
    x, y, z, qx, qy, qz, qw = a
    scale = 1.5 - 0.5 * (qx * qx + qy * qy + qz * qz + qw * qw)
    return x, y, z, qx * scale, qy * scale, qz * scale, qw * scale


def off_unit(pose: Pose) -> float:
    """How far the quaternion's squared norm is off one; not a number where one of the seven is
    not finite.
    """
    x, y, z, qx, qy, qz, qw = pose
    total = x + y + z
    square = qx * qx + qy * qy + qz * qz + qw * qw
    # Of numbers that are not finite a difference to themselves is not 0.
    return (square - square) + (total - total) + (square - 1.0)


def unit(pose: Pose, error: float) -> Pose:
    """The pose with its quaternion normalised, whose squared norm is so far off one."""
    x, y, z, qx, qy, qz, qw = pose
    scale = 1.0 / math.sqrt(1.0 + error)
    return x, y, z, qx * scale, qy * scale, qz * scale, qw * scale


def blend(a: Pose, b: Pose, ratio: float) -> Pose:
    """From `a` (ratio 0) to `b` (1) as tf2 does: translation straight, rotation by slerp the
    short way round.
    """
    ax, ay, az, apx, apy, apz, apw = a
    bx, by, bz, bpx, bpy, bpz, bpw = b
    cosine = apx * bpx + apy * bpy + apz * bpz + apw * bpw
    sign = 1.0
    if cosine < 0.0:
        cosine, sign = -cosine, -1.0
    rest = 1.0 - ratio
    short = 1.0 - cosine
    if short < _SERIES_BELOW:
        u = rest * _weight(short, rest * rest)
        v = ratio * _weight(short, ratio * ratio)
    else:
        angle = math.acos(cosine)
        scale = 1.0 / math.sin(angle)
        u = math.sin(rest * angle) * scale
        v = math.sin(ratio * angle) * scale
    v *= sign
    return (
        rest * ax + ratio * bx,
        rest * ay + ratio * by,
        rest * az + ratio * bz,
        u * apx + v * bpx,
        u * apy + v * bpy,
        u * apz + v * bpz,
        u * apw + v * bpw,
    )


def _weight(short: float, square: float) -> float:
    """sin(t angle) / (t sin(angle)) as a series in `short`, 1 - cos(angle); `square` is t * t.

    Eberly, A Fast and Accurate Algorithm for Computing SLERP, 2011; his (i*i - t*t) / (i (2i + 1)).
    """
    third = 1.0 + short * (9.0 - square) * (1.0 / 21.0)
    second = 1.0 + short * (4.0 - square) * (1.0 / 10.0) * third
    return 1.0 + short * (1.0 - square) * (1.0 / 3.0) * second


def blend_screw(a: Pose, b: Pose, ratio: float) -> Pose:
    """Along the screw from `a` (ratio 0) to `b` (1), at even speed; beyond 1 it goes on so."""
    vx, vy, vz, wx, wy, wz = log_pose(between(a, b))
    step = exp_twist(vx * ratio, vy * ratio, vz * ratio, wx * ratio, wy * ratio, wz * ratio)
    return normalised(compose(a, step))


def exp_twist(vx: float, vy: float, vz: float, wx: float, wy: float, wz: float) -> Pose:
    """The motion that a constant twist makes in unit time: a screw.

    Linear velocity v, then angular velocity w, as seen in the moving frame. Formulas: Barfoot,
    State Estimation for Robotics, 7.1.
    """
    square = wx * wx + wy * wy + wz * wz
    angle = math.sqrt(square)
    if angle < _SMALL_ANGLE:
        a = 0.5 - square / 24.0
        b = 1.0 / 6.0 - square / 120.0
        s = 0.5 - square / 48.0
    else:
        s = math.sin(0.5 * angle) / angle
        a = 2.0 * s * s
        b = (angle - math.sin(angle)) / (square * angle)
    ax = wy * vz - wz * vy
    ay = wz * vx - wx * vz
    az = wx * vy - wy * vx
    return (
        vx + a * ax + b * (wy * az - wz * ay),
        vy + a * ay + b * (wz * ax - wx * az),
        vz + a * az + b * (wx * ay - wy * ax),
        wx * s,
        wy * s,
        wz * s,
        math.cos(0.5 * angle),
    )


def log_pose(p: Pose) -> tuple[float, float, float, float, float, float]:
    """The twist that makes this motion in unit time, linear then angular; undoes `exp_twist`.

    The angle is at most half a turn.
    """
    x, y, z, qx, qy, qz, qw = p
    if qw < 0.0:
        qx, qy, qz, qw = -qx, -qy, -qz, -qw
    sine = math.sqrt(qx * qx + qy * qy + qz * qz)
    half = math.atan2(sine, qw)
    if half < _SMALL_ANGLE:
        s = 2.0 + half * half / 3.0
        c = 1.0 / 12.0 + half * half / 180.0
    else:
        s = 2.0 * half / sine
        c = (1.0 - half * qw / sine) / (4.0 * half * half)
    wx, wy, wz = qx * s, qy * s, qz * s
    ax = wy * z - wz * y
    ay = wz * x - wx * z
    az = wx * y - wy * x
    return (
        x - 0.5 * ax + c * (wy * az - wz * ay),
        y - 0.5 * ay + c * (wz * ax - wx * az),
        z - 0.5 * az + c * (wx * ay - wy * ax),
        wx,
        wy,
        wz,
    )


class Samples:
    """What a lookup reads of one edge; where the kernel is compiled, it is a struct of C.

    `stamps` and `poses` (seven numbers a sample) are rings of `capacity` slots: nothing moves where
    old samples leave at the head and new ones come at the tail. The sorted samples have the places
    [head, tail), and `slot` says where a place is. `newest` is the last stamp, NO_DATA without one.

    A static edge has the pose `fixed` at all times, and `newest` is ALL_STATIC; samples of when it
    was not are kept. `mixed` is whether the samples have several parents.

    The cursor is where the time that was asked last is found: `here` is the slot of the sample
    before it and `following` that of the one after it, and `before` and `after` are their stamps,
    between which there is no search. `pace` is about how many samples come in a nanosecond.
    """

    __slots__ = (
        "after",
        "before",
        "capacity",
        "fixed",
        "following",
        "head",
        "here",
        "is_static",
        "mixed",
        "newest",
        "pace",
        "poses",
        "stamps",
        "tail",
    )

    stamps: MutableSequence[int]
    poses: MutableSequence[float]
    head: int
    tail: int
    capacity: int
    here: int
    following: int
    before: int
    after: int
    newest: int
    pace: float
    is_static: bool
    mixed: bool
    fixed: Pose


def slot(samples: Samples, at: int) -> int:
    """Where in the columns the sample of a place is."""
    return at if at < samples.capacity else at - samples.capacity


def locate(samples: Samples, stamp_ns: int) -> float:
    """Put the cursor on the last sample that is not later than a time; how far on from there
    towards the next one it is, from 0 to 1, or OUTSIDE where samples are not on both sides of it.
    """
    if samples.is_static:
        return 0.0
    before, after = samples.before, samples.after
    if stamp_ns < before or stamp_ns >= after:
        if stamp_ns >= samples.newest:
            if stamp_ns > samples.newest or samples.head == samples.tail:
                return OUTSIDE
            samples.here = slot(samples, samples.tail - 1)
            leave(samples)
            return 0.0
        if stamp_ns < samples.stamps[slot(samples, samples.head)]:
            return OUTSIDE
        put(samples, find(samples, stamp_ns))
        before, after = samples.before, samples.after
    elapsed, period = stamp_ns - before, after - before
    return elapsed / period


def put(samples: Samples, at: int) -> None:
    """Put the cursor on a place that is not the last."""
    samples.here, samples.following = slot(samples, at), slot(samples, at + 1)
    samples.before = samples.stamps[samples.here]
    samples.after = samples.stamps[samples.following]


def leave(samples: Samples) -> None:
    """Let the next time be searched for."""
    samples.after = NO_DATA


def find(samples: Samples, stamp_ns: int) -> int:
    """The last sample that is not later than a time between the oldest and the newest.

    Samples mostly come evenly: guess where it would be then, and search around there. The pace to
    guess by is taken anew where the guess was wrong, so that else nobody waits for a division.
    """
    stamps = samples.stamps
    low, high, start = samples.head, samples.tail - 1, 0
    last = samples.newest
    if high >= samples.capacity:
        # It goes on at the first slot: before that, or from there on.
        if low < samples.capacity and stamp_ns < stamps[0]:
            high, last = samples.capacity, stamps[0]
        else:
            start = samples.capacity
            low = max(low, start)
    way = (last - stamp_ns) * samples.pace
    guess = low
    if way < high - low:
        guess = high - 1 - (cython.cast(cython.Py_ssize_t, way) if cython.compiled else int(way))
    tried = guess
    step = 1
    if stamps[guess - start] <= stamp_ns:
        low = guess
        while low + step < high and stamps[low + step - start] <= stamp_ns:
            low += step
            step += step
        if low + step < high:
            high = low + step
    else:
        high = guess
        while high - step > low and stamps[high - step - start] > stamp_ns:
            high -= step
            step += step
        if high - step > low:
            low = high - step
    while high - low > 1:
        middle = (low + high) >> 1
        if stamps[middle - start] <= stamp_ns:
            low = middle
        else:
            high = middle
    if low != tried:
        way = samples.newest - stamps[slot(samples, samples.head)]
        samples.pace = (samples.tail - samples.head - 1) / way
    return low


def pose_at(samples: Samples, ratio: float) -> Pose:
    """The pose at the cursor, and so far on towards the next sample."""
    if samples.is_static:
        return samples.fixed
    if ratio == 0.0:
        return sample(samples, samples.here)
    return blend(sample(samples, samples.here), sample(samples, samples.following), ratio)


def screw_at(samples: Samples, ratio: float) -> Pose:
    """As `pose_at`, along the screw; a ratio outside of 0 to 1 goes on beyond the two samples."""
    if samples.is_static or ratio == 0.0:
        return pose_at(samples, ratio)
    return blend_screw(sample(samples, samples.here), sample(samples, samples.following), ratio)


def sample(samples: Samples, place: int) -> Pose:
    """The pose in one slot."""
    poses = samples.poses
    k = 7 * place
    return (
        poses[k],
        poses[k + 1],
        poses[k + 2],
        poses[k + 3],
        poses[k + 4],
        poses[k + 5],
        poses[k + 6],
    )


def append(samples: Samples, stamp_ns: int, pose: Pose, cache_ns: int) -> bool:
    """Take a sample that is newer than all others, and let go of those that are too old then.

    False where it is not newer, or where there is more to do.
    """
    # The stamp of a static edge is newer than all.
    if stamp_ns <= samples.newest or samples.mixed:
        return False
    if samples.tail - samples.head == samples.capacity:
        drop(samples, stamp_ns - cache_ns)
    if samples.tail - samples.head == samples.capacity or samples.head >= samples.capacity:
        return False
    push(samples, stamp_ns, pose, cache_ns)
    return True


def append_rows(
    edges: Sequence[Samples],
    stamps: bytes,
    stamps_at: int,
    poses: bytes,
    poses_at: int,
    start: int,
    count: int,
    cache_ns: int,
) -> int:
    """Append to each edge its row, from `start` on, as long as each is newer than the others of its
    edge and can be taken (finite, of norm one, within LONGEST_NS): the row at which it is not so,
    or the count of all.

    The rows are bytes from `stamps_at` and `poses_at` on, as a message has them.
    """
    for at in range(start, count):
        stamp_ns = packed.stamp_at(stamps, stamps_at + STAMP_SIZE * at)
        pose: Pose = packed.pose_at(poses, poses_at + POSE_SIZE * at)
        error = off_unit(pose)
        if not (error > -QUATERNION_TOLERANCE and error < QUATERNION_TOLERANCE):
            return at
        if not (stamp_ns > -LONGEST_NS and stamp_ns < LONGEST_NS):
            return at
        if error > UNIT_TO_THE_LAST_BIT or error < -UNIT_TO_THE_LAST_BIT:
            pose = unit(pose, error)
        if not append(edges[at], stamp_ns, pose, cache_ns):
            return at
    return count


def push(samples: Samples, stamp_ns: int, pose: Pose, cache_ns: int) -> None:
    """Add a sample where there is room, and let go of those that are too old then."""
    write(samples, slot(samples, samples.tail), stamp_ns, pose)
    samples.tail += 1
    samples.newest = stamp_ns
    if cython.compiled:
        # Many edges take turns, so that the next slot has long left the processor's near caches:
        # without this, half the time of an insert is the wait for it.
        packed.fetch_pose(samples.poses, 7 * slot(samples, samples.tail))
    drop(samples, stamp_ns - cache_ns)


def drop(samples: Samples, oldest_ns: int) -> None:
    """Let go of the samples of before a time."""
    stamps = samples.stamps
    while samples.head < samples.tail and stamps[slot(samples, samples.head)] < oldest_ns:
        samples.head += 1
    if samples.before < oldest_ns:
        leave(samples)


def write(samples: Samples, place: int, stamp_ns: int, pose: Pose) -> None:
    """Overwrite what is in one slot."""
    x, y, z, qx, qy, qz, qw = pose
    samples.stamps[place] = stamp_ns
    poses = samples.poses
    k = 7 * place
    poses[k] = x
    poses[k + 1] = y
    poses[k + 2] = z
    poses[k + 3] = qx
    poses[k + 4] = qy
    poses[k + 5] = qz
    poses[k + 6] = qw


def shift(samples: Samples, at: int) -> None:
    """Move the samples from a place on to the next ones, as there is room behind the last."""
    for i in range(samples.tail, at, -1):
        place = slot(samples, i - 1)
        write(samples, slot(samples, i), samples.stamps[place], sample(samples, place))


class History:
    """A frame's place in its parent over time: the edge above it.

    `samples` is what there is to read. `parents` is None while all samples have the one
    `parent`; so that history survives a change of parent, it is then a list of each slot's, until
    the samples up to `mixed_until` have left.

    Reading is two steps: `seek` puts the cursor on a time, `pose` reads there.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.parent: History | None = None
        self.samples: Samples
        if cython.compiled:
            self.samples = cython.address(self.own)  # type: ignore[attr-defined]  # a struct of C
        else:
            self.samples = Samples()
        self.samples.is_static = False
        self.samples.fixed = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        self.fixed_stamp = 0
        self.authority = ""
        self.gone = False
        self.conflicts = 0
        self.refused = 0
        self.paths: dict[str, Path] = {}
        self.alarms: object = None
        # Where the cursor is between two samples, and how far beyond the samples the time is.
        self.ratio = 0.0
        self.beyond = 0
        self.mixed_until = NO_DATA
        self.forget_samples()

    # Reading

    @property
    def static(self) -> bool:
        """Whether it has one pose at all times."""
        return bool(self.samples.is_static)

    def seek(self, stamp_ns: int) -> bool:
        """Put the cursor on a time; False where there is no sample on both sides of it."""
        self.ratio = locate(self.samples, stamp_ns)
        if self.ratio > 0.0 and self._is_change():
            # Between two parents tf2 stays at the older sample.
            self.ratio = 0.0
        return self.ratio >= 0.0

    def seek_nearest(self, stamp_ns: int, tolerance_ns: int) -> bool:
        """Put the cursor on the nearest sample; False where it is not within the tolerance."""
        samples = self.samples
        if samples.is_static:
            return True
        if samples.head == samples.tail:
            return False
        if stamp_ns <= self._stamp(samples.head):
            at = samples.head
        elif stamp_ns >= samples.newest:
            at = samples.tail - 1
        else:
            at = find(samples, stamp_ns)
            if stamp_ns - self._stamp(at) > self._stamp(at + 1) - stamp_ns:
                at += 1
        samples.here = slot(samples, at)
        leave(samples)
        self.ratio = 0.0
        near = self._stamp(at)
        return stamp_ns - tolerance_ns <= near and near <= stamp_ns + tolerance_ns

    def seek_beyond(self, stamp_ns: int, extrapolation_ns: int) -> bool:
        """Put the cursor on a time up to so far outside of the samples."""
        self.beyond = 0
        if self.seek(stamp_ns):
            return True
        samples = self.samples
        if samples.tail - samples.head < 2:
            return False
        oldest = self._stamp(samples.head)
        # So compared that no difference leaves 64 bits.
        if stamp_ns > samples.newest:
            if stamp_ns - extrapolation_ns > samples.newest:
                return False
            at, beyond = samples.tail - 2, stamp_ns - samples.newest
        else:
            if stamp_ns + extrapolation_ns < oldest:
                return False
            at, beyond = samples.head, oldest - stamp_ns
        put(samples, at)
        if self._is_change():
            return False
        self.beyond = beyond
        elapsed, period = stamp_ns - samples.before, samples.after - samples.before
        self.ratio = elapsed / period
        return True

    def pose(self, screw: bool) -> Pose:
        """The pose in the parent at the cursor."""
        if screw or self.ratio < 0.0 or self.ratio > 1.0:
            return screw_at(self.samples, self.ratio)
        return pose_at(self.samples, self.ratio)

    def parent_here(self) -> "History | None":
        """The parent at the cursor."""
        if self.samples.is_static or self.parents is None:
            return self.parent
        return self.parents[self.samples.here]

    def count(self) -> int:
        """How many samples are held; a static frame has one that holds at all times."""
        return 1 if self.samples.is_static else self.samples.tail - self.samples.head

    def stamps_from(self, start_ns: int, end_ns: int) -> list[int]:
        """The stamps from start to end, both included."""
        if self.samples.is_static:
            return []
        stamps = [self._stamp(at) for at in range(self.samples.head, self.samples.tail)]
        return [stamp for stamp in stamps if start_ns <= stamp <= end_ns]

    def stamp_span(self) -> tuple[int, int] | None:
        """Oldest and newest stamp; of a static frame its own; None without a sample."""
        if self.samples.is_static:
            return self.fixed_stamp, self.fixed_stamp
        if self.samples.head == self.samples.tail:
            return None
        return self._stamp(self.samples.head), self.samples.newest

    def _stamp(self, at: int) -> int:
        """The stamp of the sample of a place."""
        return self.samples.stamps[slot(self.samples, at)]

    def _parent_of(self, at: int) -> "History | None":
        """The parent of the sample of a place."""
        return self.parent if self.parents is None else self.parents[slot(self.samples, at)]

    def _is_change(self) -> bool:
        """Whether the samples before and after the cursor have different parents."""
        if self.parents is None:
            return False
        return self.parents[self.samples.here] is not self.parents[self.samples.following]

    # Writing

    def fix(self, stamp_ns: int, pose: Pose, parent: "History") -> int:
        """Hold this pose at all times."""
        outcome = KEPT
        if self.samples.is_static and self.fixed_stamp == stamp_ns:
            outcome = REPEATED if self._is_fixed_at(pose, parent) else CONFLICT
        self.samples.is_static = True
        self.samples.newest = ALL_STATIC
        self.samples.fixed = pose
        self.fixed_stamp = stamp_ns
        self._change_parent(parent)
        return outcome

    def append(self, stamp_ns: int, pose: Pose, cache_ns: int) -> bool:
        """Take a sample of the same parent that is newer than all others; False where it is not,
        or where there is more to do, which `insert` does.
        """
        return append(self.samples, stamp_ns, pose, cache_ns)

    def insert(self, stamp_ns: int, pose: Pose, parent: "History", cache_ns: int) -> int:
        """Take a sample: KEPT; TOO_OLD, and not kept; REPEATED, one that is known already; or
        CONFLICT, which replaces a different one of the same stamp.

        A static frame is one no longer, but for a sample that is too old.
        """
        samples = self.samples
        if parent is self.parent and self.append(stamp_ns, pose, cache_ns):
            return KEPT
        newest = self._newest_sample()
        if newest != NO_DATA and newest - stamp_ns > cache_ns:
            self.refused += 1
            return TOO_OLD
        if samples.is_static:
            self._unfix()
        if stamp_ns <= newest:
            return self._insert_late(stamp_ns, pose, parent)
        drop(samples, stamp_ns - cache_ns)
        self._make_room()
        if parent is not self.parent:
            self._change_parent(parent)
        if self.parents is not None:
            if samples.head < samples.tail and self._stamp(samples.head) <= self.mixed_until:
                self.parents[slot(samples, samples.tail)] = parent
            else:
                self._set_parents(None)
        push(samples, stamp_ns, pose, cache_ns)
        return KEPT

    def parent_after(self, stamp_ns: int, parent: "History", static: bool) -> "History | None":
        """The parent that this frame will have once a sample of this parent is in."""
        if static or stamp_ns >= self._newest_sample():
            return parent
        return self._parent_of(self.samples.tail - 1)

    def forget(self) -> None:
        """Drop all that is known, the parent too."""
        self.samples.is_static = False
        self.forget_samples()
        self.parent = None
        self.paths.clear()

    def forget_samples(self) -> None:
        """Drop all samples; a static pose stays."""
        samples = self.samples
        samples.head = samples.tail = samples.here = samples.following = 0
        samples.before = NO_DATA
        samples.pace = 0.0
        leave(samples)
        self._set_parents(None)
        self._set_columns(_NO_STAMPS, _NO_POSES, 0)
        self._set_newest()

    def forget_after(self, stamp_ns: int) -> None:
        """Drop the samples later than a time; a static pose stays.

        All of them where the parent has changed: a former parent might hang below this frame by
        now.
        """
        tail = self.samples.tail
        while tail > self.samples.head and self._stamp(tail - 1) > stamp_ns:
            tail -= 1
        if tail == self.samples.tail:
            return
        if tail == self.samples.head or self.parents is not None:
            self.forget_samples()
        else:
            self.samples.tail = tail
            leave(self.samples)
            self._set_newest()

    def _insert_late(self, stamp_ns: int, pose: Pose, parent: "History") -> int:
        samples = self.samples
        if stamp_ns == samples.newest:
            at = samples.tail - 1
        elif stamp_ns >= self._stamp(samples.head):
            at = find(samples, stamp_ns)
        else:
            at = samples.head - 1
        if at >= samples.head and self._stamp(at) == stamp_ns:
            return self._replace(at, pose, parent)
        behind = samples.tail - at - 1
        self._make_room()
        at = samples.tail - behind
        if parent is not self.parent:
            self._mix(stamp_ns)
        if self.parents is not None:
            for i in range(samples.tail, at, -1):
                self.parents[slot(samples, i)] = self.parents[slot(samples, i - 1)]
            self.parents[slot(samples, at)] = parent
        shift(samples, at)
        write(samples, slot(samples, at), stamp_ns, pose)
        samples.tail += 1
        leave(samples)
        return KEPT

    def _replace(self, at: int, pose: Pose, parent: "History") -> int:
        known, place = self._parent_of(at), slot(self.samples, at)
        if known is parent and sample(self.samples, place) == pose:
            return REPEATED
        self.conflicts += 1
        if known is not parent:
            self._mix(self._stamp(at))
            if self.parents is not None:
                self.parents[place] = parent
            if at == self.samples.tail - 1:
                self.parent = parent
        write(self.samples, place, self._stamp(at), pose)
        return CONFLICT

    def _is_fixed_at(self, pose: Pose, parent: "History") -> bool:
        same = self.parent is parent and self.samples.fixed == pose
        if not same:
            self.conflicts += 1
        return same

    def _unfix(self) -> None:
        """Hold the static pose no longer."""
        self.samples.is_static = False
        self._set_newest()
        self.parent = self._parent_of(self.samples.tail - 1)

    def _newest_sample(self) -> int:
        """The stamp of the newest sample, whatever static pose hides it; NO_DATA without one."""
        tail = self.samples.tail
        return self._stamp(tail - 1) if tail > self.samples.head else NO_DATA

    def _set_newest(self) -> None:
        self.samples.newest = ALL_STATIC if self.samples.is_static else self._newest_sample()

    def _change_parent(self, parent: "History") -> None:
        if parent is not self.parent and self.samples.tail > self.samples.head:
            self._mix(self._newest_sample())
        self.parent = parent

    def _mix(self, until_ns: int) -> None:
        """From now on note the parent of each sample: until this time they may be different."""
        if self.parents is None:
            self._set_parents([self.parent] * self.samples.capacity)
        self.mixed_until = max(self.mixed_until, until_ns)

    def _set_parents(self, parents: "list[History | None] | None") -> None:
        self.parents = parents
        self.samples.mixed = parents is not None
        if parents is None:
            self.mixed_until = NO_DATA

    def _make_room(self) -> None:
        """See to it that there is a slot for one more sample, and that the head is at a slot.

        Columns get larger by a sixth where all of their slots are alive, and smaller where it is
        less than a quarter.
        """
        samples = self.samples
        alive = samples.tail - samples.head
        if alive == samples.capacity or (
            samples.head >= samples.capacity and 4 * (alive + _FIRST_CAPACITY) < samples.capacity
        ):
            self._move(alive + alive // 6 + _FIRST_CAPACITY)
        elif samples.head >= samples.capacity:
            samples.head -= samples.capacity
            samples.tail -= samples.capacity

    def _move(self, capacity: int) -> None:
        """To columns of so many slots."""
        samples = self.samples
        head, alive = slot(samples, samples.head), samples.tail - samples.head
        first = min(alive, samples.capacity - head)
        stamps, poses, parents = self.stamps, self.poses, self.parents
        self._set_columns(
            array("q", bytes(8 * capacity)), array("d", bytes(56 * capacity)), capacity
        )
        self.stamps[0:first] = stamps[head : head + first]
        self.stamps[first:alive] = stamps[0 : alive - first]
        self.poses[0 : 7 * first] = poses[7 * head : 7 * (head + first)]
        self.poses[7 * first : 7 * alive] = poses[0 : 7 * (alive - first)]
        if parents is not None:
            kept = [*parents[head : head + first], *parents[: alive - first]]
            self.parents = [*kept, *[self.parent] * (capacity - alive)]
        samples.head, samples.tail = 0, alive
        leave(samples)

    def _set_columns(
        self, stamps: MutableSequence[int], poses: MutableSequence[float], capacity: int
    ) -> None:
        self.stamps = stamps
        self.poses = poses
        self.samples.capacity = capacity
        if cython.compiled:
            self.samples.stamps = cython.address(self.stamps[0])
            self.samples.poses = cython.address(self.poses[0])
        else:
            self.samples.stamps = stamps
            self.samples.poses = poses


class Path:
    """From a source frame up to the common ancestor, and from there down to a target frame.

    `up` are the histories whose poses lead up from the source, the source's own first; `down`
    those that lead up from the target. `topology` is the state of the tree that the path was
    found in. `pose` is what `follow` has found.
    """

    def __init__(
        self,
        target: History,
        source: History,
        up: list[History],
        down: list[History],
        topology: int,
    ) -> None:
        self.target = target
        self.source = source
        self.up = up
        self.down = down
        self.topology = topology
        # The texts that it was asked for by last.
        self.asked_target = self.asked_source = ""
        self.pose = IDENTITY
        # What is read, from the common ancestor down to the target in the first `turn` steps, then
        # down to the source: so a product need not wait for all of the one before it.
        self.turn = len(down)
        self.count = len(up) + len(down)
        self._set_steps([*down[::-1], *up[::-1]])

    def _set_steps(self, histories: list[History]) -> None:
        if cython.compiled:
            self.addresses = array("Q", bytes(8 * len(histories)))
            for i in range(len(histories)):
                history = histories[i]
                self.addresses[i] = cython.cast(cython.size_t, history.samples)
            self.steps = cython.cast("samples_t **", cython.address(self.addresses[0]))
        else:
            self.steps = [history.samples for history in histories]

    def edges(self) -> list[History]:
        """The histories of all edges, from the source to the target."""
        return self.up + self.down[::-1]

    def names(self) -> list[str]:
        """The frames from the source to the target, both included."""
        up = [history.name for history in self.up]
        down = [history.name for history in self.down[::-1]]
        # The common ancestor is the parent of the last on either side.
        top = self.up[len(up) - 1].parent if self.up else self.source
        return [*up, top.name if top is not None else "", *down]

    def is_mixed(self) -> bool:
        """Whether an edge has had several parents, so that the way depends on the time."""
        mixed = False
        for i in range(self.count):
            mixed |= self.steps[i].mixed
        return mixed

    def latest(self) -> int:
        """The newest stamp that all edges have come to; ALL_STATIC; or NO_DATA where an edge is
        empty. Of a frame from itself its own newest, as tf2 has it.
        """
        if self.count == 0:
            newest = self.source.samples.newest
            return ALL_STATIC if newest == NO_DATA else newest
        latest = ALL_STATIC
        for i in range(self.count):
            newest = self.steps[i].newest
            if newest < latest:
                latest = newest
        return latest

    def follow(self, stamp_ns: int, screw: bool) -> bool:
        """Find the pose of the source in the target at a time; False where one edge does not
        reach it, or where the way at that time may have been another one, because an edge has
        had several parents.
        """
        pose: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        for i in range(self.count):
            samples = self.steps[i]
            ratio = locate(samples, stamp_ns)
            if ratio < 0.0 or samples.mixed:
                return False
            step = screw_at(samples, ratio) if screw else pose_at(samples, ratio)
            if i == self.turn:
                pose = invert(pose)
            pose = compose(pose, step)
        if self.turn == self.count:
            pose = invert(pose)
        self.pose = normalised(pose)
        return True

    def follow_as(self, stamp_ns: int, sampling: Sampling) -> int:
        """As `follow`, but as the sampling allows: how far the farthest edge had to go beyond its
        samples; -1 where `follow` would be False.
        """
        beyond = 0
        for history in self.edges():
            if history.parents is not None or not seek_as(history, stamp_ns, sampling):
                return -1
            beyond = max(beyond, history.beyond)
        screw = sampling.interpolation == "screw"
        back = invert(_climb(self.down, screw))
        self.pose = normalised(compose(back, _climb(self.up, screw)))
        return beyond


def _climb(histories: list[History], screw: bool) -> Pose:
    """The pose of the first frame in the parent of the last, at the cursors."""
    pose: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    for history in histories:
        pose = compose(history.pose(screw), pose)
    return pose


def seek_as(history: History, stamp_ns: int, sampling: Sampling) -> bool:
    """Put the cursor of an edge on a time, as the sampling allows."""
    if sampling.interpolation == "nearest":
        return history.seek_nearest(stamp_ns, round(sampling.tolerance_s * 1e9))
    return history.seek_beyond(stamp_ns, round(sampling.extrapolation_s * 1e9))
