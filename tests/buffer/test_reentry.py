"""A buffer that is used in the middle of a call of its own thread: handlers, finalizers, clocks."""

import subprocess
import sys
import threading
from pathlib import Path
from textwrap import dedent

import pytest

from tests.builders import S, moved, store_of
from tests.fakes import InAThread
from tfbus.base.clock import Bell
from tfbus.base.errors import FutureExtrapolationException, LookupException
from tfbus.buffer.buffer import COMPILED, Buffer

_BEGIN = """
import gc, signal, weakref
from tests.builders import S, moved
from tfbus import Buffer, InvalidArgumentException, TransformException

buffer = Buffer()
for i in range(3):
    buffer.set_transform(moved(i * S, "world", "robot"))
"""


def run(program: str) -> str:
    """What a process of its own prints: one that hangs is ended."""
    done = subprocess.run(
        [sys.executable, "-c", _BEGIN + dedent(program)],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.real
def test_a_finalizer_may_remove_frames():
    """The collector may call it in the middle of a lookup."""
    program = """
    class Cycle:
        def __init__(self):
            self.me = self

    gc.set_threshold(1)
    for i in range(300):
        buffer.set_transform(moved(0, "world", f"x{i}"))
        weakref.finalize(Cycle(), buffer.remove, f"x{i}")
        try:
            buffer.lookup_transform("world", "nowhere", 5, max_age_s=1.0)
        except TransformException:
            pass
    gc.collect()
    print(buffer.frames())
    """
    assert run(program) == "['robot', 'world']\n"


@pytest.mark.real
def test_a_signal_handler_may_use_it():
    """It reads, stores and removes, and is done within the thread that it interrupts."""
    program = """
    calls = 0

    def handler(*_):
        global calls
        calls += 1
        buffer.set_transform(moved(3 * S + calls, "world", "robot"))
        buffer.set_transform(moved(0, "world", "other"))
        buffer.lookup_transform("world", "robot")
        buffer.can_transform("world", "robot", 9 * S, timeout_s=0.001)
        if "other" in buffer.frames():
            buffer.remove("other")
        if calls < 100:
            signal.setitimer(signal.ITIMER_REAL, 0.001)

    signal.signal(signal.SIGALRM, handler)
    signal.setitimer(signal.ITIMER_REAL, 0.001)
    step = 0
    while calls < 100:
        step += 1
        buffer.set_transform(moved(step, "world", f"x{step % 7}"))
        try:
            buffer.lookup_transform("world", "robot", 9 * S, timeout_s=0.001)
        except TransformException:
            pass
    print(calls)
    """
    assert run(program) == "100\n"


@pytest.mark.real
def test_its_clock_may_read_it():
    """The clock is asked while nothing is locked."""
    program = """
    buffer.clock = lambda: buffer.lookup_transform("world", "robot").stamp_ns
    print(buffer.lookup_transform("world", "robot", max_age_s=1.0).stamp_ns)
    print(buffer.can_transform("world", "robot", max_age_s=1.0, living=True))
    """
    assert run(program) == f"{2 * S}\nTrue\n"


def test_what_is_stored_within_a_call_is_stored_when_it_ends():
    """The call that is interrupted sees no change, and other threads see it at once after it."""
    buffer = Buffer()
    buffer.set_transform(moved(0, "world", "robot"))
    with store_of(buffer).lock:
        assert buffer.set_transform(moved(0, "world", "late"))
        buffer.remove("robot")
        assert buffer.frames() == ["robot", "world"]
    assert buffer.frames() == ["late", "world"]


def test_a_lookup_within_a_call_does_not_wait():
    """No thread could store what it waits for."""
    buffer = Buffer()
    buffer.set_transform(moved(0, "world", "robot"))
    buffer.set_transform(moved(1, "world", "robot"))
    with store_of(buffer).lock, pytest.raises(FutureExtrapolationException):
        buffer.lookup_transform("world", "robot", S, timeout_s=1e6)


def test_what_fails_when_the_call_ends_is_logged(caplog):
    """It cannot be raised where it was called."""
    buffer = Buffer()
    with store_of(buffer).lock:
        buffer.remove("nothing")
    assert "no frame 'nothing'" in caplog.text


def test_callbacks_wait_for_the_end_of_the_call():
    """They are not called with the lock held, which another thread may need to answer them."""
    buffer = Buffer()
    seen: list[str] = []
    buffer.on_change(lambda change: seen.append(InAThread(buffer.frames).result()[0]))
    with store_of(buffer).lock:
        buffer.set_transform(moved(0, "world", "robot"))
        assert seen == []
    assert seen == ["robot", "robot"]


def test_paths_found_in_the_middle_of_a_change_are_found_again():
    """They may be of neither the tree before nor that after."""
    buffer = Buffer()
    buffer.set_transform(moved(0, "world", "robot"))
    with store_of(buffer).lock:
        assert buffer.path("world", "robot") == ["robot", "world"]
        before = store_of(buffer).tree.path("world", "robot").topology
    assert store_of(buffer).tree.path("world", "robot").topology > before


def test_other_threads_wait_until_it_is_left_as_often_as_entered():
    """Entering again and leaving once does not open the lock."""
    buffer = Buffer()
    buffer.set_transform(moved(0, "world", "robot"))
    with store_of(buffer).lock:
        with store_of(buffer).lock:
            pass
        other = threading.Thread(target=buffer.remove, args=("robot",))
        other.start()
        assert buffer.frames() == ["robot", "world"]
    other.join()
    with pytest.raises(LookupException):
        buffer.frame("robot")


def test_a_lookup_waits_while_another_thread_holds_the_lock():
    """Even along a path that is known: what that thread changes may be half done."""
    buffer = Buffer()
    buffer.set_transform(moved(0, "world", "robot", 3.0))
    for _ in range(3):
        buffer.lookup_transform("world", "robot")
    begun, answered = threading.Event(), threading.Event()

    def look_up() -> float:
        begun.set()
        x = buffer.lookup_transform("world", "robot").transform.x
        answered.set()
        return x

    with store_of(buffer).lock:
        other = InAThread(look_up)
        begun.wait()
        # A wait that ends early only where this fails.
        assert not answered.wait(0.05)
    assert other.result() == 3.0


def test_a_bell_rung_twice_rings_once():
    """And before the wait as well as during it."""
    bell = Bell()
    bell.ring()
    bell.ring()
    bell.wait(None)
    other = threading.Timer(0.01, bell.ring)
    other.start()
    bell.wait(None)
    other.join()


@pytest.mark.skipif(COMPILED, reason="no interrupt comes within the compiled lock")
def test_an_interrupt_right_after_the_lock_is_taken_frees_it(monkeypatch):
    """Ctrl-C may raise between any two calls of an interpreted buffer."""

    class Interrupted:
        def __init__(self, mutex):
            self._is_owned, self.release, self._acquire = (
                mutex._is_owned,
                mutex.release,
                mutex.acquire,
            )

        def acquire(self):
            self._acquire()
            raise KeyboardInterrupt

    buffer = Buffer()
    lock = store_of(buffer).lock
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(lock, "_mutex", Interrupted(lock._mutex))
        buffer.set_transform(moved(0, "world", "robot"))
    buffer.set_transform(moved(0, "world", "robot"))
    assert InAThread(buffer.frames).result() == ["robot", "world"]


@pytest.mark.real
def test_one_thread_stores_while_others_look_up_many():
    """The lock is passed on between the parts of a long lookup."""
    program = """
    import threading
    import numpy as np
    from tfbus.buffer.buffer import COMPILED

    stamps = np.random.default_rng(1).integers(0, 2 * S, 20_000 if COMPILED else 2_000)
    done = []

    def look():
        for _ in range(10):
            done.append(buffer.lookup_transforms("world", "robot", stamps))

    threads = [threading.Thread(target=look) for _ in range(2)]
    for thread in threads:
        thread.start()
    step = 0
    while any(thread.is_alive() for thread in threads):
        step += 1
        # As few stamps as a frame keeps, however long it takes.
        buffer.set_transform(moved(2 * S + step % 1000, "world", "robot"))
    print(len(done))
    """
    assert run(program) == "20\n"


@pytest.mark.real
def test_an_interrupt_between_the_rows_of_a_batch_leaves_the_buffer_usable():
    """What a finalizer left for later may raise where the lock is let go in the middle."""
    program = """
    import threading
    from tfbus import TransformBatch

    class Cycle:
        def __init__(self):
            self.me = self

        def __del__(self):
            buffer.set_transform(moved(0, "world", "late"))

    def on_change(change):
        if change.frame == "late":
            raise KeyboardInterrupt

    buffer.on_change(on_change)
    names = [f"x{i}" for i in range(3000)]
    rows = TransformBatch.from_transforms([moved(0, "world", name) for name in names])
    Cycle()
    gc.set_threshold(50)
    try:
        buffer.set_transforms(rows)
    except KeyboardInterrupt:
        gc.set_threshold(700)
        print("interrupted")
    other = threading.Thread(target=lambda: print(buffer.frame("late").parent))
    other.start()
    other.join()
    """
    assert run(program) == "interrupted\nworld\n"
