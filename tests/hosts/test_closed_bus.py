"""A closed bus over several hosts, by scouting and through a router: a stranger, or a member that
obeys no rights, changes and reads nothing there.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import needs
from tests.buses import eventually
from tests.hosts.network import ROUTER_HOST, Network
from tests.live_bus import Bus, Process

pytest.importorskip("cryptography", reason="needs cryptography: pip install cryptography")

from tfbus.bus.keystore import Keystore
from tfbus.bus.rights import Identity

REASON = needs.why_no_hosts()
pytestmark = [pytest.mark.real, pytest.mark.skipif(bool(REASON), reason=REASON or "-")]

PORT = 7447


class Closed:
    """A network with a keystore; each process has an identity."""

    def __init__(self, network: Network, folder: Path) -> None:
        self.network = network
        self.keystore = Keystore.init(folder / "keys", days=10)
        for identity in (
            Identity("robot", "publisher", nodes=("**",)),
            Identity("leg", "publisher"),
            Identity("desk", "reader"),
            Identity("ben", "operator"),
            Identity("hub", "router"),
            Identity("gone", "publisher"),
            Identity("late", "publisher"),
        ):
            self.keystore.add(identity, days=5)
        self.keystore.revoke("gone")
        self.keystore.renew("late", days=-0.001)
        others = Keystore.init(folder / "others", days=10)
        others.add(Identity("robot", "publisher", nodes=("**",)), days=5)
        (others.path / "robot/authority.pem").write_bytes(
            (self.keystore.path / "desk/authority.pem").read_bytes()
        )
        self.other_robot = others.path / "robot"
        self.router = f"tls/{network.hosts.address[ROUTER_HOST]}:{PORT}"

    def start(self, host: str, identity: str, *arguments: str, client: bool = False) -> Process:
        """`tfbus ARGUMENTS` on a host by an identity."""
        return self.network.start(
            host, "-m", "tfbus", *arguments, env=self.environment(identity, client=client)
        )

    def environment(self, identity: str, *, client: bool) -> dict[str, str]:
        """What makes a process a member."""
        joined = {"TFBUS_MODE": "client", "TFBUS_CONNECT": self.router} if client else {}
        return {"TFBUS_SECURE": str(self.keystore.path / identity), **joined}

    def start_router(self) -> None:
        """A router, which enforces the rights of all."""
        router = self.start(ROUTER_HOST, "hub", "router")
        router.wait_for_line("Routing on")

    def attack(self, folder: Path, gets: str, *, through_router: bool) -> Process:
        """Start an attacker by the certificate in a folder, which tries until it gets that."""
        to = self.router if through_router else ""
        return self.network.start("cellar", "closed_bus_attacker.py", str(folder), gets, to)


@pytest.fixture
def closed(bus: Bus, tmp_path: Path) -> Iterator[Closed]:
    network = Network(bus, "robot", "desk", "cellar")
    yield Closed(network, tmp_path)
    network.close()


@pytest.mark.parametrize("client", [False, True], ids=["peers", "router"])
def test_the_tutorial_runs_closed_and_strangers_change_nothing(
    closed: Closed, client: bool
) -> None:
    """Launch, frames, echo, parameters and a call work by their roles; and none that is not a
    member, nor a member without the right, reads or changes anything meanwhile.
    """
    if client:
        closed.start_router()
    launch = closed.start("robot", "robot", "launch", "turtle", client=client)
    echo_arguments = ("echo", "world", "drone", "--format", "json", "--rate", "10")
    echo = closed.start("desk", "desk", *echo_arguments, client=client)
    eventually(lambda: echo.out)
    at_start = pose_in(echo)

    path = closed.keystore.path
    gets = {closed.other_robot: "nothing", path / "late": "nothing", Path("tcp"): "nothing"}
    gets |= {path / "gone": "links", path / "desk": "transforms", path / "leg": "transforms"}
    attackers = [
        (folder.name, each, closed.attack(folder, each, through_router=client))
        for folder, each in gets.items()
    ]
    for name, each, attacker in attackers:
        found = result_of(attacker)
        assert found["answers"] == [], name
        honest = [key for key in found["read"] if key.startswith("tf/")]
        assert bool(honest) is (each == "transforms"), name
        assert bool(found["links"]) is (each != "nothing"), name
        assert each == "transforms" or found["read"] == [], name

    before = len(echo.out)
    eventually(lambda: len(echo.out) > before + 3)
    assert pose_in(echo) == pytest.approx(at_start)

    def run(identity: str, *arguments: str) -> tuple[int, str]:
        process = closed.start("desk", identity, *arguments, client=client)
        code = process.wait()
        assert "Traceback" not in "".join(process.err)
        return code, "\n".join((*process.out, *process.err))

    # A tool waits for a moment only, in which a busy host may not answer.
    frames = eventually(lambda: said if "drone" in (said := run("desk", "frames")[1]) else "")
    assert "forged" not in frames
    eventually(lambda: run("desk", "param", "get", "sim", "background_r")[0] == 0)
    refused = run("desk", "call", "turtle1/teleport_absolute", "{x: 1, y: 1}")
    assert refused[0] == 1
    assert "may not call service" in refused[1]
    call = ("call", "turtle1/teleport_absolute", "{x: 1, y: 1}")
    eventually(lambda: run("ben", *call)[0] == 0)
    eventually(lambda: pose_in(echo) != pytest.approx(at_start))
    assert (echo.stop(), launch.stop()) == (0, 0)
    assert "Traceback" not in "".join((*launch.err, *launch.out, *echo.err))


def test_those_it_keeps_out_see_that_it_is_there(closed: Closed) -> None:
    """A tool without an identity, or by one of another authority, says that a closed bus is here
    and how to join it; on an open bus one by an identity says so too.
    """
    strangers = Keystore.init(closed.keystore.path.parent / "strangers", days=10)
    strangers.add(Identity("guest", "admin"), days=5)
    guest = {"TFBUS_SECURE": str(strangers.path / "guest")}
    echo = ("-m", "tfbus", "echo", "world", "drone")
    member = closed.start("robot", "robot", "static", "world", "drone")
    here = rf"a closed bus is here \(tls/{closed.network.hosts.address['robot']}:\d+\)"
    without = closed.network.start("desk", *echo)
    without.wait_for_line(f"{here}: join it by --secure DIR")
    without.stop()
    other = closed.network.start("cellar", *echo, env=guest)
    other.wait_for_line(f"{here} that this identity gets no link to: join it by one of its auth")
    member.stop()
    other.stop()
    closed.network.start("desk", "-m", "tfbus", "static", "world", "drone")
    other = closed.network.start("cellar", *echo, env=guest)
    other.wait_for_line(r"an open bus is here \(tcp/.*\): join it without --secure")


def result_of(attacker: Process) -> dict[str, list[str]]:
    """What an attacker has read, of whom it had links, and which answers it got."""
    eventually(lambda: attacker.popen.poll() is not None)
    attacker.wait()
    assert attacker.out, attacker.err
    found: dict[str, list[str]] = json.loads(attacker.out[-1])
    return found


def pose_in(echo: Process) -> list[float]:
    """The translation in the last line of echo's JSON."""
    report = json.loads(echo.out[-1])
    found: list[float] = report.get("xyz") or report["translation"]
    return found
