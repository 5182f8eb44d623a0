"""`tfbus router`: arrivals and departures, and the error of a client that gets no link."""

import re

import pytest

from tests.buses import DEADLINE_S, eventually
from tests.live_bus import Bus, free_port
from tfbus import Buffer, Fleet, TransformListener

pytestmark = pytest.mark.real


def test_it_logs_who_joins_and_who_leaves(bus: Bus) -> None:
    """Nodes by name and routers by id and address; tools, which only look, not."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    through = {"TFBUS_MODE": "client", "TFBUS_CONNECT": endpoint}
    router = bus.start("router", "--listen", endpoint, env={"TFBUS_CONNECT": ""})
    router.wait_for_line("Routing on")
    sim = bus.start(
        "static", "map", "base", "--name", "mount", "--namespace", "robot7", env=through
    )
    router.wait_for_line(r"/robot7/mount has joined")
    eventually(lambda: bus.run("node", "list", env=through).stdout.split() == ["/robot7/mount"])
    sim.stop()
    router.wait_for_line(r"/robot7/mount has left")
    second = bus.start(
        "router", "--listen", "tcp/127.0.0.1:0", "--connect", endpoint, env={"TFBUS_CONNECT": ""}
    )
    router.wait_for_line(r"Linked to router [0-9a-f]+ at 127\.0\.0\.1$")
    second.stop()
    router.wait_for_line(r"Lost router [0-9a-f]+")
    assert not [line for line in router.err if "has joined" in line and "/robot7/mount" not in line]


@pytest.mark.parametrize(
    ("port", "said"),
    [(9, "Nothing answers at {} (Connection refused): still trying"), (0, "{} answers, and gives")],
    ids=["nothing", "itself"],
)
def test_it_names_an_endpoint_that_gives_it_no_link(bus: Bus, port: int, said: str) -> None:
    """A robot whose base is away, or was given a wrong address, says so in its log."""
    own = f"tcp/127.0.0.1:{free_port()}"
    other = f"tcp/127.0.0.1:{port}" if port else own
    router = bus.start("router", "--listen", own, "--connect", other, env={"TFBUS_CONNECT": ""})
    router.wait_for_line(re.escape(said.format(other)))


def test_sites_of_a_hub_reach_each_other_again_after_it(bus: Bus) -> None:
    """A listener at one site has the frames of a robot at another through the hub, also of a robot
    that begins after the hub was killed and is back; and what is within one site needs no hub, nor
    does it before the hub is there.
    """
    at_hub, *at_sites = (f"tcp/127.0.0.1:{free_port()}" for _ in range(3))
    alone = {"TFBUS_CONNECT": ""}
    sites = [bus.start("router", "--listen", at, "--hub", at_hub, env=alone) for at in at_sites]
    for site in sites:
        site.wait_for_line("Routing on")
    sites[0].wait_for_line("Waiting for a router")
    here, there = ({"TFBUS_MODE": "client", "TFBUS_CONNECT": at} for at in at_sites)

    def robot(name: str, at: dict[str, str]) -> None:
        static = ("static", "map", "base", "--x", "5", "--name", "mount", "--namespace", name)
        bus.start(*static, env=at).wait_for_line("ready")

    base = bus.node("base", mode="client", connect=at_sites[0])
    buffer = Buffer()
    fleet = Fleet(shared_frames=("map",))
    with TransformListener(buffer, base, reads="needed", fleet=fleet):
        robot("robot0", here)
        assert buffer.lookup_transform("map", "robot0/base", timeout_s=DEADLINE_S).transform.x == 5
        robot("robot1", there)
        hub = bus.start("router", "--listen", at_hub, env=alone)
        assert buffer.lookup_transform("map", "robot1/base", timeout_s=DEADLINE_S).transform.x == 5
        hub.kill()
        robot("robot2", here)
        assert buffer.lookup_transform("map", "robot2/base", timeout_s=DEADLINE_S).transform.x == 5
        robot("robot3", there)
        bus.start("router", "--listen", at_hub, env=alone).wait_for_line("Routing on")
        assert buffer.lookup_transform("map", "robot3/base", timeout_s=DEADLINE_S).transform.x == 5


def test_a_hub_is_the_only_router_that_is_joined(bus: Bus) -> None:
    """An endpoint to connect to beside it is refused, as is a hub that is no endpoint; Ctrl-C ends
    the wait for the hub as usual.
    """
    both = bus.run("router", "--hub", "tcp/127.0.0.1:1", "--connect", "tcp/127.0.0.1:2")
    assert both.returncode == 2
    assert "omit --connect" in both.stderr
    none = bus.run("router", "--hub", "robot", env={"TFBUS_CONNECT": ""})
    assert none.returncode == 2
    assert "is not an endpoint" in none.stderr
    alone = ("router", "--hub", f"tcp/127.0.0.1:{free_port()}")
    waiting = bus.start(*alone, "--listen", "tcp/127.0.0.1:0", env={"TFBUS_CONNECT": ""})
    waiting.wait_for_line("Waiting for a router")
    assert waiting.stop() == 0
