"""A simulated network for tests: nodes run unchanged in virtual time, everything from one seed."""

from tfbus.base.lazy_exports import exported

# As in tfbus/__init__.py: names are imported when first used. Each pytest imports the plugin.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from tfbus.testing.fabric import Faults as Faults
    from tfbus.testing.network import Network as Network
    from tfbus.testing.processes import Host as Host
    from tfbus.testing.processes import Process as Process
    from tfbus.testing.programs import Program as Program
    from tfbus.testing.tasks import SimulationError as SimulationError

_MODULES = {
    "Faults": "tfbus.testing.fabric",
    "Host": "tfbus.testing.processes",
    "Network": "tfbus.testing.network",
    "Process": "tfbus.testing.processes",
    "Program": "tfbus.testing.programs",
    "SimulationError": "tfbus.testing.tasks",
}
__all__ = [
    "Faults",
    "Host",
    "Network",
    "Process",
    "Program",
    "SimulationError",
]  # imported when used

__getattr__, __dir__ = exported(__name__, _MODULES)
