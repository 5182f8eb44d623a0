"""The processes of a launch file, as frozen values between the reader and the runner, and its
mistakes beside a file's (YamlFileError).
"""

from dataclasses import dataclass
from pathlib import Path

from tfbus.base.errors import TfbusError
from tfbus.base.yaml_file import FilePlace


@dataclass(frozen=True, slots=True)
class Argument:
    """An argument of a launch file, given as `name:=value`; required without a default."""

    name: str
    default: str | None = None
    description: str = ""
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Respawn:
    """How a process that ended is started again.

    First after `delay_s`, then after twice the delay each time, up to `longest_delay_s`; at most
    `limit` times in a row (None: no limit). A run of `steady_s` resets delay and count.
    """

    delay_s: float = 1.0
    limit: int | None = None
    longest_delay_s: float = 30.0
    steady_s: float = 30.0

    def delay_before(self, respawn: int) -> float | None:
        """Seconds to wait before the given respawn in a row, from 0; None after the last."""
        if self.limit is not None and respawn >= self.limit:
            return None
        longest = max(self.delay_s, self.longest_delay_s)
        # A larger exponent could overflow a float.
        return min(self.delay_s * 2.0 ** min(respawn, 64), longest)


@dataclass(frozen=True, slots=True)
class DescribedProcess:
    """A process of a launch: a tfbus node (`node`) or any program (`command`), not both.

    `node` is a subcommand of tfbus (an entry point of the group `tfbus.nodes`) or the path of a
    Python file; `arguments` come last on its command line. Names in `after` are full names of
    nodes, `/robot7/sim`. `secure` is the folder of its identity on a closed bus, `network` its
    network, and `poses` how precise the transforms are that it sends; "" for the whole launch's.
    """

    name: str
    namespace: str
    place: FilePlace
    directory: Path
    node: str = ""
    command: tuple[str, ...] = ()
    parameters: tuple[tuple[str, str], ...] = ()
    remappings: tuple[tuple[str, str], ...] = ()
    arguments: tuple[str, ...] = ()
    environment: tuple[tuple[str, str], ...] = ()
    respawn: Respawn | None = None
    required: bool = False
    after: tuple[str, ...] = ()
    sim_time: bool = False
    secure: str = ""
    network: str = ""
    poses: str = ""

    @property
    def full_name(self) -> str:
        """The name with its namespace in front, `/robot7/sim`."""
        return "/" + "/".join(filter(None, (self.namespace, self.name)))

    @property
    def label(self) -> str:
        """The name that starts each line of output, `robot7/sim`."""
        return self.full_name.removeprefix("/")


class LaunchError(TfbusError):
    """A launch file that cannot be found, or not be launched as asked."""


class LaunchArgumentError(LaunchError):
    """An argument that a launch file does not know, does not allow, or lacks.

    `argument` is its name.
    """

    def __init__(self, argument: str, reason: str) -> None:
        super().__init__(reason)
        self.argument = argument
