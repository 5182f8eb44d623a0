"""The tree of frames: each with its parent, and the path between any two.

Compiled if there is a C compiler (`tree.pxd` has the C types). Nothing here locks: the buffer
holds its lock around every call, but for a `fill` that finds it free.
"""

from collections import deque
from collections.abc import Iterable

from tfbus.base.errors import InvalidArgumentException, LoopException
from tfbus.buffer.info import Change, FrameInfo, Kind
from tfbus.geometry import packed
from tfbus.geometry.kernel import (
    ALL_STATIC,
    CONFLICT,
    CROWDED,
    IDENTITY,
    NO_DATA,
    TOO_OLD,
    History,
    Path,
    Pose,
    chained,
    normalised,
    seek_as,
)
from tfbus.geometry.sampling import TF2, Held, Sampling
from tfbus.geometry.transform import TransformStamped, check_frame_id, check_stamp, make_stamped

try:
    import cython
except ImportError:
    from tfbus.base import cython_stub as cython

# Target frame, source frame, stamp in nanoseconds or None for the latest.
Question = tuple[str, str, int | None]

# The most that all kept paths may cost together, in units of about 32 bytes: 30,000 paths of three
# edges. Another path is found again in a microsecond. A path costs `_PATH_COST`, and 1 an edge.
_MOST_KEPT = 2**20
_PATH_COST = 32
# Pairs of frames remembered as looked up.
_MOST_ASKED = 100_000

# Paths kept by the very texts that they were looked up by; a power of two.
_RECENT = 64


class Tree:
    """All frames by name, each with its history.

    `topology` counts the changes that may change known paths: an existing frame got a parent, or
    another one; `assignments` counts how often a frame got another publisher. `touched` and
    `moved` collect, while there are waiters, the histories that got a sample or a parent; `news`
    collects changes while there are listeners. `asked` collects, while there are watchers, the
    pairs of target and source that were looked up, and `unreported` the pairs that they were not
    called with yet. `crowded` are the histories that got more than `max_samples` for the first time
    and were not reported so far.
    """

    def __init__(self, cache_ns: int, max_samples: int) -> None:
        self.cache_ns = cache_ns
        self.max_samples = max_samples
        self.frames: dict[str, History] = {}
        # By authority the frames whose last transform it sent.
        self.senders: dict[str, dict[str, History]] = {}
        # Recent paths, by the addresses of the texts that they were looked up by.
        self.recent: list[Path | None] = [None] * _RECENT
        # All kept paths, the oldest first, also the ones that the tree has outgrown.
        self.kept: deque[Path] = deque()
        self.kept_cost = 0
        self.topology = 0
        self.assignments = 0
        self.touched: list[History] | None = None
        self.moved: list[History] | None = None
        self.news: list[Change] | None = None
        self.asked: set[tuple[str, str]] | None = None
        self.unreported: list[tuple[str, str]] = []
        self.crowded: list[History] = []

    # Looking up

    def answer(
        self, target_frame: str, source_frame: str, stamp_ns: int | None, sampling: Sampling
    ) -> TransformStamped | None:
        """The transform at a stamp, or with None at the latest common time; None without one."""
        if cython.compiled and sampling is TF2:
            answer = TransformStamped.__new__(TransformStamped)
            if self.fill(answer, target_frame, source_frame, stamp_ns):
                return answer
        path = self.path(target_frame, source_frame)
        if path is None:
            if stamp_ns is not None:
                check_stamp(stamp_ns)
            return self._answer_by_walk(target_frame, source_frame, stamp_ns, sampling)
        stamp = _stamp_on(path, stamp_ns)
        if stamp == NO_DATA:
            if stamp_ns is not None:
                check_stamp(stamp_ns)
            return None
        beyond = 0
        if sampling is not TF2:
            beyond = path.follow_as(stamp, sampling)
            if beyond < 0:
                return self._answer_by_walk(target_frame, source_frame, stamp, sampling)
        elif not path.follow(stamp, False):
            return self._answer_by_walk(target_frame, source_frame, stamp, sampling)
        return make_stamped(stamp, path.target.name, path.source.name, path.pose, beyond)

    def fill(
        self, answer: TransformStamped, target_frame: str, source_frame: str, stamp_ns: int | None
    ) -> bool:
        """Compiled: make a new transform the answer of most lookups; False for the others.

        It runs nothing of Python, so that with the GIL held nothing comes in between, and a lock
        that is free need not be entered.
        """
        # A program mostly uses the same few texts, which need not be compared then.
        path = self.recent[_slot(target_frame, source_frame)]
        if (
            path is None
            or path.asked_target is not target_frame
            or path.asked_source is not source_frame
            or path.topology != self.topology
        ):
            return False
        stamp = _stamp_on(path, stamp_ns)
        # Straight into the answer: a copy would wait until the processor has written the numbers.
        if stamp == NO_DATA or not path.follow_into(cython.address(answer._pose), stamp, False):
            return False
        answer._stamp_ns = stamp
        answer._frame_id, answer._child = path.target.name, path.source.name
        return True

    def path(self, target_frame: str, source_frame: str) -> Path | None:
        """The path as the tree is now; None if a frame is unknown or no path joins the two."""
        target = self.frames.get(target_frame)
        if target is not None:
            path = target.paths.get(source_frame)
            if path is not None and path.topology == self.topology:
                if cython.compiled:
                    path.asked_target, path.asked_source = target_frame, source_frame
                    self.recent[_slot(target_frame, source_frame)] = path
                return path
        return self._seek_path(target_frame, source_frame)

    def _seek_path(self, target_frame: str, source_frame: str) -> Path | None:
        if self.asked is not None:
            self._record_pair((target_frame, source_frame))
        target, source = self.frames.get(target_frame), self.frames.get(source_frame)
        if target is None or source is None:
            return None
        return self._find_path(target, source)

    def _record_pair(self, pair: tuple[str, str]) -> None:
        asked = self.asked
        if asked is not None and pair not in asked:
            if len(asked) >= _MOST_ASKED:
                asked.clear()
            asked.add(pair)
            self.unreported.append(pair)

    def ask_again(self) -> None:
        """Note each pair again at its next lookup."""
        if self.asked is not None:
            self.asked.clear()
            self.topology += 1

    def forget_paths(self) -> None:
        """Find every path again: some may have been found in the middle of a change."""
        self.topology += 1

    def _find_path(self, target: History, source: History) -> Path | None:
        above_target, above_source = self.chain(target), self.chain(source)
        if above_target[-1] is not above_source[-1]:
            return None
        # Both end at the same root: the frames that they share there are not on the path.
        shared = 1
        least = min(len(above_target), len(above_source))
        while shared < least and above_target[-1 - shared] is above_source[-1 - shared]:
            shared += 1
        path = Path(target, source, above_source[:-shared], above_target[:-shared], self.topology)
        target.paths[source.name] = path
        self._keep(path)
        return path

    def _keep(self, path: Path) -> None:
        """Drop the oldest paths if all of them cost too much with this new one."""
        self.kept.append(path)
        self.kept_cost += _PATH_COST + path.count
        while self.kept_cost > _MOST_KEPT and len(self.kept) > 1:
            oldest = self.kept.popleft()
            self.kept_cost -= _PATH_COST + oldest.count
            if oldest.target.paths.get(oldest.source.name) is oldest:
                del oldest.target.paths[oldest.source.name]

    def chain(self, history: History) -> list[History]:
        """The frame and its ancestors now, up to its root.

        Raises LoopException if they are more than all frames, which no insert should bring about.
        """
        above = [history]
        parent = history.parent
        while parent is not None:
            if len(above) > len(self.frames):
                raise LoopException(f"the frames above {history.name!r} are a loop: clear the tree")
            above.append(parent)
            parent = parent.parent
        return above

    def _answer_by_walk(
        self, target_frame: str, source_frame: str, stamp_ns: int | None, sampling: Sampling
    ) -> TransformStamped | None:
        """The answer along the path of that time, by the parents that the samples had then."""
        target, source = self.frames.get(target_frame), self.frames.get(source_frame)
        if target is None or source is None or stamp_ns is None:
            return None
        from_source = self._walk(source, stamp_ns, sampling)
        from_target = self._walk(target, stamp_ns, sampling)
        for down, (frame, _, back_beyond) in enumerate(from_target, start=1):
            for up, (other, _, beyond) in enumerate(from_source, start=1):
                if other is frame:
                    steps = [step for _, step, _ in from_source[1:up]]
                    back = [step for _, step, _ in from_target[1:down]]
                    pose = normalised(chained(steps, back))
                    beyond = max(beyond, back_beyond)
                    return make_stamped(stamp_ns, target.name, source.name, pose, beyond)
        return None

    def walk_end(self, frame: str, stamp_ns: int, sampling: Sampling) -> History:
        """The root above a known frame at that time, or the first edge without data."""
        end: History = self._walk(self.frames[frame], stamp_ns, sampling)[-1][0]
        return end

    def loop_above(self, frame: str, stamp_ns: int, sampling: Sampling) -> list[str]:
        """The frames of the loop at which the way up from a known frame ends at that time, the
        first one that it meets first; [] if it ends at no loop.
        """
        end = self.walk_end(frame, stamp_ns, sampling)
        names = [end.name]
        above = _parent_at(end, stamp_ns, sampling)
        while above is not None and above is not end:
            names.append(above.name)
            above = _parent_at(above, stamp_ns, sampling)
        return names if above is end else []

    def _walk(
        self, history: History, stamp_ns: int, sampling: Sampling
    ) -> list[tuple[History, Pose, int]]:
        """The frame and its ancestors at that time, each with the pose of the frame before in it,
        and how far the poses so far were extrapolated, in nanoseconds.

        Parents of different times may form a loop. It ends at the loop's first frame: along the
        others, two frames would have two answers.
        """
        beyond = 0
        walked = [(history, IDENTITY, beyond)]
        places = {history.name: 0}
        while history.parent is not None:
            if not seek_as(history, stamp_ns, sampling):
                break
            pose = history.pose(sampling.interpolation == "screw")
            beyond = max(beyond, history.beyond)
            above = history.parent_here()
            if above is None:
                break
            if above.name in places:
                return walked[: places[above.name] + 1]
            history = above
            places[history.name] = len(walked)
            walked.append((history, pose, beyond))
        return walked

    # Looking around

    def info(self, frame: str) -> FrameInfo | None:
        """The entry of one frame; None for an unknown one."""
        history = self.frames.get(frame)
        if history is None:
            return None
        children = sorted([child.name for child in self._children(history)])
        return describe(history, children)

    def infos(self) -> list[FrameInfo]:
        """The entries of all frames, sorted by name."""
        children: dict[str, list[str]] = {frame: [] for frame in self.frames}
        for frame in sorted(self.frames):
            history = self.frames[frame]
            if history.parent is not None:
                children[history.parent.name].append(frame)
        return [describe(self.frames[frame], children[frame]) for frame in sorted(self.frames)]

    def held(self) -> dict[str, Held]:
        """All that it holds of each frame, as copies."""
        return {name: history.held() for name, history in self.frames.items()}

    # Filling it

    def restore(self, held: dict[str, Held]) -> None:
        """Hold this, which was checked, and nothing else."""
        frames = {name: History(name) for name in held}
        for name, history in frames.items():
            history.restore(held[name], frames)
            if history.authority:
                self.senders.setdefault(history.authority, {})[name] = history
        self.frames = frames
        self.topology += 1
        self.assignments += 1

    def insert(
        self,
        parent_frame: str,
        child_frame: str,
        stamp_ns: int,
        pose: Pose,
        static: bool,
        authority: str,
    ) -> bool:
        """Store one sample; False if it is too old.

        Raises InvalidArgumentException and LoopException; then nothing has changed.
        """
        child = self.frames.get(child_frame)
        # A gone publisher's samples of later times do not stand in the way of its successor.
        succeeds = child is not None and child.gone and child.authority != authority
        if (
            child is None
            or child.parent is None
            or child.parent.name != parent_frame
            or (child.samples.is_static and not static)
        ):
            if (
                child is not None
                and not static
                and self._is_only_repeated(child, parent_frame, pose, authority)
            ):
                return True
            child, parent = self._join(parent_frame, child_frame, stamp_ns, static, authority)
        else:
            parent = child.parent
        if succeeds:
            child.forget_after(stamp_ns)
        if static:
            if not child.samples.is_static and child.count():
                self._report("became static", child, parent, authority, stamp_ns)
            outcome = child.set_static(stamp_ns, pose, parent)
        else:
            was_static = child.samples.is_static
            outcome = child.insert(stamp_ns, pose, parent, self.cache_ns, self.max_samples)
            if outcome == TOO_OLD:
                self._report("too old", child, parent, authority, stamp_ns)
                return False
            if was_static:
                self._report("became dynamic", child, parent, authority, stamp_ns)
                # Its newest sample may have another parent than the static pose had.
                self.topology += 1
        if outcome == CONFLICT:
            self._report("conflict", child, parent, authority, stamp_ns)
        elif outcome == CROWDED:
            self._note_crowded(child)
        if child.authority != authority:
            self._assign(child, authority, stamp_ns)
        if self.touched is not None:
            self.touched.append(child)
        return True

    def _is_only_repeated(
        self, child: History, parent_frame: str, pose: Pose, authority: str
    ) -> bool:
        """Whether a dynamic sample repeats the pose of a static frame, on behalf of another
        publisher than the living one of that pose, or of an unnamed one: the frame stays static.
        """
        if authority and authority == child.authority:
            return False
        if child.gone or child.ended:
            return False
        return child.is_repeated_by(parent_frame, pose)

    def _note_crowded(self, child: History) -> None:
        if child.crowded_out == 1:
            self.crowded.append(child)

    def _assign(self, child: History, authority: str, stamp_ns: int) -> None:
        """Note the new publisher of a frame, which therefore is not gone."""
        former = self.senders.get(child.authority)
        if former is not None:
            former.pop(child.name, None)
            if not former:
                del self.senders[child.authority]
        if authority:
            self.senders.setdefault(authority, {})[child.name] = child
        self._set_gone(child, False, authority, stamp_ns)
        child.authority = authority
        self.assignments += 1

    def _set_gone(self, child: History, gone: bool, authority: str, stamp_ns: int) -> None:
        if child.gone != gone:
            child.gone = gone
            kind: Kind = "publisher gone" if gone else "publisher back"
            self._report(kind, child, child.parent, authority, stamp_ns)
            if self.moved is not None:
                # Lookups may wait for a living publisher.
                self.moved.append(child)

    def _join(
        self, parent_frame: str, child_frame: str, stamp_ns: int, static: bool, authority: str
    ) -> tuple[History, History]:
        """The histories of a child and of a parent other than the one above it now, or of a static
        child that becomes dynamic; both in the tree, unless the sample is too old.
        """
        check_frame_id(parent_frame, "frame_id")
        check_frame_id(child_frame, "child_frame_id")
        if parent_frame == child_frame:
            raise InvalidArgumentException(
                f"frame {child_frame!r} cannot be its own parent: frame_id and child_frame_id "
                "must differ"
            )
        child, parent = self.frames.get(child_frame), self.frames.get(parent_frame)
        if parent is None:
            parent = History(parent_frame)
        if child is None:
            child = History(child_frame)
        after = parent
        if child.parent is not None and not (child.gone and child.authority != authority):
            # Its samples decide.
            child.forget_removed()
            if not static and child.is_too_old(stamp_ns, self.cache_ns):
                return child, parent
            after = child.parent_after(stamp_ns, parent, static)
        if after is not child.parent:
            self._refuse_loop(after, child, authority)
        if parent_frame not in self.frames:
            self._add(parent, authority, stamp_ns)
        if child_frame not in self.frames:
            self._add(child, authority, stamp_ns)
        elif after is not child.parent:
            if child.parent is not None:
                self._report("reparented", child, after, authority, stamp_ns)
            self.topology += 1
            if self.moved is not None:
                self.moved.append(child)
        if child.parent is None:
            child.set_parent(parent)
        return child, parent

    def _add(self, history: History, authority: str, stamp_ns: int) -> None:
        self.frames[history.name] = history
        self._report("added", history, None, authority, stamp_ns)
        if self.touched is not None:
            self.touched.append(history)

    def _refuse_loop(self, parent: History, child: History, authority: str) -> None:
        """Raise LoopException if the child is above this parent now, unless one of the edges
        between the two yields.
        """
        if child.children == 0:
            # It is above no frame, so the way up from the parent need not be walked.
            return
        above = self.chain(parent)
        if child not in above:
            return
        closing = above[: above.index(child)]
        yielding = self._yielding(closing)
        if yielding is not None:
            self._detach(yielding)
            return
        other = closing[-1].authority
        names = " -> ".join([repr(history.name) for history in [child, *closing[::-1]]])
        raise LoopException(
            f"the edge {parent.name!r} -> {child.name!r} from {_who(authority)} would close a "
            f"loop with {names}, whose first edge is from {_who(other)}: one of them has parent "
            "and child the wrong way round",
            path=tuple([history.name for history in [*closing, child]]),
            authority=authority,
            other_authority=other,
        )

    def _yielding(self, closing: list[History]) -> History | None:
        """The edge that yields to a new one: one without samples, or whose publisher is gone or has
        begun a new epoch. None if all of them hold.
        """
        for history in closing:
            if history.count() == 0:
                return history
        for history in closing:
            if history.gone or history.ended:
                return history
        return None

    def _detach(self, history: History) -> None:
        """Forget a frame's place in its parent, and its history."""
        self._report("removed", history, history.parent, history.authority, 0)
        history.forget()
        history.gone = False
        self._assign(history, "", 0)
        self.topology += 1
        if self.moved is not None:
            self.moved.append(history)

    def clear(self) -> None:
        """Forget all samples; static poses and all names stay."""
        for history in self.frames.values():
            history.forget_samples()

    def interrupt(self, reason: str) -> None:
        """As `Buffer.interrupt`."""
        for history in self.frames.values():
            history.interrupt(reason)

    def clear_after(self, stamp_ns: int) -> None:
        """Forget the samples later than a time."""
        for history in self.frames.values():
            history.forget_after(stamp_ns)

    def sent_by(self, authority: str, frames: Iterable[str]) -> dict[str, int]:
        """The frames that an authority sent last, and how many samples of each are held,
        of a static one 0.
        """
        sent = self.senders.get(authority, {})
        found = [sent[frame] for frame in frames if frame in sent]
        return {history.name: 0 if history.static else history.count() for history in found}

    def forget(self, authority: str, frames: Iterable[str]) -> None:
        """Forget the samples of the frames that an authority sent last; static poses stay."""
        sent = self.senders.get(authority, {})
        for frame in frames:
            history = sent.get(frame)
            if history is not None:
                history.forget_samples()
                history.ended = history.static

    def mark_gone(self, frames: Iterable[str], gone: bool, authority: str) -> None:
        """Mark the frames that the authority sent last."""
        sent = self.senders.get(authority, {})
        for frame in frames:
            history = sent.get(frame)
            if history is not None:
                self._set_gone(history, gone, authority, 0)

    def remove(self, frame: str) -> bool:
        """Forget a frame's place in its parent, and the frame itself if it has no children.

        False for an unknown frame.
        """
        history = self.frames.get(frame)
        if history is None:
            return False
        self._detach(history)
        if not history.children:
            history.removed = True
            del self.frames[frame]
        return True

    def remove_sent(self, frame: str, authority: str) -> bool:
        """Remove a frame if this authority sent it last; whether it did."""
        return frame in self.senders.get(authority, {}) and self.remove(frame)

    def _children(self, parent: History) -> list[History]:
        found: list[History] = []
        for history in self.frames.values():
            if len(found) == parent.children:
                break  # of a leaf at once: most questions are about one
            if history.parent is parent:
                found.append(history)
        return found

    def _report(
        self, kind: Kind, child: History, parent: History | None, authority: str, stamp_ns: int
    ) -> None:
        if self.news is not None:
            former = child.parent
            self.news.append(
                Change(
                    kind,
                    child.name,
                    None if parent is None else parent.name,
                    None if former is None else former.name,
                    authority,
                    child.authority,
                    stamp_ns,
                )
            )


def _parent_at(history: History, stamp_ns: int, sampling: Sampling) -> History | None:
    """The parent at that time; None for a root, and without data."""
    if history.parent is None or not seek_as(history, stamp_ns, sampling):
        return None
    return history.parent_here()


def _stamp_on(path: Path, stamp_ns: int | None) -> int:
    """The stamp, or with None the latest common one, 0 if all is static; NO_DATA without one,
    or if it has more than 64 bits.
    """
    if stamp_ns is not None:
        return packed.int64(stamp_ns)
    latest = path.latest()
    return 0 if latest == ALL_STATIC else latest


def _slot(target_frame: str, source_frame: str) -> int:
    """Compiled: a place in `recent`, by the addresses of the two texts."""
    target = cython.cast(cython.size_t, cython.cast(cython.p_void, target_frame))
    source = cython.cast(cython.size_t, cython.cast(cython.p_void, source_frame))
    return (target // 16 + source // 16 * 5) & (_RECENT - 1)  # type: ignore[no-any-return]  # C's own


def describe(history: History, children: list[str]) -> FrameInfo:
    """The tree's entry of a frame."""
    span = history.stamp_span()
    count = history.count()
    rate_hz = None
    if span is not None and not history.static:
        interruptions, interrupted_ns = history.interrupted()
        periods, known_ns = count - 1 - interruptions, span[1] - span[0] - interrupted_ns
        if known_ns > 0:
            rate_hz = periods * 1e9 / known_ns
    return FrameInfo(
        name=history.name,
        parent=None if history.parent is None else history.parent.name,
        children=tuple(children),
        static=history.static,
        samples=count,
        rate_hz=rate_hz,
        oldest_ns=None if span is None else span[0],
        newest_ns=None if span is None else span[1],
        authority=history.authority,
        conflicts=history.conflicts,
        refused=history.refused,
        crowded_out=history.crowded_out,
        gone=history.gone,
    )


def _who(authority: str) -> str:
    return repr(authority) if authority else "an unnamed publisher"
