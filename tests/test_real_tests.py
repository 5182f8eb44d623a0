"""The guard of tests without the marker `real`."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable

import pytest

from tests import real_tests
from tests.buses import eventually
from tests.simulated_bus import Bus

REAL: dict[str, tuple[Callable[[], object], str]] = {
    "process": (lambda: subprocess.run([sys.executable, "-V"]), "starts a process"),
    "shell": (lambda: os.system("true"), "starts a process"),
    "socket": (lambda: socket.create_connection(("127.0.0.1", 1)), "opens a socket"),
    "sleep": (lambda: time.sleep(0.01), "sleeps in real time"),
}


@pytest.mark.parametrize(("do", "what"), REAL.values(), ids=REAL)
def test_a_test_without_the_marker_does_nothing_real(
    do: Callable[[], object], what: str, request: pytest.FixtureRequest
) -> None:
    """The error names the test, what it did, and the two ways out."""
    with pytest.raises(real_tests.RealThingError) as caught:
        do()
    real_tests.guard.found = ""  # this test is to pass
    assert str(caught.value).startswith(f"{request.node.nodeid} {what}")
    assert "simulated network" in str(caught.value)
    assert "@pytest.mark.real" in str(caught.value)


@pytest.mark.real
def test_a_test_with_the_marker_may_do_all() -> None:
    """The guard lets it pass."""
    subprocess.run([sys.executable, "-c", ""], check=True)
    time.sleep(0.01)


def test_a_bus_without_the_marker_is_simulated(bus: Bus) -> None:
    """A minute passes there in no time."""
    begun_s = time.monotonic()
    eventually(lambda: time.monotonic() > begun_s + 30.0)
    assert bus.run("node", "list").returncode == 0
