"""With a largest gap, two samples that lie farther apart are not interpolated across."""

import asyncio
import math
import shutil
import subprocess
import sys
from bisect import bisect_right
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import S, moved
from tfbus import (
    Buffer,
    ExtrapolationException,
    GapException,
    InvalidArgumentException,
    Sampling,
    TimeoutException,
    TransformException,
)
from tfbus.buffer import trajectories
from tfbus.buffer.files import load, save

HALF = Sampling(max_gap_s=0.5)
ROOT = Path(__file__).parents[2]
# Of `map` -> `base` in tenths of a second: a hole from 4 to 20.
TENTHS = (0, 2, 4, 20, 22)
CLOUD = np.zeros((1, 3))


def filled(**settings: Any) -> Buffer:
    """`map` -> `base` with a hole, x is the time in seconds; `base` -> `laser` is static."""
    buffer = Buffer(math.inf, **settings)
    buffer.set_transform(moved(0, "base", "laser", 0.5), static=True)
    for tenth in TENTHS:
        buffer.set_transform(
            moved(tenth * S // 10, "map", "base", tenth / 10), authority="odometry"
        )
    return buffer


@pytest.fixture
def buffer() -> Buffer:
    return filled()


def x(buffer: Buffer, seconds: float, sampling: Sampling | None = None) -> float:
    found = buffer.lookup_transform("map", "base", round(seconds * S), sampling=sampling)
    return float(found.transform.xyz[0])


def test_by_default_no_gap_is_too_long(buffer: Buffer) -> None:
    """As in tf2."""
    assert x(buffer, 1.2) == pytest.approx(1.2)


def test_a_time_in_a_hole_has_no_answer(buffer: Buffer) -> None:
    """The samples around it and the times on either side of it do; also in a buffer made so."""
    of_its_own = filled(sampling=HALF)
    for seconds in (0.0, 0.1, 0.4, 2.0, 2.1, 2.2):
        assert x(buffer, seconds, HALF) == x(of_its_own, seconds) == pytest.approx(seconds)
    for inside in (0.4 + 1e-9, 1.2, 2.0 - 1e-9):
        for made, sampling in ((buffer, HALF), (of_its_own, None)):
            with pytest.raises(GapException):
                x(made, inside, sampling)


def test_a_gap_of_just_the_limit_is_not_too_long(buffer: Buffer) -> None:
    """A nanosecond less is."""
    assert x(buffer, 1.2, Sampling(max_gap_s=1.6)) == pytest.approx(1.2)
    with pytest.raises(GapException):
        x(buffer, 1.2, Sampling(max_gap_s=1.599999999))


def test_the_error_has_the_edge_the_hole_and_the_limit(buffer: Buffer) -> None:
    """In its sentence and as fields."""
    with pytest.raises(GapException) as caught:
        buffer.lookup_transform("map", "laser", 12 * S // 10, sampling=HALF)
    error = caught.value
    assert (error.frame_id, error.child_frame_id, error.authority) == ("map", "base", "odometry")
    assert (error.before_ns, error.after_ns) == (4 * S // 10, 2 * S)
    assert (error.requested_ns, error.max_gap_s) == (12 * S // 10, 0.5)
    for fact in ("'map' -> 'base'", "1.6 s apart", "0.5 s", "query another time", "allow more"):
        assert fact in str(error)


def test_the_error_names_no_edge_beside_the_hole(buffer: Buffer) -> None:
    """Whose samples around the time are near each other."""
    for tenth in range(10, 15):
        buffer.set_transform(moved(tenth * S // 10, "base", "arm", 0.5))
        buffer.set_transform(moved(tenth * S // 10, "earth", "map", 0.5))
    for ends in (("earth", "arm"), ("arm", "earth")):
        with pytest.raises(GapException) as caught:
            buffer.lookup_transform(*ends, 12 * S // 10 + 1, sampling=HALF)
        assert caught.value.child_frame_id == "base"


@pytest.mark.parametrize("interpolation", ["linear", "screw"])
def test_extrapolation_goes_on_from_no_two_samples_that_are_too_far_apart(
    interpolation: Any,
) -> None:
    """The twist between the two would be that of the hole."""
    buffer = Buffer(math.inf)
    for second in (0, 10):
        buffer.set_transform(moved(second * S, "map", "base", float(second)))
    near = Sampling(interpolation, extrapolation_s=5.0, max_gap_s=1.0)
    for outside in (-1.0, 11.0):
        with pytest.raises(GapException) as caught:
            x(buffer, outside, near)
        assert (caught.value.before_ns, caught.value.after_ns) == (0, 10 * S)
    buffer.set_transform(moved(11 * S, "map", "base", 11.0))
    assert x(buffer, 12.0, near) == pytest.approx(12.0)


def test_one_sample_makes_no_gap() -> None:
    """Its errors are those of ever."""
    buffer = Buffer()
    buffer.set_transform(moved(S, "map", "base", 1.0))
    assert x(buffer, 1.0, HALF) == 1.0
    for sampling in (HALF, replace(HALF, extrapolation_s=2.0)):
        for other in (0.5, 1.5):
            with pytest.raises(ExtrapolationException) as caught:
                x(buffer, other, sampling)
            assert not isinstance(caught.value, GapException)


def test_the_nearest_sample_has_a_tolerance_and_no_largest_gap() -> None:
    """Two limits for one thing would be one too many; and a gap is a number of seconds."""
    with pytest.raises(InvalidArgumentException, match="tolerance_s"):
        Sampling("nearest", max_gap_s=1.0)
    for wrong in (-1.0, math.nan, math.inf, "1"):
        with pytest.raises(InvalidArgumentException, match=r"max_gap_s .*number"):
            Sampling(max_gap_s=wrong)  # type: ignore[arg-type]


def test_all_forms_of_lookup_heed_it() -> None:
    """One and many stamps, a fixed frame, points, trajectories, and whether there is one."""
    buffer = filled(sampling=HALF)
    inside, outside = 12 * S // 10, 21 * S // 10
    _, known = buffer.lookup_known_transforms("map", "laser", [0, inside, outside])
    assert known.tolist() == [True, False, True]
    assert [buffer.can_transform("map", "laser", at) for at in (inside, outside)] == [False, True]
    for call in (
        lambda: buffer.lookup_transforms("map", "laser", [outside, inside]),
        lambda: buffer.lookup_transform_full("map", outside, "laser", inside, "map"),
        lambda: buffer.transform_points(CLOUD, "map", "laser", inside),
        lambda: buffer.transform_points(CLOUD, "map", "laser", [inside]),
        lambda: trajectories.trajectory(buffer, "map", "laser", [inside]),
    ):
        with pytest.raises(GapException):
            call()


def test_a_trajectory_leaves_out_the_stamps_in_the_holes_of_other_edges(buffer: Buffer) -> None:
    """As any stamp at which an edge has no data."""
    for tenth in range(23):
        buffer.set_transform(moved(tenth * S // 10, "laser", "tool", 1.0))
    found = trajectories.trajectory(buffer, "map", "tool", sampling=HALF)
    assert (found.stamps_ns * 10 // S).tolist() == [0, 1, 2, 3, 4, 20, 21, 22]


def test_a_hole_is_not_waited_for(buffer: Buffer) -> None:
    """Only a late sample could fill it: the error comes at once, to threads and to asyncio."""
    with pytest.raises(GapException):
        buffer.lookup_transform("map", "base", S, timeout_s=1000.0, sampling=HALF)
    with pytest.raises(GapException):
        asyncio.run(buffer.wait_for_transform("map", "base", S, sampling=HALF))
    assert buffer.waiting == 0


def test_a_hole_that_is_being_filled_is_waited_for(buffer: Buffer) -> None:
    """While the past of its publisher is on its way, as after a listener has joined."""
    ended = buffer.expect_past("odometry")

    async def wait() -> float:
        asked = asyncio.create_task(
            buffer.wait_for_transform("map", "base", S, timeout_s=60.0, sampling=HALF)
        )
        while not buffer.waiting:
            await asyncio.sleep(0)
        for tenth in range(4, 20):
            late = moved(tenth * S // 10, "map", "base", tenth / 10)
            buffer.set_transform(late, authority="odometry")
        ended()
        return float((await asked).transform.xyz[0])

    assert asyncio.run(wait()) == 1.0


def test_the_latest_in_a_hole_is_waited_for(buffer: Buffer) -> None:
    """Newer samples of the others move it out of the hole."""
    buffer.set_transform(moved(S, "laser", "tool", 1.0))
    with pytest.raises(GapException, match="wait for newer ones") as caught:
        buffer.lookup_transform("map", "tool", sampling=HALF)
    assert caught.value.requested_ns is None
    with pytest.raises(TimeoutException) as timed_out:
        buffer.lookup_transform("map", "tool", timeout_s=0.001, sampling=HALF)
    assert isinstance(timed_out.value.reason, GapException)

    async def wait() -> int:
        asked = asyncio.create_task(
            buffer.wait_for_transform("map", "tool", timeout_s=60.0, sampling=HALF)
        )
        while not buffer.waiting:
            await asyncio.sleep(0)
        buffer.set_transform(moved(21 * S // 10, "laser", "tool", 1.0))
        return (await asked).stamp_ns

    assert asyncio.run(wait()) == 21 * S // 10


def test_between_two_parents_a_hole_has_no_answer_either() -> None:
    """Where tf2 stays at the older sample."""
    buffer = Buffer(math.inf)
    for second, parent in ((0, "map"), (10, "odom"), (11, "odom")):
        buffer.set_transform(moved(second * S, parent, "base", 1.0))
    buffer.set_transform(moved(0, "map", "odom", 1.0), static=True)
    assert buffer.lookup_transform("map", "base", 5 * S).transform.xyz[0] == 1.0
    with pytest.raises(GapException):
        buffer.lookup_transform("map", "base", 5 * S, sampling=HALF)


def test_it_is_saved_with_the_buffer(tmp_path: Path) -> None:
    """And a file of a buffer without one has none."""
    for name, sampling in (("with", HALF), ("without", Sampling())):
        save(filled(sampling=sampling), tmp_path / name)
        assert load(tmp_path / name).sampling == sampling


def model(stamps: list[int], at: int, max_gap_ns: int) -> bool:
    """Whether there is an answer, by the rule."""
    if at in stamps:
        return True
    after = bisect_right(stamps, at)
    if not 0 < after < len(stamps):
        return False
    return stamps[after] - stamps[after - 1] <= max_gap_ns


@given(
    edges=st.lists(
        st.sets(st.integers(0, 60), min_size=1, max_size=20).map(sorted), min_size=1, max_size=3
    ),
    max_gap=st.integers(0, 20),
    order=st.randoms(use_true_random=False),
)
def test_lookups_answer_as_a_simple_model(edges: list[list[int]], max_gap: int, order: Any) -> None:
    """Of paths of one to three edges, inserted in any order, at every time: one by one, and many in
    one call; where there is an answer, it is that without a limit.
    """
    buffer = Buffer(math.inf)
    inserts = [(edge, stamp) for edge, stamps in enumerate(edges) for stamp in stamps]
    order.shuffle(inserts)
    for edge, stamp in inserts:
        buffer.set_transform(moved(stamp, str(edge), str(edge + 1), float(stamp)))
    limited = Sampling(max_gap_s=max_gap / 1e9)
    last = str(len(edges))
    known = [all(model(stamps, at, max_gap) for stamps in edges) for at in range(-2, 63)]
    for at, is_known in enumerate(known, start=-2):
        if is_known:
            found = buffer.lookup_transform("0", last, at, sampling=limited)
            assert found.transform.is_close(buffer.lookup_transform("0", last, at).transform)
        else:
            with pytest.raises(TransformException):
                buffer.lookup_transform("0", last, at, sampling=limited)
    _, many = buffer.lookup_known_transforms("0", last, range(-2, 63), sampling=limited)
    assert many.tolist() == known


# What a buffer says of many edges and times, as text.
_ANSWERS = """
import random
from tfbus import Buffer, Sampling, Transform, TransformException, TransformStamped
random.seed(4)
for _ in range(40):
    buffer = Buffer(1000.0)
    for parent, child in (("a", "b"), ("b", "c"), ("x", "c")):
        for stamp in random.sample(range(100), random.randrange(1, 12)):
            pose = Transform((stamp, random.random(), 0))
            buffer.set_transform(TransformStamped(stamp * 10**9, parent, child, pose))
    for interpolation in ("linear", "screw"):
        limit = random.randrange(1, 30)
        sampling = Sampling(interpolation, extrapolation_s=random.choice([0, 9]), max_gap_s=limit)
        for at in [None, *(random.randrange(-5 * 10**9, 105 * 10**9) for _ in range(30))]:
            try:
                found = buffer.lookup_transform("a", "c", at, sampling=sampling)
                print(found.stamp_ns, [f"{each:.9f}" for each in found.transform.xyz])
            except TransformException as error:
                print(type(error).__name__, error)
"""


@pytest.mark.real
def test_the_interpreted_kernel_says_the_same(tmp_path: Path) -> None:
    """Answers and errors, of parents that change, with and without extrapolation."""
    compiled = shutil.ignore_patterns("*.so", "__pycache__")
    shutil.copytree(ROOT / "tfbus", tmp_path / "tfbus", ignore=compiled)
    said = [
        subprocess.run(
            [sys.executable, "-W", "ignore", "-c", _ANSWERS],
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for folder in (ROOT, tmp_path)
    ]
    assert said[0] == said[1]
    assert "GapException" in said[0]
