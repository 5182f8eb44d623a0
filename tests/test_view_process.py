"""`tfbus view` as a process, without a browser: its options, and whom it lets in."""

import http.client
from pathlib import Path

import pytest
from conftest import DEADLINE_S, Bus, free_port

pytest.importorskip("viser", reason="the extra view is not installed")

from tfbus.nodes.viewer.origin import refusal


def status_of(address: str, **headers: str) -> tuple[int, str]:
    """What the view answers to a request for its page with these headers."""
    connection = http.client.HTTPConnection(address.removeprefix("http://"), timeout=DEADLINE_S)
    connection.request("GET", "/", headers=headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


def test_the_page_is_only_for_those_who_opened_it_here(bus: Bus) -> None:
    """No page from elsewhere may speak to it, by whatever name it calls this machine."""
    view = bus.start("view", "--port", str(free_port()))
    line = view.wait_for_line("View: http://", within_s=3 * DEADLINE_S)
    address = line.rpartition("View: ")[2]
    host = address.removeprefix("http://")
    assert status_of(address)[0] == 200
    assert status_of(address, Origin=address)[0] == 200
    code, text = status_of(address, Origin="https://evil.example")
    assert (code, text) == (
        403,
        f"a page of 'https://evil.example' may not speak to the view at '{host}': open that "
        "itself\n",
    )
    assert status_of(address, Host="evil.example:8080")[0] == 403


@pytest.mark.parametrize(
    ("headers", "listens_locally", "is_served"),
    [
        ({"Host": "localhost:9000", "Origin": "http://localhost:9000"}, True, True),
        ({"Host": "[::1]:8080", "Origin": "http://[::1]:8080"}, True, True),
        ({"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:3000"}, True, False),
        ({"Host": "127.0.0.1:8080", "Origin": "null"}, True, False),
        ({"Host": "robot.lan:8080", "Origin": "http://robot.lan:8080"}, True, False),
        ({"Host": "robot.lan:8080", "Origin": "http://robot.lan:8080"}, False, True),
        ({"Host": "robot.lan:8080", "Origin": "http://evil.example"}, False, False),
        ({}, True, False),
    ],
)
def test_a_page_may_speak_only_to_where_it_came_from(
    headers: dict[str, str], listens_locally: bool, is_served: bool
) -> None:
    """Through a tunnel too; a name that points to this machine opens nothing."""
    assert (refusal(headers, listens_locally) == "") is is_served


def test_settings_of_the_view_are_no_configuration_of_the_bus(bus: Bus, tmp_path: Path) -> None:
    """Who passes the one for the other is told the right option."""
    path = tmp_path / "view.yaml"
    path.write_text("fixed_frame: map\nscale: 2.0\n")
    done = bus.run("view", "--config", str(path))
    assert done.returncode == 2
    assert f"tfbus view --settings {path}" in " ".join(done.stderr.split())
