"""Several hosts on a network: the tutorial across machines, by scouting and through a router."""

import itertools
import json
import signal
import sys
from collections.abc import Iterator

import hosts
import pytest
from conftest import Bus, Process, eventually

REASON = hosts.why_not()
pytestmark = pytest.mark.skipif(bool(REASON), reason=REASON or "-")

COMMANDS = {
    "sim": ("robot", "simulator", "--headless"),
    "broadcaster": ("robot", "broadcaster", "--param", "turtlename=turtle1"),
    "echo": ("desk", "echo", "world", "drone", "--format", "json", "--rate", "10"),
}
# The pose that the turtle starts with is the middle of the field: the drone is behind and above.
DRONE_AT_START = [-0.5, 0.0, 1.0]


class Network:
    """Hosts, and processes of tfbus on them."""

    def __init__(self, bus: Bus):
        self._bus = bus
        self.hosts = hosts.Hosts("robot", "desk", "hub")
        self.router = f"tcp/{self.hosts.address['hub']}:7447"

    def start(self, host: str, *arguments: str, through_router: bool = False) -> Process:
        """`tfbus ARGUMENTS` on the host, found by scouting or through the router."""
        env = {"TFBUS_CONFIG": "", "TFBUS_CONNECT": ""}
        if through_router:
            env = {"TFBUS_CONFIG": "", "TFBUS_MODE": "client", "TFBUS_CONNECT": self.router}
        command = self.hosts.command(host, sys.executable, "-m", "tfbus", *arguments)
        return self._bus.start_command(command, env=env)

    def start_router(self) -> Process:
        """The router, ready."""
        router = self.start("hub", "router")
        router.wait_for_line("Routing on")
        return router


@pytest.fixture
def network(bus: Bus) -> Iterator[Network]:
    network = Network(bus)
    yield network
    bus.close()
    network.hosts.close()


def is_printing(echo: Process) -> bool:
    """Whether the echo prints the drone's pose, from now on."""
    before = len(echo.out)
    eventually(lambda: len(echo.out) > before)
    return bool(json.loads(echo.out[-1]))


@pytest.mark.parametrize("order", list(itertools.permutations(COMMANDS))[::2], ids="-".join)
def test_two_hosts_find_each_other(network: Network, order: tuple[str, ...]) -> None:
    """The robot's frames are seen from another host without any option, whoever starts first."""
    processes = {name: network.start(*COMMANDS[name]) for name in order}
    echo = processes["echo"]
    eventually(lambda: echo.out)
    assert pytest.approx(find_xyz(json.loads(echo.out[0])), abs=1e-6) == DRONE_AT_START
    assert {name: process.stop() for name, process in processes.items()} == dict.fromkeys(order, 0)


def test_nodes_of_another_host_are_listed_and_called(network: Network) -> None:
    """The tools see and reach the nodes of another host."""
    network.start(*COMMANDS["sim"]).wait_for_line("ready")
    listed = network.start("desk", "node", "list")
    assert (listed.wait(), listed.out) == (0, ["/sim"])
    called = network.start("desk", "call", "spawn", "{x: 2, y: 3, name: turtle2}")
    assert (called.wait(), called.out) == (0, ['{"name": "turtle2"}'])


def test_clients_wait_for_their_router_and_survive_its_restart(network: Network) -> None:
    """Clients may start before their router, say what they wait for, and outlive it."""
    processes = [network.start(*command, through_router=True) for command in COMMANDS.values()]
    for process in processes:
        process.wait_for_line(f"Waiting for a router at {network.router}")
    tool = network.start("desk", "node", "list", through_router=True)
    assert (tool.wait(), tool.out) == (1, [])
    assert tool.err[0].startswith(f"Error: could not join the bus through {network.router}: ")
    router = network.start_router()
    echo = processes[-1]
    assert is_printing(echo)
    router.kill()
    router = network.start_router()
    listed = network.start("desk", "node", "list", through_router=True)
    assert listed.wait() == 0

    def teleported() -> bool:
        call = ("call", "turtle1/teleport_absolute", "{x: 1, y: 1}")
        return network.start("desk", *call, through_router=True).wait() == 0

    eventually(teleported)
    moved = pytest.approx([-5.044444, -4.544444, 1.0], abs=1e-5)
    eventually(lambda: find_xyz(json.loads(echo.out[-1])) == moved)
    assert [process.stop(signal.SIGTERM) for process in (*processes, router)] == [0, 0, 0, 0]


def test_ctrl_c_ends_a_client_that_waits_for_its_router(network: Network) -> None:
    """A client that waits for a router hears Ctrl-C."""
    for number in (signal.SIGINT, signal.SIGTERM):
        process = network.start(*COMMANDS["sim"], through_router=True)
        process.wait_for_line("Waiting for a router")
        assert process.stop(number) == 0
        assert "Traceback" not in "".join(process.err)


def find_xyz(told: dict[str, object]) -> list[float]:
    """The translation in a line of echo's JSON."""
    for key in ("xyz", "translation"):
        if key in told:
            value = told[key]
            assert isinstance(value, list)
            return value
    raise AssertionError(f"no translation in {told}")
