"""The threads that Zenoh receives with."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.buses import DEADLINE_S
from tests.live_bus import free_port

pytestmark = [pytest.mark.real, pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")]

_PROGRAM = """
import logging, sys, time
from contextlib import suppress
from glob import glob
from pathlib import Path
from tfbus import NodeSettings
from tfbus.bus.session import Session

log, endpoint = logging.getLogger(), sys.argv[1]
config, wanted, within_s = sys.argv[2], int(sys.argv[3]), float(sys.argv[4])

def receiving():
    count = 0
    for name in glob("/proc/self/task/*/comm"):
        with suppress(OSError):  # the thread has ended
            count += Path(name).read_text().startswith("rx-")
    return count

with (
    Session(NodeSettings("a", config=config, listen=(endpoint,)), log),
    Session(NodeSettings("b", config=config, connect=(endpoint,)), log),
):
    deadline = time.monotonic() + within_s
    while receiving() < wanted and time.monotonic() < deadline:  # a thread has its name soon
        time.sleep(0.01)
    print(receiving())
"""


def receiving_threads(folder: Path, env: dict[str, str], wanted: int) -> int:
    """How many threads a process with one link receives with, once there are as many as wanted."""
    config = folder / "zenoh.json5"
    config.write_text("{scouting: {multicast: {enabled: false}}}")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    arguments = [endpoint, str(config), str(wanted), str(DEADLINE_S)]
    command = [sys.executable, "-c", _PROGRAM, *arguments]
    run = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
    return int(run.stdout)


@pytest.mark.parametrize(("chosen", "threads"), [(None, 32), ("(rx: (worker_threads: 3))", 3)])
def test_zenoh_receives_with_32_threads_or_as_the_user_chose(
    chosen: str | None, threads: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Closing a dead link blocks a thread for 10 s; ZENOH_RUNTIME of the environment counts."""
    monkeypatch.delenv("ZENOH_RUNTIME", raising=False)
    if chosen is not None:
        monkeypatch.setenv("ZENOH_RUNTIME", chosen)

    assert receiving_threads(tmp_path, dict(os.environ), threads) == threads
