"""`tfbus doctor` against a live bus."""

import json
import re
from pathlib import Path
from typing import Any

import msgpack
import pytest

from tests.builders import at
from tests.buses import DEADLINE_S, eventually, keep_sending, send_static
from tests.live_bus import free_port
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    TransformBroadcaster,
    TransformListener,
)
from tfbus.doctor.examination import CHECKS
from tfbus.wire.descriptions import StreamDescription, encode_stream


def examined(bus: Bus, *arguments: str) -> tuple[int, dict[str, Any]]:
    """The exit code, and what it found by the names of the checks."""
    done = bus.run("doctor", "--json", *arguments)
    assert done.stderr == ""
    return done.returncode, json.loads(done.stdout)


def test_a_healthy_bus_has_no_failure(bus: Bus) -> None:
    """On a healthy bus no check fails, and each has evidence."""
    keep_sending(bus.node("odometry"), "world", "base")
    send_static(bus.node("mount"), "base", "camera")
    listens = bus.node("planner")
    with TransformListener(Buffer(), listens):
        code, found = examined(bus)
    assert code == 0
    assert found.keys() == CHECKS.keys()
    verdicts = {name: finding["verdict"] for name, finding in found.items()}
    for name in (
        "scouting",
        "node-names",
        "conflicts",
        "loops",
        "disconnected",
        "gone",
        "stamps",
        "unread",
    ):
        assert verdicts[name] == "ok", found[name]
    assert verdicts["buffers"] == "ok"
    [clocks] = found["clock-skew"]["evidence"]
    assert clocks.startswith("2 clocks ") and "100 ms" in clocks


def test_trouble_is_found_and_fails(bus: Bus) -> None:
    """Two nodes of one name, two publishers of one frame and a separate tree are all found."""
    send_static(bus.node("mount"), "base", "camera")
    send_static(bus.node("other"), "base", "camera")
    send_static(bus.node("elsewhere"), "map", "dock")
    keep_sending(bus.node("twin"), "world", "base")
    bus.node("twin")
    code, found = examined(bus)
    assert code == 1
    failed = {name for name, finding in found.items() if finding["verdict"] == "fail"}
    assert failed == {"node-names", "conflicts"}
    assert "'camera' is published by" in found["conflicts"]["evidence"][0]
    assert found["disconnected"]["verdict"] == "warn"
    assert found["unread"]["verdict"] == "ok"
    assert "no node reads" in found["unread"]["evidence"][0]


def test_what_is_well_fits_the_screen_too(bus: Bus) -> None:
    """Long evidence goes on below itself."""
    keep_sending(bus.node("a_driver_with_a_rather_long_name"), "map", "base_link")
    lines = bus.run("doctor", "--only", "unread").stdout.splitlines()
    assert lines[1].startswith("ok ")
    assert " ".join(lines[1:-1]).split()[-1] == "/a_driver_with_a_rather_long_name"
    assert max(map(len, lines)) <= 80


@pytest.mark.real
def test_people_get_a_page(bus: Bus) -> None:
    """For people it is a line a check, the evidence and the remedy below, and a sum; this one looks
    at a real host."""
    send_static(bus.node("mount"), "base", "camera")
    send_static(bus.node("other"), "base", "camera")

    def found() -> str:
        done = bus.run("doctor", "--only", "conflicts", "--only", "install", "--for", "1")
        return done.stdout if done.returncode == 1 else ""

    # On a busy machine a second may bring neither.
    lines = eventually(found).splitlines()
    assert lines[0].endswith(" of namespace /")
    assert re.fullmatch(r"ok      install +tfbus .* Python 3.*", lines[1])
    assert re.fullmatch(r"fail    conflicts", lines[2])
    assert lines[3].startswith("    - 'camera' is published ")
    assert lines[-2].startswith("    Fix: stop one of")
    assert lines[-1] == "1 ok, 1 fail"
    assert max(map(len, lines)) <= 80


@pytest.mark.real
def test_a_configuration_may_give_a_doctor_a_port_and_an_id(bus: Bus, tmp_path: Path) -> None:
    """Its trial of scouting has others."""
    config = tmp_path / "doctor.json5"
    group = f"address: '224.0.0.224:{free_port()}', interface: 'lo'"
    config.write_text(
        f"{{id: 'd0c', listen: {{endpoints: ['tcp/127.0.0.1:{free_port()}']}},"
        f" scouting: {{multicast: {{{group}}}}}}}"
    )
    done = bus.run("doctor", "--json", "--for", "0.5", "--only", "install", "--config", str(config))
    assert (done.returncode, done.stderr) == (0, "")


def test_a_screen_has_ten_sentences_of_a_check(bus: Bus) -> None:
    """And how many more there are; JSON has all."""
    for number in range(13):
        send_static(bus.node(f"mount{number}"), f"map{number}", f"dock{number}")
    options = ("doctor", "--only", "disconnected", "--for", "0.5")
    text = " ".join(bus.run(*options).stdout.split())
    assert text.count("a separate tree") == 10
    assert "and 2 more (--json" in text
    assert len(examined(bus, *options[1:])[1]["disconnected"]["evidence"]) == 12


def test_the_checks_are_listed(bus: Bus) -> None:
    """--list names each check with what it makes sure of."""
    done = bus.run("doctor", "--list")
    assert done.returncode == 0
    live = [name for name, check in CHECKS.items() if check.applies(to_recording=False)]
    assert [line.split()[0] for line in done.stdout.splitlines()] == live
    assert "conflicts       Each frame has" in done.stdout


def test_an_unknown_check_is_a_mistake(bus: Bus) -> None:
    """An unknown check exits with 2, and the nearest names come first."""
    done = bus.run("doctor", "--only", "nodez")
    assert done.returncode == 2
    assert "'nodes'" in done.stderr
    assert "--list" in done.stderr


def test_a_simulated_time_that_is_not_ours_is_found(bus: Bus) -> None:
    """Under system time the doctor names the option, and does not judge the stamps."""
    bus.start("clock", "--start", "0").wait_for_line("It is 0")
    robot = bus.node("robot", sim_time=True)
    robot.wait_for_clock(DEADLINE_S)
    keep_sending(robot, "world", "base")
    code, found = examined(bus, "--for", "1")
    assert code == 0
    assert "1 of 1 publisher follow it" in found["clock"]["evidence"][0]
    assert "--sim-time" in found["clock"]["remedy"]
    assert {found[name]["verdict"] for name in ("rates", "stamps", "gaps")} == {"ok"}
    code, found = examined(bus, "--for", "1", "--sim-time")
    assert (code, found["clock"]["verdict"]) == (0, "ok")
    assert "simulated: use --sim-time" in bus.run("frames").stdout


def test_a_watch_prints_findings_when_they_begin_and_end(bus: Bus) -> None:
    """A publisher that leaves is found, and the finding ends when it is back; Ctrl-C ends it."""
    sim = bus.node("sim")
    keep_sending(sim, "world", "base")
    doctor = bus.start("doctor", "--watch", "--for", "1", "--only", "gone", "--only", "stale")
    doctor.wait_for_line("2 ok: nothing is wrong")
    sim.close()
    doctor.wait_for_line("warn +gone")
    doctor.wait_for_line("Fix: start it again")
    keep_sending(bus.node("sim"), "world", "base")
    doctor.wait_for_line("ended +gone")
    assert doctor.stop() == 0


def test_a_watch_forgets_programs_of_this_host_that_have_ended(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which of them scout is looked at each time, as the nodes on the bus are."""
    programs = {42: "python"}
    monkeypatch.setattr("tfbus.doctor.examine.local_scouts", lambda: dict(programs))
    doctor = bus.start("doctor", "--watch", "--for", "1", "--only", "alone")
    doctor.wait_for_line("warn +alone")
    programs.clear()
    doctor.wait_for_line("ended +alone")
    assert doctor.stop() == 0


def test_a_watch_exits_at_the_first_failure(bus: Bus) -> None:
    """With --exit-on-fail, as JSON lines; warnings do not end it."""
    keep_sending(bus.node("sim"), "world", "base")
    send_static(bus.node("elsewhere"), "map", "dock")
    doctor = bus.start(
        *("doctor", "--watch", "--for", "1", "--json", "--exit-on-fail"),
        *("--only", "conflicts", "--only", "disconnected"),
    )
    doctor.wait_for_line('"check": "disconnected"')
    keep_sending(bus.node("rival"), "world", "base")
    assert doctor.wait(timeout_s=DEADLINE_S) == 1
    last = json.loads(doctor.stdout.splitlines()[-1])
    assert (last["event"], last["check"], last["verdict"]) == ("begun", "conflicts", "fail")


@pytest.mark.real
def test_a_watch_calls_a_command(bus: Bus, tmp_path: Path) -> None:
    """With the finding in its environment; its own failure is a warning."""
    told = tmp_path / "told"
    send_static(bus.node("mount"), "base", "camera")
    send_static(bus.node("other"), "base", "camera")
    command = f'echo "$TFBUS_CHECK: $TFBUS_EVIDENCE" > {told}; exit 3'
    options = ("--watch", "--for", "0.5", "--only", "conflicts", "--on-fail", command)
    doctor = bus.start("doctor", *options)
    doctor.wait_for_line("fail +conflicts")
    assert eventually(lambda: told.exists() and told.read_text()).startswith("conflicts: 'camera'")
    eventually(lambda: any("exited with 3" in line for line in doctor.err))
    assert doctor.stop() == 0


def test_a_watch_says_at_once_that_it_watches(bus: Bus) -> None:
    """Findings come after the time it listens for; until then it is not silent."""
    doctor = bus.start("doctor", "--watch", "--for", "60", "--only", "gone")
    doctor.wait_for_line("watching namespace /: gone, first findings after 60.0 s")


def test_a_wrong_name_of_a_check_is_answered_with_the_nearest(bus: Bus) -> None:
    """Not with all 36 names, which --list has."""
    done = bus.run("doctor", "--only", "node")
    assert done.returncode == 2
    assert "'nodes'" in done.stderr and "--list" in done.stderr
    assert len(done.stderr.splitlines()[-1]) < 150


@pytest.mark.parametrize(
    "options", [("--exit-on-fail",), ("--on-fail", "true"), ("--watch", "--bag", __file__)]
)
def test_options_of_a_watch_need_one(bus: Bus, options: tuple[str, ...]) -> None:
    """A usage error; a recording is not watched."""
    done = bus.run("doctor", *options)
    assert done.returncode == 2 and "--watch" in done.stderr


def test_messages_of_a_newer_version_are_named_with_the_remedy(bus: Bus) -> None:
    """By the doctor, and by `tfbus why` of a frame that comes in them."""
    arm = bus.node("arm")
    # As a newer version would: it lists a frame, and sends it in messages of its own.
    TransformBroadcaster(arm, history_s=0.0).send_transform(at(1.0, "hand"))
    publisher = arm.session.publisher("tf/arm")
    arm.create_timer(0.1, lambda: publisher.put(msgpack.packb({"v": 3})))
    reason = "version 3; .* versions 1 and 2: update"
    code, found = examined(bus)
    [evidence] = found["refused"]["evidence"]
    assert code == 1 and re.search(f"stream 'arm' .*{reason}", evidence)
    assert re.search(reason, " ".join(bus.run("why", "world", "hand").stdout.split()))


def test_a_description_of_a_newer_version_is_named_with_the_remedy(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the doctor, and by `tfbus why` of a frame whose name only the description has."""

    def newer(description: StreamDescription) -> bytes:
        payload: bytes = msgpack.packb({**msgpack.unpackb(encode_stream(description)), "v": 2})
        return payload

    monkeypatch.setattr("tfbus.streams.stream.encode_stream", newer)
    arm = bus.node("arm")
    broadcaster = TransformBroadcaster(arm, poses="compact")
    arm.create_timer(0.1, lambda: broadcaster.send_transform(at(1.0, "hand", arm.now_ns())))
    reason = "description of stream 'arm' .* version 2; .* version 1: update"
    done = bus.run("doctor", "--json", "--only", "refused")
    found = json.loads(done.stdout)["refused"]
    assert (done.returncode, found["verdict"]) == (1, "fail")
    [evidence] = found["evidence"]
    assert re.search(reason, evidence)
    assert re.search(reason, " ".join(bus.run("why", "world", "hand").stdout.split()))


def test_a_node_that_is_stopped_is_named(bus: Bus) -> None:
    """A router says for a while that it is there; neither the doctor nor `frames` counts it."""
    endpoint = "tcp/127.0.0.1:7447"
    bus.start("router", "--listen", endpoint).wait_for_line("Routing on")
    client = ("--mode", "client", "--connect", endpoint)
    keep_sending(bus.node("odometry", mode="client", connect=(endpoint,)), "world", "base")
    with bus.network.process("outside", "sim") as process:
        bus.node("sim", mode="client", connect=(endpoint,))
    eventually(lambda: bus.run("node", "list", *client).stdout.split() == ["/odometry", "/sim"])
    doctor = bus.start("doctor", "--json", "--only", "nodes", *client)
    frames = bus.start("frames", "--json", "--wait-time", "0.2", *client)
    nodes = bus.start("node", "list", *client)
    bus.network.stop(process)
    assert (doctor.wait(), frames.wait(), nodes.wait()) == (0, 0, 0)
    assert json.loads(frames.stdout)["unanswered"] == ["/sim"]
    assert frames.stderr.startswith("Warning: /sim ") and "did not answer" in frames.stderr
    finding = json.loads(doctor.stdout)["nodes"]
    assert finding["verdict"] == "warn"
    [evidence] = finding["evidence"]
    assert evidence.startswith("/sim ") and evidence.endswith("did not answer")
    assert nodes.stdout.split() == ["/odometry", "/sim"]
    assert nodes.stderr == frames.stderr
    bus.network.go_on(process)
