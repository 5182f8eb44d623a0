# cython: boundscheck=False, wraparound=False
"""The kernel: the arithmetic of poses, their history on one edge, and paths of edges.

It is one module so that the C compiler can inline one part into the next: it runs millions of
times a second. The same source runs compiled, if there was a C compiler when it was installed, or
interpreted; `kernel.pxd` has the C types. Nothing here locks: the buffer holds its lock around
every call, but for the lookups that find it free (`Tree.fill`).

A pose is seven numbers x y z qx qy qz qw, a plain tuple (compiled: a struct), and takes points of
a child frame into its parent.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import MutableSequence, Sequence

from tfbus.base import lazy_numpy as np
from tfbus.geometry import packed
from tfbus.geometry.packed import POSE_SIZE, STAMP_SIZE
from tfbus.geometry.sampling import Held, Sampling

try:
    import cython
except ImportError:
    from tfbus.base import cython_stub as cython

Pose = tuple[float, float, float, float, float, float, float]

# The answers of `History` about a sample.
KEPT = 0
TOO_OLD = 1
REPEATED = 2
CONFLICT = 3
CROWDED = 4

# Latest stamps of static edges, and of edges without samples; no sample has such a stamp.
ALL_STATIC = 2**63 - 1
NO_DATA = -ALL_STATIC - 1

# The farthest a stamp may be from 1970, and the longest cache: differences fit 64 bits.
LONGEST_NS = 2**62

# tf2's tolerance (its "TF_DENORMALIZED_QUATERNION"): the squared norm is within 0.01 of one.
QUATERNION_TOLERANCE = 0.01
# The squared norm of a quaternion that was normalised before is as near to one.
UNIT_TO_THE_LAST_BIT = 9e-16

if cython.compiled:
    # `kernel.pxd` makes them numbers of C, which other modules could not import.
    globals().update(
        KEPT=KEPT,
        TOO_OLD=TOO_OLD,
        REPEATED=REPEATED,
        CONFLICT=CONFLICT,
        CROWDED=CROWDED,
        NO_DATA=NO_DATA,
        ALL_STATIC=ALL_STATIC,
        LONGEST_NS=LONGEST_NS,
        QUATERNION_TOLERANCE=QUATERNION_TOLERANCE,
        UNIT_TO_THE_LAST_BIT=UNIT_TO_THE_LAST_BIT,
    )


# Pose arithmetic

IDENTITY: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

# Below this distance of the cosine from one (rotations of 5 degrees between the samples) four
# terms of the series of slerp's weights are exact to 1e-14, and four times as fast.
_SERIES_BELOW = 1e-3
# Below this angle quotients of sines would lose digits.
_SMALL_ANGLE = 1e-3


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


def relative(a: Pose, b: Pose) -> Pose:
    """The motion from `a` to `b`, seen from `a`: the inverse of `a`, composed with `b`."""
    return compose(invert(a), b)


def normalised(a: Pose) -> Pose:
    """The pose with the norm of its quaternion corrected for rounding, by one Newton step."""
    x, y, z, qx, qy, qz, qw = a
    scale = 1.5 - 0.5 * (qx * qx + qy * qy + qz * qz + qw * qw)
    return x, y, z, qx * scale, qy * scale, qz * scale, qw * scale


def off_unit(pose: Pose) -> float:
    """How far the quaternion's squared norm is off one; NaN if a number is not finite."""
    x, y, z, qx, qy, qz, qw = pose
    total = x + y + z
    square = qx * qx + qy * qy + qz * qz + qw * qw
    # A number that is not finite, minus itself, is NaN.
    return (square - square) + (total - total) + (square - 1.0)


def unit(pose: Pose, error: float) -> Pose:
    """The pose with its quaternion normalised; `error` is from `off_unit`."""
    x, y, z, qx, qy, qz, qw = pose
    scale = 1.0 / math.sqrt(1.0 + error)
    return x, y, z, qx * scale, qy * scale, qz * scale, qw * scale


def lerp_slerp(a: Pose, b: Pose, ratio: float) -> Pose:
    """From `a` (ratio 0) to `b` (1) as tf2 does: translation on a straight line, rotation by slerp
    the short way round.
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


def sclerp(a: Pose, b: Pose, ratio: float) -> Pose:
    """Along the screw from `a` (ratio 0) to `b` (1), at constant speed, also beyond the two."""
    vx, vy, vz, wx, wy, wz = log_pose(relative(a, b))
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


# Edge history

# The answer of `locate` for a time that is not between samples.
OUTSIDE = -1.0

_FIRST_CAPACITY = 4
_NO_STAMPS = array("q")
_NO_POSES = array("d")


class Samples:
    """The data of one edge that a lookup reads; compiled, a struct of C.

    `stamps` and `poses` (seven numbers a sample) are rings of `capacity` slots: nothing moves when
    old samples expire at the head and new ones arrive at the tail. The sorted samples have the
    places [head, tail), and `slot` maps a place to its slot. `newest` is the last stamp, NO_DATA
    without one.

    A static edge has `static_pose` at all times, and `newest` is ALL_STATIC; its samples from
    before it became static are kept. `mixed` is whether the samples have several parents, or are
    interrupted.

    The cursor is at the time of the last lookup: `here` is the slot of the sample before it and
    `following` that of the one after it, and `before` and `after` are their stamps, between which
    there is no search. `pace` is about how many samples come in a nanosecond.
    """

    __slots__ = (
        "after",
        "before",
        "capacity",
        "following",
        "head",
        "here",
        "is_static",
        "mixed",
        "newest",
        "pace",
        "poses",
        "stamps",
        "static_pose",
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
    static_pose: Pose


def slot(samples: Samples, at: int) -> int:
    """The slot of a place."""
    return at if at < samples.capacity else at - samples.capacity


def locate(samples: Samples, stamp_ns: int) -> float:
    """Set the cursor to the last sample that is not later than a time; the ratio, 0 to 1, of the
    way to the next one, or OUTSIDE if there are no samples on both sides.
    """
    if samples.is_static:
        return 0.0
    before, after = samples.before, samples.after
    if stamp_ns < before or stamp_ns >= after:
        if stamp_ns >= samples.newest:
            if stamp_ns > samples.newest or samples.head == samples.tail:
                return OUTSIDE
            samples.here = slot(samples, samples.tail - 1)
            invalidate(samples)
            return 0.0
        if stamp_ns < samples.stamps[slot(samples, samples.head)]:
            return OUTSIDE
        set_cursor(samples, find(samples, stamp_ns))
        before, after = samples.before, samples.after
    elapsed, period = stamp_ns - before, after - before
    return elapsed / period


def locate_as(samples: Samples, other: Samples, ratio: float, stamp_ns: int) -> float:
    """As `locate`, for an edge that is not static; `ratio` is the answer for another edge at this
    time, and holds for this one if both have the same stamps around it.
    """
    if ratio >= 0.0:
        if stamp_ns < samples.before or stamp_ns >= samples.after:
            set_cursor_as(samples, other, stamp_ns)
        if (
            samples.before == other.before
            and samples.after == other.after
            and samples.after != NO_DATA
        ):
            return ratio
    return locate(samples, stamp_ns)


def set_cursor_as(samples: Samples, other: Samples, stamp_ns: int) -> None:
    """Set the cursor where another edge has it, if that is at a time, and both have these samples.

    The edges of one publisher mostly have the same stamps in the same slots.
    """
    if (
        stamp_ns >= other.before
        and stamp_ns < other.after
        and samples.head == other.head
        and samples.tail == other.tail
        and samples.capacity == other.capacity
        and samples.stamps[other.here] == other.before
        and samples.stamps[other.following] == other.after
    ):
        samples.here, samples.following = other.here, other.following
        samples.before, samples.after = other.before, other.after


def set_cursor(samples: Samples, at: int) -> None:
    """Set the cursor to a place that is not the last."""
    samples.here, samples.following = slot(samples, at), slot(samples, at + 1)
    samples.before = samples.stamps[samples.here]
    samples.after = samples.stamps[samples.following]


def invalidate(samples: Samples) -> None:
    """Invalidate the cursor: the next lookup searches."""
    samples.after = NO_DATA


def find(samples: Samples, stamp_ns: int) -> int:
    """The last sample that is not later than a time between the oldest and the newest.

    Samples mostly come evenly: guess the place from the pace, and search around it. The pace is
    computed again only after a wrong guess, as its division takes long.
    """
    stamps = samples.stamps
    low, high, start = samples.head, samples.tail - 1, 0
    last = samples.newest
    if high >= samples.capacity:
        # The ring wraps: search before the first slot, or from there on.
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
    """The pose at a ratio of the way from the cursor to the next sample."""
    if samples.is_static:
        return samples.static_pose
    if ratio == 0.0:
        return sample(samples, samples.here)
    return lerp_slerp(sample(samples, samples.here), sample(samples, samples.following), ratio)


def screw_at(samples: Samples, ratio: float) -> Pose:
    """As `pose_at`, along the screw; a ratio outside of 0 to 1 extrapolates."""
    if samples.is_static or ratio == 0.0:
        return pose_at(samples, ratio)
    return sclerp(sample(samples, samples.here), sample(samples, samples.following), ratio)


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
    """Store a sample that is newer than all others, and expire old ones.

    False, and nothing stored, if it is not newer, or if `History.insert` has more to do.
    """
    # The `newest` of a static edge is later than any stamp.
    if stamp_ns <= samples.newest or samples.mixed:
        return False
    if samples.tail - samples.head == samples.capacity:
        expire(samples, stamp_ns - cache_ns)
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
    """Append to each edge its row, from `start` on, up to the first that is not newer than the
    others of its edge or not valid (finite, norm one, within LONGEST_NS); the index of that row,
    or `count`.

    The rows are bytes from `stamps_at` and `poses_at` on, as in a message.
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
    """Add a sample if there is room, and expire old ones."""
    write(samples, slot(samples, samples.tail), stamp_ns, pose)
    samples.tail += 1
    samples.newest = stamp_ns
    if cython.compiled:
        # With many edges the next slot is no longer in the processor's near caches: without this,
        # half the time of an insert is the wait for it.
        packed.fetch_pose(samples.poses, 7 * slot(samples, samples.tail))
    expire(samples, stamp_ns - cache_ns)


def expire(samples: Samples, oldest_ns: int) -> None:
    """Remove the samples from before a time."""
    stamps = samples.stamps
    while samples.head < samples.tail and stamps[slot(samples, samples.head)] < oldest_ns:
        samples.head += 1
    if samples.before < oldest_ns:
        invalidate(samples)


def write(samples: Samples, place: int, stamp_ns: int, pose: Pose) -> None:
    """Write a sample into a slot."""
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
    """Move the samples from a place on by one; there is room behind the last."""
    for i in range(samples.tail, at, -1):
        place = slot(samples, i - 1)
        write(samples, slot(samples, i), samples.stamps[place], sample(samples, place))


class History:
    """A frame's pose in its parent over time: the edge above it.

    `parents` is None while all samples have the one `parent`. After a change of parent it is a
    list, the parent of each slot, until the samples up to `mixed_until` have expired. `children`
    counts the frames whose `parent` this is. `removed` is whether the tree no longer has it, though
    it may be the parent of earlier samples.

    `interruptions` has, by the stamp of the last sample before it, why nothing is known of the time
    until the next sample; None if there is none.

    `gone` is whether its publisher is gone, `ended` whether it is a static pose from a former epoch
    of its publisher, which the present one has not repeated so far. `crowded_out` counts samples
    that were dropped because there were too many.

    Reading takes two steps: `seek` sets the cursor to a time, `pose` reads there.

    Compiled, Python's collector does not know a frame that was never looked up: it would stop the
    process for 0.35 s when 200,000 new ones come. An object that it does not know is in no
    cycle: see `track`.
    """

    def __init__(self, name: str) -> None:
        if cython.compiled:
            tfbus_untrack(self)  # type: ignore[name-defined]  # noqa: F821  # C's own
        self.name = name
        self.parent: History | None = None
        self.samples: Samples
        if cython.compiled:
            self.samples = cython.address(self.own)  # type: ignore[attr-defined]  # a struct of C
        else:
            self.samples = Samples()
        self.samples.is_static = False
        self.samples.static_pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        self.static_stamp = 0
        self.authority = ""
        self.gone = False
        self.ended = False
        self.removed = False
        self.children = 0
        self.conflicts = 0
        self.refused = 0
        self.crowded_out = 0
        self.paths: dict[str, Path] = {}
        self.alarms: object = None
        # The cursor's ratio between two samples, and how far the time is outside of the samples.
        self.ratio = 0.0
        self.beyond = 0
        self.mixed_until = NO_DATA
        self.interruptions: dict[int, str] | None = None
        self.forget_samples()

    def track(self) -> None:
        """Let Python's collector know this frame and its ancestors: from now on it may be in a
        cycle, as it refers to more than its parent, or others that do refer to it.
        """
        if cython.compiled:
            history = self
            while history is not None and not tfbus_is_tracked(history):  # type: ignore[name-defined]  # noqa: F821
                tfbus_track(history)  # type: ignore[name-defined]  # noqa: F821
                history = history.parent  # type: ignore[assignment]

    # Reading

    @property
    def static(self) -> bool:
        """Whether the edge has one pose at all times."""
        return bool(self.samples.is_static)

    def seek(self, stamp_ns: int) -> bool:
        """Set the cursor to a time; False if there are no samples on both sides of it, or they
        were interrupted between these.
        """
        self.ratio = locate(self.samples, stamp_ns)
        if self.ratio > 0.0 and self.samples.mixed:
            if self._is_interrupted():
                self.ratio = OUTSIDE
            elif self._is_change():
                # Between two parents tf2 stays at the older sample.
                self.ratio = 0.0
        return self.ratio >= 0.0

    def seek_nearest(self, stamp_ns: int, tolerance_ns: int) -> bool:
        """Set the cursor to the nearest sample; False if it is not within the tolerance."""
        self.beyond = 0
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
        invalidate(samples)
        self.ratio = 0.0
        # Two stamps may be farther apart than 64 bits hold, and so may one and the tolerance. From
        # a sample, which is within LONGEST_NS, no tolerance up to that is out of reach.
        near = self._stamp(at)
        return near - tolerance_ns <= stamp_ns and stamp_ns <= near + tolerance_ns

    def seek_beyond(self, stamp_ns: int, extrapolation_ns: int, max_gap_ns: int) -> bool:
        """Set the cursor to a time at most `extrapolation_ns` outside of the samples; False also
        if the two samples that it is computed from are more than `max_gap_ns` apart.
        """
        self.beyond = 0
        if self.seek(stamp_ns):
            return not self._is_apart(stamp_ns, max_gap_ns)
        samples = self.samples
        if samples.tail - samples.head < 2:
            return False
        oldest = self._stamp(samples.head)
        # Compared in this way, no difference exceeds 64 bits.
        if stamp_ns > samples.newest:
            if stamp_ns - extrapolation_ns > samples.newest:
                return False
            at, beyond = samples.tail - 2, stamp_ns - samples.newest
        else:
            if stamp_ns >= oldest or stamp_ns + extrapolation_ns < oldest:
                return False
            at, beyond = samples.head, oldest - stamp_ns
        set_cursor(samples, at)
        if self._is_change() or self._is_interrupted() or self._is_apart(stamp_ns, max_gap_ns):
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
        """The parent at the cursor; None if it has been removed."""
        if self.samples.is_static or self.parents is None:
            return self.parent
        above = self.parents[self.samples.here]
        return None if above is None or above.removed else above

    def count(self) -> int:
        """How many samples are held; a static frame counts as one."""
        return 1 if self.samples.is_static else self.samples.tail - self.samples.head

    def stamps_from(self, start_ns: int, end_ns: int) -> list[int]:
        """The stamps from start to end, both included."""
        if self.samples.is_static:
            return []
        stamps = [self._stamp(at) for at in range(self.samples.head, self.samples.tail)]
        return [stamp for stamp in stamps if start_ns <= stamp <= end_ns]

    def stamp_span(self) -> tuple[int, int] | None:
        """Oldest and newest stamp; of a static frame its own stamp twice; None without a sample."""
        if self.samples.is_static:
            return self.static_stamp, self.static_stamp
        if self.samples.head == self.samples.tail:
            return None
        return self._stamp(self.samples.head), self.samples.newest

    def _stamp(self, at: int) -> int:
        """The stamp of the sample of a place."""
        return self.samples.stamps[slot(self.samples, at)]

    def _parent_of(self, at: int) -> "History | None":
        """The parent of the sample of a place; None if it has been removed."""
        above = self.parent if self.parents is None else self.parents[slot(self.samples, at)]
        return None if above is None or above.removed else above

    def _is_change(self) -> bool:
        """Whether the samples before and after the cursor have different parents."""
        if self.parents is None:
            return False
        return self.parents[self.samples.here] is not self.parents[self.samples.following]

    def _is_interrupted(self) -> bool:
        """Whether nothing is known of the time between the samples at the cursor."""
        return self.interruptions is not None and self.samples.before in self.interruptions

    def _is_apart(self, stamp_ns: int, max_gap_ns: int) -> bool:
        """Whether the samples at the cursor are more than this apart, and none is of this time."""
        samples = self.samples
        if samples.is_static or samples.after <= samples.before or stamp_ns == samples.before:
            return False
        return samples.after - samples.before > max_gap_ns

    def around(self, stamp_ns: int) -> tuple[int, int] | None:
        """The stamps of the two samples that a time is computed from: on both sides of it, or the
        first two or the last two; None if there is a sample of that time, or only one.
        """
        samples = self.samples
        if samples.is_static or samples.tail - samples.head < 2:
            return None
        if locate(samples, stamp_ns) == 0.0:
            return None
        if stamp_ns > samples.newest:
            set_cursor(samples, samples.tail - 2)
        elif stamp_ns < self._stamp(samples.head):
            set_cursor(samples, samples.head)
        return samples.before, samples.after

    def interruption(self, stamp_ns: int) -> str:
        """Why nothing is known of a time between two samples; "" if there is no reason."""
        if self.interruptions is None or locate(self.samples, stamp_ns) <= 0.0:
            return ""
        return self.interruptions.get(self.samples.before, "")

    def interrupted(self) -> tuple[int, int]:
        """How many interruptions there are between two samples, and how long they are, in ns."""
        count = length_ns = 0
        for stamp_ns in self.interruptions or ():
            if locate(self.samples, stamp_ns + 1) > 0.0 and self.samples.before == stamp_ns:
                count += 1
                length_ns += self.samples.after - stamp_ns
        return count, length_ns

    def held(self) -> Held:
        """All that it holds, as copies."""
        count = self.samples.tail - self.samples.head
        places = np.zeros(0, dtype=np.intp)
        if count:
            places = (self.samples.head + np.arange(count)) % self.samples.capacity
        return Held(
            parent=None if self.parent is None else self.parent.name,
            authority=self.authority,
            gone=self.gone,
            conflicts=self.conflicts,
            refused=self.refused,
            is_static=self.static,
            static_stamp_ns=self.static_stamp,
            static_pose=self.samples.static_pose,
            stamps_ns=np.asarray(self.stamps)[places] if count else np.zeros(0, dtype=np.int64),
            poses=np.asarray(self.poses).reshape(-1, 7)[places] if count else np.zeros((0, 7)),
            parents=None if self.parents is None else [_name_of(self.parents[i]) for i in places],
            mixed_until_ns=self.mixed_until,
            ended=self.ended,
            crowded_out=self.crowded_out,
            interruptions=dict(self.interruptions or {}),
        )

    # Writing

    def restore(self, held: Held, frames: "dict[str, History]") -> None:
        """Hold this, which was checked, and nothing else; `frames` has the parents."""
        self.set_parent(None if held.parent is None else frames[held.parent])
        self.authority, self.gone, self.ended = held.authority, held.gone, held.ended
        self.conflicts, self.refused = held.conflicts, held.refused
        self.crowded_out = held.crowded_out
        self.forget_samples()
        count = len(held.stamps_ns)
        if count:
            stamps, poses = array("q"), array("d")
            stamps.frombytes(held.stamps_ns.tobytes())
            poses.frombytes(held.poses.tobytes())
            self._set_columns(stamps, poses, count)
            self.samples.tail = count
        self.samples.is_static = held.is_static
        self.samples.static_pose = held.static_pose
        self.static_stamp = held.static_stamp_ns
        if held.parents is not None:
            self._set_parents(
                [None if parent is None else frames[parent] for parent in held.parents]
            )
            self.mixed_until = held.mixed_until_ns
        self._set_interruptions(held.interruptions)
        self._set_newest()

    def set_static(self, stamp_ns: int, pose: Pose, parent: "History") -> int:
        """Hold this pose at all times: KEPT, REPEATED or CONFLICT, as `insert`."""
        outcome = KEPT
        if self.samples.is_static and self.static_stamp == stamp_ns:
            outcome = REPEATED if self._is_static_at(pose, parent) else CONFLICT
        self.samples.is_static = True
        self.samples.newest = ALL_STATIC
        self.samples.static_pose = pose
        self.static_stamp = stamp_ns
        self.ended = False
        self._change_parent(parent)
        return outcome

    def interrupt(self, reason: str) -> None:
        """Leave the time from the newest sample to the next one without an answer."""
        newest = self._newest_sample()
        if newest != NO_DATA:
            self._set_interruptions({**(self.interruptions or {}), newest: reason})

    def _set_interruptions(self, interruptions: dict[int, str]) -> None:
        self.interruptions = interruptions or None
        self.samples.mixed = self.parents is not None or self.interruptions is not None

    def _forget_interruptions(self) -> None:
        """Remove interruptions before the oldest sample."""
        known = self.interruptions
        if known is not None and next(iter(known)) < self._stamp(self.samples.head):
            oldest = self._stamp(self.samples.head)
            self._set_interruptions({at: why for at, why in known.items() if at >= oldest})

    def append(self, stamp_ns: int, pose: Pose, cache_ns: int) -> bool:
        """Store a sample of the same parent that is newer than all others; False, and nothing
        stored, if it is not, or if `insert` has more to do.
        """
        return append(self.samples, stamp_ns, pose, cache_ns)

    def insert(
        self, stamp_ns: int, pose: Pose, parent: "History", cache_ns: int, max_samples: int
    ) -> int:
        """Store a sample: KEPT; TOO_OLD, and not stored; REPEATED, equal to the one of its stamp;
        CONFLICT, it replaced a different one of its stamp; or CROWDED, it took the place of the
        oldest, as there are `max_samples`.

        A static frame becomes dynamic, unless the sample is too old.
        """
        samples = self.samples
        if parent is self.parent and self.append(stamp_ns, pose, cache_ns):
            return KEPT
        if self.is_too_old(stamp_ns, cache_ns):
            self.refused += 1
            return TOO_OLD
        newest = self._newest_sample()
        if samples.is_static:
            self._unset_static()
        if stamp_ns <= newest:
            return self._insert_late(stamp_ns, pose, parent, max_samples)
        expire(samples, stamp_ns - cache_ns)
        is_crowded = self._make_room(max_samples)
        if parent is not self.parent:
            self._change_parent(parent)
        if self.parents is not None:
            if samples.head < samples.tail and self._stamp(samples.head) <= self.mixed_until:
                parent.track()
                self.parents[slot(samples, samples.tail)] = parent
            else:
                self._set_parents(None)
        push(samples, stamp_ns, pose, cache_ns)
        if self.interruptions is not None:
            self._forget_interruptions()
        return CROWDED if is_crowded else KEPT

    def is_too_old(self, stamp_ns: int, cache_ns: int) -> bool:
        """Whether a sample is older than the newest by more than the cache."""
        newest = self._newest_sample()
        return newest != NO_DATA and newest - stamp_ns > cache_ns

    def is_repeated_by(self, parent_frame: str, pose: Pose) -> bool:
        """Whether it is static, in this parent and with this pose."""
        if not self.samples.is_static or self.parent is None:
            return False
        return self.parent.name == parent_frame and self.samples.static_pose == pose

    def parent_after(self, stamp_ns: int, parent: "History", static: bool) -> "History":
        """The parent that this frame will have once a sample of this parent is stored."""
        if static or stamp_ns >= self._newest_sample():
            return parent
        above = self._parent_of(self.samples.tail - 1)
        return parent if above is None else above

    def set_parent(self, parent: "History | None") -> None:
        """Put it below another frame, or with None make it a root."""
        if self.parent is not None:
            self.parent.children -= 1
        self.parent = parent
        if parent is not None:
            parent.children += 1
            if cython.compiled and tfbus_is_tracked(self):  # type: ignore[name-defined]  # noqa: F821
                parent.track()

    def forget(self) -> None:
        """Remove the samples, the static pose and the parent."""
        self.samples.is_static = False
        self.ended = False
        self.forget_samples()
        self.set_parent(None)
        self.paths.clear()

    def forget_removed(self) -> None:
        """Remove the samples below a static pose if the parent of the newest has been removed: a
        frame that turns dynamic again gets the parent of its newest sample.
        """
        if self.samples.tail > self.samples.head and self._parent_of(self.samples.tail - 1) is None:
            self.forget_samples()

    def forget_samples(self) -> None:
        """Remove all samples; a static pose stays."""
        samples = self.samples
        samples.head = samples.tail = samples.here = samples.following = 0
        samples.before = NO_DATA
        samples.pace = 0.0
        invalidate(samples)
        self.interruptions = None
        self._set_parents(None)
        self._set_columns(_NO_STAMPS, _NO_POSES, 0)
        self._set_newest()

    def forget_after(self, stamp_ns: int) -> None:
        """Remove the samples later than a time; a static pose stays.

        All samples if the parent has changed: a former parent may be below this frame by now.
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
            invalidate(self.samples)
            self._set_newest()
            known = self.interruptions or {}
            self._set_interruptions({at: why for at, why in known.items() if at <= stamp_ns})

    def _insert_late(self, stamp_ns: int, pose: Pose, parent: "History", max_samples: int) -> int:
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
        if behind >= max_samples:
            # It would be the oldest of too many.
            self.crowded_out += 1
            return CROWDED
        is_crowded = self._make_room(max_samples)
        at = samples.tail - behind
        if parent is not self.parent:
            self._track_parents(stamp_ns)
        if self.parents is not None:
            for i in range(samples.tail, at, -1):
                self.parents[slot(samples, i)] = self.parents[slot(samples, i - 1)]
            parent.track()
            self.parents[slot(samples, at)] = parent
        shift(samples, at)
        write(samples, slot(samples, at), stamp_ns, pose)
        samples.tail += 1
        invalidate(samples)
        return CROWDED if is_crowded else KEPT

    def _replace(self, at: int, pose: Pose, parent: "History") -> int:
        known, place = self._parent_of(at), slot(self.samples, at)
        if known is parent and sample(self.samples, place) == pose:
            return REPEATED
        self.conflicts += 1
        if known is not parent:
            self._track_parents(self._stamp(at))
            if self.parents is not None:
                parent.track()
                self.parents[place] = parent
            if at == self.samples.tail - 1:
                self.set_parent(parent)
        write(self.samples, place, self._stamp(at), pose)
        return CONFLICT

    def _is_static_at(self, pose: Pose, parent: "History") -> bool:
        same = self.parent is parent and self.samples.static_pose == pose
        if not same:
            self.conflicts += 1
        return same

    def _unset_static(self) -> None:
        """Make the frame dynamic again."""
        self.samples.is_static = False
        self.ended = False
        self._set_newest()
        if self.samples.tail > self.samples.head:
            self.set_parent(self._parent_of(self.samples.tail - 1))

    def _newest_sample(self) -> int:
        """The stamp of the newest sample, even under a static pose; NO_DATA without one."""
        tail = self.samples.tail
        return self._stamp(tail - 1) if tail > self.samples.head else NO_DATA

    def _set_newest(self) -> None:
        self.samples.newest = ALL_STATIC if self.samples.is_static else self._newest_sample()

    def _change_parent(self, parent: "History") -> None:
        if parent is self.parent:
            return
        if self.samples.tail > self.samples.head:
            self._track_parents(self._newest_sample())
        self.set_parent(parent)

    def _track_parents(self, until_ns: int) -> None:
        """Keep the parent of each sample, as they may differ up to this time."""
        if self.parents is None:
            self._set_parents([self.parent] * self.samples.capacity)
        self.mixed_until = max(self.mixed_until, until_ns)

    def _set_parents(self, parents: "list[History | None] | None") -> None:
        self.parents = parents
        self.samples.mixed = parents is not None or self.interruptions is not None
        if parents is None:
            self.mixed_until = NO_DATA
            return
        self.track()
        for parent in parents:
            if parent is not None:
                parent.track()

    def _make_room(self, max_samples: int) -> bool:
        """Ensure a slot for one more sample, and a head below `capacity`; whether the oldest was
        dropped for that, as there are `max_samples`.

        Columns grow by a sixth when all slots are in use, and shrink when less than a quarter is.
        There is memory for twice as many, so that most growth copies nothing; unused memory is not
        touched, and takes no place.
        """
        samples = self.samples
        alive = samples.tail - samples.head
        is_crowded = alive >= max_samples
        if is_crowded:
            self.crowded_out += 1
            samples.head += 1
            alive -= 1
            invalidate(samples)
        more = min(alive + alive // 6 + _FIRST_CAPACITY, max_samples)
        if alive == samples.capacity:
            if samples.head == 0 and more <= len(self.stamps):
                if self.parents is not None:
                    self.parents += [self.parent] * (more - alive)
                samples.capacity = more
            else:
                self._move(more, 2 * more)
        elif samples.head >= samples.capacity and 4 * (alive + _FIRST_CAPACITY) < samples.capacity:
            self._move(more, more)
        elif samples.head >= samples.capacity:
            samples.head -= samples.capacity
            samples.tail -= samples.capacity
        return is_crowded

    def _move(self, capacity: int, room: int) -> None:
        """Copy the samples into columns of another capacity, which have memory for `room`."""
        samples = self.samples
        head, alive = slot(samples, samples.head), samples.tail - samples.head
        first = min(alive, samples.capacity - head)
        stamps: MutableSequence[int] = packed.unset(_NO_STAMPS, room)
        poses: MutableSequence[float] = packed.unset(_NO_POSES, 7 * room)
        stamps[0:first] = self.stamps[head : head + first]
        stamps[first:alive] = self.stamps[0 : alive - first]
        poses[0 : 7 * first] = self.poses[7 * head : 7 * (head + first)]
        poses[7 * first : 7 * alive] = self.poses[0 : 7 * (alive - first)]
        parents = self.parents
        if parents is not None:
            kept = [*parents[head : head + first], *parents[: alive - first]]
            parents = [*kept, *[self.parent] * (capacity - alive)]
        # The collector may run a finalizer that looks up, while memory is taken; not from here on.
        self.parents = parents
        self._set_columns(stamps, poses, capacity)
        samples.head, samples.tail = 0, alive
        invalidate(samples)

    def _set_columns(
        self, stamps: MutableSequence[int], poses: MutableSequence[float], capacity: int
    ) -> None:
        self.stamps = stamps
        self.poses = poses
        self.samples.capacity = capacity
        if cython.compiled:
            tfbus_untrack_view(self.stamps)  # type: ignore[name-defined]  # noqa: F821  # C's own
            tfbus_untrack_poses(self.poses)  # type: ignore[name-defined]  # noqa: F821
            self.samples.stamps = cython.address(self.stamps[0])
            self.samples.poses = cython.address(self.poses[0])
        else:
            self.samples.stamps = stamps
            self.samples.poses = poses


def _name_of(parent: "History | None") -> str | None:
    """The name of a sample's parent; None if it has been removed."""
    return None if parent is None or parent.removed else parent.name


# Path


class Path:
    """From a source frame up to the common ancestor, and from there down to a target frame.

    `up` are the edges from the source to the ancestor, the source's own first; `down` the edges
    from the target to the ancestor. `topology` is the tree's when the path was found. `pose`
    is the result of `follow`.
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
        # The very texts that it was looked up by last.
        self.asked_target = self.asked_source = ""
        self.pose = IDENTITY
        # The order of reading: from the common ancestor down to the target in the first `turn`
        # steps, then down to the source. So a product need not wait for all of the one before it.
        self.turn = len(down)
        self.count = len(up) + len(down)
        self._set_steps([*down[::-1], *up[::-1]])
        for history in (target, source, *up, *down):
            history.track()

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
        """Whether an edge has had several parents, so that the path depends on the time, or was
        interrupted.
        """
        mixed = False
        for i in range(self.count):
            mixed |= self.steps[i].mixed
        return mixed

    def latest(self) -> int:
        """The newest stamp for which all edges have data; ALL_STATIC; or NO_DATA if an edge is
        empty. From a frame to itself it is the frame's own newest, as in tf2.
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
        """Set `pose` to the source's in the target at a time; False if an edge has no data
        then, or if the path may have been another one, as an edge has had several parents, or
        none, as one was interrupted.
        """
        if cython.compiled:
            return self.follow_into(cython.address(self.pose), stamp_ns, screw)
        else:  # Cython leaves out this branch, which it could not compile
            poses = [self.pose]
            has_data = self.follow_into(poses, stamp_ns, screw)
            self.pose = poses[0]
            return has_data

    def follow_into(self, poses: MutableSequence[Pose], stamp_ns: int, screw: bool) -> bool:
        """As `follow`, to set the first of `poses`; compiled, an address of C."""
        pose: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        ratio = OUTSIDE
        if self.count > 0:
            former = self.steps[0]
        for i in range(self.count):
            samples = self.steps[i]
            if not samples.is_static:
                ratio = locate_as(samples, former, ratio, stamp_ns)
                if ratio < 0.0:
                    return False
                former = samples
            if samples.mixed:
                return False
            step = screw_at(samples, ratio) if screw else pose_at(samples, ratio)
            if i == 0:
                pose = step
                continue
            if i == self.turn:
                pose = invert(pose)
            pose = compose(pose, step)
        if self.turn == self.count:
            pose = invert(pose)
        poses[0] = normalised(pose)
        return True

    def follow_as(self, stamp_ns: int, sampling: Sampling) -> int:
        """As `follow`, with a sampling: the farthest extrapolation of an edge in nanoseconds; -1
        if `follow` would answer False.
        """
        beyond = 0
        for history in self.edges():
            if history.parents is not None or not seek_as(history, stamp_ns, sampling):
                return -1
            beyond = max(beyond, history.beyond)
        screw = sampling.interpolation == "screw"
        up = [history.pose(screw) for history in self.up]
        self.pose = normalised(chained(up, [history.pose(screw) for history in self.down]))
        return beyond


def chained(up: list[Pose], down: list[Pose]) -> Pose:
    """The pose of a source in a target, by the edges from the source up to the common ancestor, and
    from the target up to it: composed in the order of `Path.follow`, the same to the last bit.
    """
    pose: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    for step in reversed(down):
        pose = compose(pose, step)
    if down:
        pose = invert(pose)
    for step in reversed(up):
        pose = compose(pose, step)
    return pose


def seek_as(history: History, stamp_ns: int, sampling: Sampling) -> bool:
    """Set the cursor of an edge to a time, as the sampling allows; False if it does not."""
    if sampling.interpolation == "nearest":
        return history.seek_nearest(stamp_ns, round(sampling.tolerance_s * 1e9))
    max_gap_ns = ALL_STATIC if sampling.max_gap_s is None else round(sampling.max_gap_s * 1e9)
    return history.seek_beyond(stamp_ns, round(sampling.extrapolation_s * 1e9), max_gap_ns)
