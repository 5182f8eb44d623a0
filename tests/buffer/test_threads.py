"""Many threads at one buffer: longer with `--stress-s 60`.

All samples lie on one line: at the time t (in ms) a frame is at (t, 2 t, -t), turned by
1e-6 t. So any interpolated pose lies on that line, too, and a pose that mixes two samples, or
a stamp and the pose of another, does not.
"""

import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np
import pytest

from tests.builders import S, moved
from tests.fakes import InAThread
from tfbus.base.errors import ExtrapolationException, LookupException, TransformException
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.formats import as_yaml
from tfbus.buffer.lock import Lock
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import Transform, TransformStamped

MS = 1_000_000
WRITERS = 3
EDGES = 20


def on_the_line(t: float) -> Transform:
    """Where a frame is at t ms."""
    return Transform.from_rpy(0, 0, 1e-6 * t, (t, 2 * t, -t))


def is_torn(stamp_ns: int, transform: Transform) -> bool:
    """Whether a pose is not the one of its time."""
    x, y, z = transform.xyz
    t = stamp_ns / MS
    expected = (t, 2 * t, -t, 1e-6 * t)
    found = (x, y, z, transform.as_rpy()[2])
    return not all(map(lambda a, b: math.isclose(a, b, abs_tol=1e-6), found, expected))


class Crowd:
    """Threads that each do one thing again and again, until the time is up."""

    def __init__(self, seconds: float) -> None:
        self._end = time.monotonic() + seconds
        self._failures: list[object] = []
        self._threads: list[threading.Thread] = []

    def repeat(self, step: Callable[[int], object]) -> None:
        """One more thread; what its step returns, where it is anything, is a failure."""

        def run() -> None:
            i = 0
            while time.monotonic() < self._end and not self._failures:
                try:
                    failure = step(i)
                except Exception as error:
                    failure = error
                if failure is not None:
                    self._failures.append(failure)
                i += 1

        self._threads.append(threading.Thread(target=run))

    def run(self) -> None:
        """Until the time is up; all that they did went well."""
        for thread in self._threads:
            thread.start()
        for thread in self._threads:
            thread.join()
        assert self._failures == []


def test_writers_and_readers_in_many_threads_see_no_torn_pose(pytestconfig: pytest.Config) -> None:
    """However many write and read at once, no answer mixes two samples, and none is lost."""
    buffer = Buffer(1e6)
    crowd = Crowd(pytestconfig.getoption("stress_s"))
    inserted = [0] * WRITERS
    names = ("all", *(f"wheel{number}" for number in range(EDGES)))
    edges = np.array([(0, child) for child in range(1, EDGES + 1)], np.uint32)

    def writer(number: int) -> Callable[[int], object]:
        def write(i: int) -> None:
            t = i * WRITERS + number
            robot = TransformStamped(t * MS, "world", "robot", on_the_line(t))
            assert buffer.set_transform(robot)
            inserted[number] += 1
            if i % 100 == 0:
                fixed = TransformStamped(0, "world", f"post{number}_{i % 1000}", on_the_line(t))
                buffer.set_transform(fixed, static=True)

        return write

    def write_columns(i: int) -> None:
        pose = on_the_line(i).as_pose()
        batch = TransformBatch(
            names, edges, np.full(EDGES, i * MS, np.int64), np.tile(pose, (EDGES, 1))
        )
        assert buffer.set_transforms(batch) == EDGES

    def read_latest(i: int) -> object:
        try:
            answer = buffer.lookup_transform("world", "robot")
        except LookupException:
            return None
        return answer if is_torn(answer.stamp_ns, answer.transform) else None

    def read_back(i: int) -> object:
        try:
            latest = buffer.latest_common_time("world", "robot")
            stamp = (latest or 0) * (i % 97) // 97
            answer = buffer.lookup_transform("world", "robot", stamp)
        except (LookupException, ExtrapolationException):
            return None
        return answer if is_torn(answer.stamp_ns, answer.transform) else None

    def read_many(i: int) -> object:
        try:
            latest = buffer.latest_common_time("all", "wheel7") or 0
        except (LookupException, ExtrapolationException):
            return None
        stamps = np.linspace(0, latest, 500).astype(np.int64)
        many, known = buffer.lookup_known_transforms("all", "wheel7", stamps)
        line = stamps[:, None] / MS * np.array((1.0, 2.0, -1.0))
        return None if np.allclose(many.xyz[known], line[known], atol=1e-6) else many

    for number in range(WRITERS):
        crowd.repeat(writer(number))
    for step in (write_columns, read_latest, read_back, read_many):
        crowd.repeat(step)
    crowd.run()
    assert buffer.frame("robot").samples == sum(inserted)


def test_a_lookup_beside_inserts_and_removals_answers_or_says_why(
    pytestconfig: pytest.Config,
) -> None:
    """Whatever comes and goes meanwhile, a lookup raises nothing but the errors of transforms."""
    buffer = Buffer()
    crowd = Crowd(pytestconfig.getoption("stress_s") / 2)
    frames = [("world", "robot"), ("robot", "camera"), ("world", "post")]

    def come_and_go(i: int) -> None:
        parent, child = frames[i % 3]
        buffer.set_transform(TransformStamped(i * MS, parent, child, on_the_line(i)))
        with suppress(LookupException):
            buffer.remove(frames[(i + i // 3) % 3][1])

    def look(i: int) -> None:
        target, source = frames[i % 3][i % 2], frames[i // 3 % 3][1]
        for question in (
            lambda: buffer.lookup_transform(target, source),
            lambda: buffer.lookup_transform(target, source, i * MS),
            lambda: buffer.lookup_transform(target, source, max_age_s=1e9, living=True),
            lambda: buffer.lookup_transform_full(target, i * MS, source, i * MS, "world"),
            lambda: buffer.latest_common_time(target, source),
            lambda: buffer.path(target, source),
            lambda: buffer.lookup_known_transforms(target, source, [i * MS]),
            lambda: buffer.frame(source),
        ):
            with suppress(TransformException):
                question()
        as_yaml(buffer.all_frames())

    for step in (come_and_go, come_and_go, look, look):
        crowd.repeat(step)
    crowd.run()


def test_lookups_go_on_beside_thousands_of_new_frames() -> None:
    """Another thread's batch of 50,000 new frames lets lookups in between, as soon as the system
    lets the two threads meet.
    """
    columns = Columns.of_transforms(
        [TransformStamped(MS, "world", f"new {i}", Transform()) for i in range(50_000)]
    )
    assert any(_meets_a_flood(columns) for _ in range(200))


def _meets_a_flood(columns: Columns) -> bool:
    """Whether lookups saw a part of the frames while another thread inserted them all."""
    buffer = Buffer()
    buffer.set_transform(TransformStamped(0, "world", "post", Transform()), static=True)
    thread = threading.Thread(
        target=lambda: buffer.set_transforms(columns, authority="flood"), name="flood"
    )
    inserted = []
    thread.start()
    while thread.is_alive():
        assert buffer.lookup_transform("world", "post").transform == Transform()
        inserted.append(buffer.count_sent_by("flood"))
    assert buffer.count_sent_by("flood") == columns.count
    return any(0 < each < columns.count for each in inserted)


@pytest.mark.parametrize("name", ["forget", "remove_sent", "mark_gone", "senders_of"])
def test_lookups_go_on_while_many_frames_of_a_stream_change(name: str) -> None:
    """The lock is held for a few frames at a time."""
    buffer = Buffer()
    frames = [f"frame_{i}" for i in range(1000)]
    buffer.set_transforms([moved(S, "map", frame) for frame in frames], authority="sim")

    def names() -> Iterator[str]:
        for i, frame in enumerate(frames):
            if i == 900:
                assert InAThread(lambda: buffer.frame("map").name).result() == "map"
            yield frame

    calls: dict[str, Callable[[], object]] = {
        "forget": lambda: buffer.forget("sim", names()),
        "remove_sent": lambda: buffer.remove_sent(names(), "sim"),
        "mark_gone": lambda: buffer.mark_gone(names(), True, "sim"),
        "senders_of": lambda: buffer.senders_of(names()),
    }
    calls[name]()
    count = 0 if name == "remove_sent" else 1000
    assert len(buffer.sent_by("sim")) == count


@pytest.mark.real
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_child_finds_the_lock_free() -> None:
    """Whatever another thread does with a buffer meanwhile: the child has no thread to leave it."""
    lock = Lock(lambda: None)
    is_held, is_over = threading.Event(), threading.Event()

    def hold_it_again_and_again() -> None:
        while not is_over.wait(0.001):
            with lock:
                is_held.set()
                any(number < 0 for number in range(200_000))
                is_held.clear()

    holder = InAThread(hold_it_again_and_again)
    ends = []
    while len(ends) < 5 and not any(ends):
        is_held.wait()
        child = os.fork()
        if child == 0:
            signal.alarm(20)
            with lock:
                os._exit(0)
        ends.append(os.waitpid(child, 0)[1])
    is_over.set()
    holder.result()
    assert ends == 5 * [0]
