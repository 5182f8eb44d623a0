"""Zenoh's configuration files in configs/."""

import signal
from pathlib import Path

import pytest
import zenoh

from tests.docs.pages import ROOT
from tests.docs.real_shell import copy_configurations
from tests.live_bus import Bus, free_port

pytestmark = pytest.mark.real


@pytest.mark.parametrize("name", ["peer", "client", "router"])
def test_a_supplied_configuration_says_what_it_is_for(name: str) -> None:
    """configs/NAME.json5 is a file that Zenoh reads, for that mode, with timestamps on."""
    config = zenoh.Config.from_file(ROOT / "configs" / f"{name}.json5")
    assert config.get_json("mode") == f'"{name}"'
    assert config.get_json("timestamping/enabled") == "true"


def test_the_supplied_configurations_work_together(bus: Bus, tmp_path: Path) -> None:
    """A client and a peer, each with its supplied configuration, meet at a router with its own."""
    copy_configurations(tmp_path / "configs")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = bus.start(
        *("router", "--config", f"{tmp_path}/configs/router.json5", "--listen", endpoint)
    )
    router.wait_for_line("Routing on")
    at_router = ("--connect", endpoint)
    static = bus.start(
        *("static", "world", "camera", "--x", "1", *at_router),
        *("--config", f"{tmp_path}/configs/peer.json5", "--listen", "tcp/127.0.0.1:0"),
    )
    echo = bus.run(
        *("echo", "world", "camera", "--once", "--timeout", "100", *at_router),
        *("--config", f"{tmp_path}/configs/client.json5"),
    )
    assert "- Translation: [1.000, 0.000, 0.000]" in echo.stdout
    for process in (static, router):
        assert process.stop(signal.SIGTERM) == 0
