"""The lines that a node logs can be printed, whatever comes from the bus."""

import logging
import os
import sys

import pytest

from tests.fakes import Lines
from tfbus.base.log import library_log, open_log

HOSTILE = "sim\x1b[2J\r\n[ERROR] [1.0] [sim]: forged\u202e\x00"
ESCAPED = r"sim\x1b[2J\r\n[ERROR] [1.0] [sim]: forged\u202e\x00"


def logged(capsys: pytest.CaptureFixture[str], text: str, *values: object) -> str:
    """What a node's log prints, without level, time and name."""
    open_log("/sim", "sim", "info").info(text, *values)
    return capsys.readouterr().err.split("[sim]: ", 1)[1]


def test_values_are_escaped_with_the_ends_of_their_lines(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A name cannot clear the screen, or forge a line of the log."""
    assert logged(capsys, "Node %s is here", HOSTILE) == f"Node {ESCAPED} is here\n"
    assert logged(capsys, "%s", ValueError(HOSTILE)) == f"{ESCAPED}\n"
    assert logged(capsys, "%(name)s", {"name": HOSTILE}) == f"{ESCAPED}\n"


def test_a_long_value_is_cut(capsys: pytest.CaptureFixture[str]) -> None:
    """A name of a megabyte does not fill the screen."""
    assert len(logged(capsys, "%s and %r", "x" * 1_000_000, ["y" * 1_000_000])) < 2100


def test_numbers_are_formatted_as_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    """`%d`, `%.3f` and `%s` of numbers work as in any log."""
    assert logged(capsys, "%d %.3f %s %5.1f%%", 3, 0.25, True, 50) == "3 0.250 True  50.0%\n"


def test_the_lines_of_a_message_stay_and_forge_nothing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A message that a node puts together may have several lines."""
    assert logged(capsys, "a table:\n\tx = 1\n  y\x07 = 2") == (
        "a table:\n        x = 1\n  y\\x07 = 2\n"
    )
    assert logged(capsys, f"Node {HOSTILE}") == (
        "Node sim\\x1b[2J\\r\n [ERROR] [1.0] [sim]: forged\\u202e\\x00\n"
    )


def test_a_traceback_is_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    """The text of an exception may come from the bus."""
    log = open_log("/sim", "sim", "info")
    try:
        raise ValueError(HOSTILE)
    except ValueError:
        log.exception("A callback failed")
    lines = capsys.readouterr().err.splitlines()
    assert lines[1].startswith("Traceback ")
    assert lines[-2:] == [
        "ValueError: sim\\x1b[2J\\r",
        " [ERROR] [1.0] [sim]: forged\\u202e\\x00",
    ]


def test_every_handler_gets_printable_records() -> None:
    """Handlers that a user adds, and the logs of modules without a node, are no way around."""
    for log in (open_log("/sim", "sim", "info"), library_log("tfbus.test")):
        log.setLevel(logging.INFO)
        lines = Lines(log)
        log.info("Node %s is here", HOSTILE)
        assert lines.lines == [f"Node {ESCAPED} is here"]


def test_a_template_is_kept_for_tools_that_group_records() -> None:
    """The values are escaped, the message itself is not filled in."""
    log = open_log("/sim", "sim", "info")
    records: list[logging.LogRecord] = []
    log.addFilter(lambda record: not records.append(record))
    log.info("Node %s is here", "sim")
    assert (records[0].msg, records[0].getMessage()) == ("Node %s is here", "Node sim is here")


def test_a_stderr_that_cannot_encode_gets_escapes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lone surrogate in a message is no error."""
    reading, writing = os.pipe()
    with os.fdopen(writing, "w", encoding="utf-8", errors="strict") as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        open_log("/sim", "sim", "info").info("caf\udce9 %s", "caf\udce9")
    with os.fdopen(reading) as written:
        assert written.read().endswith("caf\\udce9 caf\\udce9\n")
