"""Publishers in processes of their own, and what a node's log says of them."""

import logging
import sys
from pathlib import Path

from tests.live_bus import Bus, Process
from tfbus import Node

_SCRIPT = Path(__file__).parent / "stream_publisher.py"


def launch(bus: Bus, *arguments: str, env: dict[str, str] | None = None) -> Process:
    """`stream_publisher.py ARGUMENTS`, not waited for."""
    return bus.start_command([sys.executable, str(_SCRIPT), *arguments], env=env)


def start(bus: Bus, *arguments: str, env: dict[str, str] | None = None) -> Process:
    """`stream_publisher.py ARGUMENTS`, ready."""
    process = launch(bus, *arguments, env=env)
    process.wait_for_line("ready")
    return process


class Lines(logging.Handler):
    """What a node's log says."""

    def __init__(self, node: Node) -> None:
        super().__init__()
        self.lines: list[str] = []
        node.log.addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())
