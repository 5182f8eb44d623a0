"""Tools on a recording in which the recorder was paused: their sentences on the pause."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from tests.recordings import at, described, gone, node, publisher, sent, steadily, write
from tfbus.cli import main
from tfbus.recording.items import EventItem, TopicItem

SIM, ARM = publisher("sim"), publisher("arm")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """330 s, of which all but the first and the last 10 s are a pause; arm comes at 2 Hz."""
    return write(
        tmp_path / "run.mcap",
        node(
            SIM.node,
            parameters=[{"name": "speed", "value": 1.5, "type": "double"}],
            streams=["sim"],
        ),
        described(SIM, 0.0, ("world", "base", False)),
        steadily(SIM, 0.0, 10.0, ("world", "base")),
        steadily(SIM, 320.0, 330.0, ("world", "base")),
        described(ARM, 0.0, ("base", "arm", False)),
        steadily(ARM, 0.0, 10.0, ("base", "arm"), rate_hz=2.0),
        steadily(ARM, 320.3, 330.0, ("base", "arm"), rate_hz=2.0),
        EventItem(at(10.0), "paused"),
        EventItem(at(320.0), "resumed"),
        [
            TopicItem(at(each), "pose", "Pose", {"stamp_ns": at(each) - 2_000_000, "x": 1.0})
            for each in (*range(10), *range(321, 330))
        ],
    )


def run(*args: object) -> Result:
    return CliRunner().invoke(main, [str(arg) for arg in args])


def test_info_lists_the_pauses_and_measures_without_them(path: Path) -> None:
    """Rates are those while it was recorded."""
    shown = run("bag", "info", path).output
    assert "(19.9 s recorded)" in shown
    assert "Pauses:    +10.000s to +320.000s (5 min, paused)" in shown
    facts = json.loads(run("bag", "info", "--json", path).output)
    rates = {each["name"]: round(each["flow"]["rate"]) for each in facts["streams"]}
    assert rates == {"arm": 2, "sim": 10}
    assert [each["why"] for each in facts["pauses"]] == ["paused"]


def test_monitor_and_doctor_find_no_gap(path: Path) -> None:
    """They name the pause in their first lines."""
    shown = run("monitor", "--bag", path).output
    assert "paused from +10.000s to +320.000s" in shown
    report = json.loads(run("monitor", "--bag", path, "--json").output)
    assert all(each["gap_from_ns"] is None for each in report["edges"])
    gaps = json.loads(run("doctor", "--bag", path, "--json").output)
    assert gaps["gaps"]["verdict"] == "ok"


def test_a_moment_in_a_pause_shows_what_was_there_before(path: Path) -> None:
    """Nothing is stale, and all frames are there, however long ago."""
    shown = run("frames", "--bag", path, "--at", "+100s").output
    assert "before the pause" in shown
    assert "STALE" not in shown and "world" in shown and "arm" in shown
    why = run("why", "world", "base", "--bag", path, "--at", "+100s")
    assert why.exit_code == 0
    assert "STALE" not in why.output and "its publisher" not in why.output
    assert "before or after it" in why.output


def test_why_names_the_pause_that_keeps_a_frame_away(path: Path) -> None:
    """Until its first sample behind it."""
    shown = " ".join(run("why", "base", "arm", "--bag", path, "--at", "+320.2s").output.split())
    assert "again at +320.305s" in shown and "paused from +10.000s" in shown


@pytest.mark.parametrize(
    "args",
    [
        ("echo", "world", "base", "--at", "+100s"),
        ("echo", "world", "base", "--from", "+100s", "--to", "+110s"),
    ],
)
def test_echo_says_why_there_is_nothing_in_a_pause(path: Path, args: tuple[str, ...]) -> None:
    """It exits with 1."""
    failed = run(*args, "--bag", path)
    assert failed.exit_code == 1
    assert "paused from +10.000s to +320.000s" in failed.output


def test_an_export_of_a_pause_is_refused(path: Path, tmp_path: Path) -> None:
    """Of the whole it has no pose in the pause, at any rate."""
    target = tmp_path / "base.csv"
    args = ("bag", "export", path, "world", "base", "-o", target)
    refused = run(*args, "--from", "+100s", "--to", "+110s")
    assert refused.exit_code == 1 and not target.exists()
    assert "the recorder was paused" in refused.output
    assert run(*args, "--rate", "10").exit_code == 0
    stamps = [int(row.split(",")[0]) for row in target.read_text().splitlines()[1:]]
    assert not any(at(10.0) < stamp < at(320.0) for stamp in stamps)
    assert len(stamps) > 190


def test_topics_are_measured_without_a_pause(path: Path) -> None:
    """hz, bw and delay."""
    hz, bw, delay = (
        json.loads(run("topic", verb, "pose", "--bag", path, "--json").output)
        for verb in ("hz", "bw", "delay")
    )
    assert hz["rate_hz"] == pytest.approx(0.95, abs=0.06)
    assert bw["mean_bytes"] == bw["max_bytes"] > 10
    assert delay["mean_s"] == pytest.approx(0.002)
    assert run("topic", "delay", "tf/sim", "--bag", path).exit_code == 0
    assert "too few messages" in run("topic", "bw", "pose", "--bag", path, "--to", "+0s").output


def test_a_message_without_transforms_has_no_delay(tmp_path: Path) -> None:
    """It is not counted: the delays of the others are alone in the report."""
    path = write(tmp_path / "run.mcap", sent(SIM, 0.5), steadily(SIM, 0.0, 1.0, ("world", "base")))
    delay = json.loads(run("topic", "delay", "tf/sim", "--bag", path, "--json").output)
    assert delay["window"] == 10 and delay["max_s"] == pytest.approx(0.005)


def test_nodes_and_their_parameters_are_those_of_the_moment(path: Path) -> None:
    """As they described themselves; a name that is not there gets a hint."""
    assert run("node", "list", "--bag", path).output == "/sim\n"
    assert "Host: robot" in run("node", "info", "sim", "--bag", path).output
    assert run("node", "info", "sin", "--bag", path).output.endswith("did you mean '/sim'?\n")
    assert run("param", "get", "sim", "speed", "--bag", path).output == "Double value is: 1.5\n"
    assert "/sim:\n  speed\n" in run("param", "list", "--bag", path).output
    assert run("param", "dump", "sim", "--bag", path).output == "/sim:\n  speed: 1.5\n"
    assert "did you mean 'speed'" in run("param", "get", "sim", "sped", "--bag", path).output
    assert run("topic", "type", "pose", "--bag", path).output == "Pose\n"


def test_info_prints_names_of_topics_only_and_sorts(path: Path) -> None:
    """As `ros2 bag info -t` and `--sort`."""
    assert run("bag", "info", "-t", path).output.split() == ["pose", "tf/arm", "tf/sim"]
    shown = run("bag", "info", "--sort", "count", path).output
    assert shown.index("\nsim ") < shown.index("\narm ")


def test_why_advises_what_to_look_at_in_the_file(tmp_path: Path) -> None:
    """Not to start a publisher that was lost then."""
    path = write(
        tmp_path / "lost.mcap",
        described(SIM, 0.0, ("world", "base", False)),
        steadily(SIM, 0.0, 20.0, ("world", "base")),
        described(ARM, 0.0, ("robot", "arm", False)),
        steadily(ARM, 0.0, 8.0, ("robot", "arm")),
        gone(ARM, 8.0),
    )
    lost = " ".join(run("why", "robot", "arm", "--bag", path).output.split())
    assert "lost at +8.000s" in lost and "--at +7.000s" in lost
    apart = " ".join(run("why", "world", "arm", "--bag", path).output.split())
    assert "joins 'world' and 'robot'" in apart
    unknown = " ".join(run("why", "world", "camera", "--bag", path).output.split())
    # A long path may be broken over lines.
    assert f"seewhichframeswererecorded:tfbusbaginfo-v{path}" in unknown.replace(" ", "")
    for shown in (lost, apart, unknown):
        assert "start the" not in shown and "publish a transform" not in shown


def test_a_publisher_that_did_not_describe_itself_has_no_host(tmp_path: Path) -> None:
    """As in a recording of ROS: nothing is said of it rather than an empty host and process 0."""
    path = write(tmp_path / "ros.mcap", steadily(SIM, 0.0, 5.0, ("world", "base")))
    shown = run("frames", "--bag", path).output
    assert "sim: /sim, 1 frame" in shown
    assert "pid" not in shown


def test_why_does_not_advise_to_wait_in_a_recording(tmp_path: Path) -> None:
    """Where two frames have no common time."""
    path = write(
        tmp_path / "apart.mcap",
        steadily(SIM, 0.0, 2.0, ("world", "base")),
        steadily(ARM, 5.0, 7.0, ("base", "arm")),
    )
    shown = " ".join(run("why", "world", "arm", "--bag", path).output.split())
    assert "no common time" in shown
    assert "wait" not in shown and "cache_time_s" not in shown
