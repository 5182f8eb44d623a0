"""Networks by their names: their settings of Zenoh, and the one that `auto` takes."""

import json
from pathlib import Path
from typing import Any

import pytest

from tfbus import NodeSettings, SettingsError
from tfbus.base import addresses
from tfbus.base.addresses import Interface
from tfbus.bus import settings
from tfbus.bus.settings import NETWORKS, network_of
from tfbus.bus.zenoh_config import zenoh_config

HUB = "tcp/10.0.0.1:7447"
HERE = "tcp/127.0.0.1:7447"


def value_of(key: str, **given: Any) -> Any:
    """A value of the configuration of a node with these settings."""
    return json.loads(zenoh_config(NodeSettings("sim", **given)).get_json(key))


def test_a_lan_is_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a name a network is a LAN: links of TCP, whole messages, gone at once."""
    monkeypatch.delenv("TFBUS_NETWORK", raising=False)
    assert NodeSettings("sim").network == "lan"
    assert value_of("transport/link/tx/lease") == 1500
    assert value_of("transport/unicast/max_links") == 1
    assert (NETWORKS["lan"].gone_after_s, NETWORKS["lan"].message_bytes) == (0.0, 0)


def test_the_environment_names_the_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """TFBUS_NETWORK is that of all processes of a machine; another name is refused."""
    monkeypatch.setenv("TFBUS_NETWORK", "satellite")
    assert NodeSettings("sim").network == "satellite"
    with pytest.raises(SettingsError, match=r"'radio' .* lan, wifi, mobile, "):
        NodeSettings("sim", network="radio")


@pytest.mark.parametrize(
    ("mode", "network", "expected"),
    [
        ("router", "wifi", [f"{HUB}?rel=1", "udp/10.0.0.1:7447?rel=0"]),
        ("peer", "satellite", [f"{HUB}?rel=1", "udp/10.0.0.1:7447?rel=0"]),
        # Zenoh gives a client one link.
        ("client", "wifi", [HUB]),
        ("router", "mobile", [HUB]),
        ("router", "lan", [HUB]),
    ],
)
def test_a_link_is_fit_for_its_network(mode: str, network: str, expected: list[str]) -> None:
    """Where datagrams win, a router or peer has a link of them beside each of TCP."""
    given: dict[str, Any] = {"mode": mode, "network": network}
    assert value_of("connect/endpoints", connect=[HUB], **given) == expected
    if mode == "router":
        assert value_of("listen/endpoints", listen=[HUB], **given) == expected


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, False),
        ({"network": "wifi"}, False),
        ({"network": "wifi", "mode": "client", "connect": [HUB]}, False),
        ({"network": "wifi", "connect": [HUB]}, True),
        ({"connect": ["udp/10.0.0.1:7447"]}, True),
    ],
)
def test_datagrams_are_not_taken_from_whoever_offers_them(
    given: dict[str, Any], expected: bool
) -> None:
    """A process without an endpoint of UDP opens no such link to a router that it meets by
    multicast: with several tools on one host that would be its first.
    """
    protocols = value_of("transport/link/protocols", **given)
    assert (protocols is None) == expected
    assert expected or ("tcp" in protocols and "udp" not in protocols)


@pytest.mark.parametrize(
    ("given", "is_closed", "expected"),
    [
        ({"network": "mobile", "mode": "router"}, False, 16384),
        ({"network": "wifi", "mode": "client"}, False, 24576),
        ({"network": "wifi", "mode": "client"}, True, 24576),
        ({"network": "satellite", "mode": "router"}, True, 32768),
        ({"network": "satellite", "mode": "router"}, False, None),
        ({"network": "lan"}, False, None),
        ({"network": "lan"}, True, None),
        ({"network": "wifi", "mode": "client", "connect": [HUB, HERE]}, False, 24576),
        ({"network": "wifi", "mode": "client", "connect": [HERE]}, False, None),
        ({"network": "mobile", "mode": "client", "connect": ["tls/127.0.0.1:7447"]}, True, None),
        ({"network": "mobile", "connect": [HERE]}, False, 16384),
        ({"network": "mobile", "mode": "client", "connect": [HERE], "listen": [HUB]}, False, 16384),
    ],
)
def test_where_all_goes_by_tcp_little_waits_at_the_other_end(
    tmp_path: Path, given: dict[str, Any], is_closed: bool, expected: int | None
) -> None:
    """Each process then offers to take no more than waits there: open, and closed. A client of a
    router on its own host takes more, unless others link to it: nothing is held up there.
    """
    if is_closed:
        pytest.importorskip("cryptography", reason="needs cryptography: pip install cryptography")
        from tfbus.bus.keystore import Identity, Keystore

        keystore = Keystore.init(tmp_path, days=10)
        keystore.add(Identity("sim", "router"), days=5)
        given = {**given, "secure": str(keystore.path / "sim")}
    protocol = "tls" if is_closed else "tcp"
    assert value_of(f"transport/link/{protocol}/so_rcvbuf", **given) == expected


def test_other_endpoints_stay_as_they_are() -> None:
    """An endpoint that says what kind of link it is has no other beside it."""
    given = ["tcp/10.0.0.1:7447?prio=1-7", "tcp/10.0.0.1:7448#iface=eth0", "ws/10.0.0.1:7449"]
    assert value_of("connect/endpoints", connect=given, network="wifi") == given


def test_a_configuration_file_comes_first(tmp_path: Path) -> None:
    """What the file sets counts, on each network."""
    config = tmp_path / "zenoh.json5"
    config.write_text("{transport: {link: {tx: {lease: 9000}}}}")
    assert value_of("transport/link/tx/lease", network="wifi", config=str(config)) == 9000
    assert value_of("transport/link/tx/keep_alive", network="wifi", config=str(config)) == 8


@pytest.mark.real
@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"wireless": None}, "wifi"),
        ({"uevent": "DEVTYPE=wwan\nINTERFACE=radio0\n"}, "mobile"),
        ({"uevent": "INTERFACE=radio0\n"}, "lan"),
    ],
)
def test_auto_is_the_network_of_the_interface(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, files: dict[str, str | None], expected: str
) -> None:
    """`auto` is Wi-Fi or a mobile network where Linux says so of the interface, else a LAN."""
    device = tmp_path / "radio0"
    device.mkdir()
    for name, text in files.items():
        (device / name).mkdir() if text is None else (device / name).write_text(text)
    radio = Interface("radio0", True, True, False, address="127.0.0.1")
    monkeypatch.setattr(settings, "_DEVICES", str(tmp_path))
    monkeypatch.setattr(addresses, "interfaces", lambda: [radio])
    assert network_of("auto", ["tcp/127.0.0.1:7447"]).name == expected


def test_a_session_looks_once_for_its_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the network that a session has, its configuration is made: not by another look, which may
    find another one where an interface has come meanwhile.
    """
    wifi, settings = NETWORKS["wifi"], NodeSettings("sim", network="auto")
    monkeypatch.setattr("tfbus.bus.zenoh_config.network_of", None)
    config = zenoh_config(settings, network=wifi)
    assert json.loads(config.get_json("transport/link/tx/lease")) == wifi.lease_s * 1e3


@pytest.mark.real
@pytest.mark.parametrize("host", ["no.such.host.invalid", "[::1]", f"{'ä' * 64}.local"])
def test_auto_resolves_no_name(monkeypatch: pytest.MonkeyPatch, host: str) -> None:
    """The network of a name is that of the default route: without one a LAN."""
    monkeypatch.setattr(addresses, "interfaces", list)
    assert network_of("auto", [f"tcp/{host}:7447"]).name == "lan"


def test_auto_takes_an_impossible_port_for_a_lan() -> None:
    """The endpoint is refused where it is used."""
    assert network_of("auto", ["tcp/127.0.0.1:99999"]).name == "lan"
