"""`tfbus view` as a process, without a browser: its options, and whom it lets in."""

import http.client
import socket
from pathlib import Path

import pytest

from tests.live_bus import DEADLINE_S, Bus, free_port

pytest.importorskip("viser", reason="needs viser: the extra view")

import viser

from tfbus.view.origin import machine_names, refusal
from tfbus.view.server import ServeError, serve


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
    assert status_of(address, Host="[")[0] == 403


def test_a_view_for_others_goes_by_addresses_and_names_of_its_machine(bus: Bus) -> None:
    """Nor may a page whose owner lets its name point to a view that listens for all."""
    view = bus.start("view", "--host", "0.0.0.0", "--port", str(free_port()))
    line = view.wait_for_line("View: http://", within_s=3 * DEADLINE_S)
    port = line.rpartition(":")[2]
    address = f"127.0.0.1:{port}"
    for host in (address, f"{socket.gethostname()}:{port}", f"robot.local:{port}"):
        assert status_of(address, Host=host, Origin=f"http://{host}")[0] == 200
    host = f"evil.example:{port}"
    code, text = status_of(address, Host=host, Origin=f"http://{host}")
    assert (code, text) == (
        403,
        "the view is not 'evil.example', which anybody could let point here: open the IP address "
        "of its machine, its host name, or that with .local\n",
    )


LOCAL = machine_names("127.0.0.1")
LAN = frozenset({"0.0.0.0", "robot", "robot.lan"})


@pytest.mark.parametrize(
    ("headers", "names", "is_served"),
    [
        ({"Host": "localhost:9000", "Origin": "http://localhost:9000"}, LOCAL, True),
        ({"Host": "LOCALHOST:9000", "Origin": "http://localhost:9000"}, LOCAL, True),
        ({"Host": "[::1]:8080", "Origin": "http://[::1]:8080"}, LOCAL, True),
        ({"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:3000"}, LOCAL, False),
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
        ({"Host": "["}, LOCAL, False),
        ({"Host": "["}, LAN, False),
        ({"Host": "localhost", "Origin": "http://["}, LOCAL, False),
        ({}, LOCAL, False),
        ({}, LAN, False),
    ],
)
def test_a_page_may_speak_only_to_where_it_came_from(
    headers: dict[str, str], names: frozenset[str], is_served: bool
) -> None:
    """Through a tunnel too; a name that points to this machine opens nothing."""
    assert (refusal(headers, names) == "") is is_served


def test_the_names_of_a_machine_are_its_host_name_and_what_it_was_told_to_listen_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With its domain and without, in whatever case; they count for who listens for others."""
    monkeypatch.setattr(socket, "gethostname", lambda: "Robot.lan")
    monkeypatch.setattr(socket, "getfqdn", lambda: "robot.lab.example")
    names = {"robot.lan", "robot", "robot.lab.example"}
    assert machine_names("Turtle.example") == names | {"turtle.example"}
    assert machine_names("LOCALHOST") == set()


def test_a_server_that_nobody_guards_does_not_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where viser starts its server in another way, there is no view rather than an open one."""
    stopped = []

    class Unguarded:
        def __init__(self, **options: object) -> None:
            pass

        def stop(self) -> None:
            stopped.append(self)

    monkeypatch.setattr(viser, "ViserServer", Unguarded)
    with pytest.raises(ServeError, match="any web page could speak to it"):
        serve("127.0.0.1", free_port())
    assert len(stopped) == 1


def test_settings_of_the_view_are_no_configuration_of_the_bus(bus: Bus, tmp_path: Path) -> None:
    """Who passes the one for the other is told the right option."""
    path = tmp_path / "view.yaml"
    path.write_text("fixed_frame: map\nscale: 2.0\n")
    done = bus.run("view", "--config", str(path))
    assert done.returncode == 2
    assert f"tfbus view --settings {path}" in " ".join(done.stderr.split())


def test_a_yaml_that_is_no_configuration_of_the_bus_may_be_settings(
    bus: Bus, tmp_path: Path
) -> None:
    """Where it is not evidently a view's, Zenoh's complaint names the other option too."""
    path = tmp_path / "cfg.yaml"
    path.write_text("fixed_frame: map\ncolour: blue\n")
    done = bus.run("view", "--config", str(path))
    assert done.returncode == 1
    assert f"a view's own settings are given by --settings {path}" in done.stderr


def test_settings_that_are_not_there_yet_are_new(bus: Bus, tmp_path: Path) -> None:
    """A name that was mistyped is seen, and one that is to be saved is fine."""
    view = bus.start("view", "--port", str(free_port()), "--settings", "nope.yaml")
    view.wait_for_line(r"nope\.yaml is new: Save settings writes it")


@pytest.mark.parametrize("port", ["abc", "0", "65536"])
def test_a_port_is_a_number(bus: Bus, port: str) -> None:
    """What else there can be is said."""
    done = bus.run("view", "--port", port)
    assert done.returncode == 2
    assert f"'{port}' is not the number of a port: 1 to 65535" in done.stderr
