"""Hosts for tests: network namespaces that a bridge joins, each with an address of its own."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.hosts.lossy_link import INTERFACE, Conditions, LossyLink
from tests.live_bus import Bus, Process

BRIDGE = "tfbr"
ROUTER_HOST = "hub"

# A hardware address that no host has.
_NOBODY = "02:00:00:00:00:99"

_TESTS = Path(__file__).parents[1]

_SHARED_MEMORY = "/dev/shm"

# The command after it, with shared memory of its own in the place of the machine's.
_WITH_SHARED_MEMORY = 'mount --bind "$0" /dev/shm && exec "$@"'


class Hosts:
    """Some hosts on one network, which nothing else is on; `offline` are those of them whose
    interface is down and without an address at first.

    Each has a shared memory of its own: in that of the machine Fast DDS shares ports with the nodes
    of other networks, and waits for the locks of those that were killed.
    """

    def __init__(self, *names: str, offline: Sequence[str] = ()):
        self._space = {name: f"tfbus-{os.getpid()}-{name}" for name in (*names, BRIDGE)}
        self.address = {name: f"10.99.0.{at}" for at, name in enumerate(names, start=1)}
        self.link_address = {name: f"10.98.0.{at}" for at, name in enumerate(names, start=1)}
        self._interface = dict.fromkeys(names, "eth0")
        self._memory = {
            name: tempfile.mkdtemp(prefix=f"{self._space[name]}-", dir=_SHARED_MEMORY)
            for name in names
        }
        self._links: list[LossyLink] = []
        for space in self._space.values():
            _ip("netns", "add", space)
        bridge = self._space[BRIDGE]
        # Without a querier on the network a snooping bridge forgets who wants multicast.
        _ip("-n", bridge, "link", "add", BRIDGE, "type", "bridge", "mcast_snooping", "0")
        _ip("-n", bridge, "link", "set", BRIDGE, "up")
        for name, address in self.address.items():
            space = self._space[name]
            cable = ["link", "add", "name", name, "netns", bridge, "type", "veth"]
            _ip(*cable, "peer", "name", "eth0", "netns", space)
            _ip("-n", bridge, "link", "set", name, "master", BRIDGE, "up")
            _ip("-n", space, "link", "set", "lo", "up")
            if name not in offline:
                self.set_network(name, address)

    def command(self, host: str, *command: str) -> Sequence[str]:
        """The command as it runs on the host."""
        enter = ["ip", "netns", "exec", self._space[host]]
        return [*enter, "sh", "-c", _WITH_SHARED_MEMORY, self._memory[host], *command]

    def set_link(self, host: str, *, up: bool) -> None:
        """Plug the host's cable in, or pull it out."""
        _ip("-n", self._space[BRIDGE], "link", "set", host, "up" if up else "down")

    def set_network(self, host: str, address: str) -> None:
        """Bring the host's interface up with this address, as DHCP does: a former one is gone."""
        space, interface = self._space[host], self._interface[host]
        _ip("-n", space, "addr", "flush", "dev", interface)
        _ip("-n", space, "addr", "add", f"{address}/24", "dev", interface)
        _ip("-n", space, "link", "set", interface, "up", "multicast", "on")
        self.address[host] = address

    def replace_interface(self, host: str) -> None:
        """Take the host's interface away, and give it one of another name with the same address."""
        bridge, space = self._space[BRIDGE], self._space[host]
        interface = "wlan0" if self._interface[host] == "eth0" else "eth0"
        self._interface[host] = interface
        _ip("-n", bridge, "link", "del", "dev", host)
        cable = ["link", "add", "name", host, "netns", bridge, "type", "veth"]
        _ip(*cable, "peer", "name", interface, "netns", space)
        _ip("-n", bridge, "link", "set", "dev", host, "master", BRIDGE, "up")
        _ip("-n", space, "addr", "add", f"{self.address[host]}/24", "dev", interface)
        _ip("-n", space, "link", "set", interface, "up", "multicast", "on")

    def join_by_tunnel(self, one: str, other: str) -> None:
        """Join two hosts by an interface that both get now, as a VPN does."""
        ends = (("tun0", self._space[one], "10.77.0.1"), ("tun0", self._space[other], "10.77.0.2"))
        (name, space, _), (_, other_space, _) = ends
        _ip("link", "add", "name", name, "netns", space, "type", "veth", "peer", "name", name,
            "netns", other_space)  # fmt: skip
        for interface, host, address in ends:
            _ip("-n", host, "addr", "add", f"{address}/24", "dev", interface)
            _ip("-n", host, "link", "set", interface, "up", "multicast", "on")

    def join_by_link(self, one: str, other: str, conditions: Conditions) -> LossyLink:
        """Join two hosts by a bad link; each is reached by the other at `link_address` of it."""
        addresses = self.link_address[one], self.link_address[other]
        link = LossyLink((self._space[one], self._space[other]), addresses)
        self._links.append(link)
        link.set(conditions)
        return link

    def renumber_link(self, host: str, address: str) -> None:
        """Give a host another address on its bad link."""
        space = self._space[host]
        _ip("-n", space, "addr", "flush", "dev", INTERFACE)
        _ip("-n", space, "addr", "add", f"{address}/24", "dev", INTERFACE)
        self.link_address[host] = address

    def end_connections(self, host: str) -> None:
        """End all connections of TCP that other hosts have to one."""
        _ip("netns", "exec", self._space[host], "ss", "-K", "-t", "dst", "10.98.0.0/24")

    def set_deaf(self, host: str, *, deaf: bool) -> None:
        """Drop all that is sent to the host, or none of it."""
        _set_dropping(self._space[BRIDGE], host, deaf)

    def set_mute(self, host: str, *, mute: bool) -> None:
        """Drop all that the host sends, or none of it."""
        _set_dropping(self._space[host], self._interface[host], mute)

    def set_way(self, one: str, other: str, *, is_open: bool) -> None:
        """Let what one host sends to the addresses of another arrive there, or get lost; packets
        for many still arrive.
        """
        space = self._space[one]
        for address in self._addresses(other):
            at = [address, "dev", self._interface[one]]
            if is_open:
                _ip("-n", space, "neigh", "del", *at)
            else:
                _ip("-n", space, "neigh", "replace", *at, "lladdr", _NOBODY, "nud", "permanent")

    def _addresses(self, host: str) -> list[str]:
        """The addresses of the host's interface, of IPv4 and IPv6."""
        shown = _ip("-n", self._space[host], "-j", "addr", "show", "dev", self._interface[host])
        return [each["local"] for each in json.loads(shown)[0]["addr_info"]]

    def set_rate(self, host: str, bytes_a_second: int | None) -> None:
        """Let the host send so much at most, or without bound."""
        space, interface = self._space[host], self._interface[host]
        if bytes_a_second is None:
            _ip("netns", "exec", space, "tc", "qdisc", "del", "dev", interface, "root")
        else:
            bucket = ["tbf", "rate", f"{8 * bytes_a_second}", "burst", "64kb", "latency", "50ms"]
            _ip("netns", "exec", space, "tc", "qdisc", "add", "dev", interface, "root", *bucket)

    def set_multicast(self, host: str, *, on: bool) -> None:
        """Carry packets for many to and from the host, or drop them."""
        # From the host, the only one that is asked for it; to the host, as an access point may.
        bridge = self._space[BRIDGE]
        state = "on" if on else "off"
        _ip("-n", bridge, "link", "set", host, "type", "bridge_slave", "mcast_flood", state)
        interface = self._interface[host]
        _ip("-n", self._space[host], "link", "set", interface, "multicast", state)

    def close(self) -> None:
        """Take the network down; processes on it are ended by who started them."""
        for link in self._links:
            link.close()
        for space in self._space.values():
            _ip("netns", "del", space)
        for folder in self._memory.values():
            shutil.rmtree(folder, ignore_errors=True)


class Network:
    """Hosts, and processes of Python on them: peers that scout, or clients of a router."""

    def __init__(self, bus: Bus, *names: str, offline: Sequence[str] = ()):
        self._bus = bus
        self.hosts = Hosts(*names, ROUTER_HOST, offline=offline)
        self.router = f"tcp/{self.hosts.address[ROUTER_HOST]}:7447"

    def start(
        self,
        host: str,
        *arguments: str,
        client: bool = False,
        env: Mapping[str, str] | None = None,
    ) -> Process:
        """`python ARGUMENTS` on the host; a script of the tests is found by its name."""
        program, *rest = arguments
        if program.endswith(".py"):
            program = str(next(_TESTS.rglob(program)))
        alone = {"TFBUS_CONFIG": "", "TFBUS_CONNECT": ""}
        joined = {"TFBUS_MODE": "client", "TFBUS_CONNECT": self.router} if client else {}
        command = self.hosts.command(host, sys.executable, program, *rest)
        return self._bus.start_command(command, env=alone | joined | dict(env or {}))

    def start_router(self, *, env: Mapping[str, str] | None = None) -> Process:
        """The router, ready."""
        router = self.start(ROUTER_HOST, "-m", "tfbus", "router", env=env)
        router.wait_for_line("Routing on")
        return router

    def close(self) -> None:
        """End the processes and take the network down."""
        self._bus.close()
        self.hosts.close()


def frames(witness: Process) -> dict[str, Any]:
    """What the witness knew of each frame when it printed its last line."""
    known: dict[str, Any] = json.loads(witness.out[-1])["frames"] if witness.out else {}
    return known


def _set_dropping(space: str, interface: str, dropping: bool) -> None:
    # A token bucket drops each packet that is larger than its burst.
    bucket = ("tbf", "rate", "1kbit", "burst", "10", "latency", "1ms")
    verb = (
        ("add", "dev", interface, "root", *bucket)
        if dropping
        else ("del", "dev", interface, "root")
    )
    _ip("netns", "exec", space, "tc", "qdisc", *verb)


def _ip(*arguments: str) -> str:
    """Run it; returns what it prints."""
    done = subprocess.run(
        ["ip", *arguments], check=True, capture_output=True, text=True, timeout=10
    )
    return done.stdout
