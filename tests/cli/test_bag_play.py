"""`tfbus bag play` as people type it."""

import re
import signal
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from tests.builders import S, at, x_of
from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import Buffer, TransformBroadcaster, TransformListener
from tfbus.bag.player import Player
from tfbus.cli import main
from tfbus.cli.bag.play import command
from tfbus.cli.bag.play_run import bar_text, end_text, follow, log_text
from tfbus.geometry.columns import Columns
from tfbus.recording.items import RecordedStream, TopicItem, TransformItem
from tfbus.recording.playhead import Progress
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter

pytest.importorskip("mcap")

BEGAN_NS = 1_700_000_000 * S


@pytest.fixture
def run_mcap(tmp_path: Path) -> Path:
    """A recording of 2 s with one stream and one topic."""
    path = tmp_path / "run.mcap"
    stream = RecordedStream("sim", "/sim", epoch_ns=BEGAN_NS)
    with RecordingWriter(path) as writer:
        for n in range(3):
            log_ns = BEGAN_NS + n * S
            rows = Columns.of_transforms([at(float(n), stamp_ns=log_ns)])
            writer.write(TransformItem(log_ns, stream, rows, seq=n))
            writer.write(TopicItem(log_ns, "turtle1/pose", "Pose", {"x": float(n)}))
    return path


def mistake(*arguments: object) -> str:
    """What the command says of these arguments, with exit code 2."""
    result = CliRunner().invoke(command, [*map(str, arguments)])
    assert result.exit_code == 2, result.output
    return result.output.splitlines()[-1]


def test_it_plays_to_the_end(bus: Bus, run_mcap: Path) -> None:
    """At the end of the recording it ends by itself, and says what it has played."""
    done = bus.run("bag", "play", str(run_mcap), "--rate", "50")
    assert done.returncode == 0, done.stderr
    assert re.search(r"Playing 2\.0 s .* 50: 1 stream, 1 topic; .* moved", done.stderr)
    assert re.search(r"Played 6 messages in", done.stderr)


def test_all_count_the_messages_of_a_recording_alike(bus: Bus, tmp_path: Path) -> None:
    """`bag info`, `topic list` and `bag play` have one number of messages, without those of static
    transforms, which repeat.
    """
    path = tmp_path / "run.mcap"
    stream = RecordedStream("sim", "/sim", epoch_ns=BEGAN_NS)
    with RecordingWriter(path) as writer:
        for n in range(4):
            log_ns = BEGAN_NS + n * S
            rows = Columns.of_transforms([at(float(n), stamp_ns=log_ns)])
            writer.write(TransformItem(log_ns, stream, rows, seq=n))
            still = Columns.of_transforms([at(1.0, "cam", stamp_ns=BEGAN_NS)])
            writer.write(TransformItem(log_ns, stream, still, static=True, seq=n // 2))
            writer.write(TopicItem(log_ns, "turtle1/pose", "Pose", {"x": float(n)}))
    played = bus.run("bag", "play", str(path), "--rate", "50").stderr
    info = CliRunner().invoke(main, ["bag", "info", str(path)]).stdout
    listed = CliRunner().invoke(main, ["topic", "list", "-v", "--bag", str(path)]).stdout
    rows = [line.split() for line in listed.splitlines()[1:]]
    assert sum(int(row[-1]) for row in rows if not row[0].startswith("tf_static/")) == 8
    assert re.search(r"Messages: +8 with 4 dynamic transforms, and 1 static transform\n", info)
    assert "Played 8 messages in" in played


@pytest.mark.parametrize("options", [(), ("--clock",), ("--clock", "--delay", "1")])
def test_it_does_not_follow_a_simulated_time(
    bus: Bus, run_mcap: Path, options: tuple[str, ...]
) -> None:
    """It plays to the end by real time where the environment sets simulated time, as that of a
    launch file with `sim_time`: the clock may be its own.
    """
    player = bus.start("bag", "play", str(run_mcap), *options, env={"TFBUS_SIM_TIME": "1"})
    assert player.wait(timeout_s=30.0) == 0
    assert "Played 6 messages in 2.0 s" in player.err[-1]


@pytest.mark.parametrize("delay", [(), ("--delay", "0.1")])
def test_it_does_not_take_over_a_live_robot(
    bus: Bus, run_mcap: Path, delay: tuple[str, ...]
) -> None:
    """Beside the publisher of one of its streams it ends with 1, and plays nothing; --force plays.
    Beside other streams, or with --prefix, it plays.
    """
    live = TransformBroadcaster(bus.node("robot"), stream="sim")
    buffer = Buffer()

    def robot_is_known() -> bool:
        live.send_transform(at(7.0))
        return x_of(buffer) == 7.0

    with TransformListener(buffer, bus.node("listener")):
        eventually(robot_is_known)
        play = ("bag", "play", str(run_mcap), "--rate", "50", *delay)
        done = bus.run(*play)
        assert done.returncode == 1 and "Played" not in done.stderr
        [line] = [line for line in done.stderr.splitlines() if line.startswith("Error: ")]
        assert "'sim'" in line and "--prefix recorded" in line and "--force" in line
        assert x_of(buffer) == 7.0
        assert bus.run(*play, "--prefix", "old").returncode == 0
        done = bus.run(*play, "--force")
        assert done.returncode == 0 and "taken over: 'sim'" in done.stderr


def test_quiet_it_shows_no_progress(bus: Bus, run_mcap: Path) -> None:
    """With --quiet only its first line is there."""
    done = bus.run("bag", "play", str(run_mcap), "-r", "50", "-q", "--topics", "turtle1/pose")
    assert done.returncode == 0
    assert [line for line in done.stderr.splitlines() if "Play" in line] == done.stderr.splitlines()
    assert "Played" not in done.stderr


def test_in_a_terminal_it_has_a_bar(bus: Bus, run_mcap: Path) -> None:
    """One line with state, time, bar and rate, written again and again."""
    shown = bus.run_in_terminal("bag", "play", str(run_mcap), "--loop", until="loop 2")
    assert re.search(r"playing\x1b\[0m +\d\.\d / 2\.0 s \[=*>? *\] 1x  loop 2", shown)


def test_a_terminal_that_goes_away_ends_it_as_ctrl_c_does(bus: Bus, run_mcap: Path) -> None:
    """So its streams are taken back, whose frames would be stale otherwise."""
    player = bus.start("bag", "play", str(run_mcap), "--loop")
    player.wait_for_line("Playing")
    assert player.stop(signal.SIGHUP) == 0


def test_without_a_file_it_says_how() -> None:
    """The first thing that goes wrong."""
    assert mistake().endswith(": tfbus bag play FILE")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-m", "turtle1/pose"], "'turtle1/pose' is not of the form --remap FROM:=TO"),
        (["-m", "turtle1/pose:=a b"], "'a b' cannot be the name of a topic or stream"),
        (["-m", "sim:=*"], "'*' cannot be the name of a topic or stream"),
        (["-m", "sim:=/"], "'' cannot be the name of a topic or stream"),
        (["--from", "9"], r"\(2\.0 s\): --from, .*, is after its end"),
        (["--start", "1.5", "--until", "0.5"], "--to, .*, is before --from"),
        (["--to", "2001-01-01"], "--to, .*, is before its beginning"),
        (["--clock", "--stamps", "now"], "--clock is the recorded time"),
        (["--rate", "0"], "at least 0.001"),
        (["--exclude", "("], "no regular expression"),
        (["--prefix", "a*b"], "cannot be the name of a namespace"),
    ],
)
def test_mistakes_are_one_sentence(run_mcap: Path, arguments: list[str], said: str) -> None:
    """Each says what is wrong, and what is there."""
    assert re.search(said, mistake(run_mcap, *arguments))


def test_options_of_ros2_bag_are_known() -> None:
    """Options that mean the same here have the same names."""
    names = {name for param in command.params for name in (*param.opts, *param.secondary_opts)}
    assert {
        "--rate",
        "-r",
        "--loop",
        "-l",
        "--start-offset",
        "--playback-duration",
        "--playback-until-sec",
        "--topics",
        "--regex",
        "-e",
        "--exclude-regex",
        "-x",
        "--exclude-topics",
        "--remap",
        "-m",
        "--clock",
        "--start-paused",
        "-p",
        "--delay",
        "-d",
        "--input",
        "-i",
        "--disable-keyboard-controls",
    } <= names


@pytest.mark.parametrize(
    ("arguments", "hz"),
    [(["--clock", "FILE"], 40.0), (["FILE", "--clock"], 40.0), (["--clock", "100", "FILE"], 100.0)],
)
def test_the_rate_of_the_clock_may_be_left_out(
    run_mcap: Path, arguments: list[str], hz: float
) -> None:
    """The file after it is not taken for a rate."""
    words = [str(run_mcap) if word == "FILE" else word for word in arguments]
    context: Any = command.make_context("play", words)
    assert isinstance(context, click.Context)
    assert context.params["clock_hz"] == hz
    assert context.params["files"] == (run_mcap,)


def test_keys_do_what_they_say(run_mcap: Path) -> None:
    """Pause, one message, seek, rate, end; other keys do nothing."""
    with RecordingReader(run_mcap) as reader:
        player = Player(reader)
        assert follow(" ", player)
        assert player.progress.is_paused
        assert follow("right", player)
        assert player.progress.played_s == 2.0
        assert follow("left", player)
        assert player.progress.played_s == 0.0
        assert follow("up", player)
        assert player.progress.rate == 1.1
        assert follow("down", player) and follow("down", player)
        assert player.progress.rate == 0.9091
        assert follow("x", player)
        assert not follow("q", player)


def progress(**given: Any) -> Progress:
    """At 15 s of a minute."""
    return Progress(**{"start_ns": 0, "end_ns": 60 * S, "log_ns": 15 * S, **given})


def test_the_bar_fits_its_line() -> None:
    """It is as long as there is room, and left out where there is little."""
    assert bar_text(progress(), 46) == "playing 15.0 / 60.0 s [====>              ] 1x"
    assert len(bar_text(progress(), 200)) < 100
    assert bar_text(progress(rate=2.5), 30) == "playing 15.0 / 60.0 s 2.5x"


def test_the_bar_says_what_is_special() -> None:
    """A pause, a loop, and a machine that is too slow."""
    text = bar_text(progress(is_paused=True, loops=2, late_ns=3 * S), 79)
    assert text.startswith("paused ") and text.endswith("1x  loop 2  3 s behind")


def test_log_and_end_are_sentences() -> None:
    """In a pipe the same is said in words."""
    assert log_text(progress(rate=2.0)) == "At 15.0 of 60.0 s, rate 2"
    assert log_text(progress(is_paused=True)) == "Paused at 15.0 of 60.0 s, rate 1"
    assert end_text(progress(sent=1), 2.0) == "Played 1 message in 2.0 s"
    assert "too slow for rate 1" in end_text(progress(late_ns=5 * S), 2.0)
