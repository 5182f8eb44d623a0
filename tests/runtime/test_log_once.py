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
