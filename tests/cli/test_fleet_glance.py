"""`tfbus fleet`: a fleet at a glance, and its roster."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import pytest

from tests.buses import eventually, keep_sending, send_static
from tests.recordings import described, gone, publisher, steadily, write
from tests.simulated_bus import Bus
from tfbus.base import scheduler
from tfbus.cli.fleet import as_lines
from tfbus.frames.fleet import RobotStatus, worst_first
from tfbus.testing.programs import Program


@pytest.fixture
def fleet(bus: Bus) -> Bus:
    """The robots robot2, robot3 and robot10, each with base_link in its map and a camera on it;
    robot3 is a process of its own.
    """
    for number in (2, 10):
        robot(bus, number)
    with bus.network.process("outside", "robot3"):
        robot(bus, 3)
    return bus


def robot(bus: Bus, number: int, **given: Any) -> None:
    """A robot of two nodes."""
    namespace = f"robot{number}"
    keep_sending(bus.node("wheels", namespace=namespace, **given), "map", "base_link")
    send_static(bus.node("mount", namespace=namespace, **given), "base_link", "camera")


def shown(bus: Bus, *arguments: str) -> tuple[int, dict[str, dict[str, Any]]]:
    """The exit code, and the robots by their names, in their order."""
    done = bus.run("fleet", "--json", *arguments)
    assert done.stderr == ""
    return done.returncode, {each["name"]: each for each in json.loads(done.stdout)["robots"]}


def test_each_robot_has_a_line(fleet: Bus) -> None:
    """A robot that is well has its nodes, age, rate, load and version; robot2 is before robot10."""
    code, robots = shown(fleet)
    assert (code, list(robots)) == (0, ["robot2", "robot3", "robot10"])
    for each in robots.values():
        assert (each["state"], each["problems"], each["stale"]) == ("there", [], 0)
        assert 0.0 <= each["age_s"] < 0.5
        assert 10.0 < each["messages_hz"] < 30.0
        assert each["bytes_per_s"] > 100.0
        assert len(each["versions"]) == 1
        assert each["nodes"] == [f"/{each['name']}/mount", f"/{each['name']}/wheels"]
    lines = fleet.run("fleet").stdout.splitlines()
    assert [line.split()[0] for line in lines[2:]] == ["robot2", "robot3", "robot10"]
    assert max(map(len, lines)) <= 80


def test_a_robot_that_never_came_is_missing(fleet: Bus, tmp_path: Path) -> None:
    """A robot of the roster that is not there is missing, in front of the others, and the exit code
    is 1; a robot outside of the roster is shown as such.
    """
    code, robots = shown(fleet, "--expect", "robot[1-3]")
    assert (code, list(robots)) == (1, ["robot1", "robot2", "robot3", "robot10"])
    assert [each["state"] for each in robots.values()] == ["missing", *["there"] * 3]
    assert [each["is_expected"] for each in robots.values()] == [True, True, True, False]
    headline = fleet.run("fleet", "--expect", "robot[1-3]").stdout.splitlines()[0]
    assert "2 of 3" in headline and headline.endswith(", 1 missing, 1 not expected")
    roster = tmp_path / "robots.txt"
    roster.write_text("# the hall\nrobot[2-3]\nrobot10\n")
    assert shown(fleet, "--expect", str(roster))[0] == 0


def test_a_command_that_got_no_cpu_says_so(fleet: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    """Robots that it calls missing or gone may be there; without any it says nothing."""
    monkeypatch.setattr(scheduler, "longest_wait_for_cpu_s", lambda: 7.5)
    assert fleet.run("fleet").stderr == ""
    warning = " ".join(fleet.run("fleet", "--expect", "robot[1-3]").stderr.split())
    assert warning.startswith("Warning: this machine ") and "waited 7.5 s" in warning
    assert warning.rstrip(".").endswith("robot1 may be there")


@pytest.mark.real
def test_a_process_knows_how_long_it_has_waited_for_a_cpu() -> None:
    """Of all its threads the one that waited longest counts, so also this one."""
    own_s = scheduler.waited_for_cpu_s()
    assert scheduler.longest_wait_for_cpu_s() >= own_s


def test_a_lost_robot_is_gone_until_it_is_back(fleet: Bus) -> None:
    """While it watches, a robot that is killed is gone, and there again when it comes back."""
    program = fleet.start("fleet", "--watch", "--json", "--expect", "robot[1-3]")

    def states() -> list[tuple[str, str]]:
        news = [json.loads(line) for line in program.stdout.splitlines()]
        return [(each["name"], each["state"]) for each in news]

    eventually(lambda: len(states()) == 4)
    assert states()[0] == ("robot1", "missing")
    fleet.network.kill("outside/robot3")
    eventually(lambda: states()[4:] == [("robot3", "gone")])
    assert json.loads(program.stdout.splitlines()[-1])["gone_ns"] is not None
    robot(fleet, 3)
    eventually(lambda: states()[5:] == [("robot3", "there")])
    assert program.stop() == 0


def test_a_robot_that_is_on_twice_is_in_trouble(fleet: Bus) -> None:
    """A robot and the one that takes its place, with its name, are not one that is well."""
    with fleet.network.process(fleet.network.host("spare"), "robot3"):
        robot(fleet, 3)
    _, robots = shown(fleet)
    assert robots["robot3"]["twice"] == ["outside", "spare"]
    assert robots["robot2"]["twice"] == []
    lines = fleet.run("fleet").stdout.splitlines()
    assert lines[2].startswith("robot3 ")
    assert "twice, on outside, spare" in lines[2]


@pytest.mark.real
def test_a_command_runs_for_a_robot_that_is_not_there(bus: Bus, tmp_path: Path) -> None:
    """The command of --on-gone has the robot and its state in its environment, and so has that of
    --on-back when it comes.
    """
    told = tmp_path / "told"
    command = f'echo "$TFBUS_ROBOT $TFBUS_STATE" >> {told}'
    options = ("--grace", "0", "--on-gone", command, "--on-back", command)
    program = bus.start("fleet", "--watch", "--expect", "robot[1-2]", *options)
    eventually(lambda: told.exists() and told.read_text().count("missing") == 2)
    robot(bus, 2)
    eventually(lambda: told.read_text().endswith("there\n"))
    assert told.read_text() == "robot1 missing\nrobot2 missing\nrobot2 there\n"
    program.stop()


def test_a_robot_that_boots_is_not_lost(fleet: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command of --on-gone waits for a robot that never came as long as --grace says, not for
    one that has left; that of --on-back is for robots of which --on-gone was told.
    """
    ran: list[tuple[str, str, str]] = []

    def run(option: str, _: str, told: dict[str, str]) -> None:
        ran.append((option, told["TFBUS_ROBOT"], told["TFBUS_STATE"]))

    monkeypatch.setattr("tfbus.cli.fleet.run_in_shell", run)
    commands = ("--on-gone", "alarm", "--on-back", "calm", "--grace", "10")
    program = fleet.start("fleet", "--watch", "--json", "--expect", "robot[1-4]", *commands)
    eventually(lambda: '"missing"' in program.stdout)
    robot(fleet, 1)
    fleet.network.kill("outside/robot3")
    eventually(lambda: len(ran) == 2)
    assert ran == [("--on-gone", "robot3", "gone"), ("--on-gone", "robot4", "missing")]
    robot(fleet, 3)
    eventually(lambda: len(ran) == 3)
    assert ran[2] == ("--on-back", "robot3", "there")
    assert program.stop() == 0


def test_a_wrong_clock_and_a_lost_publisher_come_first(fleet: Bus) -> None:
    """A robot with problems is in front of the others, and its line says what and how much."""
    with fleet.network.process(fleet.network.host("robot11", offset_s=2.5), "robot11"):
        robot(fleet, 11)
    _, robots = shown(fleet, "--shared", "map")
    assert next(iter(robots)) == "robot11"
    assert robots["robot11"]["clock_offset_s"] == pytest.approx(2.5, abs=0.1)
    assert [each["kind"] for each in robots["robot11"]["problems"]] == ["ahead"]
    line = fleet.run("fleet").stdout.splitlines()[2].split()
    assert line[:2] == ["robot11", "there"]
    assert "+2.5" in line and line[-1] == "ahead"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--expect", "robot[9-1]"), "a range goes up"),
        (("--expect", "robot[]"), "robot[1-30]"),
        (("--expect", "nowhere.txt"), "cannot be read"),
        (("--expect", "robot 7"), "robot 7"),
        (("--on-gone", "true"), "--watch"),
        (("--on-back", "true"), "--watch"),
    ],
)
def test_a_mistake_is_a_usage_error(bus: Bus, arguments: tuple[str, ...], message: str) -> None:
    """A roster that names no robots, and a command without --watch, exit with 2."""
    done = bus.run("fleet", *arguments)
    assert done.returncode == 2
    assert message in done.stderr


def test_without_a_robot_it_says_so(bus: Bus) -> None:
    """A bus without a robot in a namespace exits with 1, and names nodes that are in none, but no
    tools.
    """
    bus.node("_echo_1")
    assert "is a node running" in bus.run("fleet").stderr
    bus.node("tower")
    done = bus.run("fleet")
    assert (done.returncode, done.stdout) == (1, "")
    assert ": /tower is in none" in done.stderr and "--namespace" in done.stderr
    assert "/tower is in none" in bus.run_in_terminal("fleet", "--watch", until="is in none")


@pytest.mark.parametrize("tool", [("frames", "--fleet", "--watch"), ("monitor", "--fleet")])
def test_frames_that_fit_no_screen_are_shown_by_robot(fleet: Bus, tool: tuple[str, ...]) -> None:
    """On a small screen a tool shows a line a robot, in natural order, and how to see frames."""
    page = fleet.run_in_terminal(*tool, until="robot10", lines=9)
    assert "base_link" not in page
    assert page.index("robot2") < page.index("robot3") < page.index("robot10")
    assert "9 frames" in page


def test_a_page_of_a_thousand_robots_fits_a_screen() -> None:
    """It has the worst, and counts the others."""
    well = [RobotStatus(f"robot{number}", "there", age_s=0.1) for number in range(800)]
    lost = [RobotStatus(f"robot{number}", "gone", gone_ns=0) for number in range(800, 1000)]
    lines = as_lines(worst_first([*well, *lost]), 10**12, 24)
    assert len(lines) <= 24
    assert max(map(len, map(click.unstyle, lines))) <= 80
    assert any("robot800" in line for line in lines)
    assert "800" in lines[-1]
    assert len(as_lines(worst_first(well), 0)) == 802


def test_a_recording_has_its_fleet(bus: Bus, tmp_path: Path) -> None:
    """With --bag it is the fleet at a moment; a lost robot is gone since its last frames."""
    items = []
    for number, to_s in ((2, 20.0), (10, 5.0)):
        stream = publisher(f"robot{number}/wheels")
        items.append(described(stream, 0.0, ("map", "base", False)))
        items += steadily(stream, 0.0, to_s, ("map", "base"))
    path = write(tmp_path / "run.mcap", *items, gone(stream, 6.0))
    code, robots = shown(bus, "--bag", str(path), "--at", "+15s", "--expect", "robot[2,10]")
    assert (code, list(robots)) == (1, ["robot10", "robot2"])
    assert [each["state"] for each in robots.values()] == ["gone", "there"]
    text = bus.run("fleet", "--bag", str(path), "--at", "+15s").stdout
    assert "gone 10" in text
    assert shown(bus, "--bag", str(path), "--at", "+3s", "--expect", "robot[2,10]")[0] == 0


def test_a_command_that_was_stopped_listens_again(fleet: Bus) -> None:
    """Robots that it did not hear while it was stopped are there, and it waits until it knows."""
    program = fleet.start("fleet", "--json", "--period", "3", "--expect", "robot[2-3]")
    fleet.network.run(2.0)
    fleet.network.stop(program.process)
    fleet.network.run(10.0)
    fleet.network.go_on(program.process)
    assert program.wait() == 0
    robots = {each["name"]: each["state"] for each in json.loads(program.stdout)["robots"]}
    assert robots == {"robot2": "there", "robot3": "there", "robot10": "there"}


def test_a_watch_that_was_stopped_raises_no_alarm(fleet: Bus) -> None:
    """The command of --on-gone does not run for robots that were not heard because of that."""
    program = fleet.start("fleet", "--watch", "--json", "--expect", "robot[2-3]")
    eventually(lambda: program.stdout.count('"there"') == 3)
    fleet.network.stop(program.process)
    fleet.network.run(10.0)
    fleet.network.go_on(program.process)
    fleet.network.run(15.0)
    assert program.stdout.count('"state"') == 3
    assert program.stop() == 0


_HUB = "tcp/outside:7447"


def _watch_of_two(
    bus: Bus, monkeypatch: pytest.MonkeyPatch, *options: str
) -> tuple[list[tuple[str, str]], Callable[[], None], Program]:
    """The options that have run, each with its robot; a function that starts the hub; and a watch
    with a grace of 20 s, of robot2 and robot3, which are there.
    """
    ran: list[tuple[str, str]] = []

    def run(option: str, _: str, told: dict[str, str]) -> None:
        ran.append((option, told["TFBUS_ROBOT"]))

    monkeypatch.setattr("tfbus.cli.fleet.run_in_shell", run)

    def start_hub() -> None:
        with bus.network.process("outside", "hub"):
            bus.node("hub", mode="router", listen=("tcp/[::]:7447",))

    start_hub()
    for number in (2, 3):
        with bus.network.process("outside", f"robot{number}"):
            robot(bus, number, mode="client", connect=(_HUB,))
    commands = ("--on-gone", "alarm", "--on-back", "calm", "--grace", "20")
    join = ("--mode", "client", "--connect", _HUB)
    expect = ("--expect", "robot[2-3]")
    program = bus.start("fleet", "--watch", *expect, *commands, *join, *options)
    eventually(lambda: "2 of 2 robots there" in program.stdout)
    return ran, start_hub, program


def test_a_watch_that_lost_its_own_link_blames_no_robot(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the router of the watch is away its page says so, and the command of --on-gone does
    not run; a robot that is not back --grace seconds after the router is gone.
    """
    ran, start_hub, program = _watch_of_two(bus, monkeypatch)
    bus.network.kill("outside/hub")
    eventually(lambda: f"No link to {_HUB}" in program.stdout and "2 gone" in program.stdout)
    bus.network.run(5.0)
    bus.network.kill("outside/robot3")
    start_hub()
    eventually(lambda: "1 of 2 robots there, 1 gone" in program.stdout)
    bus.network.run(10.0)
    assert ran == []
    eventually(lambda: ran == [("--on-gone", "robot3")])
    assert f"No link to {_HUB}" not in program.stdout.rpartition("1 of 2")[0].rpartition("\n\n")[2]
    program.stop()


def test_a_watch_whose_link_comes_and_goes_misses_no_lost_robot(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command of --on-gone runs for a robot that is gone, though the own link is never there
    for as long as --grace, and for none that is there whenever the link is.
    """
    ran, start_hub, program = _watch_of_two(bus, monkeypatch)
    for number in range(6):
        bus.network.kill("outside/hub")
        bus.network.run(7.0)
        if not number:
            bus.network.kill("outside/robot3")
        start_hub()
        bus.network.run(10.0)
    assert ran == [("--on-gone", "robot3")]
    program.stop()


def test_a_watch_that_looks_rarely_blames_no_robot_at_its_first_look(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot that left since the last look may have left just now."""
    ran, start_hub, program = _watch_of_two(bus, monkeypatch, "--period", "30")
    bus.network.kill("outside/hub")
    eventually(lambda: f"No link to {_HUB}" in program.stdout)
    start_hub()
    bus.network.run(90.0)
    assert "2 of 2 robots there" in program.stdout.rpartition("No link")[2]
    assert ran == []
    program.stop()
