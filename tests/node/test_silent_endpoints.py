"""The log of a node on endpoints to connect to that do not answer."""

import logging
import re
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, cast

import pytest

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import NodeSettings
from tfbus.base import scheduler
from tfbus.base.executor import Executor
from tfbus.bus.session import Session
from tfbus.node import surroundings
from tfbus.node.surroundings import watch_endpoints


@pytest.mark.real
def test_a_node_names_the_endpoint_that_does_not_answer(
    bus: Bus, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """With how many it found without it; an endpoint that answers is not named."""
    monkeypatch.setattr(surroundings, "_AFTER_S", 0.001)
    said = ""

    def is_said() -> re.Match[str] | None:
        nonlocal said
        said += capfd.readouterr().err
        return re.search(r"\[eye\]: Nothing answers at (\S+) \(Connection refused\): .*\n", said)

    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))  # it does not listen, and no other can
        endpoint = f"tcp/127.0.0.1:{silent.getsockname()[1]}"
        bus.node("eye", connect=(bus.endpoint, endpoint))
        found = eventually(is_said)
    assert found[1] == endpoint
    assert re.search(r"still trying; \d+ links? ", found[0])


@dataclass
class FakeBus:
    """A session with these routers, and an executor that runs what is due at once."""

    settings: NodeSettings
    routers_: list[str] = field(default_factory=list)
    looks: int = 0

    def routers(self) -> list[str]:
        return self.routers_

    def after(self, _: float, callback: Callable[..., None], *given: Any) -> None:
        self.looks += 1
        callback(*given)


@pytest.mark.parametrize(
    ("settings", "routers", "looks"),
    [
        (NodeSettings("eye", connect="tcp/127.0.0.1:1"), ["router"], 1),
        (NodeSettings("eye", connect="tcp/127.0.0.1:1", mode="client"), [], 0),
        (NodeSettings("eye", connect=()), [], 0),
    ],
)
def test_where_a_router_is_there_no_endpoint_is_tried(
    settings: NodeSettings, routers: list[str], looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client waits for its router in any case."""

    def start(*_: object, **__: object) -> None:
        raise AssertionError("it tries an endpoint")

    monkeypatch.setattr(scheduler, "Thread", start)
    fake = FakeBus(settings, routers)
    watch_endpoints(cast(Session, fake), cast(Executor, fake), logging.getLogger("eye"))
    assert fake.looks == looks


def test_a_client_says_that_its_router_is_gone_and_back(bus: Bus) -> None:
    """Once each, in its log; that it ends itself is no such thing."""
    hub = "tcp/outside:7447"
    network = bus.network

    def start_hub() -> None:
        with network.process("outside", "hub"):
            bus.node("hub", mode="router", listen=("tcp/[::]:7447",))

    start_hub()
    client = ("--mode", "client", "--connect", hub)
    program = bus.start("static", "map", "base", *client)
    program.wait_for_line("ready")
    network.run(10.0)
    network.kill("outside/hub")
    program.wait_for_line(f"No link to {hub}")
    start_hub()
    program.wait_for_line("Linked to a router again")
    network.run(10.0)
    assert program.stop() == 0
    assert program.stderr.count("No link") == 1
