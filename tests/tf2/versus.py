"""tfbus beside the real tf2: the process to ask, the first mismatch, and how to make it small.

A plugin of pytest: the fixture `tf2`, and the options `--lookups` and `--seed`.
"""

import json
import os
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from tests import needs
from tests.tf2.steps import (
    Answer,
    CanTransform,
    Clear,
    Insert,
    LatestCommonTime,
    Lookup,
    Step,
    program,
    read_answer,
)
from tfbus import Buffer

TOLERANCE = 1e-9
CACHE_TIME_S = 10.0
NS_PER_S = 1_000_000_000

# Where tf2 answers by a way round a loop: tfbus and tf2.
_OUT_OF_A_LOOP = (
    ("transform", "transform"),
    ("ConnectivityException", "transform"),
    ("no", "yes"),
)

_ORACLE = Path(__file__).parent / "oracle.py"


def pytest_addoption(parser: pytest.Parser) -> None:
    """How long to compare with tf2, and from where to start."""
    parser.addoption(
        "--lookups", type=int, default=4_000, help="lookups to compare with tf2 (default: 4000)"
    )
    parser.addoption("--seed", type=int, default=1, help="seed of the lookups (default: 1)")


@pytest.fixture(scope="session")
def tf2() -> Iterator["Oracle"]:
    """The real tf2; a test that asks for it is skipped where it is not installed."""
    # That Python must see its own packages, whatever environment the tests run in.
    env = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    with subprocess.Popen(
        [needs.python_of_tf2(), str(_ORACLE)],
        env=env,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        yield Oracle(process)
        process.communicate()


class Oracle:
    """The process of tests/tf2/oracle.py."""

    def __init__(self, process: subprocess.Popen[str]):
        self._process = process

    def ask(self, steps: Sequence[Step]) -> list[Answer]:
        """What tf2 answers to the steps, in a buffer of their own."""
        case = {
            "cache_time_s": CACHE_TIME_S,
            "epoch_ns": _epoch_ns(steps),
            "steps": [step.for_tf2() for step in steps],
        }
        assert self._process.stdin and self._process.stdout
        print(json.dumps(case), file=self._process.stdin, flush=True)
        line = self._process.stdout.readline()
        assert line, f"tf2 has ended, with code {self._process.wait()}"
        return [read_answer(answer) for answer in json.loads(line)]


@dataclass(frozen=True)
class Mismatch:
    """The last of some steps, which the two sides answer differently."""

    steps: Sequence[Step]
    tfbus: Answer
    tf2: Answer

    def is_like(self, other: "Mismatch | None") -> bool:
        """The same question, with the same words said to it."""
        return other is not None and (self.steps[-1], self.tfbus.word, self.tf2.word) == (
            other.steps[-1],
            other.tfbus.word,
            other.tf2.word,
        )

    def __str__(self) -> str:
        return f"{program(self.steps)}\n# tfbus: {self.tfbus}\n# tf2:   {self.tf2}\n"


def first_mismatch(
    tf2: Oracle, steps: Sequence[Step], tolerance: float = TOLERANCE
) -> Mismatch | None:
    """Put all the steps to both; the first that they do not agree about."""
    buffer = Buffer(CACHE_TIME_S)
    ours = [step.ask(buffer) for step in steps]
    for_tf2 = as_tf2_takes(steps, ours)
    theirs = tf2.ask(list(for_tf2.values()))
    for index, answer in zip(for_tf2, theirs, strict=True):
        if not ours[index].agrees(answer, tolerance):
            before = [step for at, step in for_tf2.items() if at < index]
            mismatch = Mismatch(steps[: index + 1], ours[index], answer)
            if not is_meant(tf2, before, mismatch):
                return mismatch
    return None


def is_meant(tf2: Oracle, before: Sequence[Step], mismatch: Mismatch) -> bool:
    """Whether it is one of the differences that no choice of steps can keep out.

    They are shown in test_tf2_differences.py: a name that cannot be is refused before one that is
    unknown; frames of two trees are unconnected whatever the time, also where an edge between them
    was cleared and gave way; what was cleared has no data, the latest neither; and of a loop of
    parents of different times tf2 answers for two frames on it, each way another way round, and
    fails for all frames below it.
    """

    def tf2_says(*questions: Step) -> list[Answer]:
        return tf2.ask([*before, *questions])[len(before) :]

    def meets_a_loop() -> bool:
        # A walk to a tree apart cannot stop in the loop.
        apart = Insert("apart", "elsewhere", 0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), static=True)
        frames = {frame for pair in question.pairs() for frame in pair}
        latest = tf2_says(*(LatestCommonTime(*pair) for pair in question.pairs()))
        stamps = {*question.stamps(), *(each.stamp_ns for each in latest)} - {None}
        walks = [Lookup("elsewhere", frame, at) for frame in frames for at in stamps]
        return any("contains a loop" in answer.text for answer in tf2_says(apart, *walks))

    question, words = mismatch.steps[-1], (mismatch.tfbus.word, mismatch.tf2.word)
    if words == ("InvalidArgumentException", "LookupException"):
        return any(frame[:1] in ("", "/") for pair in question.pairs() for frame in pair)
    if words == ("ConnectivityException", "ExtrapolationException"):
        # Of a lookup by a fixed frame, whose first half is on a loop for tfbus alone, tf2 looks at
        # the other half.
        if "was a loop then" in mismatch.tfbus.text:
            return meets_a_loop()
        latest = tf2_says(*(LatestCommonTime(*pair) for pair in question.pairs()))
        return has_yielded(before) or any(each.word == "ConnectivityException" for each in latest)
    if words == ("ExtrapolationException", "ConnectivityException"):
        return Clear() in before
    if isinstance(question, CanTransform):
        question = Lookup(question.target, question.source, question.stamp_ns)
        answer = tf2_says(question)[0]
    else:
        answer = mismatch.tf2
    if words in _OUT_OF_A_LOOP:
        return meets_a_loop()
    return "contains a loop" in answer.text


def has_yielded(steps: Sequence[Step]) -> bool:
    """Whether an edge that was cleared has given way to one that would close a loop: its child is a
    root in tfbus, and has no data in tf2.
    """
    buffer = Buffer(CACHE_TIME_S)
    for step in steps:
        step.ask(buffer)
    children = {step.child for step in steps if isinstance(step, Insert)}
    return any(each.parent is None for each in buffer.all_frames() if each.name in children)


def last_answers(tf2: Oracle, *steps: Step) -> tuple[Answer, Answer]:
    """Put all the steps to both: what tfbus and what tf2 say to the last."""
    buffer = Buffer(CACHE_TIME_S)
    ours = [step.ask(buffer) for step in steps]
    return ours[-1], tf2.ask(steps)[-1]


def shrunk(tf2: Oracle, mismatch: Mismatch, tolerance: float = TOLERANCE) -> Mismatch:
    """The same mismatch after as few steps as can be had by leaving out, first many, then one."""
    *before, last = mismatch.steps
    before = [step for step in before if isinstance(step, Insert | Clear)]
    size = len(before)
    while size:
        start = 0
        while start < len(before):
            fewer = before[:start] + before[start + size :]
            found = first_mismatch(tf2, [*fewer, last], tolerance)
            if mismatch.is_like(found):
                assert found
                before, mismatch = fewer, found
            else:
                start += size
        size //= 2
    return mismatch


def as_tf2_takes(steps: Sequence[Step], ours: Sequence[Answer]) -> dict[int, Step]:
    """The steps by their index, but for those where tfbus means to differ.

    An edge that tfbus refuses since it would close a loop is kept from tf2. A sample that is too
    old makes no frame known: tf2 is given it under a parent that it knows. Of equal stamps between
    two questions tf2 is given the last arrival at the place of the first: Noetic would keep the
    first, where ROS 2 and tfbus take the last.
    """
    taken: dict[int, Step] = {}
    first_of: dict[tuple[str, int], int] = {}
    parent_of: dict[str, str] = {}
    for index, (step, answer) in enumerate(zip(steps, ours, strict=True)):
        if not isinstance(step, Insert):
            first_of.clear()
        elif answer.word == "LoopException":
            continue
        elif answer.word == "rejected":
            step = replace(step, parent=parent_of[step.child])
        elif answer.word == "accepted":
            parent_of[step.child] = step.parent
        if isinstance(step, Insert) and not step.static and answer.word == "accepted":
            first = first_of.setdefault((step.child, step.stamp_ns), index)
            if first != index:
                taken[first] = step
                continue
        taken[index] = step
    return taken


def _epoch_ns(steps: Sequence[Step]) -> int:
    """A whole second before all that are named, but for 0."""
    stamps = [stamp_ns for step in steps for stamp_ns in step.stamps() if stamp_ns]
    return max(0, min(stamps, default=0) // NS_PER_S - 1) * NS_PER_S
