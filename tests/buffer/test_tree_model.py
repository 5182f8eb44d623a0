"""The tree in any order of changes, against a plain model that looks at everything each time."""

from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from tests.builders import examples, moved
from tfbus.base.errors import (
    InvalidArgumentException,
    LookupException,
    LoopException,
    TransformException,
)
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.files import load, save

CACHE_NS = 60
FRAMES = "abcde"
AUTHORITIES = ("", "arm", "base")

frames = st.sampled_from(FRAMES)
authorities = st.sampled_from(AUTHORITIES)
stamps = st.integers(0, 15).map(lambda tens: 10 * tens)
places = st.integers(0, 2).map(float)


@dataclass
class Frame:
    """A frame as the model has it: `samples` are the parent, None where it was removed, and x by
    stamp; `mixed_until` is the last stamp up to which the parents may differ.
    """

    parent: str | None = None
    samples: dict[int, tuple[str | None, float]] = field(default_factory=dict)
    static: tuple[str, float] | None = None
    mixed_until: int | None = None
    authority: str = ""
    gone: bool = False
    ended: bool = False

    def newest(self) -> int | None:
        """The stamp of the newest sample."""
        return max(self.samples, default=None)

    def clear(self) -> None:
        """Drop the samples."""
        self.samples, self.mixed_until = {}, None

    def clear_after(self, stamp: int) -> None:
        """Drop the later samples; all of them where the parent has changed."""
        kept = {t: sample for t, sample in self.samples.items() if t <= stamp}
        if len(kept) < len(self.samples):
            if self.mixed_until is not None:
                kept = {}
            self.samples = kept
            self.mixed_until = self.mixed_until if kept else None

    def mix(self, until: int) -> None:
        """Up to this stamp the parents may differ."""
        self.mixed_until = until if self.mixed_until is None else max(self.mixed_until, until)

    def move(self, parent: str) -> None:
        """Get another parent."""
        if parent != self.parent and self.samples:
            self.mix(max(self.samples))
        self.parent = parent

    def at(self, stamp: int) -> tuple[str | None, float] | None:
        """Its parent and x in it at a time; None where that is not known."""
        if self.static is not None:
            return self.static
        if not self.samples or not min(self.samples) <= stamp <= max(self.samples):
            return None
        before = max(t for t in self.samples if t <= stamp)
        after = min(t for t in self.samples if t >= stamp)
        (parent, x), (other, y) = self.samples[before], self.samples[after]
        if parent != other or before == after:
            return parent, x
        return parent, x + (y - x) * (stamp - before) / (after - before)


class Model:
    """The tree, slow and plain."""

    def __init__(self) -> None:
        self.frames: dict[str, Frame] = {}

    def above(self, frame: str) -> list[str]:
        """The frame and those above it now."""
        names = [frame]
        while (parent := self.frames[names[-1]].parent) is not None:
            assert parent not in names
            names.append(parent)
        return names

    def insert(
        self, parent: str, child: str, stamp: int, x: float, static: bool, authority: str
    ) -> bool:
        """As `Buffer.set_transform`."""
        known = self.frames.get(child, Frame())
        succeeds = known.gone and known.authority != authority
        is_repeated = not static and known.static == (parent, x) and not known.gone
        if is_repeated and not known.ended and (not authority or authority != known.authority):
            return True
        samples, newest, after = known.samples, known.newest(), parent
        if known.static and not static and newest is not None and samples[newest][0] is None:
            samples, newest = {}, None
        if not static and newest is not None and not succeeds:
            if newest - stamp > CACHE_NS:
                return False
            if stamp < newest:
                after = samples[newest][0] or parent
        if after != known.parent and after in self.frames:
            self.make_way(after, child)
        self.frames.setdefault(parent, Frame())
        frame = self.frames.setdefault(child, known)
        if samples is not frame.samples:
            frame.clear()
        if succeeds:
            frame.clear_after(stamp)
        if static:
            frame.static, frame.ended = (parent, x), False
            frame.move(parent)
        else:
            self.add(frame, parent, stamp, x)
        if frame.authority != authority:
            frame.authority, frame.gone = authority, False
        return True

    def add(self, frame: Frame, parent: str, stamp: int, x: float) -> None:
        """A dynamic sample that is not too old."""
        newest = frame.newest()
        if frame.static is not None:
            frame.static, frame.ended = None, False
            if newest is not None:
                frame.parent = frame.samples[newest][0]
        if newest is None or stamp > newest:
            frame.samples = {t: s for t, s in frame.samples.items() if t >= stamp - CACHE_NS}
            frame.move(parent)
            oldest = min(frame.samples, default=None)
            if oldest is None or (frame.mixed_until is not None and oldest > frame.mixed_until):
                frame.mixed_until = None
        elif stamp not in frame.samples:
            if parent != frame.parent:
                frame.mix(stamp)
        elif frame.samples[stamp][0] != parent:
            frame.mix(stamp)
            if stamp == newest:
                frame.parent = parent
        frame.samples[stamp] = (parent, x)

    def make_way(self, parent: str, child: str) -> None:
        """Detach what yields of the edges that would make a loop with a new one, or raise."""
        above = self.above(parent)
        if child not in above:
            return
        closing = above[: above.index(child)]
        edges = [self.frames[name] for name in closing]
        empty = [edge for edge in edges if edge.static is None and not edge.samples]
        yielding = empty + [edge for edge in edges if edge.gone or edge.ended]
        if not yielding:
            raise LoopException("a loop")
        yielding[0].__init__()

    def remove(self, name: str) -> None:
        """As `Buffer.remove`."""
        if name not in self.frames:
            raise LookupException("unknown")
        self.frames[name].__init__()
        if all(frame.parent != name for frame in self.frames.values()):
            del self.frames[name]
            for frame in self.frames.values():
                for stamp, (parent, x) in frame.samples.items():
                    if parent == name:
                        frame.samples[stamp] = (None, x)

    def sent_by(self, authority: str) -> dict[str, Frame]:
        """The frames whose last transform this authority sent."""
        return {n: f for n, f in self.frames.items() if authority and f.authority == authority}

    def lookup(self, target: str, source: str, stamp: int) -> float | None:
        """The source's x in the target; None where that is not known."""
        if target not in self.frames or source not in self.frames:
            return None
        from_source = self.walk(source, stamp)
        for frame, back in self.walk(target, stamp):
            for other, x in from_source:
                if other == frame:
                    return x - back
        return None

    def is_loop_at(self, stamp: int) -> bool:
        """Whether parents of different times make a loop at that one, so that it depends on the way
        what a lookup answers.
        """
        return any(len(self.walk(frame, stamp)) > len(self.frames) for frame in self.frames)

    def walk(self, frame: str, stamp: int) -> list[tuple[str, float]]:
        """The frame and those above it at a time, and where it is in each."""
        walked = [(frame, 0.0)]
        while len(walked) <= len(self.frames):
            edge = self.frames[walked[-1][0]].at(stamp)
            if edge is None or edge[0] is None:
                break
            walked.append((edge[0], walked[-1][1] + edge[1]))
        return walked


class TreeMachine(RuleBasedStateMachine):
    """Makes the same changes to a buffer and to the model."""

    def __init__(self) -> None:
        super().__init__()
        self.buffer = Buffer(CACHE_NS / 1e9)
        self.files = TemporaryDirectory()
        self.model = Model()

    @rule(
        parent=frames,
        child=frames,
        stamp=stamps,
        x=places,
        static=st.sampled_from([False, False, False, True]),
        authority=authorities,
    )
    def insert(self, parent, child, stamp, x, static, authority):
        """One transform: stored, too old or refused as in the model."""
        transform = moved(stamp, parent, child, x)
        if parent == child:
            with pytest.raises(InvalidArgumentException):
                self.buffer.set_transform(transform, static=static, authority=authority)
            return
        try:
            expected = self.model.insert(parent, child, stamp, x, static, authority)
        except LoopException:
            with pytest.raises(LoopException):
                self.buffer.set_transform(transform, static=static, authority=authority)
        else:
            stored = self.buffer.set_transform(transform, static=static, authority=authority)
            assert stored == expected

    @rule(frame=frames)
    def remove(self, frame):
        """One frame, if it is known."""
        try:
            self.model.remove(frame)
        except LookupException:
            with pytest.raises(LookupException):
                self.buffer.remove(frame)
        else:
            self.buffer.remove(frame)

    @rule(names=st.lists(frames), authority=authorities)
    def remove_sent(self, names, authority):
        """Remove the frames of some names that an authority sent last."""
        self.buffer.remove_sent(names, authority)
        for name in names:
            if name in self.model.sent_by(authority):
                self.model.remove(name)

    @rule()
    def save_and_load(self):
        """The buffer goes on as it was."""
        path = Path(self.files.name) / "buffer.npz"
        save(self.buffer, path)
        self.buffer = load(path)

    def teardown(self):
        """Remove the files."""
        self.files.cleanup()

    @rule()
    def clear(self):
        """All samples."""
        self.buffer.clear()
        for frame in self.model.frames.values():
            frame.clear()

    @rule(stamp=stamps)
    def clear_after(self, stamp):
        """The later samples."""
        self.buffer.clear(after_ns=stamp)
        for frame in self.model.frames.values():
            frame.clear_after(stamp)

    @rule(authority=authorities)
    def restart(self, authority):
        """An authority has restarted."""
        self.buffer.forget(authority)
        for frame in self.model.sent_by(authority).values():
            frame.clear()
            frame.ended = frame.static is not None

    @rule(authority=authorities, gone=st.booleans())
    def mark_gone(self, authority, gone):
        """An authority is gone, or back."""
        self.buffer.mark_gone(FRAMES, gone, authority)
        for frame in self.model.sent_by(authority).values():
            frame.gone = gone

    @invariant()
    def there_is_no_loop(self):
        """The parents of the buffer are those of the model, which has no loop."""
        infos = self.buffer.all_frames()
        assert {i.name: i.parent for i in infos} == {
            name: frame.parent for name, frame in self.model.frames.items()
        }
        for info in infos:
            frame = self.model.frames[info.name]
            self.model.above(info.name)
            children = [n for n, f in self.model.frames.items() if f.parent == info.name]
            assert list(info.children) == sorted(children)
            assert (info.authority, info.gone) == (frame.authority, frame.gone)
            assert info.samples == (1 if frame.static else len(frame.samples))

    @invariant()
    def every_lookup_answers_as_the_model(self):
        """Any two frames at any time: the model's answer, or an error of the family."""
        for target in FRAMES:
            for source in FRAMES:
                for stamp in (0, 55, 100, 150):
                    expected = self.model.lookup(target, source, stamp)
                    try:
                        answer = self.buffer.lookup_transform(target, source, stamp)
                    except TransformException:
                        assert expected is None or self.model.is_loop_at(stamp)
                    else:
                        if not self.model.is_loop_at(stamp):
                            assert answer.transform.x == pytest.approx(expected), (target, source)


TestTree = TreeMachine.TestCase
TestTree.settings = settings(deadline=None, max_examples=examples(60), stateful_step_count=30)
