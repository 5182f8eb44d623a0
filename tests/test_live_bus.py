"""Processes under test that hang."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from tests.live_bus import Process

pytestmark = pytest.mark.real

HANGS = """
import threading
def stuck():
    print("begun", flush=True)
    threading.Event().wait()
stuck()
"""


@pytest.fixture
def hanging() -> Iterator[Process]:
    """A process that has begun, and does not end."""
    process = Process([sys.executable, "-c", HANGS], dict(os.environ))
    process.wait_for_line("begun")
    yield process
    process.kill()


@pytest.mark.parametrize(
    "wait",
    [
        lambda process: process.wait(timeout_s=0.01),
        lambda process: process.wait_for_line("ended", timeout_s=0.01),
    ],
    ids=["for its end", "for a line"],
)
def test_the_failure_says_where_it_hangs(
    hanging: Process, wait: Callable[[Process], object]
) -> None:
    """It has the stacks of Python."""
    with pytest.raises((subprocess.TimeoutExpired, AssertionError)) as caught:
        wait(hanging)
    said = "\n".join([str(caught.value), *getattr(caught.value, "__notes__", ())])
    assert "in stuck" in said
