"""Lookups that want fresh data: frames whose publisher is gone, and samples that are too old."""

import asyncio
import threading

import pytest

from tests.builders import S, moved
from tests.buses import DEADLINE_S, eventually, lookups_wait
from tests.fakes import Clock
from tfbus import (
    Buffer,
    Change,
    InvalidArgumentException,
    StaleException,
    TimeoutException,
    TransformStamped,
)


@pytest.fixture
def buffer() -> Buffer:
    """A robot that moves, sent at 8 s and at 9 s, with a camera fixed on it; it is 10 s now."""
    buffer = Buffer(clock=Clock(10 * S))
    buffer.set_transform(moved(8 * S, "world", "robot", 1), authority="sim")
    buffer.set_transform(moved(9 * S, "world", "robot", 2), authority="sim")
    buffer.set_transform(moved(0, "robot", "camera", 3), static=True, authority="mount")
    return buffer


def test_the_age_of_an_edge_is_that_of_its_newest_sample(buffer: Buffer) -> None:
    """A lookup with max_age_s answers while every edge that moves has a sample so young."""
    found = buffer.lookup_transform("world", "camera", max_age_s=1.0)
    assert found.transform.xyz.tolist() == [5, 0, 0]
    assert buffer.can_transform("world", "camera", 8 * S, max_age_s=1.0)
    assert not buffer.can_transform("world", "camera", max_age_s=0.9)
    assert buffer.can_transform("world", "camera")


def test_a_stale_lookup_says_which_edge_is_stale(buffer: Buffer) -> None:
    """The error names the edge, its publisher, its age, and what to do."""
    with pytest.raises(StaleException) as caught:
        buffer.lookup_transform("world", "camera", max_age_s=0.5)
    error = caught.value
    assert (error.frame_id, error.child_frame_id, error.authority) == ("world", "robot", "sim")
    assert (error.age_s, error.gone) == (1.0, False)
    assert error.waiting_by == "timeout_s"
    assert "1.000 s old: " in error.fact and "max_age_s allows 0.5 s" in error.fact


def test_a_frame_whose_publisher_is_gone_says_so(buffer: Buffer) -> None:
    """It is marked, and stays usable unless a living publisher is asked for."""
    buffer.mark_gone(["robot"], True, "sim")
    assert [buffer.frame(name).gone for name in ("world", "robot", "camera")] == [0, 1, 0]
    assert buffer.can_transform("world", "robot")
    assert buffer.can_transform("robot", "camera", living=True)
    with pytest.raises(StaleException) as caught:
        buffer.lookup_transform("world", "camera", living=True)
    error = caught.value
    assert (error.frame_id, error.child_frame_id, error.authority) == ("world", "robot", "sim")
    assert (error.age_s, error.gone, error.waiting) == (1.0, True, "")
    assert "publisher is gone" in error.fact and error.advice == "start it again"
    with pytest.raises(StaleException, match=r"1\.000 s old: .*0\.5 s, and its publisher is gone"):
        buffer.lookup_transform("world", "camera", max_age_s=0.5)
    buffer.mark_gone(["robot"], False, "sim")
    assert buffer.can_transform("world", "camera", living=True)


def test_a_static_frame_has_no_age_but_a_publisher(buffer: Buffer) -> None:
    """A static transform is never too old, and can have lost its publisher."""
    buffer.mark_gone(["camera"], True, "mount")
    assert buffer.can_transform("robot", "camera", max_age_s=0.0)
    with pytest.raises(StaleException) as caught:
        buffer.lookup_transform("robot", "camera", living=True)
    error = caught.value
    assert (error.frame_id, error.child_frame_id, error.authority) == ("robot", "camera", "mount")
    assert (error.age_s, error.gone, error.advice) == (None, True, "start it again")
    assert "is static: " in error.fact


def test_only_who_sent_a_frame_last_is_gone_for_it(buffer: Buffer) -> None:
    """A frame that another publisher has taken over is not gone with the former."""
    buffer.set_transform(moved(10 * S, "world", "robot", 3), authority="other")
    buffer.mark_gone(["robot"], True, "sim")
    assert not buffer.frame("robot").gone


def test_a_new_publisher_brings_a_frame_back(buffer: Buffer) -> None:
    """A sample of another publisher ends that a frame is gone."""
    buffer.mark_gone(["robot"], True, "sim")
    buffer.set_transform(moved(10 * S, "world", "robot", 3), authority="other")
    assert not buffer.frame("robot").gone


def test_events_tell_who_is_gone_and_who_is_back(buffer: Buffer) -> None:
    """Each frame is reported once when its publisher goes, and once when it comes back."""
    changes: list[Change] = []
    buffer.on_change(changes.append)
    for gone in (True, True, False, False):
        buffer.mark_gone(["robot", "nobody"], gone, "sim")
    assert [(c.kind, c.frame, c.parent, c.authority) for c in changes] == [
        ("publisher gone", "robot", "world", "sim"),
        ("publisher back", "robot", "world", "sim"),
    ]


def test_waiting_goes_on_until_the_data_is_fresh(buffer: Buffer) -> None:
    """With a timeout, a stale answer is waited out until the next sample comes."""
    answers: list[TransformStamped] = []

    def look_up() -> None:
        answers.append(
            buffer.lookup_transform("world", "camera", max_age_s=0.5, timeout_s=DEADLINE_S)
        )

    thread = threading.Thread(target=look_up)
    thread.start()
    eventually(lambda: buffer.waiting == 1)
    buffer.set_transform(moved(10 * S, "world", "robot", 4), authority="sim")
    thread.join(DEADLINE_S)
    assert [answer.stamp_ns for answer in answers] == [10 * S]


@pytest.mark.parametrize("authority", ["mount", "another"])
def test_waiting_goes_on_until_the_publisher_is_back(buffer: Buffer, authority: str) -> None:
    """A lookup that wants living publishers waits for the former, or for another."""
    buffer.mark_gone(["camera"], True, "mount")

    async def look_up() -> TransformStamped:
        waiting = asyncio.create_task(
            buffer.wait_for_transform("robot", "camera", living=True, timeout_s=DEADLINE_S)
        )
        await lookups_wait(buffer)
        if authority == "mount":
            buffer.mark_gone(["camera"], False, "mount")
        else:
            buffer.set_transform(moved(1, "robot", "camera", 3), static=True, authority="another")
        return await waiting

    assert asyncio.run(look_up()).transform.xyz.tolist() == [3, 0, 0]


def test_waiting_in_vain_says_what_was_stale(buffer: Buffer) -> None:
    """When the time is over, the reason is the stale edge."""
    with pytest.raises(TimeoutException) as caught:
        buffer.lookup_transform("world", "robot", max_age_s=0.5, timeout_s=0.01)
    assert isinstance(caught.value.reason, StaleException)
    assert not buffer.can_transform("world", "robot", max_age_s=0.5, timeout_s=0.01)


def test_an_age_is_a_number_of_seconds(buffer: Buffer) -> None:
    """An age below zero, or one that is no number, is refused."""
    for impossible in (-1.0, float("nan")):
        with pytest.raises(InvalidArgumentException, match="max_age_s must be"):
            buffer.lookup_transform("world", "robot", max_age_s=impossible)


def test_an_authority_can_be_forgotten(buffer: Buffer) -> None:
    """Forgetting an authority drops the samples it sent; static poses and others' stay."""
    buffer.set_transform(moved(9 * S, "world", "other", 5), authority="else")
    buffer.set_transform(moved(9 * S, "world", "post", 6), static=True, authority="sim")
    assert buffer.sent_by("sim") == {"robot": 2, "post": 0}
    buffer.forget("sim")
    assert buffer.sent_by("sim") == {"robot": 0, "post": 0}
    assert not buffer.can_transform("world", "robot")
    assert buffer.can_transform("world", "other")
    assert buffer.can_transform("world", "post")
    # A looped replay: far older than what was there.
    assert buffer.set_transform(moved(-99 * S, "world", "robot", 7), authority="sim")
    assert buffer.lookup_transform("world", "robot").stamp_ns == -99 * S


def test_only_the_authority_of_a_frame_takes_it_out(buffer: Buffer) -> None:
    """Frames are removed on behalf of who sent them last; others' stay."""
    buffer.remove_sent(["robot", "camera", "nobody"], "mount")
    assert buffer.frames() == ["robot", "world"]
    assert buffer.sent_by("mount") == {}
