"""What a launch file says, as frozen values: nothing here reads, starts or waits."""

from dataclasses import dataclass
from pathlib import Path

from tfbus.launch.place import Place


@dataclass(frozen=True, slots=True)
class Argument:
    """An argument that a launch file takes: `name:=value`. Without a default it must be given."""

    name: str
    default: str | None = None
    description: str = ""
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Respawn:
    """How a process that ended is started again.

    The first time after `delay_s`, then after twice as long each time, never longer than
    `longest_delay_s`; at most `limit` times in a row (None: always). Once it has run for
    `steady_s` it has recovered: delay and count begin anew.
    """

    delay_s: float = 1.0
    limit: int | None = None
    longest_delay_s: float = 30.0
    steady_s: float = 30.0

    def delay_before(self, respawn: int) -> float | None:
        """Seconds to wait before the given respawn in a row (from 0); None: not again."""
        if self.limit is not None and respawn >= self.limit:
            return None
        longest = max(self.delay_s, self.longest_delay_s)
        # An exponent beyond this says nothing new and could overflow a float.
        return min(self.delay_s * 2.0 ** min(respawn, 64), longest)


@dataclass(frozen=True, slots=True)
class Process:
    """One process of a launch: a tfbus node (`node`) or any program (`command`), not both.

    `node` is a subcommand of tfbus (an entry point of the group `tfbus.nodes`) or the path of a
    Python file that is a node; `arguments` come after everything else. Names in `after` are full
    names of nodes, `/robot7/sim`.
    """

    name: str
    namespace: str
    place: Place
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

    @property
    def full_name(self) -> str:
        """The name with its namespace in front, `/robot7/sim`."""
        return "/" + "/".join(filter(None, (self.namespace, self.name)))

    @property
    def label(self) -> str:
        """The name that stands before each line of output, `robot7/sim`."""
        return self.full_name.removeprefix("/")
