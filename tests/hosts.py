"""Hosts for tests: network namespaces that a bridge joins, each with an address of its own."""

import os
import shutil
import subprocess
from collections.abc import Sequence

BRIDGE = "tfbr"


def why_not() -> str:
    """Why hosts cannot be made here; "" where they can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which("ip") is None:
        return "network namespaces need the command ip (apt-get install iproute2)"
    probe = f"tfbus-{os.getpid()}-probe"
    try:
        _ip("netns", "add", probe)
        _ip("netns", "del", probe)
    except subprocess.CalledProcessError as error:
        return f"network namespaces cannot be made here: {error.stderr.strip()}"
    return ""


class Hosts:
    """Some hosts on one network, which nothing else is on."""

    def __init__(self, *names: str):
        self._space = {name: f"tfbus-{os.getpid()}-{name}" for name in (*names, BRIDGE)}
        self.address = {name: f"10.99.0.{at}" for at, name in enumerate(names, start=1)}
        for space in self._space.values():
            _ip("netns", "add", space)
        bridge = self._space[BRIDGE]
        # Without a querier on the network a snooping bridge forgets who wants multicast.
        _ip("-n", bridge, "link", "add", BRIDGE, "type", "bridge", "mcast_snooping", "0")
        _ip("-n", bridge, "link", "set", BRIDGE, "up")
        for name, address in self.address.items():
            space = self._space[name]
            cable = ["link", "add", name, "netns", bridge, "type", "veth"]
            _ip(*cable, "peer", "name", "eth0", "netns", space)
            _ip("-n", bridge, "link", "set", name, "master", BRIDGE, "up")
            _ip("-n", space, "addr", "add", f"{address}/24", "dev", "eth0")
            _ip("-n", space, "link", "set", "lo", "up")
            _ip("-n", space, "link", "set", "eth0", "up", "multicast", "on")

    def command(self, host: str, *command: str) -> Sequence[str]:
        """The command as it runs on the host."""
        return ["ip", "netns", "exec", self._space[host], *command]

    def set_link(self, host: str, *, up: bool) -> None:
        """Plug the host's cable in, or pull it out."""
        _ip("-n", self._space[BRIDGE], "link", "set", host, "up" if up else "down")

    def close(self) -> None:
        """Take the network down; processes on it are ended by who started them."""
        for space in self._space.values():
            _ip("netns", "del", space)


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True, timeout=10)
