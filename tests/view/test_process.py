"""`tfbus view` as a process, without a browser: its options, and which requests it serves."""

import http.client
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.buses import DEADLINE_S
from tests.live_bus import Bus, free_port

pytest.importorskip("viser", reason="needs viser: the extra view")

import viser

from tfbus.view import screenshot
from tfbus.view.screenshot import BrowserError, Screenshot
from tfbus.view.server import ServeError, serve


def status_of(address: str, **headers: str) -> tuple[int, str]:
    """The view's answer to a request for its page with these headers."""
    connection = http.client.HTTPConnection(address.removeprefix("http://"), timeout=DEADLINE_S)
    connection.request("GET", "/", headers=headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


@pytest.fixture(scope="module")
def address(real: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a running view, of which the tests only read."""
    with closing(Bus(tmp_path_factory.mktemp("bus"))) as bus:
        view = bus.start("view", "--port", str(free_port()))
        yield view.wait_for_line("View: http://").rpartition("View: ")[2]


def test_the_page_refuses_pages_from_elsewhere(address: str) -> None:
    """A page from elsewhere may not use it, under any name of this machine."""
    assert status_of(address)[0] == 200
    assert status_of(address, Origin=address)[0] == 200
    code, text = status_of(address, Origin="https://evil.example")
    assert code == 403 and "'https://evil.example' may not" in text
    assert status_of(address, Host="evil.example:8080")[0] == 403
    assert status_of(address, Host="[")[0] == 403


@pytest.mark.real
def test_a_port_that_is_taken_is_said(bus: Bus) -> None:
    """It takes the next free port, says so, and prints the address that holds."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        view = bus.start("view", "--port", str(taken))
        line = view.wait_for_line("View: http://127.0.0.1:")
        port = line.rpartition(":")[2]
        assert int(port) > taken
        view.wait_for_line(f"Port {taken} of 127.0.0.1 is taken: using {port}")


def test_a_wrong_setting_of_a_topic_is_a_mistake_of_usage(bus: Bus) -> None:
    """The view does not start, and says the unit."""
    done = bus.run("view", "--topic", "cloud:voxel=0.05")
    assert done.returncode == 2
    assert "0.05 m is voxel=5" in done.stderr


def test_a_view_for_others_must_be_public(bus: Bus) -> None:
    """Otherwise all who reach the machine could drive the turtles."""
    done = bus.run("view", "--host", "0.0.0.0")
    assert done.returncode == 2
    assert "add --public" in done.stderr and "ssh -L 8080:127.0.0.1:8080" in done.stderr


def test_pages_of_other_machines_cannot_frame_it(address: str) -> None:
    """A click on one could be a click on the view; a notebook of this machine can."""
    connection = http.client.HTTPConnection(address.rpartition("//")[2], timeout=DEADLINE_S)
    connection.request("GET", "/")
    assert connection.getresponse().headers["Content-Security-Policy"] == (
        "frame-ancestors 'self' http://localhost:* http://127.0.0.1:*"
    )


@pytest.mark.real
def test_no_browser_can_share_the_page() -> None:
    """viser would pass it on through a server of its makers, to all the world."""
    server = serve("127.0.0.1", free_port())
    try:
        assert server.request_share_url() is None
        assert server._share_tunnel is None
    finally:
        server.stop()


@pytest.mark.real
def test_a_server_that_ctrl_c_leaves_ends_without_a_word() -> None:
    """Of viser, whose own end at the exit of Python writes one."""
    code = f"from tfbus.view.server import serve; serve('127.0.0.1', {free_port()})"
    ended = subprocess.run(
        [sys.executable, "-c", f"{code}; raise KeyboardInterrupt"],
        capture_output=True,
        text=True,
        timeout=2 * DEADLINE_S,
    )
    assert ended.stdout == "" and ended.stderr.endswith("KeyboardInterrupt\n")


@pytest.mark.real
def test_an_unguarded_server_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    """If viser starts its server in another way, there is no view rather than an open one."""
    stopped = []

    class Unguarded:
        def __init__(self, **options: object) -> None:
            pass

        def stop(self) -> None:
            stopped.append(self)

    monkeypatch.setattr(viser, "ViserServer", Unguarded)
    with pytest.raises(ServeError, match="any web page"):
        serve("127.0.0.1", free_port())
    assert len(stopped) == 1


def test_settings_of_the_view_are_not_taken_for_a_configuration_of_zenoh(
    bus: Bus, tmp_path: Path
) -> None:
    """The error names the right option."""
    path = tmp_path / "view.yaml"
    path.write_text("fixed_frame: map\nscale: 2.0\n")
    done = bus.run("view", "--config", str(path))
    assert done.returncode == 2
    assert f"tfbus view --settings {path}" in " ".join(done.stderr.split())


@pytest.mark.real
def test_a_yaml_that_is_no_configuration_of_zenoh_may_be_settings(bus: Bus, tmp_path: Path) -> None:
    """If it is not evidently the view's, Zenoh's error names the other option too."""
    path = tmp_path / "cfg.yaml"
    path.write_text("fixed_frame: map\ncolour: blue\n")
    done = bus.run("view", "--config", str(path))
    assert done.returncode == 2
    assert f"--settings {path}" in done.stderr


@pytest.mark.real
def test_a_missing_settings_file_is_named(bus: Bus, tmp_path: Path) -> None:
    """A mistyped name shows, and a name for the file to be saved is fine."""
    view = bus.start("view", "--port", str(free_port()), "--settings", "nope.yaml")
    view.wait_for_line(r"nope\.yaml does not exist yet: Save settings writes it")


@pytest.mark.parametrize("port", ["abc", "0", "65536"])
def test_a_port_is_a_number(bus: Bus, port: str) -> None:
    """The error says which numbers are allowed."""
    done = bus.run("view", "--port", port)
    assert done.returncode == 2
    assert f"'{port}'" in done.stderr and "from 1 to 65535" in done.stderr


@pytest.mark.parametrize("host", ["10.0..7", "a" * 64])
def test_a_name_that_no_host_has_is_a_mistake(host: str) -> None:
    """It is said in a sentence, as a host is of which there is none."""
    with pytest.raises(ServeError, match="no host has such a name"):
        serve(host, 8080)


@pytest.mark.real
def test_a_browser_that_says_nothing_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A picture is not waited for without end: the error says that it did not start."""
    monkeypatch.setattr(screenshot, "_PATIENCE_S", 0.2)
    browser = tmp_path / "chromium"
    browser.write_text("#!/bin/sh\nexec sleep 1000\n")
    browser.chmod(0o755)
    shot = Screenshot(tmp_path / "out.png", 0.0, (640, 480), str(browser))
    ended = threading.Event()
    shot.begin("http://127.0.0.1:1", lambda: "", ended.set)
    has_ended = ended.wait(DEADLINE_S)
    with pytest.raises(BrowserError, match="did not start within"):
        shot.finish()
    assert has_ended
