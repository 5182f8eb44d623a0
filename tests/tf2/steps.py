"""Calls that can be put to both tfbus and tf2, one step at a time. Not a test itself.

A step knows how to put itself to a `tfbus.Buffer`, how to tell itself to tests/tf2/oracle.py, and
how to write itself down as Python. Both sides answer with an `Answer`.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

from tfbus import Buffer, Transform, TransformException, TransformStamped
from tfbus.base.errors import ExtrapolationException, InvalidArgumentException, LoopException

Pose = tuple[float, float, float, float, float, float, float]

# What tf2 raises, whose Python binding has one kind of extrapolation only; and what it cannot say.
_KINDS = ("LookupException", "ConnectivityException", "TimeoutException", "LoopException")


@dataclass(frozen=True)
class Answer:
    """What one side says to one step: a word, and what comes with it.

    The word is "transform", "stamp", "accepted", "rejected", "yes", "no", "frames", "cleared", the
    name of tf2's exception, or "LoopException", which only tfbus says. `text` is a reason, and
    never compared.
    """

    word: str
    stamp_ns: int | None = None
    pose: Pose | None = None
    names: tuple[str, ...] = ()
    text: str = ""

    def agrees(self, other: "Answer", tolerance: float) -> bool:
        """The same word, stamp and names; poses within the tolerance, quaternions up to sign."""
        if (self.word, self.stamp_ns, self.names) != (other.word, other.stamp_ns, other.names):
            return False
        if self.pose is None or other.pose is None:
            return self.pose is other.pose
        return _distance(self.pose, other.pose) <= tolerance

    def __str__(self) -> str:
        facts = [self.word, self.stamp_ns, self.pose, ", ".join(self.names), self.text.strip()]
        return " ".join(str(fact) for fact in facts if fact not in (None, ""))


class Step(ABC):
    """One insert or one question."""

    def ask(self, buffer: Buffer) -> Answer:
        """Put it to tfbus; an exception of the transforms is an answer too."""
        try:
            return self._ask(buffer)
        except TransformException as error:
            return Answer(_kind(error), text=str(error))

    @abstractmethod
    def _ask(self, buffer: Buffer) -> Answer:
        """Put it to tfbus."""

    @abstractmethod
    def for_tf2(self) -> list[Any]:
        """The step as the oracle takes it."""

    def stamps(self) -> tuple[int | None, ...]:
        """The times that it names."""
        return ()

    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The (target, source) that it asks about."""
        return ()

    @abstractmethod
    def python(self) -> str:
        """The step as a line of Python, where `buffer` is a tfbus.Buffer."""


@dataclass(frozen=True)
class Insert(Step):
    """One transform; the pose takes points of the child into the parent."""

    parent: str
    child: str
    stamp_ns: int
    pose: Pose
    static: bool = False

    def stamped(self) -> TransformStamped:
        """The transform as tfbus takes it."""
        transform = Transform(self.pose[:3], self.pose[3:])
        return TransformStamped(self.stamp_ns, self.parent, self.child, transform)

    def _ask(self, buffer: Buffer) -> Answer:
        accepted = buffer.set_transform(self.stamped(), static=self.static)
        return Answer("accepted" if accepted else "rejected")

    def for_tf2(self) -> list[Any]:
        return ["set", self.parent, self.child, self.stamp_ns, self.pose, self.static]

    def stamps(self) -> tuple[int | None, ...]:
        return (self.stamp_ns,)

    def python(self) -> str:
        static = ", static=True" if self.static else ""
        return (
            f"buffer.set_transform(TransformStamped({self.stamp_ns}, {self.parent!r}, "
            f"{self.child!r}, Transform({self.pose[:3]}, {self.pose[3:]})){static})"
        )


@dataclass(frozen=True)
class Lookup(Step):
    """The source seen from the target at one time; None is the latest common time."""

    target: str
    source: str
    stamp_ns: int | None

    def _ask(self, buffer: Buffer) -> Answer:
        return _transform(buffer.lookup_transform(self.target, self.source, self.stamp_ns))

    def for_tf2(self) -> list[Any]:
        return ["lookup", self.target, self.source, self.stamp_ns]

    def stamps(self) -> tuple[int | None, ...]:
        return (self.stamp_ns,)

    def pairs(self) -> tuple[tuple[str, str], ...]:
        return ((self.target, self.source),)

    def python(self) -> str:
        return f"buffer.lookup_transform({self.target!r}, {self.source!r}, {self.stamp_ns})"


@dataclass(frozen=True)
class LookupFull(Step):
    """The source at its time, seen from the target at its own, through a fixed frame."""

    target: str
    target_stamp_ns: int | None
    source: str
    source_stamp_ns: int | None
    fixed: str

    def _ask(self, buffer: Buffer) -> Answer:
        return _transform(
            buffer.lookup_transform_full(
                self.target, self.target_stamp_ns, self.source, self.source_stamp_ns, self.fixed
            )
        )

    def for_tf2(self) -> list[Any]:
        times = self.target_stamp_ns, self.source_stamp_ns
        return ["full", self.target, times[0], self.source, times[1], self.fixed]

    def stamps(self) -> tuple[int | None, ...]:
        return self.target_stamp_ns, self.source_stamp_ns

    def pairs(self) -> tuple[tuple[str, str], ...]:
        return (self.fixed, self.source), (self.target, self.fixed)

    def python(self) -> str:
        return (
            f"buffer.lookup_transform_full({self.target!r}, {self.target_stamp_ns}, "
            f"{self.source!r}, {self.source_stamp_ns}, {self.fixed!r})"
        )


@dataclass(frozen=True)
class CanTransform(Step):
    """Whether the lookup of the same arguments would answer."""

    target: str
    source: str
    stamp_ns: int | None

    def _ask(self, buffer: Buffer) -> Answer:
        yes = buffer.can_transform(self.target, self.source, self.stamp_ns)
        return Answer("yes" if yes else "no")

    def for_tf2(self) -> list[Any]:
        return ["can", self.target, self.source, self.stamp_ns]

    def stamps(self) -> tuple[int | None, ...]:
        return (self.stamp_ns,)

    def python(self) -> str:
        return f"buffer.can_transform({self.target!r}, {self.source!r}, {self.stamp_ns})"


@dataclass(frozen=True)
class LatestCommonTime(Step):
    """The newest time at which the whole path is known.

    Where all of the path is static tf2 says stamp 0, which tfbus says as None: one answer.
    """

    target: str
    source: str

    def _ask(self, buffer: Buffer) -> Answer:
        return Answer("stamp", buffer.latest_common_time(self.target, self.source) or 0)

    def for_tf2(self) -> list[Any]:
        return ["latest", self.target, self.source]

    def pairs(self) -> tuple[tuple[str, str], ...]:
        return ((self.target, self.source),)

    def python(self) -> str:
        return f"buffer.latest_common_time({self.target!r}, {self.source!r})"


@dataclass(frozen=True)
class Frames(Step):
    """The names of all known frames, sorted."""

    def _ask(self, buffer: Buffer) -> Answer:
        return Answer("frames", names=tuple(sorted(buffer.frames())))

    def for_tf2(self) -> list[Any]:
        return ["frames"]

    def python(self) -> str:
        return "buffer.frames()"


@dataclass(frozen=True)
class Clear(Step):
    """Forget what is not static."""

    def _ask(self, buffer: Buffer) -> Answer:
        buffer.clear()
        return Answer("cleared")

    def for_tf2(self) -> list[Any]:
        return ["clear"]

    def python(self) -> str:
        return "buffer.clear()"


def read_answer(answer: list[Any]) -> Answer:
    """An answer of tests/tf2/oracle.py."""
    match answer:
        case ["transform", stamp_ns, [*pose]]:
            return Answer("transform", stamp_ns, tuple(pose))
        case ["stamp", stamp_ns]:
            return Answer("stamp", stamp_ns)
        case ["frames", [*names]]:
            return Answer("frames", names=tuple(names))
        case [bool(yes)]:
            return Answer("yes" if yes else "no")
        case ["rejected", "TF_REPEATED_DATA", text]:
            return Answer("accepted", text=text)  # ROS 2 says so, where Noetic keeps the first
        case ["rejected", _, text]:
            return Answer("rejected", text=text)
        case [word, *rest]:
            return Answer(word, text=" ".join(rest))
    raise ValueError(f"the oracle said {answer}")


def program(steps: Sequence[Step]) -> str:
    """The steps as a program against tfbus; the last one's answer is printed."""
    *before, last = (step.python() for step in steps)
    lines = [
        "from tfbus import Buffer, Transform, TransformStamped",
        "",
        "buffer = Buffer()",
        *before,
        f"print({last})",
    ]
    return "\n".join(lines)


def _kind(error: TransformException) -> str:
    if isinstance(error, ExtrapolationException):
        return "ExtrapolationException"
    if isinstance(error, InvalidArgumentException) and not isinstance(error, LoopException):
        return "InvalidArgumentException"
    name = type(error).__name__
    assert name in _KINDS, f"{name} is no error of a buffer's"
    return name


def _transform(ts: TransformStamped) -> Answer:
    t = ts.transform
    return Answer("transform", ts.stamp_ns, (t.x, t.y, t.z, t.qx, t.qy, t.qz, t.qw))


def _distance(one: Pose, other: Pose) -> float:
    """The largest difference of a number; of the two signs of a quaternion, the nearer."""
    xyz = max(abs(a - b) for a, b in zip(one[:3], other[:3], strict=True))
    same, opposite = (
        sqrt(sum((a - sign * b) ** 2 for a, b in zip(one[3:], other[3:], strict=True)))
        for sign in (1.0, -1.0)
    )
    return max(xyz, min(same, opposite))
