"""Sessions: how Zenoh is set where nobody says otherwise."""

import logging
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
from conftest import Bus

from tfbus import NodeSettings
from tfbus.session import Session, zenoh_config


def lease_ms(config: str, folder: Path) -> str:
    """The lease of a session with this configuration file, "" for none."""
    path = folder / "zenoh.json5"
    path.write_text(config)
    settings = NodeSettings("sim", config=str(path) if config else "")
    return str(zenoh_config(settings).get_json("transport/link/tx/lease"))


@pytest.mark.parametrize("config", ["", "{}", "{mode: 'client'}"])
def test_a_silent_link_is_given_up_within_two_seconds(config: str, tmp_path: Path) -> None:
    """An unplugged host is noticed after a lease of 1.5 s, without a configuration and with one."""
    assert lease_ms(config, tmp_path) == "1500"


def test_a_configuration_file_may_set_another_lease(tmp_path: Path) -> None:
    """The lease of the configuration file is taken, where it is not Zenoh's own of 10 s."""
    assert lease_ms("{transport: {link: {tx: {lease: 4000}}}}", tmp_path) == "4000"


def test_a_bus_that_does_not_let_go_is_told_in_the_log(
    bus: Bus, caplog: pytest.LogCaptureFixture
) -> None:
    """Where Zenoh cannot close in time, as a peer has stopped, the node goes on to its end."""

    def close() -> None:
        raise zenoh.ZError("close operation timed out! at /root/zenoh/close.rs:135.")

    settings = NodeSettings("sim", config=str(bus.config), connect=(bus.endpoint,))
    session: Any = Session(settings, logging.getLogger("sim"))
    real, session.zenoh = session.zenoh, SimpleNamespace(close=close)
    session.close()
    real.close()
    assert caplog.messages == ["Left the bus untidily: close operation timed out!"]
