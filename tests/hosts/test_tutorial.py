"""Several hosts on a network: the tutorial across machines, by scouting and through a router."""

import itertools
import json
import signal
from collections.abc import Iterator

import pytest

from tests import needs
from tests.buses import eventually
from tests.hosts.network import Network
from tests.live_bus import Bus, Process

REASON = needs.why_no_hosts()
pytestmark = [pytest.mark.real, pytest.mark.skipif(bool(REASON), reason=REASON or "-")]

COMMANDS = {
    "sim": ("robot", "simulator", "--headless"),
    "broadcaster": ("robot", "broadcaster", "--param", "turtlename=turtle1"),
    "echo": ("desk", "echo", "world", "drone", "--format", "json", "--rate", "10"),
}
# The pose that the turtle starts with is the middle of the field: the drone is behind and above.
DRONE_AT_START = [-0.5, 0.0, 1.0]


def start(network: Network, host: str, *arguments: str, client: bool = False) -> Process:
    """`tfbus ARGUMENTS` on the host, found by scouting or through the router."""
    return network.start(host, "-m", "tfbus", *arguments, client=client)


@pytest.fixture
def network(bus: Bus) -> Iterator[Network]:
    network = Network(bus, "robot", "desk")
    yield network
    network.close()


def is_printing(echo: Process) -> bool:
    """Whether the echo prints the drone's pose, from now on."""
    before = len(echo.out)
    eventually(lambda: len(echo.out) > before)
    return bool(json.loads(echo.out[-1]))


@pytest.mark.parametrize("order", list(itertools.permutations(COMMANDS))[::2], ids="-".join)
def test_two_hosts_find_each_other(network: Network, order: tuple[str, ...]) -> None:
    """Another host sees the robot's frames without any option, whichever starts first."""
    processes = {name: start(network, *COMMANDS[name]) for name in order}
    echo = processes["echo"]
    eventually(lambda: echo.out)
    assert pytest.approx(find_xyz(json.loads(echo.out[0])), abs=1e-6) == DRONE_AT_START
    assert {name: process.stop() for name, process in processes.items()} == dict.fromkeys(order, 0)


def test_nodes_of_another_host_are_listed_and_called(network: Network) -> None:
    """The tools see and reach the nodes of another host."""
    start(network, *COMMANDS["sim"]).wait_for_line("ready")

    def says(*arguments: str) -> tuple[int, list[str]]:
        tool = start(network, "desk", *arguments)
        return tool.wait(), tool.out

    # A tool scouts for a moment only, in which a busy host may not answer.
    eventually(lambda: says("node", "list") == (0, ["/sim"]))
    spawn = ("call", "spawn", "{x: 2, y: 3, name: turtle2}")
    eventually(lambda: says(*spawn) == (0, ['{"name": "turtle2"}']))


def test_clients_wait_for_their_router_and_survive_its_restart(network: Network) -> None:
    """Clients may start before their router, say what they wait for, and outlive it."""
    processes = [start(network, *command, client=True) for command in COMMANDS.values()]
    for process in processes:
        process.wait_for_line(f"Waiting for a router at {network.router}")
    tool = start(network, "desk", "node", "list", client=True)
    assert (tool.wait(), tool.out) == (1, [])
    assert f"no router answers at {network.router}: " in tool.err[0]
    router = network.start_router()
    echo = processes[-1]
    assert is_printing(echo)
    router.kill()
    router = network.start_router()
    listed = start(network, "desk", "node", "list", client=True)
    assert listed.wait() == 0

    def teleported() -> bool:
        call = ("call", "turtle1/teleport_absolute", "{x: 1, y: 1}")
        return start(network, "desk", *call, client=True).wait() == 0

    eventually(teleported)
    moved = pytest.approx([-5.044444, -4.544444, 1.0], abs=1e-5)
    eventually(lambda: find_xyz(json.loads(echo.out[-1])) == moved)
    assert [process.stop(signal.SIGTERM) for process in (*processes, router)] == [0, 0, 0, 0]


def test_ctrl_c_ends_a_client_that_waits_for_its_router(network: Network) -> None:
    """Ctrl-C ends a client that waits for a router."""
    for number in (signal.SIGINT, signal.SIGTERM):
        process = start(network, *COMMANDS["sim"], client=True)
        process.wait_for_line("Waiting for a router")
        assert process.stop(number) == 0
        assert "Traceback" not in "".join(process.err)


def find_xyz(report: dict[str, object]) -> list[float]:
    """The translation in a line of echo's JSON."""
    for key in ("xyz", "translation"):
        if key in report:
            value = report[key]
            assert isinstance(value, list)
            return value
    raise AssertionError(f"no translation in {report}")
