"""The tree of frames: who hangs below whom, and the way between any two.

One of the modules that are compiled where there is a C compiler (`tree.pxd` says the C types).
Nothing here locks: the buffer holds its lock around every call.
"""

from collections.abc import Iterable

from tfbus.buffer.info import Change, FrameInfo, Kind
from tfbus.core.kernel import IDENTITY, History, Path, Pose, compose, invert, normalised, seek_as
from tfbus.core.outcome import ALL_STATIC, CONFLICT, NO_DATA, TOO_OLD
from tfbus.core.sampling import TF2, Sampling
from tfbus.errors import InvalidArgumentException, LoopException
from tfbus.geometry.transform import TransformStamped, check_frame_id, make_stamped

try:
    import cython
except ImportError:
    from tfbus.core import cython_stub as cython

# Paths are found again in a microsecond; so many of one target are worth keeping.
_MOST_PATHS = 1024
# Of so many pairs it is remembered that they were asked for.
_MOST_ASKED = 100_000

# So many paths are found by the very texts that they were asked for by; a power of two.
_RECENT = 64


class Tree:
    """All frames by name, each with its history.

    `topology` counts the changes after which a path that was found may be another: a frame that
    had been there got a parent, or another parent; `assignments` counts how often a frame was sent
    by another one than before. `touched` and `moved` gather, while somebody
    waits, the histories that got a sample or a parent; `news` gathers, while somebody listens,
    what changed. `asked` gathers, while somebody wants to know, the pairs of target and source
    that a path was looked for between, and `unreported` those of them that he was not told of.
    """

    def __init__(self, cache_ns: int) -> None:
        self.cache_ns = cache_ns
        self.frames: dict[str, History] = {}
        # Of each authority the frames whose last transform it sent.
        self.senders: dict[str, dict[str, History]] = {}
        # Paths found of late, by where the texts stand in memory that they were asked for by.
        self.recent: list[Path | None] = [None] * _RECENT
        self.topology = 0
        self.assignments = 0
        self.touched: list[History] | None = None
        self.moved: list[History] | None = None
        self.news: list[Change] | None = None
        self.asked: set[tuple[str, str]] | None = None
        self.unreported: list[tuple[str, str]] = []

    # Looking up

    def answer(
        self, target_frame: str, source_frame: str, stamp_ns: int | None, sampling: Sampling
    ) -> TransformStamped | None:
        """The transform, `stamp_ns` None being the latest common time; None: there is none."""
        path = self.path(target_frame, source_frame)
        if path is None:
            return self._answer_by_walk(target_frame, source_frame, stamp_ns, sampling)
        if stamp_ns is None:
            latest = path.latest()
            if latest == NO_DATA:
                return None
            stamp = 0 if latest == ALL_STATIC else latest
        else:
            stamp = stamp_ns
        beyond = 0
        if sampling is not TF2:
            beyond = path.follow_as(stamp, sampling)
            if beyond < 0:
                return self._answer_by_walk(target_frame, source_frame, stamp, sampling)
        elif not path.follow(stamp, False):
            return self._answer_by_walk(target_frame, source_frame, stamp, sampling)
        return make_stamped(stamp, path.target.name, path.source.name, path.pose, beyond)

    def path(self, target_frame: str, source_frame: str) -> Path | None:
        """The path as the tree is now; None where a frame is unknown or nothing joins them."""
        slot = 0
        if cython.compiled:
            # A program mostly asks with the same few texts, which need not be compared then.
            slot = _slot(target_frame, source_frame)
            path = self.recent[slot]
            if (
                path is not None
                and path.asked_target is target_frame
                and path.asked_source is source_frame
                and path.topology == self.topology
            ):
                return path
        target = self.frames.get(target_frame)
        if target is not None:
            path = target.paths.get(source_frame)
            if path is not None and path.topology == self.topology:
                if cython.compiled:
                    path.asked_target, path.asked_source = target_frame, source_frame
                    self.recent[slot] = path
                return path
        return self._seek_path(target_frame, source_frame)

    def _seek_path(self, target_frame: str, source_frame: str) -> Path | None:
        if self.asked is not None:
            self._note((target_frame, source_frame))
        target, source = self.frames.get(target_frame), self.frames.get(source_frame)
        if target is None or source is None:
            return None
        return self._find_path(target, source)

    def _note(self, pair: tuple[str, str]) -> None:
        asked = self.asked
        if asked is not None and pair not in asked:
            if len(asked) >= _MOST_ASKED:
                asked.clear()
            asked.add(pair)
            self.unreported.append(pair)

    def ask_again(self) -> None:
        """Note each pair anew when it is asked for next."""
        if self.asked is not None:
            self.asked.clear()
            self.topology += 1

    def _find_path(self, target: History, source: History) -> Path | None:
        above_target, above_source = chain(target), chain(source)
        if above_target[-1] is not above_source[-1]:
            return None
        # Both end at the same root: what they share at that end is not on the way.
        shared = 1
        least = min(len(above_target), len(above_source))
        while shared < least and above_target[-1 - shared] is above_source[-1 - shared]:
            shared += 1
        path = Path(target, source, above_source[:-shared], above_target[:-shared], self.topology)
        if len(target.paths) >= _MOST_PATHS:
            target.paths.clear()
        target.paths[source.name] = path
        return path

    def _answer_by_walk(
        self, target_frame: str, source_frame: str, stamp_ns: int | None, sampling: Sampling
    ) -> TransformStamped | None:
        """The way as it was at that time, by the parents that the samples had then."""
        target, source = self.frames.get(target_frame), self.frames.get(source_frame)
        if target is None or source is None or stamp_ns is None:
            return None
        from_source = self._walk(source, stamp_ns, sampling)
        for frame, back, back_beyond in self._walk(target, stamp_ns, sampling):
            for other, pose, beyond in from_source:
                if other is frame:
                    whole = normalised(compose(invert(back), pose))
                    beyond = max(beyond, back_beyond)
                    return make_stamped(stamp_ns, target.name, source.name, whole, beyond)
        return None

    def walk_end(self, frame: str, stamp_ns: int, sampling: Sampling) -> History:
        """The root above a known frame at that time, or the edge without data in the way."""
        end: History = self._walk(self.frames[frame], stamp_ns, sampling)[-1][0]
        return end

    def _walk(
        self, history: History, stamp_ns: int, sampling: Sampling
    ) -> list[tuple[History, Pose, int]]:
        """The frame and those above it at that time, each with the pose of the first in it, and
        how far that was extrapolated.
        """
        pose = IDENTITY
        beyond = 0
        walked = [(history, pose, beyond)]
        # Parents of different times could make a circle, but no way is longer than all frames.
        while history.parent is not None and len(walked) <= len(self.frames):
            if not seek_as(history, stamp_ns, sampling):
                break
            pose = compose(history.pose(sampling.interpolation == "screw"), pose)
            beyond = max(beyond, history.beyond)
            above = history.parent_here()
            if above is None:
                break
            history = above
            walked.append((history, pose, beyond))
        return walked

    # Looking around

    def info(self, frame: str) -> FrameInfo | None:
        """What is known of one frame; None where it is not known."""
        history = self.frames.get(frame)
        if history is None:
            return None
        children = sorted([child.name for child in self._children(history)])
        return describe(history, children)

    def infos(self) -> list[FrameInfo]:
        """What is known of every frame, sorted by name."""
        children: dict[str, list[str]] = {frame: [] for frame in self.frames}
        for frame in sorted(self.frames):
            history = self.frames[frame]
            if history.parent is not None:
                children[history.parent.name].append(frame)
        return [describe(self.frames[frame], children[frame]) for frame in sorted(self.frames)]

    # Filling it

    def insert(
        self,
        parent_frame: str,
        child_frame: str,
        stamp_ns: int,
        pose: Pose,
        static: bool,
        authority: str,
    ) -> bool:
        """Take one sample; False where it is too old to be kept.

        Raises InvalidArgumentException and LoopException; then nothing has changed.
        """
        child = self.frames.get(child_frame)
        if child is None or child.parent is None or child.parent.name != parent_frame:
            child, parent = self._join(parent_frame, child_frame, stamp_ns, static, authority)
        else:
            parent = child.parent
        if static:
            if not child.samples.is_static and child.count():
                self._tell("became static", child, parent, authority, stamp_ns)
            outcome = child.fix(stamp_ns, pose, parent)
        else:
            was_static = child.samples.is_static
            outcome = child.insert(stamp_ns, pose, parent, self.cache_ns)
            if outcome == TOO_OLD:
                self._tell("too old", child, parent, authority, stamp_ns)
                return False
            if was_static:
                self._tell("became dynamic", child, parent, authority, stamp_ns)
                # Its newest sample may be of another parent than the static pose was.
                self.topology += 1
        if outcome == CONFLICT:
            self._tell("conflict", child, parent, authority, stamp_ns)
        if child.authority != authority:
            self._assign(child, authority, stamp_ns)
        if self.touched is not None:
            self.touched.append(child)
        return True

    def _assign(self, child: History, authority: str, stamp_ns: int) -> None:
        """Note that another one sends this frame now, which therefore is not gone."""
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
            self._tell(kind, child, child.parent, authority, stamp_ns)
            if self.moved is not None:
                # It matters to those who wait for a living publisher.
                self.moved.append(child)

    def _join(
        self, parent_frame: str, child_frame: str, stamp_ns: int, static: bool, authority: str
    ) -> tuple[History, History]:
        """The histories of a child and of a parent that is not, or not yet, the one above it."""
        check_frame_id(parent_frame, "frame_id")
        check_frame_id(child_frame, "child_frame_id")
        if parent_frame == child_frame:
            raise InvalidArgumentException(
                f"frame {child_frame!r} cannot be its own parent: frame_id and child_frame_id "
                "are to differ"
            )
        child, parent = self.frames.get(child_frame), self.frames.get(parent_frame)
        if child is None:
            if parent is None:
                parent = self._add(parent_frame, authority, stamp_ns)
            child = self._add(child_frame, authority, stamp_ns)
            child.parent = parent
            return child, parent
        if parent is None:
            parent = self._add(parent_frame, authority, stamp_ns)
        after = child.parent_after(stamp_ns, parent, static)
        if after is not child.parent:
            if after is not None:
                self._refuse_loop(after, child, authority)
            if child.parent is not None:
                self._tell("reparented", child, after, authority, stamp_ns)
            self.topology += 1
            if self.moved is not None:
                self.moved.append(child)
        if child.parent is None:
            child.parent = parent
        return child, parent

    def _add(self, frame: str, authority: str, stamp_ns: int) -> History:
        history = History(frame)
        self.frames[frame] = history
        self._tell("added", history, None, authority, stamp_ns)
        if self.touched is not None:
            self.touched.append(history)
        return history

    def _refuse_loop(self, parent: History, child: History, authority: str) -> None:
        above = chain(parent)
        if child not in above:
            return
        closing = above[: above.index(child)]
        for history in closing:
            if history.count() == 0:
                # Its samples were cleared: it holds nothing together any more.
                history.parent = None
                self.topology += 1
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

    def clear(self) -> None:
        """Forget all samples; static poses and all names stay."""
        for history in self.frames.values():
            history.forget_samples()

    def clear_after(self, stamp_ns: int) -> None:
        """Forget the samples later than a time."""
        for history in self.frames.values():
            history.forget_after(stamp_ns)

    def sent_by(self, authority: str) -> dict[str, int]:
        """The frames that an authority sent last, and how many samples of each are held, those
        of static transforms not counted.
        """
        return {
            name: 0 if history.static else history.count()
            for name, history in self.senders.get(authority, {}).items()
        }

    def forget(self, authority: str, frames: Iterable[str] | None) -> None:
        """Forget the samples of what an authority sent last, of all of it or of these frames;
        static poses stay.
        """
        sent = self.senders.get(authority, {})
        for frame in sent if frames is None else frames:
            history = sent.get(frame)
            if history is not None:
                history.forget_samples()

    def mark_gone(self, frames: Iterable[str], gone: bool, authority: str) -> None:
        """Mark those of the frames that the authority sent last."""
        sent = self.senders.get(authority, {})
        for frame in frames:
            history = sent.get(frame)
            if history is not None:
                self._set_gone(history, gone, authority, 0)

    def remove(self, frame: str) -> bool:
        """Forget a frame's place in its parent, and the frame where nothing hangs below it.

        False where it is not known.
        """
        history = self.frames.get(frame)
        if history is None:
            return False
        self._tell("removed", history, history.parent, history.authority, 0)
        history.forget()
        history.gone = False
        self._assign(history, "", 0)
        self.topology += 1
        if not self._children(history):
            del self.frames[frame]
        return True

    def remove_sent(self, frame: str, authority: str) -> bool:
        """Remove a frame where this authority sent it last; whether it was so."""
        return frame in self.senders.get(authority, {}) and self.remove(frame)

    def _children(self, parent: History) -> list[History]:
        return [history for history in self.frames.values() if history.parent is parent]

    def _tell(
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


def _slot(target_frame: str, source_frame: str) -> int:
    """Compiled: a place in `recent`, by where the two texts stand in memory."""
    target = cython.cast(cython.size_t, cython.cast(cython.p_void, target_frame))
    source = cython.cast(cython.size_t, cython.cast(cython.p_void, source_frame))
    return (target // 16 + source // 16 * 5) % _RECENT  # type: ignore[no-any-return]  # C's own


def describe(history: History, children: list[str]) -> FrameInfo:
    """What is known of a frame, as a value to keep."""
    span = history.stamp_span()
    count = history.count()
    rate_hz = None
    if span is not None and not history.static and span[1] > span[0]:
        rate_hz = (count - 1) * 1e9 / (span[1] - span[0])
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
        gone=history.gone,
    )


def chain(history: History) -> list[History]:
    """The frame and those above it now, up to its root."""
    above = [history]
    parent = history.parent
    while parent is not None:
        above.append(parent)
        parent = parent.parent
    return above


def _who(authority: str) -> str:
    return repr(authority) if authority else "an unnamed publisher"
