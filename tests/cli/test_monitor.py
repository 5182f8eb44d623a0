"""`tfbus monitor` on a live bus: its measurements, and its report of a pair."""

import json
import re

import pytest

from tests.buses import keep_sending, send_static
from tests.simulated_bus import Bus
from tfbus import Transform, TransformBroadcaster, TransformStamped

LATE_NS = 300_000_000


@pytest.fixture
def robot(bus: Bus) -> Bus:
    """world -> base at once, base -> arm 0.3 s late, both at 50 Hz; arm -> camera is static."""
    keep_sending(bus.node("odometry"), "world", "base", rate_hz=50.0)
    keep_sending(bus.node("kinematics"), "base", "arm", late_ns=LATE_NS, rate_hz=50.0)
    send_static(bus.node("mount"), "arm", "camera")
    return bus


def test_all_edges_and_streams_are_measured(robot: Bus) -> None:
    """It has rate, jitter, delay, age and order of each edge; rate and bytes of each stream."""
    done = robot.run("monitor", "--once", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    report = json.loads(done.stdout)
    edges = {edge["name"]: edge for edge in report["edges"]}
    assert edges.keys() == {"base", "arm", "camera"}
    assert 10.0 < edges["base"]["rate_hz"] < 60.0
    assert edges["base"]["jitter_s"] < 0.1
    assert edges["arm"]["delays_s"]["p50"] > LATE_NS / 1e9
    assert edges["arm"]["delays_s"]["p50"] > edges["base"]["delays_s"]["p50"]
    assert edges["arm"]["out_of_order"] == 0
    assert edges["camera"]["static"]
    streams = {stream["name"]: stream for stream in report["streams"]}
    assert streams["odometry"]["bytes_per_s"] > 1_000.0
    # On a busy machine Zenoh drops some.
    assert streams["odometry"]["missed"] < 10
    assert streams["odometry"]["node"] == "/odometry"


def test_it_prints_tables(robot: Bus) -> None:
    """For people it prints a table of edges and one of streams, in 80 columns."""
    out = robot.run("monitor", "--once").stdout
    lines = out.splitlines()
    assert lines[0].split()[:4] == ["frame", "by", "Hz", "jitter"]
    assert [line.split()[:2] for line in lines[1:4]] == [
        ["arm", "kinematics"],
        ["base", "odometry"],
        ["camera", "mount"],
    ]
    assert lines[5].split() == ["stream", "node", "host", "Hz", "kB/s", "missed", "clock"]
    assert max(map(len, lines)) <= 80


def test_a_problem_of_an_edge_is_written_out(robot: Bus) -> None:
    """A frame with two publishers has a row of each, marked behind it, also without colour."""
    keep_sending(robot.node("rival"), "world", "base", rate_hz=50.0)
    lines = robot.run("monitor", "--once").stdout.splitlines()
    rows = [line.split() for line in lines if line.startswith("base ")]
    assert [row[1:3] for row in rows] == [["odometry", "CONFLICT"], ["rival", "CONFLICT"]]
    assert all(10.0 < float(row[3]) < 60.0 for row in rows)


def test_a_pair_has_its_chain_and_latest_edge(robot: Bus) -> None:
    """For two frames it has the chain between them, the net delay and the latest edge."""
    pair = json.loads(robot.run("monitor", "world", "camera", "--once", "--json").stdout)["pair"]
    assert pair["chain"] == ["world", "base", "arm", "camera"]
    assert pair["net_delay_s"]["p50"] > LATE_NS / 1e9
    assert pair["held_back_by"] == "arm"
    out = robot.run("monitor", "world", "camera", "--once").stdout
    pair_line, chain, delay, *_ = out.splitlines()
    assert (pair_line, chain) == ("world -> camera", "Chain: world -> base -> arm -> camera")
    assert delay.startswith("Net delay: p50 3")
    assert "\nHeld back by: arm\n" in out


def test_a_pair_without_a_transform_says_why(robot: Bus) -> None:
    """Without a transform it exits with 1 and the reason in one sentence."""
    done = robot.run("monitor", "world", "camra")
    assert (done.returncode, done.stdout) == (1, "")
    assert "no frame 'camra'" in done.stderr and "mean 'camera'" in done.stderr
    assert done.stderr.endswith("tfbus why world camra)\n")


def test_one_frame_is_no_pair(bus: Bus) -> None:
    """A single frame is a usage error."""
    done = bus.run("monitor", "world")
    assert done.returncode == 2
    assert "tfbus monitor world FRAME" in done.stderr


def test_a_command_that_it_names_can_be_copied(robot: Bus) -> None:
    """A shell takes a frame with a space in quotes."""
    done = robot.run("monitor", "world", "left arm")
    assert done.stderr.endswith("why world 'left arm')\n")
    done = robot.run("monitor", "left arm")
    assert "monitor 'left arm' FRAME" in done.stderr


def test_stamps_ahead_are_named(bus: Bus) -> None:
    """Behind the publisher of the frame, and in a sentence that says what to do."""
    keep_sending(bus.node("arm"), "world", "base", late_ns=-300_000_000_000)
    out = bus.run("monitor", "--once", "-p", "2").stdout
    assert re.search("^base +arm AHEAD .* -5 min", out, re.MULTILINE)
    shown = " ".join(out.split())
    assert "'base' are 5 min in" in shown and "have /arm on " in shown
    pair = bus.run("monitor", "world", "base", "--once", "-p", "2").stdout
    assert "'base' are 5 min in" in " ".join(pair.split())


def test_a_pipe_has_whole_names(bus: Bus) -> None:
    """It has no width: no name is cut, however long, nor wrapped."""
    left, right = (f"{'robot7/' * 40}"[: 255 - len(end)] + end for end in ("left", "right"))
    keep_sending(bus.node("sim"), left, right, late_ns=1_600_000_000 * 10**9)
    pair = bus.run("monitor", left, right, "--once", "-p", "2").stdout.splitlines()
    assert pair[:2] == [f"{left} -> {right}", f"Chain: {left} -> {right}"]
    (row,) = [line for line in pair if line.startswith(f"{right}  sim ")]
    assert "are of another clock" in pair[-1] and repr(right) in pair[-1]
    assert "are of another clock" not in row


def test_it_goes_on_until_ctrl_c(robot: Bus) -> None:
    """It reports periodically, and marks a publisher that ends."""
    monitor = robot.start("monitor", "--period", "0.2")
    monitor.wait_for_line("^base +odometry")
    short_lived = robot.node("short_lived")
    keep_sending(short_lived, "world", "visitor", rate_hz=50.0)
    monitor.wait_for_line("^visitor +short_lived +4|^visitor +short_lived +5")
    short_lived.close()
    monitor.wait_for_line("^visitor +short_lived GONE")
    assert monitor.stop() == 0


def test_stamps_of_another_clock_are_named(bus: Bus) -> None:
    """Ages of years come from a simulated time, and both tools that print ages ask for that."""
    keep_sending(bus.node("simulated"), "world", "base", late_ns=10**18, rate_hz=50.0)
    report = bus.run("monitor", "world", "base", "--once")
    assert re.search("stamps of 'base' .* another clock: .*--sim-time", report.stdout)
    delay = bus.run("topic", "delay", "tf/simulated", "--once")
    assert re.fullmatch("Warning: .* 'tf/simulated' .* another clock: .*--sim-time\n", delay.stderr)


@pytest.mark.parametrize(("unit", "ns"), [("milliseconds", 10**6), ("microseconds", 10**3)])
def test_stamps_in_another_unit_are_named(bus: Bus, unit: str, ns: int) -> None:
    """Both tools that print ages say so in the words of `frames`, and suspect no other clock."""
    node = bus.node("odometry")
    broadcaster = TransformBroadcaster(node)

    def send() -> None:
        stamp_ns = node.now_ns() // ns
        broadcaster.send_transform(
            TransformStamped(stamp_ns, "world", "base", Transform.identity())
        )

    node.create_timer(0.02, send)
    words = f"look like {unit}, and stamps are nanoseconds"
    remedy = "stamp them with node.now_ns(), or tfbus.stamp_ns(SECONDS)"
    frames = " ".join(bus.run("frames").stdout.split())
    report = " ".join(bus.run("monitor", "world", "base", "--once").stdout.split())
    delay = bus.run("topic", "delay", "tf/odometry", "--once")
    assert words in frames
    assert f"{words}: {remedy}" in report
    assert delay.stderr == f"Warning: the stamps on 'tf/odometry' {words}: {remedy}\n"
    assert "another clock" not in report
