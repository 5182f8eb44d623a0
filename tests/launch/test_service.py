"""A launch file as a service of systemd: its unit, and launch's messages to the manager."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests import needs
from tfbus.bus.rights import Identity
from tfbus.cli import main
from tfbus.launch.service_manager import Service, unit_text

FILE = """
arguments:
  x: {default: "1"}
nodes:
  - node: static
    arguments: [map, base_link, --x, "${x}"]
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A launch file; units go into a folder beside it."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setattr("tfbus.cli.service._SYSTEMD", tmp_path / "none")
    path = tmp_path / "robot.yaml"
    path.write_text(FILE)
    return path


def run(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(main, ["service", *arguments])
    return done.exit_code, done.output


def test_a_unit_is_written_and_removed(file: Path, tmp_path: Path) -> None:
    """It runs the file with its arguments and options; a unit of others is left alone."""
    unit = tmp_path / "config" / "systemd" / "user" / "robot.service"
    given = ["install", str(file), "x:=3", "--namespace", "robot7", "--user"]
    code, output = run(*given)
    assert code == 0 and f"Wrote {unit}" in output
    text = unit.read_text()
    assert f"-m tfbus launch {file} x:=3 --namespace robot7\n" in text
    # Commands of launch files, such as tfbus, are those of this environment.
    assert f"Environment=PATH={Path(sys.executable).parent}:" in text
    assert run(*given)[0] == 0
    assert run("uninstall", "robot", "--user")[0] == 0
    assert not unit.exists()
    unit.write_text("[Unit]\n")
    assert run(*given)[0] == 1
    assert run("uninstall", "robot", "--user")[0] == 1
    assert unit.read_text() == "[Unit]\n"


@pytest.mark.real
def test_a_service_that_is_installed_again_runs_by_its_new_unit(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """systemd is told to read the unit, to start it at boot, and to restart it now: one
    that runs would not be started by its new unit.
    """
    log, systemctl = tmp_path / "log", tmp_path / "systemctl"
    systemctl.write_text(f'#!/bin/sh\necho "$@" >> {log}\n')
    systemctl.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr("tfbus.cli.service._SYSTEMD", tmp_path)
    assert run("install", str(file), "--user")[0] == 0
    words = ("daemon-reload", "enable robot", "restart robot")
    assert log.read_text().splitlines() == [f"--user {each}" for each in words]


@pytest.mark.real
def test_a_service_that_systemd_does_not_start_is_told_by_the_exit_code(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The unit is there, and so it is removed though systemd cannot be asked to stop it."""
    systemctl = tmp_path / "systemctl"
    systemctl.write_text("#!/bin/sh\nexit 5\n")
    systemctl.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr("tfbus.cli.service._SYSTEMD", tmp_path)
    unit = tmp_path / "config" / "systemd" / "user" / "robot.service"
    assert run("install", str(file), "--user")[0] == 1 and unit.exists()
    assert run("uninstall", "robot", "--user")[0] == 1 and not unit.exists()


def test_what_launch_does_not_take_is_not_installed(file: Path) -> None:
    """An argument or option that is wrong would fail at each boot."""
    for wrong in ("y:=3", "--no-such-option", "nothing"):
        code, output = run("install", str(file), wrong, "--print")
        assert code == 2 and wrong.partition(":")[0] in output
        assert "tfbus launch --help" not in output


@pytest.mark.parametrize("option", ["--print", "--dry-run", "-n"])
def test_a_dry_run_installs_nothing(file: Path, tmp_path: Path, option: str) -> None:
    """It prints the unit, by the name that launch has for it, too."""
    code, output = run("install", str(file), option, "--user")
    assert code == 0 and f"-m tfbus launch {file}\n" in output
    assert not (tmp_path / "config").exists()


@pytest.mark.parametrize("option", ["--list", "--show-args", "-s"])
def test_a_service_does_not_only_print(file: Path, option: str) -> None:
    """It would end at once, and systemd would start it for ever."""
    code, output = run("install", str(file), option, "--user", "--print")
    assert code == 2 and "only prints" in output and "ExecStart" not in output
    assert run("container", str(file), "--dry-run")[0] == 2


def test_a_service_runs_as_a_user_that_is_there(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """systemd would start nothing as another one: an error where it runs, a warning of a unit that
    may be for another machine.
    """
    given = ("install", str(file), "--system", "--run-as")
    for user, is_warned in (("no-such-user", True), ("root", False), ("1234", False)):
        code, output = run(*given, user, "--print")
        assert (code, "has no user" in output) == (0, is_warned)
        assert f"User={user}\n" in output
    monkeypatch.setattr("tfbus.cli.service._SYSTEMD", tmp_path)
    monkeypatch.setattr("shutil.which", lambda name: name)
    code, output = run(*given, "no-such-user")
    assert code == 2 and "no user 'no-such-user'" in output


def test_a_service_reads_its_key(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A key is its owner's alone: of one that is not that of the user of the service it warns."""
    pytest.importorskip("cryptography", reason="needs cryptography: pip install cryptography")
    from tfbus.bus.keystore import Keystore

    keystore = Keystore.init(tmp_path / "keys", days=10)
    keystore.add(Identity("arm", "publisher"), days=5)
    folder = keystore.path / "arm"
    monkeypatch.setenv("TFBUS_SECURE", str(folder))
    for user, is_warned in (("54321", True), (str(os.getuid()), False)):
        code, output = run("install", str(file), "--system", "--print", "--run-as", user)
        assert (code, f"chown -R {user} {folder}" in " ".join(output.split())) == (0, is_warned)


@pytest.mark.real
def test_systemd_takes_the_unit(tmp_path: Path) -> None:
    """Also with letters that mean something in units."""
    systemd_analyze = needs.program("systemd-analyze")
    odd = 'a b%c$d"e\\f'
    command = [sys.executable, "-m", "tfbus", "launch", f"{odd}.yaml"]
    service = Service("robot7", command, tmp_path, {"TFBUS_CONNECT": odd})
    unit = tmp_path / "robot7.service"
    unit.write_text(unit_text(service, is_system=True))
    done = subprocess.run(
        [systemd_analyze, "verify", str(unit)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_an_image_runs_the_launch_file(file: Path) -> None:
    """With its arguments, from the folder that it is in."""
    code, text = run("container", str(file), "x:=3", "--network", "mobile")
    assert code == 0
    entry = '["tfbus", "launch", "/robot/robot.yaml", "x:=3", "--network", "mobile"]'
    assert text.splitlines()[-1] == f"ENTRYPOINT {entry}"
    # One that comes with tfbus is in no folder of the user's.
    assert (
        run("container", "turtle")[1].splitlines()[-1] == 'ENTRYPOINT ["tfbus", "launch", "turtle"]'
    )


@pytest.mark.real
def test_launch_tells_the_service_manager_how_it_goes(file: Path, tmp_path: Path) -> None:
    """Ready when all are started, then alive, stopping at the end; its lines have levels."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(60.0)
        read, write = os.pipe()
        journal = os.fstat(write)
        process = subprocess.Popen(
            [sys.executable, "-m", "tfbus", "launch", str(file)],
            stdout=write,
            stderr=write,
            env={
                **os.environ,
                "NOTIFY_SOCKET": str(tmp_path / "notify"),
                "WATCHDOG_USEC": "300000",
                "JOURNAL_STREAM": f"{journal.st_dev}:{journal.st_ino}",
            },
        )
        os.close(write)
        told = [manager.recv(1000).decode() for _ in range(3)]
        process.send_signal(signal.SIGTERM)
        while not told[-1].startswith("STOPPING"):
            told.append(manager.recv(1000).decode())
        assert process.wait(60.0) == 0
    assert told[0] == "READY=1\nSTATUS=1 of 1 program running"
    assert told[1].startswith("WATCHDOG=1\n") and told[2].startswith("WATCHDOG=1\n")
    with os.fdopen(read) as output:
        lines = output.read().splitlines()
    [warning] = [line for line in lines if line.startswith("<4>[WARNING] [launch]: ")]
    assert "(SIGTERM)" in warning
    assert any(line.startswith("<6>[INFO] [static]: process started") for line in lines)
