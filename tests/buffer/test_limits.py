"""The memory of a buffer has limits: samples of a frame, paths, and nothing recursive."""

import logging
import subprocess
import sys

import pytest

from tests.builders import S, moved, store_of
from tests.fakes import Lines
from tfbus.base.errors import ExtrapolationException, InvalidArgumentException, TransformException
from tfbus.buffer.buffer import Buffer
from tfbus.geometry.sampling import Sampling


def stamps_of(buffer: Buffer) -> list[int]:
    """The stamps up to 200 at which there is a sample of the robot."""
    exact = Sampling("nearest")
    return [s for s in range(200) if buffer.can_transform("world", "robot", s, sampling=exact)]


def test_of_one_frame_only_so_many_samples_are_kept() -> None:
    """The oldest gives way; it is counted, logged once, and the answers are those of the rest."""
    log = Lines(logging.getLogger("tfbus"))
    buffer = Buffer(max_samples=10)
    for stamp in range(100):
        assert buffer.set_transform(moved(stamp, "world", "robot", float(stamp)))
        if stamp >= 20:
            assert buffer.lookup_transform("world", "robot", stamp - 5).transform.x == stamp - 5
    assert stamps_of(buffer) == list(range(90, 100))
    info = buffer.frame("robot")
    assert (info.samples, info.crowded_out, info.oldest_ns) == (10, 90, 90)
    with pytest.raises(ExtrapolationException):
        buffer.lookup_transform("world", "robot", 89)
    for stamp in range(30):
        buffer.set_transform(moved(stamp, "world", "other"))
    assert len(log.lines) == 1
    assert "'robot'" in log.lines[0] and "more than 10 samples" in log.lines[0]
    assert "max_samples" in log.lines[0]


def test_a_buffer_may_keep_the_last_sample_alone() -> None:
    """The least limit is one sample."""
    buffer = Buffer(max_samples=1)
    for stamp in range(3):
        buffer.set_transform(moved(stamp, "world", "robot"))
    assert stamps_of(buffer) == [2]
    with pytest.raises(InvalidArgumentException):
        Buffer(max_samples=0)


def test_a_late_sample_takes_the_place_of_the_oldest() -> None:
    """One that would be the oldest of too many is counted and not kept."""
    buffer = Buffer(max_samples=3)
    for stamp in (10, 30, 50, 40, 5, 20):
        assert buffer.set_transform(moved(stamp, "world", "robot", float(stamp)))
    assert stamps_of(buffer) == [30, 40, 50]
    assert buffer.frame("robot").crowded_out == 3
    assert buffer.lookup_transform("world", "robot", 35).transform.x == 35.0


def test_lookups_that_a_longer_cache_would_answer_are_counted() -> None:
    """They are before the oldest sample of a frame with a full cache; the furthest is told."""
    buffer = Buffer(1.0)

    def ask(stamp_ns: int | None, source: str = "robot") -> tuple[int, int]:
        assert not buffer.can_transform("world", source, stamp_ns)
        with pytest.raises(TransformException):
            buffer.lookup_transform("world", source, stamp_ns)
        expired = buffer.expired_lookups
        return expired.count, expired.missed_by_ns

    buffer.set_transforms([moved(50 * S, "world", "robot"), moved(50 * S + 1, "world", "robot")])
    # It is younger than the cache.
    assert ask(48 * S) == (0, 0)
    buffer.set_transform(moved(51 * S, "world", "robot"))
    assert ask(49 * S) == (1, 1 * S)
    assert ask(47 * S) == (2, 3 * S)
    assert ask(48 * S) == (3, 3 * S)
    for stamp_ns, source in ((52 * S, "robot"), (48 * S, "nowhere"), (None, "nowhere")):
        assert ask(stamp_ns, source) == (3, 3 * S)


def test_lookups_of_another_unit_or_clock_are_not_for_a_longer_cache() -> None:
    """They are counted on their own, with what is wrong with the last stamp."""
    now_ns = 1_790_000_000 * S
    buffer, expired = Buffer(1.0), []
    for tenths in range(12):
        buffer.set_transform(moved(now_ns + tenths * S // 10, "world", "robot"))
    for stamp_ns in (now_ns // 10**9, now_ns // 10**6, 0, 5 * S):
        with pytest.raises(TransformException):
            buffer.lookup_transform("world", "robot", stamp_ns)
        expired.append(buffer.expired_lookups.mistake)
    seconds, milliseconds, zero, clock = expired
    assert "1790000000 looks like seconds, but stamps are nanoseconds" in seconds
    assert "1790000000000 looks like milliseconds" in milliseconds
    assert zero == "the stamp 0 is the year 1970, not the latest as in tf2; omit it for the latest"
    assert "57 years later, so its stamps are of another clock; if one of the two" in clock
    assert (buffer.expired_lookups.mistaken, buffer.expired_lookups.count) == (4, 0)


def test_the_limit_grows_with_the_cache() -> None:
    """By default it is ten thousand samples a second; less than one is refused."""
    assert store_of(Buffer()).tree.max_samples == 100_000
    assert store_of(Buffer(0.0)).tree.max_samples == 100_000
    assert store_of(Buffer(60.0)).tree.max_samples == 600_000
    assert store_of(Buffer(float("inf"))).tree.max_samples == 10**13
    for impossible in (0, -1, 2.5):
        with pytest.raises(InvalidArgumentException, match="max_samples must be"):
            Buffer(max_samples=impossible)


def test_paths_have_one_budget() -> None:
    """However many pairs are looked up, the oldest paths are dropped, and found again."""
    buffer = Buffer()
    for i in range(1_000):
        buffer.set_transform(moved(0, f"f{i}", f"f{i + 1}"), static=True)
    for i in range(40):
        for j in range(960, 1_000):
            assert len(buffer.path(f"f{i}", f"f{j}")) == j - i + 1
    assert 2**19 < store_of(buffer).tree.kept_cost <= 2**20
    assert len(buffer.path("f0", "f960")) == 961


@pytest.mark.real
def test_the_end_of_a_long_chain_does_not_need_a_deep_stack() -> None:
    """A buffer of a chain of frames is freed, and so is a tree that was cut, frame by frame."""
    script = """
import threading
from tfbus import Buffer, Transform, TransformStamped

def run():
    buffer = Buffer()
    for i in range(12_000):
        edge = TransformStamped(0, f"f{i}", f"f{i + 1}", Transform())
        buffer.set_transform(edge, static=True, authority="one")
    assert buffer.can_transform("f0", "f12000")
    del buffer
    print("freed", flush=True)

threading.stack_size(2**17)
thread = threading.Thread(target=run)
thread.start()
thread.join()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "freed\n")
