"""Networks that come after the processes, or change under them: all meet, without a restart."""

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from signal import SIGCONT, SIGSTOP
from typing import Any, NamedTuple

import pytest

from tests import needs
from tests.buses import eventually
from tests.hosts.fault_witness import PERIOD_S
from tests.hosts.network import ROUTER_HOST, Hosts, Network, frames
from tests.live_bus import Bus, Process

pytest.importorskip("cryptography", reason="needs cryptography: pip install cryptography")

from tfbus.bus.keystore import Keystore
from tfbus.bus.rights import Identity

REASON = needs.why_no_hosts()
pytestmark = [pytest.mark.real, pytest.mark.skipif(bool(REASON), reason=REASON or "-")]

NAMES = ("robot", "desk")
# A link that is lost is noticed in less than the time of so many reports.
REPORTS = 15


class Row(NamedTuple):
    """One way in which a network comes or changes.

    `offline` are the hosts without a network when the processes start, `unplugged` those whose
    interface has an address and no carrier. `change` is done then; `by_router` is whether a router
    can be reached after it.
    """

    change: Callable[[Hosts], None]
    offline: tuple[str, ...] = ()
    unplugged: tuple[str, ...] = ()
    by_router: bool = True


def come_up(*hosts_up: str) -> Callable[[Hosts], None]:
    """The interfaces of hosts get an address, and are up."""
    return lambda hosts: (
        [hosts.set_network(each, hosts.address[each]) for each in hosts_up] and None
    )


def plug_in(*hosts_up: str) -> Callable[[Hosts], None]:
    """The cables of hosts are plugged in."""
    return lambda hosts: [hosts.set_link(each, up=True) for each in hosts_up] and None


def renumber(*renumbered: str) -> Callable[[Hosts], None]:
    """Hosts get other addresses."""

    def change(hosts: Hosts) -> None:
        for each in renumbered:
            hosts.set_network(each, f"{hosts.address[each]}0")

    return change


def replace(*replaced: str) -> Callable[[Hosts], None]:
    """The interfaces of hosts are replaced by those of another name."""
    return lambda hosts: [hosts.replace_interface(each) for each in replaced] and None


ROWS = {
    "no interface here": Row(come_up("desk"), offline=("desk",)),
    "no interface there": Row(come_up("robot"), offline=("robot",)),
    "no interface on both": Row(come_up(*NAMES), offline=NAMES),
    "no carrier here": Row(plug_in("desk"), unplugged=("desk",)),
    "no carrier on both": Row(plug_in(*NAMES), unplugged=NAMES),
    "another address here": Row(renumber("desk")),
    "another address on both": Row(renumber(*NAMES)),
    "another interface here": Row(replace("desk")),
    "another interface on both": Row(replace(*NAMES)),
    "a tunnel": Row(
        lambda hosts: hosts.join_by_tunnel(*NAMES), offline=("robot",), by_router=False
    ),
}

# Each way between peers and, where these can, clients; one of the two on a closed bus, in turns: so
# each of the four kinds of bus meets half of the ways, and each way an open and a closed bus.
CASES = [
    (name, bool((at + client) % 2), client)
    for at, (name, row) in enumerate(ROWS.items())
    for client in (False, True)
    if row.by_router or not client
]


def id_of(case: tuple[str, bool, bool]) -> str:
    """A case as the names of tests have it."""
    name, closed, client = case
    return f"{name}-{'closed' if closed else 'open'}-{'clients' if client else 'peers'}"


class Members:
    """A publisher on the robot, a listener and another publisher on the desk."""

    def __init__(
        self,
        network: Network,
        row: Row,
        folder: Path,
        *,
        closed: bool,
        client: bool,
        moving: Sequence[str] = ("arm",),
    ):
        self.network = network
        self._client = client
        self._keys: Path | None = None
        if closed:
            keystore = Keystore.init(folder / "keys", days=10)
            for name in ("arm", "lamp"):
                keystore.add(Identity(name, "publisher", nodes=("**",)), days=5)
            keystore.add(Identity("witness", "reader"), days=5)
            keystore.add(Identity("hub", "router"), days=5)
            self._keys = keystore.path
        for host in row.unplugged:
            network.hosts.set_link(host, up=False)
        if client:
            router = network.start(ROUTER_HOST, "-m", "tfbus", "router", env=self._env("hub"))
            router.wait_for_line("Routing on")
        frames = [f"--static=arm{number}" for number in range(3)]
        frames += [f"--moving={each}" for each in moving]
        self.arm = self._start("robot", "stream_publisher.py", "arm", *frames)
        self.lamp = self._start("desk", "stream_publisher.py", "lamp", "--moving=lamp")
        self.witness = self._start("desk", "fault_witness.py", "witness")

    def _start(self, host: str, *arguments: str) -> Process:
        env = self._env(arguments[1])
        if self._client:
            protocol = "tls" if self._keys else "tcp"
            router = f"{protocol}/{self.network.hosts.address[ROUTER_HOST]}:7447"
            env |= {"TFBUS_MODE": "client", "TFBUS_CONNECT": router}
        return self.network.start(host, *arguments, env=env)

    def _env(self, identity: str) -> dict[str, str]:
        return {} if self._keys is None else {"TFBUS_SECURE": str(self._keys / identity)}

    def knows(self, *names: str) -> bool:
        """Whether the witness has these publishers as alive, their frames as fresh."""
        return bool(self.witness.out) and _knows(self.witness.out[-1], *names)

    def wait_until_apart(self, row: Row) -> None:
        """Wait until the processes are in the state in which the network comes or changes."""
        if not row.offline + row.unplugged:
            eventually(lambda: self.knows("arm", "lamp"))
        elif not self._client:
            eventually(lambda: self.knows("lamp"))
            self.arm_waits()
        elif "desk" in row.offline + row.unplugged:
            self.witness.wait_for_line("Waiting for a router")
        else:
            eventually(lambda: self.knows("lamp"))

    def arm_waits(self) -> None:
        """Wait until the publisher has started; it prints nothing."""
        count = len(self.witness.out)
        eventually(lambda: len(self.witness.out) > count + 5)

    def change(self, row: Row) -> float:
        """Change the network, and wait until the witness knows all, and goes on to; the time in
        which it did not.
        """
        before = len(self.witness.out)
        row.change(self.network.hosts)
        return self.wait_until_met(before)

    def wait_until_met(self, since: int) -> float:
        """Wait until the witness knows all in report after report; the time in s in which it did
        not, since it printed the report of this number.
        """

        def is_met() -> bool:
            last = self.witness.out[since:][-REPORTS:]
            return len(last) == REPORTS and all(_knows(each, "arm", "lamp") for each in last)

        eventually(is_met)
        return (len(self.witness.out) - since - REPORTS) * PERIOD_S


def _knows(line: str, *names: str) -> bool:
    report: dict[str, Any] = json.loads(line)
    known = report["frames"]
    statics = [known.get(f"arm{number}", {}) for number in range(3)]
    return (
        report["alive"] == sorted(names)
        and all(known.get(name, {}).get("age_s", 9.0) < 1.0 for name in names)
        and not any(known[name]["gone"] for name in names)
        and ("arm" not in names or all(each.get("x") == 0.0 for each in statics))
    )


@pytest.fixture
def network(bus: Bus, request: pytest.FixtureRequest) -> Iterator[Network]:
    name = request.node.callspec.params.get("name") if hasattr(request.node, "callspec") else None
    network = Network(bus, *NAMES, offline=() if name is None else ROWS[name].offline)
    yield network
    network.close()


def members(network: Network, row: Row, folder: Path, *, closed: bool, client: bool) -> Members:
    """The processes, in the state in which the network comes or changes."""
    started = Members(network, row, folder, closed=closed, client=client)
    started.wait_until_apart(row)
    return started


@pytest.mark.parametrize(("name", "closed", "client"), CASES, ids=map(id_of, CASES))
def test_processes_meet_once_their_network_is_there(
    network: Network, tmp_path: Path, name: str, closed: bool, client: bool
) -> None:
    """Processes that started before their network, or whose network changes, know all streams and
    frames soon after it is there.
    """
    row = ROWS[name]
    joined = members(network, row, tmp_path, closed=closed, client=client)
    print(f"known after {joined.change(row):.1f} s")


@pytest.mark.parametrize("closed", [False, True], ids=["open", "closed"])
def test_a_client_is_met_again_whatever_was_on_its_way_to_it(
    network: Network, tmp_path: Path, closed: bool
) -> None:
    """A client whose address changes is met again while more waits for its former address than the
    system takes.
    """
    row = ROWS["another address here"]
    moving = ["arm", *(f"part{number}" for number in range(400))]
    joined = Members(network, row, tmp_path, closed=closed, client=True, moving=moving)
    joined.wait_until_apart(row)
    print(f"known after {joined.change(row):.1f} s")


@pytest.mark.parametrize("client", [False, True], ids=["peers", "clients"])
def test_a_process_that_stood_still_is_met_again(
    network: Network, tmp_path: Path, client: bool
) -> None:
    """A process that did not run, as one of a host that slept, is known again once it runs."""
    joined = members(network, Row(lambda hosts: None), tmp_path, closed=False, client=client)
    joined.arm.signal(SIGSTOP)
    eventually(lambda: joined.knows("lamp"))
    before = len(joined.witness.out)
    joined.arm.signal(SIGCONT)
    print(f"known after {joined.wait_until_met(before):.1f} s")


def test_a_router_is_met_by_one_interface_after_the_other(network: Network) -> None:
    """A peer whose interface is replaced again and again, unseen since it stands still, meets the
    router, which does not scout, by the interface of now.
    """
    network.start_router()
    arm = network.start("robot", "stream_publisher.py", "arm", "--moving=arm")
    witness = network.start("desk", "fault_witness.py", "witness", client=True)
    for _ in range(3):
        eventually(lambda: frames(witness).get("arm", {}).get("gone") is False)
        arm.signal(SIGSTOP)
        eventually(lambda: frames(witness)["arm"]["gone"])
        network.hosts.replace_interface("robot")
        arm.signal(SIGCONT)
    eventually(lambda: not frames(witness)["arm"]["gone"])


def test_a_change_of_the_network_is_logged_in_one_line(network: Network, tmp_path: Path) -> None:
    """The log says once what has changed and what is done about it."""
    row = ROWS["no interface on both"]
    joined = Members(network, row, tmp_path, closed=False, client=False)
    eventually(lambda: joined.knows("arm", "lamp"))
    network.hosts.join_by_tunnel(*NAMES)
    line = joined.arm.wait_for_line("network has changed")
    assert "tun0 has 10.77.0.1: looking" in line
    assert len([line for line in joined.arm.err if "network has changed" in line]) == 1
