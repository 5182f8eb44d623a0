"""Log lines that could repeat without end."""

import logging
import re

import pytest

from tests.fakes import Clock
from tfbus.base.log import LogOnce


def test_the_first_of_a_kind_is_logged_and_all_are_counted(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Three refusals and a drop are two lines, and counts of three and one."""
    once = LogOnce(logging.getLogger("test"))
    for frame in ("a", "b", "c"):
        once.warning("refused", "Refused frame %r", frame)
    once.warning("dropped", "Dropped a message")
    refused, dropped = caplog.messages
    assert refused.startswith("Refused frame 'a'. ") and refused.endswith("counted, not logged")
    assert dropped.startswith("Dropped a message. ") and dropped.endswith("counted, not logged")
    assert once.counts == {"refused": 3, "dropped": 1}


@pytest.mark.parametrize("end", [".", "?", "!"])
def test_a_line_that_has_its_mark_gets_no_full_stop(
    caplog: pytest.LogCaptureFixture, end: str
) -> None:
    """The mark is in the text, or in the value at its end."""
    once = LogOnce(logging.getLogger("test"))
    once.warning("text", f"Refused a frame{end}")
    once.warning("value", "Refused: %s", f"a frame{end}")
    text, value = caplog.messages
    assert text.startswith(f"Refused a frame{end} Further ones ")
    assert value.startswith(f"Refused: a frame{end} Further ones ")


@pytest.mark.parametrize("values", [(), ("lidar",), ("lidar", "camera", "radar")])
def test_values_that_do_not_fit_their_text_raise_nothing(
    capsys: pytest.CaptureFixture[str], values: tuple[str, ...]
) -> None:
    """Whoever logs goes on: logging itself writes of the mistake on stderr."""
    log = logging.Logger("test")
    log.addHandler(logging.StreamHandler())
    LogOnce(log).warning("refused", "Refused %s of %s", *values)
    assert "Refused %s of %s" in capsys.readouterr().err


def test_a_value_that_cannot_be_printed_raises_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    """Its error is one more line of logging's own."""

    class Unprintable:
        def __str__(self) -> str:
            raise RuntimeError("no text")

    log = logging.Logger("test")
    log.addHandler(logging.StreamHandler())
    LogOnce(log).warning("refused", "Refused %s", Unprintable())
    assert "no text" in capsys.readouterr().err


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
    assert record.getMessage().startswith("Could not handle 'a'. Further")
    assert record.levelno == logging.ERROR
    assert record.exc_info is not None and record.exc_info[0] is ValueError
    assert once.counts == {"failed": 2}


def test_a_kind_is_logged_again_after_a_while_with_its_number(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A hundred restarts within a minute are one line, and the next minute's first says so."""
    clock = Clock()
    lines = LogOnce(logging.getLogger("test"), again_s=60.0, clock=clock)
    for clock.now_ns in [*range(100), 60, 61]:
        lines.warning("restarted", "Stream %r restarted", "sim")
    first, second = caplog.messages
    assert first == "Stream 'sim' restarted" and second.startswith(f"{first} (60 times ")
    assert lines.counts == {"restarted": 102}


def test_many_kinds_at_once_end_in_one_line(caplog: pytest.LogCaptureFixture) -> None:
    """Names come from the bus: of a thousand in a minute the first ten are logged, and again."""
    clock = Clock()
    lines = LogOnce(logging.getLogger("test"), again_s=60.0, most=10, clock=clock)
    for number in range(1000):
        lines.warning(number, "Stream %r is gone", number)
    assert len(caplog.messages) == 11
    assert re.match("More than 10 lines .* 60 s: ", caplog.messages[-1])
    assert len(lines.counts) == 10
    clock.now_ns = 61
    lines.warning("later", "Stream %r is gone", "later")
    assert caplog.messages[-1] == "Stream 'later' is gone"
    assert len(lines.counts) == 10


def test_kinds_that_are_logged_once_make_room_too(caplog: pytest.LogCaptureFixture) -> None:
    """After more kinds than are kept one line says so, and 10 minutes later new ones are logged."""
    clock = Clock()
    once = LogOnce(logging.getLogger("test"), most=10, clock=clock)
    for number in range(1000):
        once.warning(number, "Rejected stream %r", number)
    assert len(caplog.messages) == 11
    assert re.match("More than 10 lines .* 600 s: ", caplog.messages[-1])
    clock.now_ns = 601
    once.warning("honest", "Rejected stream %r", "honest")
    assert caplog.messages[-1].startswith("Rejected stream 'honest'")
    assert len(once.counts) == 10
