"""A simulated network for tests: nodes run unchanged in virtual time, everything from one seed."""

from tfbus.testing.network import Network
from tfbus.testing.processes import Host, Process
from tfbus.testing.tasks import SimulationError

__all__ = ["Host", "Network", "Process", "SimulationError"]
