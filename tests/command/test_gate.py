"""The web pages that may connect to a server."""

import socket

import pytest

from tfbus.command.server_access import PageGate, machine_names

LOCAL = machine_names("127.0.0.1")
LAN = frozenset({"0.0.0.0", "robot", "robot.lan"})


@pytest.mark.parametrize(
    ("headers", "names", "is_served"),
    [
        ({"Host": "localhost:9000", "Origin": "http://localhost:9000"}, LOCAL, True),
        ({"Host": "LOCALHOST:9000", "Origin": "http://localhost:9000"}, LOCAL, True),
        ({"Host": "[::1]:8080", "Origin": "http://[::1]:8080"}, LOCAL, True),
        ({"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:3000"}, LOCAL, True),
        ({"Host": "127.0.0.1:8080", "Origin": "null"}, LOCAL, False),
        ({"Host": "robot.lan:8080", "Origin": "http://robot.lan:8080"}, LOCAL, False),
        ({"Host": "robot.lan:8080", "Origin": "http://robot.lan:8080"}, LAN, True),
        ({"Host": "robot.lan:8080", "Origin": "http://evil.example"}, LAN, False),
        ({"Host": "Robot:8080", "Origin": "http://robot:8080"}, LAN, True),
        ({"Host": "robot7.local", "Origin": "https://robot7.local"}, LAN, True),
        ({"Host": "10.0.0.7:8080", "Origin": "http://10.0.0.7:8080"}, LAN, True),
        ({"Host": "[fd00::7]:8080", "Origin": "http://[fd00::7]:8080"}, LAN, True),
        ({"Host": "localhost:8080"}, LAN, True),
        ({"Host": "evil.example:8080", "Origin": "http://evil.example:8080"}, LAN, False),
        ({"Host": "robot.evil.example"}, LAN, False),
        ({"Host": "robot7.lab.example"}, LAN | {"*.lab.example"}, True),
        ({"Host": "robot7.evil.example"}, LAN | {"*.lab.example"}, False),
        ({"Host": "["}, LOCAL, False),
        ({"Host": "["}, LAN, False),
        ({"Host": "localhost", "Origin": "http://["}, LOCAL, False),
        ({}, LOCAL, False),
        ({}, LAN, False),
    ],
)
def test_a_page_may_use_the_server_it_came_from(
    headers: dict[str, str], names: frozenset[str], is_served: bool
) -> None:
    """Through a tunnel too; a foreign name that points to this machine is refused."""
    gate, host = PageGate(names, knows_neighbours=not names), headers.get("Host", "")
    refused = gate.stranger(host) or gate.refusal(headers.get("Origin"), host)
    assert (not refused) is is_served


def test_a_server_with_a_cookie_has_no_neighbours() -> None:
    """A browser sends the cookie of a port to all ports, so only its own page may connect."""
    gate = PageGate(LAN, knows_neighbours=False)
    for origin in ("https://localhost:3000", "https://127.0.0.1", "file://", "null"):
        assert "may not connect" in gate.refusal(origin, "localhost:8080")
    assert not gate.refusal("https://localhost:8080", "localhost:8080")


def test_the_names_of_a_machine_are_its_host_name_and_the_one_it_listens_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With and without its domain, in lower case; none for a view on localhost."""
    monkeypatch.setattr(socket, "gethostname", lambda: "Robot.lan")
    monkeypatch.setattr(socket, "getfqdn", lambda: "robot.lab.example")
    names = {"robot.lan", "robot", "robot.lab.example"}
    assert machine_names("Turtle.example") == names | {"turtle.example"}
    assert machine_names("LOCALHOST") == set()
