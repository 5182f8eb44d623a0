"""The buffer: the last seconds of every frame, and the transform between any two at any time.

One of the modules that are compiled where there is a C compiler (`buffer.pxd` says the C types).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tfbus.buffer.formats import as_dot, as_svg, as_text, as_yaml
from tfbus.buffer.frame import FrameInfo as FrameInfo
from tfbus.buffer.freshness import Freshness
from tfbus.buffer.lookup_many import Filling
from tfbus.core.outcome import ALL_STATIC, NO_DATA
from tfbus.core.sampling import Sampling
from tfbus.errors import ExtrapolationException, InvalidArgumentException, TransformException
from tfbus.geometry.transform import Transform, TransformStamped, check_stamp, make_stamped
from tfbus.geometry.transform_array import TransformArray, rotate
from tfbus.geometry.twist import TwistStamped, fit_twist, pick_stamps

try:
    import cython
except ImportError:
    from tfbus.core import cython_stub as cython

# Whether this kernel is compiled, or interpreted.
COMPILED: bool = cython.compiled


class Buffer(Filling):
    """The transforms of the last `cache_time_s` seconds, by their own stamps.

    What is set becomes an edge from parent to child; a lookup follows the edges between two
    frames, at one time. Times are integer nanoseconds since the Unix epoch. Semantics are tf2's
    unless `sampling` says otherwise.

    Safe from any thread. There is one lock, held for one lookup, or for the rows of one batch; a
    lookup with a timeout waits on a condition, without the lock, and never polls.

    `rejected` counts the rows of batches that could not be taken, by their reason; `shortfall`
    the lookups that it was too short for.

    `clock` says what time it is, in nanoseconds since the Unix epoch, where the age of a sample
    matters. Where it is simulated (`node.clock`), timeouts count its seconds, and real ones
    otherwise. A TransformListener gives the buffer its node's clock, unless it has another.
    """

    def remove(self, frame: str) -> None:
        """Forget a frame's place in its parent, static or not, and its history.

        Frames below it stay, and it stays as their root. Raises LookupException where it is not
        known.
        """
        with self._lock:
            known = self._tree.remove(frame)
        if not known:
            raise self._unknown(frame)
        self._waiters.wake_all()
        if self._tree.news:
            self._announce()

    # Looking up

    def lookup_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        timeout_s: float = 0.0,
        sampling: Sampling | None = None,
        max_age_s: float | None = None,
        living: bool = False,
    ) -> TransformStamped:
        """The transform that takes data in `source_frame` into `target_frame`.

        So: the pose of the source seen from the target, at the stamp; None is the latest time
        that every edge between the two has come to. Of static edges alone that is 0.

        Waits for at most `timeout_s` seconds for what may still come. Raises
        InvalidArgumentException for a name that cannot be, LookupException for one that is not
        known, ConnectivityException where no path joins them, a kind of ExtrapolationException
        where the time is outside of what is known; and TimeoutException after waiting, with the
        reason in it.

        With `max_age_s` the newest sample of each edge that moves is to be no older, and with
        `living` the publisher of each edge is to be there: StaleException where it is not so.
        """
        if stamp_ns is not None and type(stamp_ns) is not int:
            stamp_ns = check_stamp(stamp_ns)
        if max_age_s is not None or living:
            fresh = Freshness(max_age_s, living)
            question = (target_frame, source_frame, stamp_ns)
            return self._wait((question,), timeout_s, sampling, fresh)[0]
        try:
            with self._lock:
                answer = self._tree.answer(
                    target_frame,
                    source_frame,
                    stamp_ns,
                    self.sampling if sampling is None else sampling,
                )
        except OverflowError:
            check_stamp(stamp_ns)
            raise
        if answer is None:
            question = (target_frame, source_frame, stamp_ns)
            answer = self._wait((question,), timeout_s, sampling)[0]
        return answer

    def lookup_transform_full(
        self,
        target_frame: str,
        target_stamp_ns: int | None,
        source_frame: str,
        source_stamp_ns: int | None,
        fixed_frame: str,
        *,
        timeout_s: float = 0.0,
        sampling: Sampling | None = None,
    ) -> TransformStamped:
        """The source as it was at one time, seen from the target at another.

        `fixed_frame` is one that does not move in between. The answer has the target's stamp.
        Waits and raises as `lookup_transform`.
        """
        questions = (
            (fixed_frame, source_frame, _stamp(source_stamp_ns)),
            (target_frame, fixed_frame, _stamp(target_stamp_ns)),
        )
        return _joined(self._wait(questions, timeout_s, sampling))

    def can_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        timeout_s: float = 0.0,
        sampling: Sampling | None = None,
        max_age_s: float | None = None,
        living: bool = False,
    ) -> bool:
        """Whether `lookup_transform` with the same arguments answers."""
        question = (target_frame, source_frame, _stamp(stamp_ns))
        fresh = _freshness(max_age_s, living)
        if timeout_s <= 0.0:
            return self._ask((question,), sampling, fresh) is not None
        try:
            self._wait((question,), timeout_s, sampling, fresh)
        except TransformException:
            return False
        return True

    async def wait_for_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        timeout_s: float | None = None,
        sampling: Sampling | None = None,
        max_age_s: float | None = None,
        living: bool = False,
    ) -> TransformStamped:
        """The answer of `lookup_transform` as soon as there is one, for asyncio.

        Raises TimeoutException after `timeout_s` (None: never), and at once what waiting cannot
        mend. Cancel it as any task.
        """
        question = (target_frame, source_frame, _stamp(stamp_ns))
        fresh = _freshness(max_age_s, living)
        return (await self._wait_async((question,), timeout_s, sampling, fresh))[0]

    async def wait_for_transform_full(
        self,
        target_frame: str,
        target_stamp_ns: int | None,
        source_frame: str,
        source_stamp_ns: int | None,
        fixed_frame: str,
        *,
        timeout_s: float | None = None,
        sampling: Sampling | None = None,
    ) -> TransformStamped:
        """The answer of `lookup_transform_full` as soon as there is one, for asyncio."""
        questions = (
            (fixed_frame, source_frame, _stamp(source_stamp_ns)),
            (target_frame, fixed_frame, _stamp(target_stamp_ns)),
        )
        return _joined(await self._wait_async(questions, timeout_s, sampling))

    def latest_common_time(self, target_frame: str, source_frame: str) -> int | None:
        """The latest stamp that every edge between the two frames has come to.

        None where all of them are static. Raises as `lookup_transform`.
        """
        with self._lock:
            path = self._tree.path(target_frame, source_frame)
            latest = NO_DATA if path is None else path.latest()
        if latest == NO_DATA:
            raise self._why_not((target_frame, source_frame, None), None)
        return None if latest == ALL_STATIC else latest

    # Looking up many

    def lookup_transforms(
        self,
        target_frame: str,
        source_frame: str,
        stamps_ns: ArrayLike,
        *,
        sampling: Sampling | None = None,
    ) -> TransformArray:
        """The transforms at N stamps: `xyz` (N, 3) in metres and `quat_xyzw` (N, 4).

        Raises as `lookup_transform` where one of the stamps cannot be answered. The lock is let
        go now and then, so writers need not wait for all of it.
        """
        stamps = _stamps(stamps_ns)
        answers, known = self._fill(target_frame, source_frame, stamps, sampling)
        if not known.all():
            first = int(stamps[np.argmin(known)])
            raise self._why_not((target_frame, source_frame, first), sampling)
        return answers

    def lookup_known_transforms(
        self,
        target_frame: str,
        source_frame: str,
        stamps_ns: ArrayLike,
        *,
        sampling: Sampling | None = None,
    ) -> tuple[TransformArray, NDArray[np.bool_]]:
        """The transforms at those of N stamps that can be answered, and which they are.

        The mask (N,) is False, and the rows are NaN, where the time is out of range. Raises
        LookupException or ConnectivityException where no stamp could be answered whatever it is.
        """
        return self._fill(target_frame, source_frame, _stamps(stamps_ns), sampling)

    def transform_points(
        self,
        points: ArrayLike,
        target_frame: str,
        source_frame: str,
        stamps_ns: ArrayLike | None = None,
        *,
        target_stamp_ns: int | None = None,
        fixed_frame: str | None = None,
        sampling: Sampling | None = None,
    ) -> NDArray[np.float64]:
        """Points (N, 3) of the source frame, taken into the target frame.

        `stamps_ns` is one time, or one for each point (N,); None is the latest. With a
        `fixed_frame` all points go into the target as it was at `target_stamp_ns` (None: the
        latest): so a lidar's scan, each point of which has its own time, is undistorted. Raises
        as `lookup_transform`.
        """
        array = np.asarray(points, dtype=np.float64)
        if array.ndim != 2 or array.shape[1] != 3:
            raise InvalidArgumentException(f"points have shape {array.shape}; (N, 3) is wanted")
        if fixed_frame is not None:
            into = self.lookup_transform(
                target_frame, fixed_frame, target_stamp_ns, sampling=sampling
            )
            fixed = self.transform_points(
                array, fixed_frame, source_frame, stamps_ns, sampling=sampling
            )
            return into.transform.apply(fixed)
        if stamps_ns is None or np.ndim(stamps_ns) == 0:
            whole = self.lookup_transform(
                target_frame,
                source_frame,
                None if stamps_ns is None else check_stamp(stamps_ns),
                sampling=sampling,
            )
            return whole.transform.apply(array)
        stamps = _stamps(stamps_ns)
        if len(stamps) != len(array):
            raise InvalidArgumentException(
                f"there are {len(array)} points but {len(stamps)} stamps; each needs its own"
            )
        xyz, quat_xyzw = self.lookup_transforms(
            target_frame, source_frame, stamps, sampling=sampling
        )
        moved: NDArray[np.float64] = rotate(quat_xyzw, array) + xyz
        return moved

    def lookup_twist(
        self,
        frame: str,
        reference_frame: str,
        stamp_ns: int | None = None,
        *,
        observation_frame: str | None = None,
        window_s: float = 0.1,
    ) -> TwistStamped:
        """How `frame` moves against `reference_frame`: linear in m/s, angular in rad/s.

        Both are written in the axes of `observation_frame`, which is the reference unless it is
        given, as it stands at that time. Estimated from the samples of a window of `window_s`
        around the stamp, moved to where there are samples; None is the latest common time. Exact
        where the motion in the window is a line, a circle or a screw at constant speed. Raises as
        `lookup_transform`.
        """
        observer = reference_frame if observation_frame is None else observation_frame
        now = self.lookup_transform(reference_frame, frame, stamp_ns)
        axes = self.lookup_transform(observer, reference_frame, now.stamp_ns).transform
        with self._lock:
            path = self._tree.path(reference_frame, frame)
            moving = [] if path is None else [h for h in path.edges() if not h.static]
            spans = [history.stamp_span() for history in moving]
        if not moving:
            still = np.zeros(3)
            stamp = now.stamp_ns
            return TwistStamped(stamp, observer, frame, reference_frame, still, still, stamp, stamp)
        oldest = max(span[0] for span in spans if span)
        newest = min(span[1] for span in spans if span)
        width = round(window_s * 1e9)
        end = min(max(now.stamp_ns, oldest) + width // 2, newest)
        start = max(end - width, oldest)
        if end <= start:
            raise _too_few_for_twist(frame, reference_frame, now.stamp_ns, window_s)
        with self._lock:
            sampled = [stamp for h in moving for stamp in h.stamps_from(start, end)]
        stamps = pick_stamps(sampled, start, end)
        xyz, quat_xyzw = self.lookup_transforms(reference_frame, frame, stamps)
        poses = [Transform(x, q) for x, q in zip(xyz, quat_xyzw, strict=True)]
        linear, angular = fit_twist(stamps, poses)
        turn = axes @ now.transform
        return TwistStamped(
            now.stamp_ns,
            observer,
            frame,
            reference_frame,
            turn.rotate(linear),
            turn.rotate(angular),
            start,
            end,
        )

    # Looking around

    def frames(self) -> list[str]:
        """The names of all known frames, sorted."""
        with self._lock:
            return sorted(self._tree.frames)

    def frame(self, name: str) -> FrameInfo:
        """What is known of one frame. Raises LookupException where it is not known."""
        with self._lock:
            info = self._tree.info(name)
        if info is None:
            raise self._unknown(name)
        return info

    def path(self, target_frame: str, source_frame: str) -> list[str]:
        """The frames from the source to the target, both included, as the tree is now.

        Raises LookupException or ConnectivityException.
        """
        with self._lock:
            path = self._tree.path(target_frame, source_frame)
            names = [] if path is None else path.names()
        if not names:
            raise self._why_not((target_frame, source_frame, None), None)
        return names

    def all_frames(self) -> list[FrameInfo]:
        """What is known of every frame, sorted by name."""
        with self._lock:
            return self._tree.infos()

    def all_frames_as_yaml(self) -> str:
        """Every edge as YAML, in the form of tf2's `allFramesAsYAML`."""
        return as_yaml(self.all_frames())

    def all_frames_as_dot(self) -> str:
        """The trees as a Graphviz graph, in the form of tf2's view_frames."""
        return as_dot(self.all_frames())

    def all_frames_as_text(self) -> str:
        """The trees as lines of text, children below their parent."""
        return as_text(self.all_frames())

    def _repr_svg_(self) -> str:
        return as_svg(self.all_frames())

    def __repr__(self) -> str:
        return f"<Buffer of {len(self._tree.frames)} frames over {self.cache_time_s:g} s>"


def _joined(answers: Sequence[TransformStamped]) -> TransformStamped:
    """Source to fixed frame at one time, then fixed frame to target at another, as one."""
    back, there = answers
    return make_stamped(
        there.stamp_ns,
        there.frame_id,
        back.child_frame_id,
        (there.transform @ back.transform).as_pose(),
        max(back.extrapolated_ns, there.extrapolated_ns),
    )


def _freshness(max_age_s: float | None, living: bool) -> Freshness | None:
    return Freshness(max_age_s, living) if max_age_s is not None or living else None


def _stamp(stamp_ns: int | None) -> int | None:
    return None if stamp_ns is None else check_stamp(stamp_ns)


def _stamps(stamps_ns: ArrayLike) -> NDArray[np.int64]:
    stamps = np.asarray(stamps_ns)
    if stamps.ndim != 1 or (stamps.size and not np.issubdtype(stamps.dtype, np.integer)):
        raise InvalidArgumentException(
            f"stamps are {stamps.dtype} of shape {stamps.shape}; integers (N,) are wanted"
        )
    return np.ascontiguousarray(stamps, dtype=np.int64)


def _too_few_for_twist(
    frame: str, reference_frame: str, stamp_ns: int, window_s: float
) -> TransformException:
    return ExtrapolationException(
        f"{frame!r} against {reference_frame!r} has no two times within {window_s:g} s to "
        "tell a velocity from; widen window_s, or wait",
        requested_ns=stamp_ns,
    )
