"""A buffer that is pickled or copied: a snapshot, with the same answers to the last bit."""

import copy
import math
import multiprocessing
import pickle
from collections.abc import Callable

import pytest

from tests.builders import S, moved
from tfbus import Buffer, FutureExtrapolationException, Sampling, SimulatedClock
from tfbus.buffer import trajectories

Copier = Callable[[Buffer], Buffer]
COPIERS: dict[str, Copier] = {
    "pickle": lambda buffer: pickle.loads(pickle.dumps(buffer)),
    "deepcopy": copy.deepcopy,
    "copy": copy.copy,
}
each_copier = pytest.mark.parametrize("copier", COPIERS.values(), ids=COPIERS.keys())


def filled(buffer: Buffer) -> Buffer:
    """A static frame, one with two parents, one that is gone, and a pause."""
    buffer.set_transform(moved(0, "base", "laser", 0.5), static=True, authority="urdf")
    for second, parent in enumerate(("map", "map", "odom", "odom")):
        buffer.set_transform(moved(second * S, parent, "base", 0.1 * second), authority="slam")
    buffer.set_transform(moved(S, "map", "odom", 3.0), authority="fixed")
    buffer.mark_gone(["odom"], True, "fixed")
    buffer.interrupt("a pause")
    buffer.set_transform(moved(4 * S, "odom", "base", 0.4), authority="slam")
    return buffer


@each_copier
def test_a_copy_has_the_same_contents_and_settings(copier: Copier) -> None:
    """All frames with their facts, all samples, and the answers to lookups."""
    sampling = Sampling("screw", max_gap_s=2.0)
    buffer = filled(Buffer(math.inf, sampling=sampling, max_samples=70))
    copied = copier(buffer)
    assert type(copied) is Buffer
    assert copied.all_frames() == buffer.all_frames()
    assert (copied.cache_time_s, copied.sampling) == (math.inf, sampling)
    assert trajectories.samples(copied, "base", parent="map") == trajectories.samples(
        buffer, "base", parent="map"
    )
    stamp_ns = S // 3
    found = copied.lookup_transform("map", "laser", stamp_ns)
    assert found == buffer.lookup_transform("map", "laser", stamp_ns)
    for second in range(5, 90):
        copied.set_transform(moved(second * S, "odom", "base"))
    assert copied.frame("base").samples == 70


@each_copier
def test_a_copy_and_its_original_are_apart(copier: Copier) -> None:
    """What one gets later the other does not; listeners are those of the original alone."""
    buffer = filled(Buffer())
    changes: list[object] = []
    buffer.on_change(changes.append)
    copied = copier(buffer)
    copied.set_transform(moved(5 * S, "odom", "new"))
    assert changes == []
    assert "new" not in buffer.frames()
    buffer.remove("laser")
    assert "laser" in copied.frames()


def test_a_deep_copy_keeps_the_clock_and_a_pickle_has_the_systems() -> None:
    """A simulated clock is moved by its process, and cannot go to another one."""
    clock = SimulatedClock()
    buffer = Buffer(clock=clock)
    assert copy.deepcopy(buffer).clock is clock
    assert pickle.loads(pickle.dumps(buffer)).clock == Buffer().clock


class Named(Buffer):
    """A buffer of a program, with more in it."""

    def __init__(self, name: str) -> None:
        super().__init__(20.0)
        self.name = [name]


@each_copier
def test_a_subclass_is_copied_with_what_it_has(copier: Copier) -> None:
    """Without its constructor, whatever that takes."""
    buffer = filled(Named("mine"))
    copied = copier(buffer)
    assert isinstance(copied, Named)
    assert (copied.name, copied.cache_time_s) == (["mine"], 20.0)
    assert copied.frames() == buffer.frames()


def test_a_buffer_that_gets_no_more_stays_so() -> None:
    """Errors of a copy advise no waiting either."""
    buffer = filled(Buffer())
    buffer.expect_no_more()
    with pytest.raises(FutureExtrapolationException) as caught:
        copy.deepcopy(buffer).lookup_transform("odom", "base", 9 * S)
    assert "wait" not in str(caught.value)


def look_up(buffer: Buffer) -> float:
    """In another process."""
    return buffer.lookup_transform("map", "base", S).transform.x


def test_a_worker_process_gets_one() -> None:
    """As the workers that load data for training."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(look_up, (filled(Buffer()),)) == pytest.approx(0.1)
