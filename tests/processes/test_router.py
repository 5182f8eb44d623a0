"""`tfbus router`: arrivals and departures, and the error of a client that gets no link."""

import re

import pytest

from tests.buses import eventually
from tests.live_bus import Bus, free_port

pytestmark = pytest.mark.real


def test_it_logs_who_joins_and_who_leaves(bus: Bus) -> None:
    """Nodes by name and routers by id; tools, which only look, not."""
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
    router.wait_for_line(r"Linked to router [0-9a-f]+")
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
