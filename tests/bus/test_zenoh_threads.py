"""The threads that Zenoh receives with."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.live_bus import free_port

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")

_PROGRAM = """
import logging, sys
from glob import glob
from pathlib import Path
from tfbus import NodeSettings
from tfbus.bus.session import Session

log, endpoint = logging.getLogger(), sys.argv[1]
config = sys.argv[2]
with (
    Session(NodeSettings("a", config=config, listen=(endpoint,)), log),
    Session(NodeSettings("b", config=config, connect=(endpoint,)), log),
):
    names = [Path(name).read_text() for name in glob("/proc/self/task/*/comm")]
    print(sum(name.startswith("rx-") for name in names))
"""


def receiving_threads(folder: Path, env: dict[str, str]) -> int:
    """How many threads a process with one link receives with."""
    config = folder / "zenoh.json5"
    config.write_text("{scouting: {multicast: {enabled: false}}}")
    command = [sys.executable, "-c", _PROGRAM, f"tcp/127.0.0.1:{free_port()}", str(config)]
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

    assert receiving_threads(tmp_path, dict(os.environ)) == threads
