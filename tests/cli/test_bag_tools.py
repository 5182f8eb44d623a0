"""The tools that look into a recording: their output, and that they open no bus."""

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from tests.needs import module
from tests.recordings import at, described, gone, publisher, sent, statics, steadily, write
from tfbus.cli import main
from tfbus.recording.items import TopicItem

SIM, ARM = publisher("sim"), publisher("arm")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """20 s: base with a pause from 10 to 12 s, laser fixed to it, arm gone at 8 s, and a topic."""
    return write(
        tmp_path / "run.mcap",
        described(SIM, 0.0, ("world", "base", False), ("base", "laser", True)),
        statics(SIM, 0.001, ("base", "laser", 0.2)),
        steadily(SIM, 0.0, 20.0, ("world", "base"), pause=(10.0, 12.0)),
        described(ARM, 0.0, ("base", "arm", False)),
        steadily(ARM, 0.0, 8.0, ("base", "arm")),
        gone(ARM, 8.0),
        [TopicItem(at(each), "turtle1/pose", "Point", {"x": float(each)}) for each in range(20)],
    )


def run(*args: object) -> Result:
    return CliRunner().invoke(main, [str(arg) for arg in args])


def test_frames_shows_the_tree_of_a_moment(path: Path) -> None:
    """Its first line says which moment it is; a frame is gone only from then on."""
    now, later = (run("frames", "--bag", path, "--at", each) for each in ("+5s", "-0s"))
    assert (now.exit_code, later.exit_code) == (0, 0)
    assert "5.0 s into run.mcap" in now.output.splitlines()[0]
    assert "GONE" not in now.output
    assert "arm    GONE" in later.output


def test_frames_writes_pictures_and_checks(path: Path, tmp_path: Path) -> None:
    """All formats as of a bus; --check is of the moment."""
    tree = tmp_path / "tree.json"
    assert run("frames", "--bag", path, "-o", tree).exit_code == 0
    frames = {each["name"]: each for each in json.loads(tree.read_text())["frames"]}
    assert frames["arm"]["gone"] and frames["laser"]["static"]
    assert run("frames", "--bag", path, "--check", "--at", "+5s").exit_code == 0
    assert run("frames", "--bag", path, "--check").exit_code == 1


def test_why_explains_the_latest_lookup_of_a_moment(path: Path) -> None:
    """Edge by edge, with the ages of then."""
    fine = run("why", "world", "laser", "--bag", path, "--at", "+5s")
    assert fine.exit_code == 0
    assert "there is an answer" in fine.output and "warn" not in fine.output
    stale = run("why", "world", "laser", "--bag", path, "--at", "+11.9s")
    assert "STALE, 2.0 s old" in stale.output
    assert "'base' comes again at +12.005s" in stale.output
    unknown = run("why", "world", "lasr", "--bag", path)
    assert unknown.exit_code == 1 and "did you mean 'laser'" in unknown.output


def test_why_and_echo_say_that_the_publisher_was_gone(path: Path) -> None:
    """At a moment after its end there is no pose, and both say since when, with exit code 1."""
    for tool in ("why", "echo"):
        done = run(tool, "world", "arm", "--bag", path, "--at", "+15s")
        text = " ".join(done.output.split())
        assert done.exit_code == 1
        assert "/arm was gone from +8.0 s" in text and "an earlier --at" in text
    assert "there is an answer" in run("why", "world", "arm", "--bag", path, "--at", "+5s").output


def test_a_static_pair_is_exported_at_a_rate(path: Path, tmp_path: Path) -> None:
    """It has no samples of its own: without a rate the error says which options give some."""
    out = tmp_path / "laser.tum"
    bare = run("bag", "export", path, "base", "laser", "-o", out)
    assert bare.exit_code == 2 and "--rate" in bare.output and "--samples-of" in bare.output
    done = run("bag", "export", path, "base", "laser", "-o", out, "--rate", "10")
    assert done.exit_code == 0, done.output
    assert len(out.read_text().splitlines()) == 201  # with its header


@pytest.mark.parametrize("name", ["drive.db3", "drive.bag", "folder"])
@pytest.mark.parametrize(
    "tool",
    [
        ("bag", "info"),
        ("bag", "play"),
        ("echo", "world", "arm", "--bag"),
        ("bag", "export", "-o", "out.csv"),
    ],
)
def test_recordings_of_ros_are_to_be_imported(
    tmp_path: Path, name: str, tool: tuple[str, ...]
) -> None:
    """A file, or a folder as rosbag2 makes it: the error has the command."""
    given = tmp_path / name
    file = given / "drive_0.db3" if name == "folder" else given
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(b"SQLite format 3\0" * 10)
    done = run(*tool, given)
    assert done.exit_code == 1
    assert f"tfbus bag import {given} -o" in " ".join(done.output.split())


@pytest.mark.parametrize("command", ["bag export", "plot", "echo"])
def test_a_span_of_a_century_at_a_rate_is_refused(tmp_path: Path, command: str) -> None:
    """One wrong stamp makes it so long: the sentence says how many poses it has."""
    far = sent(SIM, 50.0, ("world", "base", 1.0), stamp_ns=(2**31 - 1) * 10**9)
    path = write(tmp_path / "far.mcap", steadily(SIM, 0.0, 5.0, ("world", "base")), far)
    name, *more = command.split()
    output = {"echo": (), "plot": ("-o", tmp_path / "out.svg")}.get(
        name, ("-o", tmp_path / "a.csv")
    )
    words = (*more, path) if more else ("--bag", path)
    done = run(name, *words, "world", "base", "--rate", 100, *output)
    assert done.exit_code == 1
    assert "35,748," in done.output and "give a lower --rate" in done.output


@pytest.mark.parametrize(
    "option",
    ["--wait-for-all-acked", "--read-ahead-queue-size", "--message-order", "--services", "--burst"],
)
def test_options_of_ros_that_play_has_not_are_answered(path: Path, option: str) -> None:
    """With what to do, or why it is not needed."""
    done = run("bag", "play", path, option)
    assert done.exit_code == 2 and f"there is no option {option}: " in done.output


def test_no_recording_is_written_in_another_format(tmp_path: Path) -> None:
    """A name of a file of rosbag2 is answered, as is another serialization."""
    done = run("bag", "record", "-f", "cdr", "-s", "mcap", "-o", tmp_path / "x.db3")
    assert done.exit_code == 2 and "that ends with .mcap" in " ".join(done.output.split())
    assert run("bag", "record", "-f", "json", "-o", tmp_path / "x").exit_code == 2


def test_echo_prints_a_block_for_each_sample(path: Path) -> None:
    """In all formats and styles; with --at one."""
    csv = run("echo", "world", "laser", "--bag", path, "--format", "csv").output.splitlines()
    assert len(csv) == 1 + 180
    rows = run("echo", "world", "arm", "--bag", path, "--format", "json").output.splitlines()
    assert json.loads(rows[-1])["stamp_ns"] == at(7.9)
    one = run("echo", "world", "laser", "--bag", path, "--at", "+5s", "--style", "line")
    assert one.output.count("\n") == 1 and "xyz [5.200" in one.output
    some = run("echo", "world", "base", "--bag", path, "--from", "+15s", "--count", 3)
    assert some.output.count("At time") == 3


def test_monitor_prints_the_rates_and_the_longest_gap(path: Path) -> None:
    """In 80 columns, and as JSON."""
    lines = run("monitor", "--bag", path).output.splitlines()
    (base,) = [line for line in lines if line.startswith("base ")]
    cells = "base sim 10.0 0.0 ms 5.0 ms 5.0 ms 2.1 s at +9.9s"
    assert " ".join(base.split()) == cells
    assert max(map(len, lines)) <= 80
    report = json.loads(run("monitor", "world", "laser", "--bag", path, "--json").output)
    assert report["pair"]["chain"] == ["world", "base", "laser"]
    assert [edge["child"] for edge in report["edges"]] == ["base", "laser"]
    assert report["statics"] == ["laser"]


@pytest.mark.parametrize("span", [(), ("--to", "+5s")])
def test_a_command_that_monitor_names_can_be_copied(path: Path, span: tuple[str, ...]) -> None:
    """It looks into the same recording, at the end of the same span."""
    named = path.rename(path.with_name("a run.mcap"))
    done = run("monitor", "world", "lasr", "--bag", named, *span)
    assert done.exit_code == 1
    command = shlex.split(done.output.rstrip(")\n").rpartition("(see: ")[2])
    assert command[:2] == ["tfbus", "why"]
    copied = run(*command[1:])
    assert "no frame 'lasr'" in copied.output
    assert f"{'5.0' if span else '19.9'} s into a run.mcap" in copied.output.splitlines()[0]


def test_doctor_checks_a_recording(path: Path) -> None:
    """By the same table; checks of this host and bus are skipped, and named in one line."""
    found = json.loads(run("doctor", "--bag", path, "--json").output)
    assert found["gaps"]["verdict"] == found["gone"]["verdict"] == "warn"
    assert found["scouting"]["verdict"] == "skipped"
    lines = run("doctor", "--bag", path).output.splitlines()
    assert not [line for line in lines if line.startswith("skipped scouting")]
    assert "scouting" in " ".join(lines[-4:])
    other = run("doctor", "--bag", path, "--only", "unread")
    assert other.exit_code == 0 and "live bus" in other.output
    listed = run("doctor", "--bag", path, "--list").output
    assert "clock-jumps" in listed and "routers" not in listed


@pytest.mark.parametrize(
    ("library", "extra", "arguments"),
    [
        ("zstandard", "bag", ("bag", "info", "RUN")),
        ("zstandard", "bag", ("frames", "--bag", "RUN")),
        ("mcap", "bag", ("bag", "cut", "RUN", "--to", "1", "-o", "NEW")),
        ("mcap", "bag", ("bag", "record", "-o", "NEW")),
        ("matplotlib", "plot", ("plot", "world", "base", "--bag", "RUN", "-o", "plot.png")),
        ("textual", "top", ("top",)),
        ("cryptography", "secure", ("keys", "init", "KEYS")),
    ],
)
def test_a_missing_library_is_answered_with_its_extra(
    path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    library: str,
    extra: str,
    arguments: tuple[str, ...],
) -> None:
    """With the command that installs it, as it is typed."""
    for name in [library, *(each for each in sys.modules if each.startswith(f"{library}."))]:
        monkeypatch.setitem(sys.modules, name, None)
    # Another test may have imported the module that needs it.
    for name in [each for each in sys.modules if each.startswith("tfbus.top.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr("tfbus.cli.keys.find_spec", lambda name: None)
    monkeypatch.chdir(tmp_path)
    places = {"RUN": str(path), "NEW": "new.mcap"}
    done = run(*(places.get(each, each) for each in arguments))
    assert done.exit_code == 1
    assert f"pip install 'tfbus[{extra}]'" in done.output


def test_plot_draws_a_span(path: Path, tmp_path: Path) -> None:
    """--from and --to are moments of the recording."""
    module("matplotlib")
    picture = tmp_path / "path.svg"
    span = ("--from", "+1s", "--to", "+3s")
    done = run("plot", "world", "base", "--bag", path, *span, "-o", picture)
    assert done.exit_code == 0 and "20 poses over 1.9 s" in done.output
    assert picture.read_text().startswith("<?xml")


def test_topics_are_listed_printed_and_measured(path: Path) -> None:
    """`topic list`, `info`, `echo` and `hz`, of transforms too."""
    assert run("topic", "list", "--bag", path).output.split() == [
        "tf/arm",
        "tf/sim",
        "tf_static/sim",
        "turtle1/pose",
    ]
    assert "Messages: 20" in run("topic", "info", "turtle1/pose", "--bag", path).output
    some = run("topic", "echo", "turtle1/pose", "--bag", path, "--csv", "--from", "+17.5s")
    assert some.output.split() == ["18.0", "19.0"]
    whole = run("topic", "echo", "tf/arm", "--bag", path, "--json", "--once").output
    assert json.loads(whole)["transforms"][0]["child_frame_id"] == "arm"
    assert "average rate: 1.000" in run("topic", "hz", "turtle1/pose", "--bag", path).output
    unknown = run("topic", "echo", "turtle1/pos", "--bag", path)
    assert "mean 'turtle1/pose'" in unknown.output


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (("frames", "--at", "+99s"), "outside of the recording"),
        (("frames", "--watch"), "--watch shows a bus"),
        (("echo", "world", "base", "--timeout", "3"), "--timeout waits for a bus"),
        (("echo", "world", "base", "--at", "+1s", "--to", "+2s"), "--at is one moment"),
        (("plot", "world", "base", "-o", "a.svg", "--for", "3"), "--for listens to a bus"),
        (("topic", "echo", "turtle1/pose", "--raw"), "of a bus"),
        (("topic", "hz", "turtle1/pose", "--window", "2"), "--window and --timeout are of a bus"),
        (("topic", "bw", "turtle1/pose", "--timeout", "3"), "--window and --timeout are of a bus"),
    ],
)
def test_what_a_recording_has_not_is_a_usage_error(
    path: Path, args: tuple[str, ...], text: str
) -> None:
    """It says what to do instead, and exits with 2."""
    done = run(*args, "--bag", path)
    assert done.exit_code == 2
    assert text in " ".join(done.output.split())


# The output of each command, and what all of them have imported.
READS = """
import sys
from click.testing import CliRunner
from tfbus.cli import main
for line in sys.argv[2:]:
    done = CliRunner().invoke(main, [*line.split(), "--bag", sys.argv[1]])
    assert done.stdout, (line, done.stderr)
print(*sys.modules, sep="\\n")
"""


@pytest.mark.real
def test_no_bus_is_opened(path: Path) -> None:
    """A tool that looks into a recording does not even import Zenoh."""
    lines = [
        "frames",
        "why world laser",
        "echo world laser --at +5s",
        "monitor",
        "doctor",
        "topic echo turtle1/pose --once",
    ]
    command = [sys.executable, "-c", READS, str(path), *lines]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    imported = set(done.stdout.splitlines())
    assert "tfbus.recording.reader" in imported
    assert not imported & {"zenoh", "tfbus.node.node", "tfbus.bus.session"}
