"""A buffer whose samples were interrupted has no answer between the two around that time."""

import math
from pathlib import Path

import pytest

from tests.builders import S, moved
from tfbus import Buffer, ExtrapolationException, Sampling
from tfbus.buffer.files import load, save

WHY = "the recorder was paused"


@pytest.fixture
def buffer() -> Buffer:
    """`map` -> `base` at 0, 1, 2 s; interrupted; at 6, 7 s. x is the time."""
    made = Buffer(math.inf)
    for second in (0, 1, 2):
        made.set_transform(moved(second * S, "map", "base", float(second)))
    made.interrupt(WHY)
    for second in (6, 7):
        made.set_transform(moved(second * S, "map", "base", float(second)))
    return made


def x(buffer: Buffer, seconds: float, sampling: Sampling | None = None) -> float:
    found = buffer.lookup_transform("map", "base", round(seconds * S), sampling=sampling)
    return float(found.transform.xyz[0])


def test_there_is_no_answer_between_the_samples_around_an_interruption(buffer: Buffer) -> None:
    """The samples themselves and the times on either side of them are as ever."""
    assert [x(buffer, each) for each in (1.5, 2.0, 6.0, 6.5)] == [1.5, 2.0, 6.0, 6.5]
    for inside in (2.001, 4.0, 5.999):
        with pytest.raises(ExtrapolationException, match=WHY):
            x(buffer, inside)


@pytest.mark.parametrize(
    "sampling",
    [Sampling(interpolation="screw"), Sampling(extrapolation_s=100.0)],
    ids=["screw", "extrapolation"],
)
def test_no_sampling_answers_in_an_interruption(buffer: Buffer, sampling: Sampling) -> None:
    """Neither along a screw nor by extrapolation."""
    with pytest.raises(ExtrapolationException, match=WHY):
        x(buffer, 4.0, sampling)
    assert x(buffer, 1.5, sampling) == pytest.approx(1.5)


def test_many_lookups_leave_out_those_in_an_interruption(buffer: Buffer) -> None:
    """As those that are not known."""
    stamps = [round(each * S) for each in (1.5, 3.0, 5.0, 6.5)]
    _, known = buffer.lookup_known_transforms("map", "base", stamps)
    assert known.tolist() == [True, False, False, True]


def test_a_static_edge_is_not_interrupted(buffer: Buffer) -> None:
    """It has one pose at all times."""
    buffer.set_transform(moved(0, "base", "laser", 0.5), static=True)
    buffer.interrupt(WHY)
    assert buffer.can_transform("base", "laser", 4 * S)


def test_an_interruption_passes_with_its_samples() -> None:
    """A buffer that keeps 5 s has none later."""
    buffer = Buffer(5.0)
    buffer.set_transform(moved(0, "map", "base", 0.0))
    buffer.interrupt(WHY)
    for second in range(1, 12):
        buffer.set_transform(moved(second * S, "map", "base", float(second)))
    assert x(buffer, 10.5) == 10.5
    with pytest.raises(ExtrapolationException) as raised:
        x(buffer, 0.5)
    assert WHY not in str(raised.value)


def test_an_interruption_that_is_forgotten_does_not_come_back(buffer: Buffer) -> None:
    """A simulation that begins again sends the same stamps again, this time without a pause."""
    buffer.clear(after_ns=1 * S)
    for second in (2, 3):
        buffer.set_transform(moved(second * S, "map", "base", float(second)))
    assert x(buffer, 2.5) == 2.5


def test_a_saved_buffer_keeps_its_interruptions(buffer: Buffer, tmp_path: Path) -> None:
    """And the reason of each."""
    save(buffer, tmp_path / "buffer.npz")
    loaded = load(tmp_path / "buffer.npz")
    with pytest.raises(ExtrapolationException, match=WHY):
        x(loaded, 4.0)
    assert x(loaded, 6.5) == 6.5


def test_the_rate_of_a_frame_does_not_count_an_interruption(buffer: Buffer) -> None:
    """1 Hz before and after it."""
    assert buffer.frame("base").rate_hz == 1.0
