"""`tfbus bag info`: the contents of a recording, on one screen."""

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from tests.builders import S, at, in_recording
from tfbus.cli import main
from tfbus.messages import PointStamped, PoseStamped
from tfbus.recording.items import EventItem, Item, TopicItem, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.records import MAGIC
from tfbus.recording.writer import RecordingWriter
from tfbus.wire.codec import as_map

T0 = 1_700_000_000 * S


def items() -> list[Item]:
    """10 Hz with a gap of 2 s, a restart and a loss; a topic; a node that ends."""
    found: list[Item] = [
        EventItem(T0, "node", "/sim", {"host": "atlas"}),
        EventItem(T0, "stream", "sim", {"epoch": 1, "frames": [["world", "turtle1", False]]}),
        in_recording(T0, [at(1, "laser", T0)], static=True, seq=0),
    ]
    for i in range(100):
        now = T0 + i * S // 10 + (2 * S if i >= 50 else 0)
        sent = [at(i, "turtle1", now), at(i, "turtle10", now), at(i, "turtle2", now)]
        found.append(in_recording(now, sent, epoch_ns=1 if i < 70 else 2, seq=i))
        if i % 10 == 0:
            found.append(TopicItem(now, "turtle1/pose", "Pose\x1b[31m", {"x": 0.5}))
    found.append(EventItem(T0 + 12 * S, "dropped", "", {"messages": 3}))
    found.append(EventItem(T0 + 12 * S, "node gone", "/sim"))
    found.append(EventItem(T0 + 12 * S, "stream gone", "sim"))
    return found


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """The recording of these items."""
    with RecordingWriter(tmp_path / "run.mcap", about={"host": "atlas"}) as writer:
        for item in items():
            writer.write(item)
    return tmp_path / "run.mcap"


def info(*arguments: object) -> Result:
    """What the command prints."""
    words = [str(each) for each in arguments]
    return CliRunner().invoke(main, ["bag", "info", *words], env={"TZ": "UTC", "COLUMNS": "80"})


def row(text: str, name: str) -> list[str]:
    """The words of the row of a table that begins with a name."""
    return next(line.split() for line in text.splitlines() if line.startswith(name))


def test_the_screen(bag: Path) -> None:
    """Frames, rate, the longest gap and when it began, restarts, what was lost and who is gone."""
    shown = info(bag).output
    assert row(shown, "sim")[:7] == ["sim", "gone", "/sim", "3", "1", "100", "8.32"]
    assert row(shown, "sim")[7:] == ["2.1", "s", "at", "+4.9s", "1"]
    assert row(shown, "turtle1/pose")[2:5] == ["10", "0.818", "3.0"]
    assert "complete" in shown and "12.0 s" in shown and "on atlas" in shown
    assert "3 messages dropped while recording" in shown
    assert "/sim gone" in shown and "1 lost stream" in shown
    assert max(map(len, shown.splitlines()[1:])) <= 80


def test_a_fleet_is_in_natural_order_without_tools(tmp_path: Path) -> None:
    """robot2 is before robot10; nodes of tools, which only looked, are there with -v."""
    with RecordingWriter(tmp_path / "run.mcap") as writer:
        for name in ("robot10", "robot2"):
            writer.write(EventItem(T0, "node", f"/{name}/sim", {}))
            writer.write(EventItem(T0, "stream", f"{name}/sim", {"epoch": 1, "frames": []}))
            writer.write(TopicItem(T0, f"{name}/pose", "Pose", {"x": 0.5}))
        writer.write(EventItem(T0, "node", "/_fleet_1", {}))
    shown = info(tmp_path / "run.mcap").output
    assert re.findall(r"^(robot\S+)", shown, re.M)[-2:] == ["robot2/pose", "robot10/pose"]
    assert "/robot2/sim, /robot10/sim\n" in shown
    assert "/_fleet_1" in info("-v", tmp_path / "run.mcap").output


def test_a_gap_that_was_filled_says_from_when_to_when(tmp_path: Path) -> None:
    """An incident may have begun while a robot was out of reach."""
    with RecordingWriter(tmp_path / "run.mcap") as writer:
        for item in items():
            writer.write(item)
        facts = {"until": T0 + 4 * S, "messages": 504, "lost": []}
        writer.write(EventItem(T0 + S, "filled", "/robot7/recorder", facts))
    shown = info("-v", tmp_path / "run.mcap").output
    assert re.search(r"\+1\.000s  filled .*\(to \+4\.000s, 504 messages\)", shown)
    assert "1 filled gap" in shown


def test_types_have_the_names_of_ros(tmp_path: Path) -> None:
    """All of a list, as `ros2 bag info` has them; JSON has those on the bus too."""
    path = tmp_path / "types.mcap"
    sent = {
        "goal": ("PoseStamped", as_map(PoseStamped(1, "map"))),
        "click": ("geometry_msgs/msg/PointStamped", as_map(PointStamped(1, "map"))),
        "battery": ("Battery", {"percent": 74.5}),
        "unknown": ("", {"x": 1}),
    }
    with RecordingWriter(path) as writer:
        for topic, (name, values) in sent.items():
            writer.write(TopicItem(T0, topic, name, values))
    shown = info(path).output
    for topic, name in (
        ("goal", "geometry_msgs/msg/PoseStamped"),
        ("click", "geometry_msgs/msg/PointStamped"),
        ("battery", "tfbus_msgs/msg/Battery"),
        ("unknown", "?"),
    ):
        assert row(shown, topic)[1] == name
    told = json.loads(info("--json", path).output)["topics"]
    assert {each["name"]: each["type_name"] for each in told}["goal"] == "PoseStamped"


def test_nothing_that_a_terminal_obeys_is_printed(bag: Path) -> None:
    """Names of strangers are escaped."""
    for arguments in ((bag,), ("-v", bag), ("--json", bag)):
        assert "\x1b" not in info(*arguments).output


def test_all_of_it(bag: Path) -> None:
    """With -v the frames, in order of their numbers, and the events."""
    shown = info("-v", bag).output
    assert "  turtle1  turtle2  turtle10\n" in shown
    assert row(shown, "      +12.000s")[:3] == ["+12.000s", "dropped", "(3"]


def test_json(bag: Path) -> None:
    """Numbers for programs: times in nanoseconds."""
    told = json.loads(info("--json", bag).output)
    assert (told["start_ns"], told["end_ns"], told["is_complete"]) == (T0, T0 + 12 * S, True)
    [stream] = told["streams"]
    assert (stream["name"], stream["restarts"], stream["transforms"]) == ("sim", 1, 300)
    assert stream["flow"]["longest_gap_s"] == pytest.approx(2.1)
    assert told["topics"][0]["flow"]["messages"] == 10


def test_a_gap_is_judged_by_the_median_period(tmp_path: Path) -> None:
    """Many gaps in a stream of 10 Hz make its rate 2 Hz: still each is one, as to the monitor."""
    path = tmp_path / "bursts.mcap"
    with RecordingWriter(path) as writer:
        for i in range(60):
            now = T0 + i * S // 10 + i // 5 * 2 * S
            writer.write(in_recording(now, [at(i, "arm", now)], seq=i))
    [stream] = json.loads(info("--json", path).output)["streams"]
    assert 2.0 * 5.0 / stream["flow"]["rate"] > stream["flow"]["longest_gap_s"]
    assert stream["flow"]["period_s"] == pytest.approx(0.1)
    assert "2.1 s at +0.4s" in info(path).output
    measured = CliRunner().invoke(main, ["monitor", "--bag", str(path)]).output
    assert "2.1 s at +0.4s" in measured


def test_a_file_cut_short(bag: Path) -> None:
    """It is said, and what is there is shown."""
    data = bag.read_bytes()
    bag.write_bytes(data[: len(data) - 60])
    done = info(bag)
    assert done.exit_code == 0 and "cut short" in done.output and "turtle1/pose" in done.output


def test_a_file_that_is_being_written(tmp_path: Path) -> None:
    """It is not said to be cut short, before and after its first message; once it is closed, it is
    complete.
    """
    path = tmp_path / "growing.mcap"
    with RecordingWriter(path) as writer:
        writer.flush()
        done = info(path)
        assert done.exit_code == 1 and "is being written: no message" in done.output
        writer.write(TopicItem(T0, "turtle1/pose", "Pose", {"x": 0.5}))
        writer.flush()
        done = info(path)
        assert "being written" in done.output and "cut short" not in done.output
        doctor = CliRunner().invoke(main, ["doctor", "--bag", str(path)]).output
        assert "cut short" not in doctor
    assert "complete" in info(path).output


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"text", "is not a recording: it does not begin as MCAP files do"),
        (b"", "is not a recording: it is an empty file, of 0 bytes"),
        (MAGIC + bytes(300), "is cut short before its first message: nothing is in it"),
    ],
)
def test_another_file(tmp_path: Path, content: bytes, said: str) -> None:
    """It is one sentence, and the exit code 1."""
    (tmp_path / "x.txt").write_bytes(content)
    done = info(tmp_path / "x.txt")
    assert done.exit_code == 1 and said in done.output
    assert len(done.output.splitlines()) == 1


def test_a_damaged_file(bag: Path) -> None:
    """It is said what cannot be read; without reading all it is not known."""
    with RecordingReader(bag) as reader:
        chunk = reader.chunks[0].chunk
    data = bytearray(bag.read_bytes())
    data[chunk.offset + chunk.length - 3] ^= 255
    bag.write_bytes(data)
    done = info(bag)
    assert done.exit_code == 0
    assert "damaged" in done.output and "Damaged:" in done.output and "from +0.00s" in done.output
    unchecked = info("--no-check", bag)
    assert "not checked for damage" in unchecked.output and "Damaged:" not in unchecked.output
    told = json.loads(info("--json", bag).stdout)
    assert told["is_complete"] is False
    [file] = told["files"]
    assert [each["offset"] for each in file["damage"]] == [chunk.offset]


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    """It is a usage error."""
    assert info(tmp_path / "x.mcap").exit_code == 2


def test_the_name_that_a_recording_was_given_without_its_ending_gets_a_hint(tmp_path: Path) -> None:
    """`tfbus bag record -o run` writes run.mcap."""
    (tmp_path / "run.mcap").touch()
    for verb in ("info", "play", "cut", "export"):
        done = CliRunner().invoke(main, ["bag", verb, str(tmp_path / "run")])
        assert done.exit_code == 2
        assert f"did you mean '{tmp_path / 'run.mcap'}'?" in done.output


def test_a_folder_with_a_file_cut_short_in_the_middle(tmp_path: Path) -> None:
    """It is said which file ends where, not where the recording does; `bag recover` takes the
    folder, and makes one file of what is there.
    """
    day = tmp_path / "day"
    day.mkdir()
    for number in range(3):
        with RecordingWriter(day / f"run_{number}.mcap") as writer:
            # What is in force is repeated at the beginning of each file.
            begin = T0 + 10 * number * S
            writer.write(in_recording(begin, [at(1, "laser", T0)], static=True, seq=0))
            for i in range(100):
                now = begin + i * S // 10
                writer.write(in_recording(now, [at(i, "arm", now)], seq=100 * number + i))
                if i == 49:
                    writer.flush()
    middle = day / "run_1.mcap"
    with RecordingReader(middle) as reader:
        second = reader.chunks[1].offset
    middle.write_bytes(middle.read_bytes()[: second + 30])
    done = info(day)
    assert done.exit_code == 0
    said = " ".join(done.stderr.split())
    assert f"{middle} is cut short" in said and "2023-11-14 22:13:34.900" in said
    assert "2 of 3 files" in said and "tfbus bag recover" in said
    assert row(done.output, "End:")[2].startswith("22:13:49.900")
    whole = tmp_path / "day.mcap"
    done = CliRunner().invoke(main, ["bag", "recover", str(day), "-o", str(whole)])
    assert done.exit_code == 0 and f"Lost of {middle}: " in done.output
    with RecordingReader(day) as reader, RecordingReader(whole) as recovered:
        assert recovered.is_complete
        found, expected = (
            [(item.log_ns, item.seq) for item in each.items() if isinstance(item, TransformItem)]
            for each in (recovered, reader)
        )
        assert found == expected and len(found) == 251
