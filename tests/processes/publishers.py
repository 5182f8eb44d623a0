"""Publishers in processes of their own."""

import sys
from pathlib import Path

from tests.live_bus import Bus, Process

_SCRIPT = Path(__file__).parent / "stream_publisher.py"


def launch(bus: Bus, *arguments: str, env: dict[str, str] | None = None) -> Process:
    """`stream_publisher.py ARGUMENTS`, not waited for."""
    return bus.start_command([sys.executable, str(_SCRIPT), *arguments], env=env)


def start(bus: Bus, *arguments: str, env: dict[str, str] | None = None) -> Process:
    """`stream_publisher.py ARGUMENTS`, ready."""
    process = launch(bus, *arguments, env=env)
    process.wait_for_line("ready")
    return process
