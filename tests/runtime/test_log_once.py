"""Log lines that could repeat without end."""

import logging

import pytest

from tfbus.runtime.log_once import LogOnce


def test_the_first_of_a_kind_is_logged_and_all_are_counted(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Three refusals and a drop are two lines, and counts of three and one."""
    once = LogOnce(logging.getLogger("test"))
    for frame in ("a", "b", "c"):
        once.warning("refused", "Refused frame %r", frame)
    once.warning("dropped", "Dropped a message")
    assert caplog.messages == [
        "Refused frame 'a'. Further ones are counted, not logged",
        "Dropped a message. Further ones are counted, not logged",
    ]
    assert once.counts == {"refused": 3, "dropped": 1}


def test_the_first_exception_of_a_kind_is_logged_with_its_traceback(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """As an error, where the warning of another kind is a warning."""
    once = LogOnce(logging.getLogger("test"))
    for _ in range(2):
        try:
            raise ValueError("refused")
        except ValueError:
            once.exception("failed", "Could not handle %r", "a")
    (record,) = caplog.records
    assert record.getMessage() == "Could not handle 'a'. Further ones are counted, not logged"
    assert record.levelno == logging.ERROR
    assert record.exc_info is not None and record.exc_info[0] is ValueError
    assert once.counts == {"failed": 2}
