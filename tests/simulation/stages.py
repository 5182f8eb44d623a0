"""Stages for scenarios: in a simulated network, and on real hosts with real Zenoh."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any, Protocol

from tests.hosts.network import Hosts
from tests.simulation.actor import Actor
from tfbus.testing.network import Network, SimulationError
from tfbus.testing.processes import Process

DEADLINE_S = 30.0


class Player(Protocol):
    """An actor of a scenario, wherever it is."""

    def do(self, verb: str, *args: Any) -> Any:
        """Do one thing, and return what comes of it."""
        ...


class Part:
    """An actor of a scenario: its verbs are methods."""

    def __init__(self, stage: "Stage", player: Player) -> None:
        self._stage = stage
        self._player = player

    def __getattr__(self, verb: str) -> Callable[..., Any]:
        return lambda *args: self._player.do(verb, *args)

    def expect(self, verb: str, *args: Any, gives: Any) -> None:
        """Wait until doing this gives that."""
        found: list[Any] = [None]

        def is_there() -> bool:
            found[0] = self._player.do(verb, *args)
            return bool(found[0] == gives)

        assert self._stage.wait(is_there), f"{verb}{args} gives {found[0]!r}, not {gives!r}"

    def expects(self, name: str, *events: str) -> None:
        """Wait until these events, and no others, have come in this order."""
        self.expect("events", name, gives=list(events))

    def expects_all(self, name: str, *events: str) -> None:
        """Wait until each of these events has come, in any order."""
        found: list[str] = []

        def is_there() -> bool:
            found[:] = self._player.do("events", name)
            return set(events) <= set(found)

        assert self._stage.wait(is_there), f"{name} has {found}, not {events}"

    def kill(self) -> None:
        """SIGKILL."""
        self._stage.signal(self._player, "kill")

    def stop(self) -> None:
        """SIGSTOP."""
        self._stage.signal(self._player, "stop")

    def go_on(self) -> None:
        """SIGCONT."""
        self._stage.signal(self._player, "go_on")


class Stage(Protocol):
    """The verbs of a scenario."""

    def open(self, name: str, host: str = "h1", **options: Any) -> Part:
        """A session on a host."""
        ...

    def wait(self, condition: Callable[[], bool]) -> bool:
        """Wait until the condition holds; whether it does."""
        ...

    def signal(self, player: Player, what: str) -> None:
        """Send a signal to the process of an actor."""
        ...

    def set_cable(self, host: str, *, plugged: bool) -> None:
        """Pull a host's cable out, or plug it in."""
        ...

    def set_deaf(self, host: str, *, deaf: bool) -> None:
        """Drop all that is sent to a host, or none of it."""
        ...

    def set_mute(self, host: str, *, mute: bool) -> None:
        """Drop all that a host sends, or none of it."""
        ...

    def set_way(self, one: str, other: str, *, is_open: bool) -> None:
        """Let what one host sends to another arrive there, or get lost."""
        ...

    def set_rate(self, host: str, bytes_a_second: int) -> None:
        """Let a host send so much at most."""
        ...

    def set_multicast(self, host: str, *, on: bool) -> None:
        """Carry packets for many to and from a host, or drop them."""
        ...

    def roam(self, host: str) -> None:
        """Give a host another address."""
        ...

    def address(self, host: str, port: int = 7447, protocol: str = "tcp") -> str:
        """The endpoint at which a session of this host listens."""
        ...


HOSTS = "h1", "h2", "h3"


class _Simulated:
    def __init__(self, network: Network, process: Process, name: str, options: Any) -> None:
        self.network, self.process = network, process
        with network.within(process):
            self._actor = Actor(name, options)

    def do(self, verb: str, *args: Any) -> Any:
        with self.network.within(self.process):
            return self._actor.do(verb, *args)


class SimulatedStage:
    """A stage in a simulated network."""

    def __init__(self, network: Network) -> None:
        self.network = network
        for host in HOSTS:
            network.host(host)

    def open(self, name: str, host: str = "h1", **options: Any) -> Part:
        with self.network.process(host, name) as process:
            pass
        return Part(self, _Simulated(self.network, process, name, options))

    def wait(self, condition: Callable[[], bool]) -> bool:
        try:
            self.network.run(until=condition, timeout_s=DEADLINE_S)
        except SimulationError:
            return False
        return True

    def signal(self, player: Any, what: str) -> None:
        getattr(self.network, what)(player.process)

    def set_cable(self, host: str, *, plugged: bool) -> None:
        if plugged:
            self.network.heal()
        else:
            self.network.partition(host)

    def set_deaf(self, host: str, *, deaf: bool) -> None:
        for other in _others(host):
            self.set_way(other, host, is_open=not deaf)

    def set_mute(self, host: str, *, mute: bool) -> None:
        for other in _others(host):
            self.set_way(host, other, is_open=not mute)

    def set_way(self, one: str, other: str, *, is_open: bool) -> None:
        if is_open:
            self.network.heal()
        else:
            self.network.cut(one, other, both_ways=False)

    def set_rate(self, host: str, bytes_a_second: int) -> None:
        for other in _others(host):
            self.network.path(host, other, bytes_a_second=bytes_a_second)

    def set_multicast(self, host: str, *, on: bool) -> None:
        for other in _others(host):
            self.network.path(host, other, multicast=on)

    def roam(self, host: str) -> None:
        self.network.roam(host, "elsewhere")

    def address(self, host: str, port: int = 7447, protocol: str = "tcp") -> str:
        return f"{protocol}/{host}:{port}"


def _others(host: str) -> list[str]:
    return [each for each in HOSTS if each != host]


class _Real:
    def __init__(self, hosts: Hosts, host: str, name: str, options: Any) -> None:
        command = [sys.executable, "-m", "tests.simulation.actor", json.dumps([name, options])]
        self.process = subprocess.Popen(
            hosts.command(host, *command), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._read()

    def do(self, verb: str, *args: Any) -> Any:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps([verb, *args]) + "\n")
        self.process.stdin.flush()
        return self._read()

    def _read(self) -> Any:
        assert self.process.stdout is not None
        return json.loads(self.process.stdout.readline())

    def end(self) -> None:
        self.process.kill()
        self.process.communicate()


_SIGNALS = {"kill": signal.SIGKILL, "stop": signal.SIGSTOP, "go_on": signal.SIGCONT}


class RealStage:
    """A stage on hosts in network namespaces, where Zenoh's own sessions meet."""

    def __init__(self) -> None:
        self._hosts = Hosts(*HOSTS)
        self._players: list[_Real] = []
        # What takes back each change of the network.
        self._heals: dict[tuple[str, ...], Callable[[], None]] = {}

    def open(self, name: str, host: str = "h1", **options: Any) -> Part:
        player = _Real(self._hosts, host, name, options)
        self._players.append(player)
        return Part(self, player)

    def wait(self, condition: Callable[[], bool]) -> bool:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            if time.monotonic() > deadline:
                return False
            time.sleep(0.02)
        return True

    def signal(self, player: Any, what: str) -> None:
        player.process.send_signal(_SIGNALS[what])

    def set_cable(self, host: str, *, plugged: bool) -> None:
        set_link = self._hosts.set_link
        self._change(("cable", host), not plugged, lambda injured: set_link(host, up=not injured))

    def set_deaf(self, host: str, *, deaf: bool) -> None:
        set_deaf = self._hosts.set_deaf
        self._change(("deaf", host), deaf, lambda injured: set_deaf(host, deaf=injured))

    def set_mute(self, host: str, *, mute: bool) -> None:
        set_mute = self._hosts.set_mute
        self._change(("mute", host), mute, lambda injured: set_mute(host, mute=injured))

    def set_way(self, one: str, other: str, *, is_open: bool) -> None:
        def change(injured: bool) -> None:
            self._hosts.set_way(one, other, is_open=not injured)

        self._change(("way", one, other), not is_open, change)

    def set_rate(self, host: str, bytes_a_second: int) -> None:
        def change(injured: bool) -> None:
            self._hosts.set_rate(host, bytes_a_second if injured else None)

        self._change(("rate", host), True, change)

    def set_multicast(self, host: str, *, on: bool) -> None:
        def change(injured: bool) -> None:
            self._hosts.set_multicast(host, on=not injured)

        self._change(("multicast", host), not on, change)

    def roam(self, host: str) -> None:
        former = self._hosts.address[host]

        def change(injured: bool) -> None:
            self._hosts.set_network(host, "10.99.0.77" if injured else former)

        self._change(("roam", host), True, change)

    def address(self, host: str, port: int = 7447, protocol: str = "tcp") -> str:
        return f"{protocol}/{self._hosts.address[host]}:{port}"

    def _change(self, what: tuple[str, ...], injured: bool, change: Callable[[bool], None]) -> None:
        """Change the network, unless it is so already."""
        if injured and what not in self._heals:
            change(True)
            self._heals[what] = lambda: change(False)
        elif not injured and what in self._heals:
            self._heals.pop(what)()

    def clear(self) -> None:
        """End all actors, and take all changes of the network back: the next scenario is alone."""
        for player in self._players:
            player.end()
        self._players.clear()
        while self._heals:
            self._heals.popitem()[1]()

    def close(self) -> None:
        """End all, and take the hosts down."""
        self.clear()
        self._hosts.close()
