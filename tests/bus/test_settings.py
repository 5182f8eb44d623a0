"""The settings of a node: given ones, the environment's, and invalid ones."""

import dataclasses
from pathlib import Path

import pytest

from tfbus import InvalidNameError, NodeSettings, SettingsError


@pytest.fixture(autouse=True)
def bare_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("NAMESPACE", "MODE", "CONNECT", "LISTEN", "CONFIG", "LOG_LEVEL", "SIM_TIME"):
        monkeypatch.delenv(f"TFBUS_{name}", raising=False)


def test_only_a_name_is_needed() -> None:
    """A node needs a name and nothing else."""
    settings = NodeSettings("sim")
    assert (settings.namespace, settings.mode, settings.connect, settings.listen) == (
        "",
        "",
        (),
        (),
    )
    assert (settings.config, settings.log_level, settings.sim_time) == ("", "info", False)
    assert (dict(settings.parameters), dict(settings.remappings)) == ({}, {})


def test_defaults_come_from_the_environment(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """One environment can set up all processes of a machine."""
    config = tmp_path / "zenoh.json5"
    config.write_text("{}")
    monkeypatch.setenv("TFBUS_NAMESPACE", "/robot7")
    monkeypatch.setenv("TFBUS_MODE", "client")
    monkeypatch.setenv("TFBUS_CONNECT", "tcp/hub:7447, tcp/hub2:7447")
    monkeypatch.setenv("TFBUS_LISTEN", "tcp/[::]:7448")
    monkeypatch.setenv("TFBUS_CONFIG", str(config))
    monkeypatch.setenv("TFBUS_LOG_LEVEL", "debug")
    monkeypatch.setenv("TFBUS_SIM_TIME", "1")
    assert NodeSettings("sim") == NodeSettings(
        "sim",
        namespace="robot7",
        mode="client",
        connect=("tcp/hub:7447", "tcp/hub2:7447"),
        listen=("tcp/[::]:7448",),
        config=str(config),
        log_level="debug",
        sim_time=True,
    )


@pytest.mark.parametrize(
    ("text", "value"), [("1", True), ("Yes", True), ("true", True), ("0", False), ("off", False)]
)
def test_whether_time_is_simulated_is_a_word_for_true_or_false(
    monkeypatch: pytest.MonkeyPatch, text: str, value: bool
) -> None:
    """TFBUS_SIM_TIME is one of the words for true and false, and any other is refused."""
    monkeypatch.setenv("TFBUS_SIM_TIME", text)
    assert NodeSettings("sim").sim_time is value
    monkeypatch.setenv("TFBUS_SIM_TIME", "perhaps")
    with pytest.raises(SettingsError, match=r"^TFBUS_SIM_TIME .*'perhaps'$") as caught:
        NodeSettings("sim")
    allowed = str(caught.value).partition("one of ")[2].split(", ")[:-1]
    assert allowed == ["1", "true", "yes", "on", "0", "false", "no", "off"]


def test_given_settings_override_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """A given setting, even an empty one, is not taken from the environment."""
    monkeypatch.setenv("TFBUS_NAMESPACE", "robot7")
    monkeypatch.setenv("TFBUS_CONNECT", "tcp/hub:7447")
    settings = NodeSettings("sim", namespace="", connect=())
    assert (settings.namespace, settings.connect) == ("", ())


def test_settings_do_not_change() -> None:
    """Settings are a value: neither they nor the maps in them can be changed."""
    given = {"turtlename": "turtle1"}
    settings = NodeSettings("broadcaster1", parameters=given)
    given["turtlename"] = "turtle2"
    assert settings.parameters["turtlename"] == "turtle1"
    with pytest.raises(TypeError):
        settings.parameters["turtlename"] = "x"  # that is the test
    with pytest.raises(dataclasses.FrozenInstanceError):
        settings.name = "x"  # that is the test


def test_one_endpoint_may_be_a_str() -> None:
    """It is one, not one for each of its letters; a list is as good as a tuple."""
    settings = NodeSettings("a", connect="tcp/1.2.3.4:7447", listen=["tcp/[::]:7447"])
    assert (settings.connect, settings.listen) == (("tcp/1.2.3.4:7447",), ("tcp/[::]:7447",))


def test_settings_can_be_used_for_another_name() -> None:
    """The same settings serve a second node under a name of its own."""
    settings = NodeSettings("a", namespace="robot7", connect=("tcp/hub:7447",))
    assert settings.renamed("b") == NodeSettings("b", namespace="robot7", connect=("tcp/hub:7447",))


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"mode": "boss"}, "mode 'boss' is not one of peer, client, router"),
        (
            {"log_level": "loud"},
            "log level 'loud' is not one of debug, info, warning, error",
        ),
        (
            {"connect": ("hub",)},
            "'hub' is not an endpoint: write protocol/address, as in tcp/hub:7447",
        ),
        (
            {"listen": ("hub:1234",)},
            "'hub:1234' is not an endpoint: write protocol/address, as in tcp/hub:1234",
        ),
        (
            {"connect": ("http/hub:1",)},
            "endpoint 'http/hub:1' has an unknown protocol: use one of tcp, udp, tls, quic, ws, "
            "serial, unixpipe, unixsock-stream, vsock",
        ),
        ({"connect": ("tcp/hub",)}, "endpoint 'tcp/hub' has no port: write tcp/hub:7447"),
        (
            {"connect": ("tcp/hub:port",)},
            "endpoint 'tcp/hub:port' has no port: write tcp/hub:port:7447",
        ),
        (
            {"connect": 7447},
            "connect must be an endpoint such as tcp/host:7447, or a list of them, not int",
        ),
        ({"listen": [7447]}, "listen: each endpoint must be a str such as tcp/host:7447, not int"),
        ({"parameters": 3}, "parameters must be a dict, with a value for each name, not int"),
        ({"sim_time": "false"}, "sim_time must be a bool, not 'false'"),
        (
            {"limits": "topic=64MB"},
            "limits must be a Limits, not 'topic=64MB'; Limits.parse reads a text",
        ),
        ({"config": 3}, "config must be a str, not 3"),
        ({"config": "/nowhere.json5"}, "there is no configuration file '/nowhere.json5'"),
    ],
)
def test_an_invalid_setting_is_refused(given: dict[str, object], reason: str) -> None:
    """An invalid setting is refused in one sentence that says what is valid."""
    with pytest.raises(SettingsError) as caught:
        NodeSettings("sim", **given)  # that is the test
    assert str(caught.value) == reason


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp/127.0.0.1:7447",
        "tcp/[::]:0",
        "udp/hub:7447",
        "tcp/[::]:7447#iface=eth0",
        "tcp/h:1?rel=1",
    ],
)
def test_endpoints_are_those_of_zenoh(endpoint: str) -> None:
    """Zenoh's endpoints pass, with what Zenoh allows behind them."""
    assert NodeSettings("sim", connect=(endpoint,)).connect == (endpoint,)


@pytest.mark.parametrize(
    "given",
    [
        {"name": "robot7/sim"},
        {"namespace": "a b"},
        {"namespace": "a\x1bb"},
        {"parameters": {"caf\udce9": 1}},
        {"remappings": {"pose": "/turtle1//pose"}},
        {"remappings": {"a//b": "pose"}},
    ],
)
def test_an_invalid_name_is_refused(given: dict[str, object]) -> None:
    """Names in the settings follow the rules of names on the bus."""
    with pytest.raises(InvalidNameError):
        NodeSettings(**({"name": "sim"} | given))  # that is the test


@pytest.mark.parametrize("variable", ["MODE", "CONNECT", "CONFIG", "LOG_LEVEL"])
def test_a_mistake_in_the_environment_is_refused_too(
    monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    """A value from the environment is checked like a given one."""
    monkeypatch.setenv(f"TFBUS_{variable}", "nonsense")
    with pytest.raises(SettingsError, match="nonsense"):
        NodeSettings("sim")
