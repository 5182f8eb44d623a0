"""Publishers in processes of their own."""

from tests.simulated_bus import Bus
from tfbus.testing.programs import Program

_MODULE = "tests.processes.stream_publisher"


def launch(bus: Bus, *arguments: str, env: dict[str, str] | None = None) -> Program:
    """`stream_publisher.py ARGUMENTS`, not waited for."""
    return bus.start_python(_MODULE, *arguments, env=env)


def start(bus: Bus, *arguments: str, env: dict[str, str] | None = None) -> Program:
    """`stream_publisher.py ARGUMENTS`, ready."""
    process = launch(bus, *arguments, env=env)
    process.wait_for_line("ready")
    return process
