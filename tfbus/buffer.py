"""The buffer: the last seconds of every frame, and the transform between any two at any time.

One of the modules that are compiled where there is a C compiler (`buffer.pxd` says the C types).
"""

import logging
import math
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tfbus import octets
from tfbus.batch import TransformBatch
from tfbus.change import Change
from tfbus.clock import SYSTEM_CLOCK, limit_by
from tfbus.columns import Columns
from tfbus.describe import as_dot, as_svg, as_text, as_yaml
from tfbus.errors import (
    ConnectivityException,
    ExtrapolationException,
    InvalidArgumentException,
    LookupException,
    StaleException,
    TimeoutException,
    TransformException,
)
from tfbus.explain import may_come, unknown_frame, why_not
from tfbus.frame import FrameInfo as FrameInfo
from tfbus.freshness import Freshness
from tfbus.kernel import Path, Pose
from tfbus.octets import EDGE_SIZE, POSE_SIZE, STAMP_SIZE
from tfbus.outcome import ALL_STATIC, NO_DATA
from tfbus.rejections import Rejections
from tfbus.sampling import TF2, Sampling
from tfbus.shortfall import Shortfall
from tfbus.transform import (
    QUATERNION_TOLERANCE,
    UNIT_TO_THE_LAST_BIT,
    Transform,
    TransformStamped,
    check_frame_id,
    check_stamp,
    make_stamped,
)
from tfbus.transform_array import TransformArray, rotate
from tfbus.tree import Tree
from tfbus.twist import TwistStamped, fit_twist, pick_stamps
from tfbus.waiting import Question, Waiter, Waiters

try:
    import cython
except ImportError:
    from tfbus import uncompiled as cython

# Whether this kernel is compiled, or interpreted.
COMPILED: bool = cython.compiled

# A batch holds the lock for so many stamps at a time, which is some microseconds.
_CHUNK = 256
# As long as a cache can be: stamps span no more.
_LONGEST_NS = 2**62

# Told which frames are asked for; and explains why one of them is not there yet, if it can.
Reader = tuple[Callable[[str, str], object], Callable[[str, str], TransformException | None]]

_log = logging.getLogger(__name__)


class Buffer:
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

    def __init__(
        self,
        cache_time_s: float = 10.0,
        *,
        sampling: Sampling = TF2,
        clock: Callable[[], int] = SYSTEM_CLOCK,
    ) -> None:
        if not cache_time_s >= 0.0:
            raise InvalidArgumentException(
                f"cache_time_s is {cache_time_s!r}; it is a number of seconds, 0 or more"
            )
        if not cython.compiled:
            # Compiled, it is a mutex of C.
            self._lock = threading.Lock()
        self.cache_time_s = cache_time_s
        self.sampling = TF2 if sampling == TF2 else sampling
        self.clock = clock
        self.rejected = Rejections()
        self.shortfall = Shortfall()
        self._tree = Tree(round(min(cache_time_s * 1e9, _LONGEST_NS)))
        self._waiters = Waiters(self._tree)
        self._listeners: list[Callable[[Change], None]] = []
        self._readers: list[Reader] = []

    # Filling it

    def set_transform(
        self, transform: TransformStamped, *, static: bool = False, authority: str = ""
    ) -> bool:
        """Take one transform; a static one holds at all times.

        False where it is older than the newest of its child frame by more than the cache time.
        One that repeats a stamp replaces the former; where it differs, that is a conflict, which
        is counted and told to listeners. Raises InvalidArgumentException for a frame that is its
        own parent, LoopException for an edge that would close a loop; then nothing has changed.
        """
        with self._lock:
            taken = self._insert_one(transform, static, authority)
        if self._tree.touched or self._tree.news or self._tree.untold:
            self._announce()
        return taken

    def set_transforms(
        self, batch: TransformBatch | Columns, *, static: bool = False, authority: str = ""
    ) -> int:
        """Take the rows of a batch; how many were taken.

        A row that cannot be taken harms none of the others: it is counted in `rejected`, by its
        reason.
        """
        columns = batch if isinstance(batch, Columns) else Columns.of_batch(batch)
        with self._lock:
            taken = self._insert_rows(columns, static, authority)
        if self._tree.touched or self._tree.news or self._tree.untold:
            self._announce()
        return taken

    def clear(self, *, after_ns: int | None = None) -> None:
        """Forget all samples, or those later than a time where it is given; static transforms
        stay, and so do the names of all frames.

        A frame that has changed its parent of late, and has samples later than the time, loses
        its earlier ones, too.
        """
        with self._lock:
            if after_ns is None:
                self._tree.clear()
            else:
                self._tree.clear_after(after_ns)
        self._waiters.wake_all()

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

    # What a listener learns about who sends them

    def sent_by(self, authority: str) -> dict[str, int]:
        """The frames whose last transform this authority sent, and how many samples of each are
        held; of a static transform none is counted.
        """
        with self._lock:
            return self._tree.sent_by(authority)

    def forget(self, authority: str, frames: Iterable[str] | None = None) -> None:
        """Forget the samples of the frames that this authority sent last, as it begins anew;
        static transforms stay. With `frames` only of these.
        """
        with self._lock:
            self._tree.forget(authority, frames)
        self._waiters.wake_all()

    def mark_gone(self, frames: Iterable[str], gone: bool, authority: str) -> None:
        """Note that the publisher of those of the frames that it sent last is gone, or back."""
        with self._lock:
            self._tree.mark_gone(frames, gone, authority)
        self._announce()

    def remove_sent(self, frames: Iterable[str], authority: str) -> None:
        """Remove those of the frames that this authority sent last, as `remove` does."""
        with self._lock:
            for frame in frames:
                self._tree.remove_sent(frame, authority)
        self._waiters.wake_all()
        self._announce()

    def tell(self, change: Change) -> None:
        """Tell those who listen for changes of one that was noticed elsewhere."""
        with self._lock:
            if self._tree.news is not None:
                self._tree.news.append(change)
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
            raise self._too_few_for_twist(frame, reference_frame, now.stamp_ns, window_s)
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

    def on_change(self, listener: Callable[[Change], None]) -> Callable[[], None]:
        """Call the listener with each change from now on; call what it returns to end that.

        It is called in the thread that inserts, without the lock, one change after another; it
        may use the buffer. What it raises is logged.
        """
        with self._lock:
            self._listeners = [*self._listeners, listener]
            if self._tree.news is None:
                self._tree.news = []

        def end() -> None:
            with self._lock:
                with suppress(ValueError):
                    others = list(self._listeners)
                    others.remove(listener)
                    self._listeners = others
                if not self._listeners:
                    self._tree.news = None

        return end

    def watch_questions(
        self,
        callback: Callable[[str, str], object],
        explain: Callable[[str, str], TransformException | None] = lambda target, source: None,
    ) -> Callable[[], None]:
        """Call `callback(target, source)` once for each pair of frames that is asked for from now
        on; call what is returned to end that.

        It is called without the lock, in the thread that asks and before a lookup waits. A pair
        that can be answered at once is told at the next insert, or the next lookup that cannot
        be answered; so the others pay nothing for it. Where frames are unknown or not connected,
        `explain(target, source)` may give the error that says it better.
        """
        reader = (callback, explain)
        with self._lock:
            self._readers = [*self._readers, reader]
            self._tree.asked = set()
            self._tree.topology += 1

        def end() -> None:
            with self._lock:
                self._readers = [each for each in self._readers if each is not reader]
                if not self._readers:
                    self._tree.asked = None

        return end

    def ask_again(self) -> None:
        """Call those who watch questions once more for each pair, when it is asked for next;
        for those that wait in a lookup that is now.
        """
        with self._lock:
            self._tree.ask_again()
        self._waiters.wake_all()

    @property
    def waiting(self) -> int:
        """How many lookups wait in it now."""
        return len(self._waiters)

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

    # The rest is not for users

    def _insert_one(self, transform: TransformStamped, static: bool, authority: str) -> bool:
        return self._tree.insert(
            transform._frame_id,
            transform._child_frame_id,
            transform._stamp_ns,
            transform._pose,
            static,
            authority,
        )

    def _insert_rows(self, columns: Columns, static: bool, authority: str) -> int:
        frames = columns.frames
        edges, stamps, poses = columns.edges, columns.stamps, columns.poses
        taken = 0
        table = None if static else self._tree.table(columns, authority)
        for i in range(columns.count):
            stamp = octets.stamp_at(stamps, columns.stamps_at + STAMP_SIZE * i)
            pose: Pose = octets.pose_at(poses, columns.poses_at + POSE_SIZE * i)
            x, y, z, qx, qy, qz, qw = pose
            total = x + y + z
            square = qx * qx + qy * qy + qz * qz + qw * qw
            error = square - 1.0
            why = ""
            # Of numbers that are not finite a difference to themselves is not 0.
            if total - total != 0.0 or square - square != 0.0:
                why = "a number is not finite"
            elif error >= QUATERNION_TOLERANCE or error <= -QUATERNION_TOLERANCE:
                why = "the quaternion's norm is not 1"
            elif stamp >= _LONGEST_NS or stamp <= -_LONGEST_NS:
                why = "the stamp is not within 146 years of 1970"
            elif error > UNIT_TO_THE_LAST_BIT or error < -UNIT_TO_THE_LAST_BIT:
                scale = 1.0 / math.sqrt(square)
                pose = (x, y, z, qx * scale, qy * scale, qz * scale, qw * scale)
            if (
                table is not None
                and not why
                and self._tree.append(table, i, stamp, pose, authority)
            ):
                taken += 1
                continue
            edge = octets.edge_at(edges, columns.edges_at + EDGE_SIZE * i)
            parent, child = frames[edge[0]], frames[edge[1]]
            if why:
                self.rejected.add(f"{child!r}: {why}")
                continue
            try:
                taken += self._tree.insert(parent, child, stamp, pose, static, authority)
            except InvalidArgumentException as reason:
                self.rejected.add(str(reason))
        return taken

    def _fill(
        self,
        target_frame: str,
        source_frame: str,
        stamps: NDArray[np.int64],
        sampling: Sampling | None,
    ) -> tuple[TransformArray, NDArray[np.bool_]]:
        sampling = self.sampling if sampling is None else sampling
        if self._ask_path(target_frame, source_frame) is None:
            self._check_connected(target_frame, source_frame, stamps)
        xyz = np.full((len(stamps), 3), np.nan)
        quat_xyzw = np.full((len(stamps), 4), np.nan)
        known = np.zeros(len(stamps), dtype=np.bool_)
        if len(stamps):
            self._fill_chunks(
                target_frame,
                source_frame,
                stamps.data,
                xyz.reshape(-1).data,
                quat_xyzw.reshape(-1).data,
                known.view(np.uint8).data,
                sampling,
            )
        return TransformArray(xyz, quat_xyzw), known

    def _fill_chunks(
        self,
        target_frame: str,
        source_frame: str,
        stamps: Any,
        xyz: Any,
        quat: Any,
        known: Any,
        sampling: Sampling,
    ) -> None:
        count = len(stamps)
        strict = sampling.interpolation != "nearest" and not sampling.extrapolation_s
        screw = sampling.interpolation == "screw"
        start = 0
        while start < count:
            path = self._ask_path(target_frame, source_frame)
            before = start
            if strict and path is not None:
                # Python's other threads go on meanwhile.
                with cython.nogil:
                    start = self._fill_along(path, stamps, start, xyz, quat, known, screw)
            if start == before:
                stop = min(start + _CHUNK, count)
                with self._lock:
                    for i in range(start, stop):
                        answer = self._tree.answer(target_frame, source_frame, stamps[i], sampling)
                        if answer is not None:
                            _write_row(answer, i, xyz, quat, known)
                start = stop

    def _fill_along(
        self, path: Path, stamps: Any, start: int, xyz: Any, quat: Any, known: Any, screw: bool
    ) -> int:
        """Fill the rows from `start` on while the path is one for all times: to which row."""
        count = len(stamps)
        while start < count:
            with self._lock:
                if path.topology != self._tree.topology or path.is_mixed():
                    return start
                stop = min(start + _CHUNK, count)
                path.fill(stamps, start, stop, xyz, quat, known, screw)
            start = stop
        return start

    def _ask_path(self, target_frame: str, source_frame: str) -> Path | None:
        with self._lock:
            return self._tree.path(target_frame, source_frame)

    def _check_connected(
        self, target_frame: str, source_frame: str, stamps: NDArray[np.int64]
    ) -> None:
        """Raise where no path joins the frames now, nor at one of the times."""
        for stamp in stamps.tolist():
            if self._ask(((target_frame, source_frame, stamp),), None) is not None:
                return
        raise self._why_not((target_frame, source_frame, None), None)

    def _ask(
        self,
        questions: Sequence[Question],
        sampling: Sampling | None,
        fresh: Freshness | None = None,
    ) -> list[TransformStamped] | None:
        """The answers, of one state of the buffer; None where one is missing or not fresh."""
        answers = self._answers(questions, sampling, fresh)
        if self._tree.untold:
            self._tell_questions()
        return answers

    def _answers(
        self,
        questions: Sequence[Question],
        sampling: Sampling | None,
        fresh: Freshness | None,
    ) -> list[TransformStamped] | None:
        answers = []
        with self._lock:
            for target_frame, source_frame, stamp_ns in questions:
                answer = self._tree.answer(
                    target_frame,
                    source_frame,
                    stamp_ns,
                    self.sampling if sampling is None else sampling,
                )
                if answer is None:
                    return None
                answers.append(answer)
            if fresh is not None and self._why_stale(questions, fresh) is not None:
                return None
        return answers

    def _why_stale(self, questions: Sequence[Question], fresh: Freshness) -> StaleException | None:
        """With the lock held: why the answers to the questions are not fresh enough."""
        pairs = [question[:2] for question in questions]
        return fresh.why_stale(self._tree, pairs, self.clock())

    def _wait(
        self,
        questions: Sequence[Question],
        timeout_s: float,
        sampling: Sampling | None,
        fresh: Freshness | None = None,
    ) -> list[TransformStamped]:
        answers = self._ask(questions, sampling, fresh)
        if answers is not None:
            return answers
        if timeout_s <= 0.0:
            raise self._why_none(questions, sampling, fresh)
        changed = threading.Event()
        waiter = Waiter(changed.set)
        self._waiters.add(waiter)
        try:
            with limit_by(self.clock, timeout_s, changed.set) as limit:
                while True:
                    changed.clear()
                    self._watch(waiter, questions, fresh)
                    answers = self._ask(questions, sampling, fresh)
                    if answers is not None:
                        return answers
                    reason = self._why_none(questions, sampling, fresh)
                    if not may_come(reason):
                        raise reason
                    if limit.passed:
                        raise _timed_out(timeout_s, reason) from reason
                    changed.wait(limit.left_s)
        finally:
            self._waiters.discard(waiter)

    async def _wait_async(
        self,
        questions: Sequence[Question],
        timeout_s: float | None,
        sampling: Sampling | None,
        fresh: Freshness | None = None,
    ) -> list[TransformStamped]:
        answers = self._ask(questions, sampling, fresh)
        if answers is not None:
            return answers
        import asyncio  # which takes long, and most processes have no use for

        loop = asyncio.get_running_loop()
        changed = asyncio.Event()

        def wake() -> None:
            # The loop may be closed already, and nobody there to be woken.
            with suppress(RuntimeError):
                loop.call_soon_threadsafe(changed.set)

        waiter = Waiter(wake)
        self._waiters.add(waiter)
        try:
            with limit_by(self.clock, timeout_s, wake) as limit:
                while True:
                    changed.clear()
                    self._watch(waiter, questions, fresh)
                    answers = self._ask(questions, sampling, fresh)
                    if answers is not None:
                        return answers
                    reason = self._why_none(questions, sampling, fresh)
                    if not may_come(reason):
                        raise reason
                    if limit.passed:
                        raise _timed_out(timeout_s or 0.0, reason) from reason
                    with suppress(TimeoutError):
                        async with asyncio.timeout(limit.left_s):
                            await changed.wait()
        finally:
            self._waiters.discard(waiter)

    def _watch(
        self, waiter: Waiter, questions: Sequence[Question], fresh: Freshness | None = None
    ) -> None:
        if fresh is not None:
            # Any sample of an edge may make it fresh, whatever stamp is asked for.
            questions = [(target, source, None) for target, source, _ in questions]
        with self._lock:
            self._waiters.watch(waiter, questions)

    def _announce(self) -> None:
        """Wake those who wait, and tell those who listen; without the lock."""
        tree = self._tree
        with self._lock:
            touched, moved, news = tree.touched, tree.moved, tree.news
            if touched is not None:
                tree.touched, tree.moved = [], []
            if news is not None:
                tree.news = []
            spans = [(history, history.stamp_span()) for history in touched or ()]
            listeners = self._listeners
        if spans or moved:
            self._waiters.notify(spans, moved or ())
        for change in news or ():
            for listener in listeners:
                try:
                    listener(change)
                except Exception:
                    _log.exception("a listener of changes failed")
        if tree.untold:
            self._tell_questions()

    def _tell_questions(self) -> None:
        """Tell those who watch which pairs were asked for; without the lock."""
        with self._lock:
            untold, self._tree.untold = self._tree.untold, []
            readers = self._readers
        for target_frame, source_frame in untold:
            for callback, _ in readers:
                try:
                    callback(target_frame, source_frame)
                except Exception:
                    _log.exception("a watcher of questions failed")

    def _why_none(
        self,
        questions: Sequence[Question],
        sampling: Sampling | None,
        fresh: Freshness | None = None,
    ) -> TransformException:
        """The error for the first of the questions that has no answer, or no fresh one."""
        # All names first, as tf2 does: a time is of no use to a frame that is not known.
        names = {"target_frame": questions[-1][0], "source_frame": questions[0][1]}
        if len(questions) > 1:
            names["fixed_frame"] = questions[0][0]
        error = self._misnamed(names)
        if error is not None:
            return self._explained(error, questions)
        for question in questions[:-1]:
            if self._ask((question,), sampling) is None:
                return self._why_not(question, sampling)
        if fresh is not None and self._ask(questions, sampling) is not None:
            with self._lock:
                stale = self._why_stale(questions, fresh)
            if stale is not None:
                return stale
        return self._why_not(questions[-1], sampling)

    def _why_not(self, question: Question, sampling: Sampling | None) -> TransformException:
        target_frame, source_frame, stamp_ns = question
        if self._tree.untold:
            self._tell_questions()
        misnamed = self._misnamed({"target_frame": target_frame, "source_frame": source_frame})
        if misnamed is not None:
            return self._explained(misnamed, (question,))
        if stamp_ns is not None:
            check_stamp(stamp_ns)
        with self._lock:
            error = why_not(
                self._tree,
                target_frame,
                source_frame,
                stamp_ns,
                self.sampling if sampling is None else sampling,
            )
        self.shortfall.note(error, self.cache_time_s)
        if isinstance(error, ConnectivityException):
            error = self._explained(error, (question,))
        return error or ExtrapolationException(
            f"{source_frame!r} could not be seen from {target_frame!r} a moment ago, and can be "
            "now: ask again",
            requested_ns=stamp_ns,
        )

    def _explained(
        self, error: TransformException, questions: Iterable[Question]
    ) -> TransformException:
        """The error, or the one that a reader of what is asked for has in its place."""
        if self._readers and isinstance(error, LookupException | ConnectivityException):
            for target_frame, source_frame, _ in questions:
                if self._ask_path(target_frame, source_frame) is None:
                    for _, explain in self._readers:
                        better = explain(target_frame, source_frame)
                        if better is not None:
                            return better
        return error

    def _misnamed(self, names: dict[str, str]) -> TransformException | None:
        for what, frame in names.items():
            check_frame_id(frame, what)
            if frame not in self._tree.frames:
                return self._unknown(frame)
        return None

    def _unknown(self, frame: str) -> TransformException:
        with self._lock:
            names = list(self._tree.frames)
        return unknown_frame(frame, names)

    def _too_few_for_twist(
        self, frame: str, reference_frame: str, stamp_ns: int, window_s: float
    ) -> TransformException:
        return ExtrapolationException(
            f"{frame!r} against {reference_frame!r} has no two times within {window_s:g} s to "
            "tell a velocity from; widen window_s, or wait",
            requested_ns=stamp_ns,
        )


def _write_row(answer: TransformStamped, i: int, xyz: Any, quat: Any, known: Any) -> None:
    x, y, z, qx, qy, qz, qw = answer.transform.as_pose()
    xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2] = x, y, z
    quat[4 * i], quat[4 * i + 1], quat[4 * i + 2], quat[4 * i + 3] = qx, qy, qz, qw
    known[i] = 1


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


def _timed_out(timeout_s: float, reason: TransformException | None) -> TimeoutException:
    return TimeoutException(f"waited {timeout_s:g} s in vain: {reason}", reason=reason)
