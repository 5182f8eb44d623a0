"""Sessions: how Zenoh is set where nobody says otherwise."""

from pathlib import Path

import pytest

from tfbus import NodeSettings
from tfbus.session import zenoh_config


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
