"""The buffer against the real tf2: the same transforms, the same questions, the same answers.

tf2 is Debian's python3-tf2, in a process of its own (tf2/oracle.py). If a random case fails it
is made small, and printed as a program against tfbus that shows the answer. More lookups with
`--lookups 100000`, others with `--seed 2`.
"""

from itertools import pairwise
from random import Random

import numpy as np
import pytest

from tests.tf2 import recorded
from tests.tf2.cases import random_case
from tests.tf2.steps import Clear, Frames, Insert, LatestCommonTime, Lookup, Step
from tests.tf2.versus import CACHE_TIME_S, Oracle, first_mismatch, shrunk
from tfbus import Buffer, TransformBatch

pytestmark = pytest.mark.real

LOOKUPS_PER_CASE = 200


def test_random_trees_are_answered_as_tf2_answers_them(
    tf2: Oracle, pytestconfig: pytest.Config
) -> None:
    """Whatever the tree and the order of arrival, tfbus answers what tf2 answers, to 1e-9."""
    seed = pytestconfig.getoption("seed")
    left = pytestconfig.getoption("lookups")
    rng = Random(seed)
    while left > 0:
        steps = random_case(rng, LOOKUPS_PER_CASE)
        left -= sum(not isinstance(step, Insert | Clear | Frames) for step in steps)
        if mismatch := first_mismatch(tf2, steps):
            pytest.fail(f"--seed {seed}\n\n{shrunk(tf2, mismatch)}", pytrace=False)


@pytest.mark.parametrize("name", recorded.RECORDINGS)
def test_recorded_robots_are_answered_as_tf2_answers_them(tf2: Oracle, name: str) -> None:
    """What real robots sent, with their clocks and repeats, is taken and answered as tf2 does."""
    # Some hardly turn, and tf2 does not interpolate the smallest rotations: see the differences.
    tolerance = 5e-8
    steps = _with_questions(recorded.inserts(name), Random(name))
    if mismatch := first_mismatch(tf2, steps, tolerance):
        pytest.fail(str(shrunk(tf2, mismatch, tolerance)), pytrace=False)


@pytest.mark.parametrize("name", recorded.RECORDINGS)
def test_recorded_messages_are_taken_as_ros_2_takes_them(name: str) -> None:
    """Of each message of a recording as many transforms are kept as ROS 2's tf2 keeps."""
    columns = recorded.columns(name)
    inserts = recorded.inserts(name)
    buffer = Buffer(CACHE_TIME_S)
    starts = np.flatnonzero(np.diff(columns["msg_index"], prepend=-1))
    for start, end in pairwise((*starts.tolist(), len(inserts))):
        for static in (False, True):
            rows = [row for row in range(start, end) if inserts[row].static == static]
            batch = TransformBatch.from_transforms(inserts[row].stamped() for row in rows)
            kept = buffer.set_transforms(batch, static=static)
            assert kept == columns["ros2_accepted"][rows].sum()


def _with_questions(inserts: list[Insert], rng: Random) -> list[Step]:
    """The inserts, with questions after one in five, about any two frames lately."""
    steps: list[Step] = []
    names: dict[str, None] = {}
    for insert in inserts:
        steps.append(insert)
        names |= {insert.parent: None, insert.child: None}
        if rng.random() < 0.2:
            target, source = rng.choices(list(names), k=2)
            past_ns = max(1, insert.stamp_ns - rng.randrange(500_000_000))
            steps.append(Lookup(target, source, rng.choice((None, past_ns))))
            steps.append(LatestCommonTime(target, source))
    return steps
