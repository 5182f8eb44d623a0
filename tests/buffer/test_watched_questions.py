"""The pairs of frames that are looked up can be watched, to fill the buffer with them."""

import pytest

from tests.builders import moved
from tfbus import (
    Buffer,
    ConnectivityException,
    LookupException,
    TimeoutException,
    TransformException,
)

Pair = tuple[str, str]


def watched(buffer: Buffer) -> list[Pair]:
    """The pairs that the buffer is asked for from now on."""
    asked: list[Pair] = []
    buffer.watch_questions(lambda target, source: asked.append((target, source)))
    return asked


def test_a_pair_that_cannot_be_answered_is_told_at_once_and_once() -> None:
    """A watcher learns of each pair before the lookup fails, the first time only."""
    buffer = Buffer()
    asked = watched(buffer)
    for _ in range(3):
        with pytest.raises(LookupException):
            buffer.lookup_transform("map", "base")
        assert asked == [("map", "base")]


def test_every_kind_of_question_is_told() -> None:
    """Lookups at two times, of many stamps, of times, paths and velocities are reported as well."""
    buffer = Buffer()
    asked = watched(buffer)
    buffer.can_transform("a", "can")
    for question in (
        lambda: buffer.lookup_transform_full("b", 1, "full", 2, "fixed"),
        lambda: buffer.lookup_transforms("c", "many", [1, 2]),
        lambda: buffer.latest_common_time("d", "time"),
        lambda: buffer.path("e", "path"),
        lambda: buffer.lookup_twist("twist", "f"),
    ):
        with pytest.raises(TransformException):
            question()
    assert asked == [
        ("a", "can"),
        ("fixed", "full"),
        ("b", "fixed"),
        ("c", "many"),
        ("d", "time"),
        ("e", "path"),
        ("f", "twist"),
    ]


def test_a_pair_that_is_answered_is_reported_with_the_next_insert() -> None:
    """A lookup that has its answer does not stop to report it; the next insert does."""
    buffer = Buffer()
    buffer.set_transform(moved(1, "map", "base"))
    buffer.lookup_transform("map", "base")
    asked = watched(buffer)
    buffer.lookup_transform("map", "base")
    buffer.set_transform(moved(2, "map", "base"))
    assert asked == [("map", "base")]


def test_a_watcher_may_fill_the_buffer() -> None:
    """The watcher is called without the lock: what it inserts is there for the lookup."""
    buffer = Buffer()
    buffer.watch_questions(lambda target, source: buffer.set_transform(moved(1, target, source)))
    assert buffer.lookup_transform("map", "base", timeout_s=20).child_frame_id == "base"


def test_a_watcher_that_fails_fails_alone(caplog: pytest.LogCaptureFixture) -> None:
    """What a watcher raises is logged; the lookup goes on, and the other watchers hear of it."""
    buffer = Buffer()

    def fail(target: str, source: str) -> None:
        raise RuntimeError("no")

    buffer.watch_questions(fail)
    asked = watched(buffer)
    assert not buffer.can_transform("map", "base")
    assert asked == [("map", "base")]
    assert "A watcher of questions failed" in caplog.text


def test_watching_ends() -> None:
    """The callback is not called once the watch has ended; ending it twice is fine."""
    buffer = Buffer()
    asked: list[Pair] = []
    end = buffer.watch_questions(lambda target, source: asked.append((target, source)))
    buffer.can_transform("map", "base")
    end()
    end()
    buffer.can_transform("map", "camera")
    assert asked == [("map", "base")]


def test_pairs_can_be_told_again() -> None:
    """After `ask_again` each pair is reported once more, at its next lookup."""
    buffer = Buffer()
    buffer.set_transform(moved(1, "map", "base"))
    asked = watched(buffer)
    for source in ("base", "camera"):
        buffer.can_transform("map", source)
    buffer.ask_again()
    buffer.can_transform("map", "base")
    assert asked == [("map", "base"), ("map", "camera"), ("map", "base")]


def test_a_watcher_may_say_why_a_frame_is_missing() -> None:
    """The watcher's own error stands for that of a frame that is unknown or not connected."""
    buffer = Buffer()
    buffer.set_transform(moved(1, "map", "base"))
    buffer.set_transform(moved(1, "odom", "arm"))
    missing = {"camera": LookupException("on its way"), "arm": ConnectivityException("far away")}
    buffer.watch_questions(lambda target, source: None, lambda target, source: missing.get(source))
    with pytest.raises(LookupException, match=r"^on its way$"):
        buffer.lookup_transform("map", "camera")
    with pytest.raises(ConnectivityException, match=r"^far away$"):
        buffer.lookup_transform("map", "arm")
    with pytest.raises(LookupException, match=r"no frame 'tool'; available"):
        buffer.lookup_transform("map", "tool")
    with pytest.raises(TimeoutException, match=r" 0\.01 s: on its way$"):
        buffer.lookup_transform("map", "camera", timeout_s=0.01)
