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

from tfbus.outcome import ALL_STATIC, CONFLICT, KEPT, NO_DATA, REPEATED, TOO_OLD
from tfbus.sampling import Sampling

Pose = tuple[float, float, float, float, float, float, float]

IDENTITY: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

# Below this distance of the cosine from one (rotations of 5 degrees between the samples) four
# terms of the series of slerp's weights are exact to 1e-14, and four times as fast.
_SERIES_BELOW = 1e-3
# Where sines of so small an angle would lose digits.
_SMALL_ANGLE = 1e-3

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


class History:
    """A frame's place in its parent over time.

    `stamps` and `poses` (seven numbers a sample) are sorted columns, of which [head, tail) is
    alive: old samples leave at the head, new ones come at the tail, and now and then what is
    alive moves down to the start. `parents` is None while all samples have the one `parent`; so
    that history survives a change of parent, it is then a list of each sample's parent.

    A static frame has the pose `fixed` at all times; samples of when it was not are kept.

    Reading is two steps: `seek` puts the cursor on a time, `pose` reads there. The cursor stays,
    and is where the next search begins.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.parent: History | None = None
        self.static = False
        self.fixed: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        self.fixed_stamp = 0
        self.stamps = _NO_STAMPS
        self.poses = _NO_POSES
        self.parents: list[History | None] | None = None
        self.capacity = 0
        self.head = 0
        self.tail = 0
        # The cursor: the sample before the time, and how far on towards the next one.
        self.at = 0
        self.ratio = 0.0
        self.beyond = 0
        self.authority = ""
        self.gone = False
        self.conflicts = 0
        self.refused = 0
        self.paths: dict[str, Path] = {}
        self.alarms: object = None

    # Reading

    def seek(self, stamp_ns: int) -> bool:
        """Put the cursor on a time; False where there is no sample on both sides of it."""
        if self.static:
            return True
        head, last, at = self.head, self.tail - 1, self.at
        if head <= at < last and self.stamps[at] <= stamp_ns and stamp_ns < self.stamps[at + 1]:
            before = self.stamps[at]
        else:
            if last < head or stamp_ns < self.stamps[head] or stamp_ns > self.stamps[last]:
                return False
            at = self._find(stamp_ns)
            self.at = at
            before = self.stamps[at]
        if before == stamp_ns or (
            self.parents is not None and self.parents[at] is not self.parents[at + 1]
        ):
            # Between two parents tf2 stays at the older sample.
            self.ratio = 0.0
        else:
            elapsed = stamp_ns - before
            self.ratio = elapsed / (self.stamps[at + 1] - before)
        return True

    def seek_nearest(self, stamp_ns: int, tolerance_ns: int) -> bool:
        """Put the cursor on the nearest sample; False where it is not within the tolerance."""
        if self.static:
            return True
        if self.head == self.tail:
            return False
        if stamp_ns <= self.stamps[self.head]:
            at = self.head
        elif stamp_ns >= self.stamps[self.tail - 1]:
            at = self.tail - 1
        else:
            at = self._find(stamp_ns)
            if stamp_ns - self.stamps[at] > self.stamps[at + 1] - stamp_ns:
                at += 1
        self.at = at
        self.ratio = 0.0
        near = self.stamps[at]
        return stamp_ns - tolerance_ns <= near and near <= stamp_ns + tolerance_ns

    def seek_beyond(self, stamp_ns: int, extrapolation_ns: int) -> bool:
        """Put the cursor on a time up to so far outside of the samples."""
        self.beyond = 0
        if self.static or self.seek(stamp_ns):
            return True
        first, last = self.head, self.tail - 1
        if last <= first:
            return False
        # So compared that no difference leaves 64 bits.
        if stamp_ns > self.stamps[last]:
            if stamp_ns - extrapolation_ns > self.stamps[last]:
                return False
            at, beyond = last - 1, stamp_ns - self.stamps[last]
        else:
            if stamp_ns + extrapolation_ns < self.stamps[first]:
                return False
            at, beyond = first, self.stamps[first] - stamp_ns
        if self.parents is not None and self.parents[at] is not self.parents[at + 1]:
            return False
        self.at = at
        self.beyond = beyond
        before = self.stamps[at]
        elapsed = stamp_ns - before
        self.ratio = elapsed / (self.stamps[at + 1] - before)
        return True

    def pose(self, screw: bool) -> Pose:
        """The pose in the parent at the cursor."""
        if self.static:
            return self.fixed
        if self.ratio == 0.0:
            return self._sample(self.at)
        if screw or self.ratio < 0.0 or self.ratio > 1.0:
            return blend_screw(self._sample(self.at), self._sample(self.at + 1), self.ratio)
        return blend(self._sample(self.at), self._sample(self.at + 1), self.ratio)

    def parent_here(self) -> "History | None":
        """The parent at the cursor."""
        if self.static or self.parents is None:
            return self.parent
        return self.parents[self.at]

    def latest(self) -> int:
        """The stamp of the newest sample; NO_DATA without one."""
        return self.stamps[self.tail - 1] if self.tail > self.head else NO_DATA

    def count(self) -> int:
        """How many samples are held; a static frame has one that holds at all times."""
        return 1 if self.static else self.tail - self.head

    def stamps_from(self, start_ns: int, end_ns: int) -> list[int]:
        """The stamps from start to end, both included."""
        if self.static:
            return []
        stamps = (self.stamps[i] for i in range(self.head, self.tail))
        return [stamp for stamp in stamps if start_ns <= stamp <= end_ns]

    def stamp_span(self) -> tuple[int, int] | None:
        """Oldest and newest stamp; of a static frame its own; None without a sample."""
        if self.static:
            return self.fixed_stamp, self.fixed_stamp
        if self.head == self.tail:
            return None
        return self.stamps[self.head], self.stamps[self.tail - 1]

    def _find(self, stamp_ns: int) -> int:
        """The last sample that is not newer than the time, which lies within the history.

        Samples mostly come evenly: guess where it would be then, and search around there.
        """
        low, high = self.head, self.tail - 1
        oldest, newest = self.stamps[low], self.stamps[high]
        if stamp_ns >= newest:
            return high
        # Rounded up, the period never leads beyond the last but one.
        period = (newest - oldest) // (high - low) + 1
        guess = low + (stamp_ns - oldest) // period
        step = 1
        if self.stamps[guess] <= stamp_ns:
            low = guess
            while low + step < high and self.stamps[low + step] <= stamp_ns:
                low += step
                step += step
            if low + step < high:
                high = low + step
        else:
            high = guess
            while high - step > low and self.stamps[high - step] > stamp_ns:
                high -= step
                step += step
            if high - step > low:
                low = high - step
        while high - low > 1:
            middle = (low + high) >> 1
            if self.stamps[middle] <= stamp_ns:
                low = middle
            else:
                high = middle
        return low

    def _sample(self, at: int) -> Pose:
        k = 7 * at
        return (
            self.poses[k],
            self.poses[k + 1],
            self.poses[k + 2],
            self.poses[k + 3],
            self.poses[k + 4],
            self.poses[k + 5],
            self.poses[k + 6],
        )

    # Writing

    def fix(self, stamp_ns: int, pose: Pose, parent: "History") -> int:
        """Hold this pose at all times."""
        outcome = KEPT
        if self.static and self.fixed_stamp == stamp_ns:
            outcome = REPEATED if self._is_fixed_at(pose, parent) else CONFLICT
        self.static = True
        self.fixed = pose
        self.fixed_stamp = stamp_ns
        self._change_parent(parent)
        return outcome

    def insert(self, stamp_ns: int, pose: Pose, parent: "History", cache_ns: int) -> int:
        """Take a sample: KEPT; TOO_OLD, and not kept; REPEATED, one that is known already; or
        CONFLICT, which replaces a different one of the same stamp.
        """
        if self.tail > self.head and stamp_ns <= self.stamps[self.tail - 1]:
            return self._insert_late(stamp_ns, pose, parent, cache_ns)
        if self.tail == self.capacity:
            self._make_room()
        tail = self.tail
        if parent is not self.parent:
            self._change_parent(parent)
        if self.parents is not None:
            self.parents.append(parent)
        self.stamps[tail] = stamp_ns
        self._write(tail, pose)
        self.tail = tail + 1
        oldest = stamp_ns - cache_ns
        while self.stamps[self.head] < oldest:
            self.head += 1
        return KEPT

    def unfix(self) -> None:
        """Hold the static pose no longer."""
        self.static = False
        if self.parents is not None:
            self.parent = self.parents[self.tail - 1]

    def parent_after(self, stamp_ns: int, parent: "History", static: bool) -> "History | None":
        """The parent that this frame will have once a sample of this parent is in."""
        if static or stamp_ns >= self.latest():
            return parent
        return self.parent if self.parents is None else self.parents[self.tail - 1]

    def forget(self) -> None:
        """Drop all that is known, the parent too."""
        self.forget_samples()
        self.static = False
        self.parent = None
        self.paths.clear()

    def forget_samples(self) -> None:
        """Drop all samples; a static pose stays."""
        self.head = self.tail = self.capacity = self.at = 0
        self.stamps = _NO_STAMPS
        self.poses = _NO_POSES
        self.parents = None

    def forget_after(self, stamp_ns: int) -> None:
        """Drop the samples later than a time; a static pose stays.

        All of them where the parent has changed: a former parent might hang below this frame by
        now.
        """
        tail = self.tail
        while tail > self.head and self.stamps[tail - 1] > stamp_ns:
            tail -= 1
        if tail == self.tail:
            return
        if tail == self.head or self.parents is not None:
            self.forget_samples()
        else:
            self.tail = tail
            self.at = self.head

    def _insert_late(self, stamp_ns: int, pose: Pose, parent: "History", cache_ns: int) -> int:
        if self.stamps[self.tail - 1] - stamp_ns > cache_ns:
            self.refused += 1
            return TOO_OLD
        at = self._find(stamp_ns) if stamp_ns >= self.stamps[self.head] else self.head - 1
        if at >= self.head and self.stamps[at] == stamp_ns:
            return self._replace(at, pose, parent)
        if self.tail == self.capacity:
            before = self.head
            self._make_room()
            at -= before - self.head
        at += 1
        tail = self.tail
        if self.parents is None and parent is not self.parent:
            self.parents = [self.parent] * tail
        if self.parents is not None:
            self.parents.insert(at, parent)
        self.stamps[at + 1 : tail + 1] = self.stamps[at:tail]
        self.poses[7 * at + 7 : 7 * tail + 7] = self.poses[7 * at : 7 * tail]
        self.stamps[at] = stamp_ns
        self._write(at, pose)
        self.tail = tail + 1
        return KEPT

    def _replace(self, at: int, pose: Pose, parent: "History") -> int:
        known = self.parents[at] if self.parents is not None else self.parent
        if known is parent and self._sample(at) == pose:
            return REPEATED
        self.conflicts += 1
        if known is not parent:
            if self.parents is None:
                self.parents = [self.parent] * self.tail
            self.parents[at] = parent
            if at == self.tail - 1:
                self.parent = parent
        self._write(at, pose)
        return CONFLICT

    def _is_fixed_at(self, pose: Pose, parent: "History") -> bool:
        same = self.parent is parent and self.fixed == pose
        if not same:
            self.conflicts += 1
        return same

    def _change_parent(self, parent: "History") -> None:
        if parent is not self.parent and self.parents is None and self.tail > self.head:
            self.parents = [self.parent] * self.tail
        self.parent = parent

    def _make_room(self) -> None:
        """Move what is alive to the start; to larger columns, unless an eighth has died.

        So a column is at most a sixth larger than what is alive in it, or was when it was made.
        """
        head, tail = self.head, self.tail
        alive = tail - head
        stamps, poses = self.stamps, self.poses
        if 8 * head <= self.capacity or 4 * alive < self.capacity:
            self.capacity = alive + alive // 6 + _FIRST_CAPACITY
            self.stamps = array("q", bytes(8 * self.capacity))
            self.poses = array("d", bytes(56 * self.capacity))
        self.stamps[0:alive] = stamps[head:tail]
        self.poses[0 : 7 * alive] = poses[7 * head : 7 * tail]
        if self.parents is not None:
            del self.parents[:head]
            if all(parent is self.parent for parent in self.parents):
                self.parents = None
        self.head, self.tail = 0, alive

    def _write(self, at: int, pose: Pose) -> None:
        k = 7 * at
        x, y, z, qx, qy, qz, qw = pose
        self.poses[k] = x
        self.poses[k + 1] = y
        self.poses[k + 2] = z
        self.poses[k + 3] = qx
        self.poses[k + 4] = qy
        self.poses[k + 5] = qz
        self.poses[k + 6] = qw


class Path:
    """From a source frame up to the common ancestor, and from there down to a target frame.

    `up` are the histories whose poses lead up from the source, the source's own first; `down`
    those that lead up from the target. `topology` is the state of the tree that the path was
    found in.
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
        return any([history.parents is not None for history in self.edges()])

    def latest(self) -> int:
        """The newest stamp that all edges have come to; ALL_STATIC; or NO_DATA where an edge is
        empty. Of a frame from itself its own newest, as tf2 has it.
        """
        latest = ALL_STATIC
        if self.source is self.target:
            history = self.source
            return latest if history.static or history.count() == 0 else history.latest()
        for history in self.up:
            if not history.static:
                latest = min(latest, history.latest())
        for history in self.down:
            if not history.static:
                latest = min(latest, history.latest())
        return latest

    def seek(self, stamp_ns: int) -> bool:
        """Put all cursors on a time; False where one cannot be, or where the way at that time
        may have been another one, because an edge has had several parents.
        """
        for history in self.up:
            if history.parents is not None or not history.seek(stamp_ns):
                return False
        for history in self.down:
            if history.parents is not None or not history.seek(stamp_ns):
                return False
        return True

    def seek_as(self, stamp_ns: int, sampling: Sampling) -> int:
        """Put all cursors on a time as the sampling allows: how far the farthest had to go beyond
        its samples; -1 where `seek` would be False.
        """
        beyond = 0
        for history in self.edges():
            if history.parents is not None or not seek_as(history, stamp_ns, sampling):
                return -1
            beyond = max(beyond, history.beyond)
        return beyond

    def pose(self, screw: bool) -> Pose:
        """The pose of the source in the target at the cursors."""
        if not self.down:
            return normalised(climb(self.up, screw)) if self.up else IDENTITY
        back = invert(climb(self.down, screw))
        return normalised(compose(back, climb(self.up, screw)) if self.up else back)

    def fill(
        self,
        stamps: Sequence[int],
        start: int,
        stop: int,
        xyz: MutableSequence[float],
        quat: MutableSequence[float],
        known: MutableSequence[int],
        screw: bool,
    ) -> None:
        """The poses at the stamps of rows [start, stop), written into their rows of `xyz` (three
        numbers each) and `quat` (four); `known` is 0 where there is none.
        """
        for i in range(start, stop):
            if not self.seek(stamps[i]):
                known[i] = 0
                continue
            x, y, z, qx, qy, qz, qw = self.pose(screw)
            known[i] = 1
            xyz[3 * i] = x
            xyz[3 * i + 1] = y
            xyz[3 * i + 2] = z
            quat[4 * i] = qx
            quat[4 * i + 1] = qy
            quat[4 * i + 2] = qz
            quat[4 * i + 3] = qw


def climb(histories: list[History], screw: bool) -> Pose:
    """The pose of the first frame in the parent of the last, at the cursors."""
    history = histories[0]
    pose = history.pose(screw)
    for i in range(1, len(histories)):
        history = histories[i]
        pose = compose(history.pose(screw), pose)
    return pose


def seek_as(history: History, stamp_ns: int, sampling: Sampling) -> bool:
    """Put the cursor of an edge on a time, as the sampling allows."""
    if sampling.interpolation == "nearest":
        return history.seek_nearest(stamp_ns, round(sampling.tolerance_s * 1e9))
    return history.seek_beyond(stamp_ns, round(sampling.extrapolation_s * 1e9))
