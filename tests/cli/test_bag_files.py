"""`tfbus bag` cut, merge, filter, recover, import and export: recordings into files."""

import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner, Result

from tests.builders import at
from tests.recording.foreign_files import RawTransform, Sent, write_bag
from tests.recordings import at as log_at
from tests.recordings import publisher, sent, write
from tfbus import Buffer, Trajectory
from tfbus.base.errors import TfbusError
from tfbus.buffer import trajectories
from tfbus.cli import main
from tfbus.cli.bag import VERBS
from tfbus.cli.bag import command as group
from tfbus.cli.bag.files import write_recording
from tfbus.geometry.columns import Columns
from tfbus.recording.items import Item, RecordedStream, TopicItem, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter

S = 1_000_000_000
START_NS = 1_700_000_000 * S
SIM = RecordedStream("sim", "/sim", epoch_ns=5)


def items() -> Iterator[Item]:
    """Ten seconds of a robot, and a topic."""
    laser = Columns.of_transforms([at(1, "laser", START_NS, parent="base")])
    yield TransformItem(START_NS, SIM, laser, static=True)
    for tick in range(100):
        now = START_NS + tick * S // 10
        yield TransformItem(now, SIM, Columns.of_transforms([at(tick, "base", now)]), seq=tick)
        yield TopicItem(now + 1, "pose", "Pose", {"p": {"x": float(tick)}, "names": ["a"]})


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """The recording, in a folder that is the current one."""
    os.chdir(tmp_path)
    path = Path("drive.mcap")
    with RecordingWriter(path) as writer:
        for item in items():
            writer.write(item)
    return path


@pytest.fixture(autouse=True)
def _same_folder() -> Iterator[None]:
    before = Path.cwd()
    yield
    os.chdir(before)


def run(*arguments: object) -> Result:
    """`tfbus bag` with these arguments."""
    return CliRunner().invoke(main, ["bag", *map(str, arguments)], prog_name="tfbus")


def wrote(*arguments: object) -> str:
    """What a run says that must succeed."""
    done = run(*arguments)
    assert done.exit_code == 0, done.output
    return done.output


def test_a_part_is_cut(drive: Path) -> None:
    """One line says what was written."""
    said = wrote("cut", drive, "--from", "+2s", "--to", "-5s", "-o", "part.mcap")
    assert said.startswith("Wrote part.mcap: ")
    assert "2.9 s, 30 dynamic" in said and said.endswith(" 30 messages of 1 topic\n")
    with RecordingReader("part.mcap") as reader:
        assert reader.start_ns == START_NS + 2 * S


def test_several_parts_are_cut(drive: Path) -> None:
    """Each with its static transforms."""
    wrote("cut", drive, "--range", "+1s", "+2s", "--range", "-1s", "-0s", "-o", "parts.mcap")
    with RecordingReader("parts.mcap") as reader:
        assert [event.kind for event in reader.events] == ["paused", "resumed"]


def test_parts_are_merged(drive: Path) -> None:
    """The whole is there again."""
    wrote("cut", drive, "--to", "+5s", "-o", "a.mcap")
    wrote("cut", drive, "--from", "+4s", "-o", "b.mcap")
    said = wrote("merge", "b.mcap", "a.mcap", "-o", "whole.mcap")
    assert "9.9 s, 100 dynamic" in said and said.endswith(" 100 messages of 1 topic\n")


def test_a_recording_is_filtered(drive: Path) -> None:
    """By frames, by names to drop; a name that is not there is said."""
    assert wrote("filter", drive, "--frames", "laser", "-o", "a.mcap").endswith(
        "1 static transform of 1 stream\n"
    )
    assert wrote("filter", drive, "--topics", "tf_static", "-o", "s.mcap").endswith(
        "1 static transform of 1 stream\n"
    )
    assert "1 topic" not in wrote("filter", drive, "--drop", "pose,laser", "-o", "b.mcap")
    dynamic = wrote("filter", drive, "--topics", "tf", "pose", "-o", "d.mcap")
    assert "100 dynamic transforms" in dynamic and "100 messages" in dynamic
    assert "static" not in dynamic
    for wrong_name in ("--frames", "--drop"):
        wrong = run("filter", drive, wrong_name, "bse", "-o", "c.mcap")
        assert wrong.exit_code == 1
        assert "did you mean 'base'" in " ".join(wrong.output.split())
    wrong = run("filter", drive, "--topics", "/pos", "-o", "c.mcap")
    assert wrong.exit_code == 1
    assert "no topic 'pos'" in wrong.output and "mean 'pose'" in wrong.output
    assert run("filter", drive, "-o", "c.mcap").exit_code == 2


def test_a_recording_gets_a_namespace(drive: Path) -> None:
    """As one robot of a fleet."""
    wrote("filter", drive, "--namespace", "/robot1", "-o", "r1.mcap")
    with RecordingReader("r1.mcap") as reader:
        assert [each.stream.name for each in reader.streams] == ["robot1/sim"]
        assert [each.name for each in reader.topics] == ["robot1/pose"]


def test_a_damaged_recording_is_recovered(drive: Path) -> None:
    """What is lost is said; a whole one loses nothing."""
    assert "drive.mcap was whole" in wrote("recover", drive, "-o", "a.mcap")
    data = drive.read_bytes()
    drive.write_bytes(data[: len(data) - 700])
    assert "the end, its index" in wrote("recover", drive, "-o", "b.mcap")
    drive.write_bytes(b"nothing")
    done = run("recover", drive, "-o", "c.mcap")
    assert done.exit_code == 1 and done.output.startswith("Error: drive.mcap holds no recording")
    assert not Path("c.mcap").exists()


def test_a_bag_is_imported(tmp_path: Path) -> None:
    """A file that is none is refused in one sentence."""
    os.chdir(tmp_path)
    pose = RawTransform(START_NS, "/map", "/base", (1, 2, 3, 0, 0, 0, 1))
    write_bag(Path("r.bag"), [Sent(START_NS, [pose], publisher="/slam")])
    assert wrote("import", "r.bag", "-o", "r.mcap").endswith("1 dynamic transform of 1 stream\n")
    Path("r.bag").write_bytes(b"nothing")
    done = run("import", "r.bag", "-o", "other.mcap")
    assert done.exit_code == 1
    assert done.output.startswith("Error: r.bag ")
    assert done.output.count("\n") == 1


def json_file(path: Path, *values: int) -> None:
    """A file of another writer, with a message in JSON of each value."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("", "x")
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channel = writer.register_channel("/t", "json", schema)
        for value in values:
            writer.add_message(channel, START_NS, json.dumps({"a": value}).encode(), START_NS)
        writer.finish()  # mcap leaves it untyped


def test_a_message_that_no_recording_holds_is_left_out(tmp_path: Path) -> None:
    """The others are imported, and it is said; where none is left there is no file."""
    os.chdir(tmp_path)
    json_file(Path("j.mcap"), 1, 2**70, 3)
    said = wrote("import", "j.mcap", "-o", "r.mcap")
    assert "left out 1 message of t: " in said and "type 'any'" in said
    assert said.endswith("2 messages of 1 topic\n")
    json_file(Path("k.mcap"), 2**70)
    done = run("import", "k.mcap", "-o", "s.mcap")
    assert done.exit_code == 1 and not Path("s.mcap").exists()
    assert "nothing was imported" in done.output


def test_poses_are_exported(drive: Path) -> None:
    """At the samples of the source, at a rate, in a part; what is read is what was sent."""
    assert "100 poses of 'base'" in wrote("export", drive, "world", "base", "-o", "a.csv")
    assert Trajectory.read_csv("a.csv").xyz[:, 0].tolist() == list(range(100))
    wrote("export", drive, "world", "laser", "--rate", "20", "-o", "a.tum")
    laser = Trajectory.read_tum("a.tum", "world", "laser")
    assert laser.xyz[:, 0] == pytest.approx(np.arange(199) / 2 + 1)
    wrote("export", drive, "world", "base", "--from", "+2s", "--to", "+3s", "-o", "a.kitti")
    assert len(Path("a.kitti").read_text().splitlines()) == 11


def test_a_span_without_the_frame_is_refused_by_its_name(tmp_path: Path) -> None:
    """Though other frames came in it."""
    os.chdir(tmp_path)
    sim = publisher("sim")
    early = [sent(sim, s / 10, ("world", "base", 1.0), stamp_ns=log_at(s / 10)) for s in range(10)]
    all_along = [sent(sim, s, ("world", "arm", 1.0), stamp_ns=log_at(s)) for s in range(1, 20)]
    path = write(tmp_path / "run.mcap", [*early, *all_along])
    refused = run("export", path, "world", "base", "--from", "+10s", "-o", "base.csv")
    assert refused.exit_code == 1 and not Path("base.csv").exists()
    assert "no pose in 'world'" in " ".join(refused.output.split())


def test_all_transforms_are_exported(drive: Path) -> None:
    """As rows that a buffer reads, and as arrays."""
    assert "101 transforms" in wrote("export", drive, "-o", "all.csv")
    buffer = Buffer(cache_time_s=1e6)
    trajectories.insert_csv(buffer, "all.csv")
    assert buffer.lookup_transform("world", "base", START_NS + S).transform.xyz[0] == 10
    wrote("export", drive, "-o", "all.npz")
    with np.load("all.npz") as data:
        frames, child = data["frames"], data["child"]
        assert frames[child].tolist() == ["laser"] + ["base"] * 100
        assert data["static"].tolist() == [True] + [False] * 100
        assert data["log_ns"][2] == START_NS + S // 10
        assert data["xyz"].shape == (101, 3)


def test_one_transform_is_called_one(tmp_path: Path) -> None:
    """The line that says what was written counts in English."""
    path = write(tmp_path / "one.mcap", [next(items())])
    assert wrote("export", path, "-o", tmp_path / "one.csv").endswith(", 1 transform\n")


def test_each_field_of_a_topic_has_a_column_of_its_own(tmp_path: Path) -> None:
    """A field called log_ns beside the log time, and fields of a nested map that has bytes for
    names.
    """
    values: dict[str, Any] = {"log_ns": 5, "map": {b"\xff": 1.5, 3: math.nan}, "list": [math.nan]}
    path = write(tmp_path / "run.mcap", TopicItem(7, "odd", "", values))
    wrote("export", path, "--topic", "odd", "-o", tmp_path / "odd.csv")
    header, row = (tmp_path / "odd.csv").read_text().splitlines()
    assert header == "log_ns,log_ns_2,map.ff,map.3,list"
    assert row == "7,5,1.5,nan,[null]"


def test_a_topic_is_exported(drive: Path) -> None:
    """A column for each field."""
    assert "100 messages" in wrote("export", drive, "--topic", "/pose", "-o", "pose.csv")
    lines = Path("pose.csv").read_text().splitlines()
    assert lines[:2] == ["log_ns,p.x,names", f'{START_NS + 1},0.0,"[""a""]"']


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("-o", "a.txt"), "the format is not clear"),
        (("world", "-o", "a.csv"), "name two frames"),
        (("-o", "a.tum"), "tum has the poses of one frame: name TARGET and SOURCE"),
        (("world", "base", "-o", "a.npz"), "npz has all transforms"),
        (("--rate", "5", "-o", "a.csv"), "--rate and --samples-of are for a pair of frames"),
        (("--from", "5000", "-o", "a.csv"), "--from: 5000s is outside of the recording"),
    ],
)
def test_a_mistake_is_named(drive: Path, arguments: tuple[str, ...], said: str) -> None:
    """As a usage error, and no file is written."""
    done = run("export", drive, *arguments)
    assert done.exit_code == 2
    assert said in " ".join(done.output.split())
    assert sorted(os.listdir()) == ["drive.mcap"]


def test_a_file_is_replaced_only_if_told(drive: Path) -> None:
    """And then whole."""
    part = Path("part.mcap")
    part.write_bytes(b"former")
    refused = run("cut", drive, "--to", "+1s", "-o", part)
    assert refused.exit_code == 2
    assert "part.mcap exists" in refused.output
    assert part.read_bytes() == b"former"
    wrote("cut", drive, "--to", "+1s", "-o", part, "--force")
    with RecordingReader(part) as reader:
        assert reader.end_ns == START_NS + S


@pytest.mark.parametrize(
    "arguments",
    [("cut", "--to", "+1s"), ("merge",), ("filter", "--drop", "pose"), ("recover",), ("export",)],
)
def test_the_recording_that_is_read_is_never_replaced(
    drive: Path, arguments: tuple[str, ...]
) -> None:
    """Not even by another name of it."""
    before = drive.read_bytes()
    Path("same.csv" if arguments == ("export",) else "same.mcap").symlink_to(drive)
    same = "same.csv" if arguments == ("export",) else "same.mcap"
    refused = run(*arguments, drive, "-o", same, "--force")
    assert refused.exit_code == 2, refused.output
    assert f"{same} is the recording" in refused.output
    assert drive.read_bytes() == before


def test_a_recording_that_is_given_twice_counts_once(drive: Path) -> None:
    """Also as a copy."""
    Path("copy.mcap").write_bytes(drive.read_bytes())
    said = wrote("merge", drive, "copy.mcap", drive, "-o", "a.mcap")
    assert "same as drive.mcap" in said
    assert "9.9 s, 100 dynamic" in said and said.endswith(" 100 messages of 1 topic\n")


def test_what_the_recorder_said_of_itself_stays(drive: Path) -> None:
    """And what was done, and lost, is added."""
    drive.unlink()
    about = {"host": "robot7", "version": "0.1"}
    with RecordingWriter(drive, about=about) as writer:
        for item in items():
            writer.write(item)
    wrote("cut", drive, "--to", "+5s", "-o", "a.mcap")
    wrote("merge", drive, "a.mcap", "-o", "b.mcap")
    wrote("filter", "b.mcap", "--topics", "pose", "-o", "c.mcap")
    data = bytearray(drive.read_bytes())
    Path("cut.mcap").write_bytes(data[: len(data) // 2])
    wrote("recover", "cut.mcap", "-o", "d.mcap")
    for name, edited in (
        ("a.mcap", "cut of drive.mcap"),
        ("b.mcap", "merge of drive.mcap, a.mcap"),
        ("c.mcap", "filter of b.mcap"),
        ("d.mcap", "recover of cut.mcap"),
    ):
        with RecordingReader(name) as reader:
            assert about.items() <= reader.about.items()
            assert reader.about["edited"] == edited
    with RecordingReader("d.mcap") as reader:
        assert reader.about["lost"].startswith("what came after 2023-11-14T22:13:2")
    said = wrote("info", "d.mcap")
    assert "tfbus 0.1 on robot7" in said and "recover of cut.mcap" in said
    assert "what came after 2023-11-14T22:13:2" in said


def test_a_topic_that_an_import_does_not_meet_is_said(tmp_path: Path) -> None:
    """With one that is near."""
    os.chdir(tmp_path)
    row = RawTransform(START_NS, "map", "base", (0, 0, 0, 0, 0, 0, 1))
    write_bag(Path("r.bag"), [Sent(START_NS, [row])])
    said = wrote("import", "r.bag", "--topics", "tff", "tf", "-o", "r.mcap")
    assert "no topic 'tff'" in said and "mean 'tf'" in said and said.count("no topic") == 1
    assert run("import", "r.bag", "--topics", "a", "--only-tf", "-o", "s.mcap").exit_code == 2


@pytest.mark.parametrize("verb", ["filter", "import"])
@pytest.mark.parametrize("option", ["-e", "-x"])
def test_what_is_no_regular_expression_is_a_usage_error(
    drive: Path, verb: str, option: str
) -> None:
    """As in `tfbus bag record`."""
    done = run(verb, drive, option, "[", "-o", "a.mcap")
    assert done.exit_code == 2
    assert "is no regular expression" in " ".join(done.output.split())


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(28, "No space left on device")])
@pytest.mark.parametrize("exists", [False, True])
def test_an_end_in_the_middle_leaves_no_file(
    tmp_path: Path, error: BaseException, exists: bool
) -> None:
    """Under its name there is nothing, or the former file, and nothing beside it."""

    def interrupted() -> Iterator[Item]:
        yield from list(items())[:50]
        raise error

    place = tmp_path / "out.mcap"
    if exists:
        place.write_text("former")
    span = (START_NS, START_NS + S)
    with pytest.raises((SystemExit, TfbusError)):
        write_recording(interrupted(), place, force=True, span=span, sources=())
    assert [path.name for path in tmp_path.iterdir()] == ["out.mcap"] * exists
    assert not exists or place.read_text() == "former"


def test_the_list_of_verbs_says_what_each_help_says() -> None:
    """The lines stand twice, as importing all verbs is slow."""
    for name, text in VERBS.items():
        verb = group.get_command(click.Context(group), name)
        assert verb is not None
        assert " ".join((verb.help or "").partition("\n\n")[0].split()) == text


def test_what_is_lost_on_the_way_is_said_in_the_new_file(drive: Path) -> None:
    """By its time of day, as the new file may begin elsewhere."""
    with RecordingWriter("bad.mcap") as writer:
        for number, item in enumerate(items()):
            writer.write(item)
            if number % 50 == 0:
                writer.flush()
    with RecordingReader("bad.mcap") as reader:
        chunk = reader.chunks[2].chunk
    data = bytearray(Path("bad.mcap").read_bytes())
    data[chunk.offset + chunk.length - 3] ^= 255
    Path("bad.mcap").write_bytes(data)
    said = wrote("filter", "bad.mcap", "--exclude", "none", "-o", "a.mcap")
    assert "bad.mcap is damaged: " in said
    wrote("merge", "a.mcap", drive, "-o", "b.mcap")
    for name in ("a.mcap", "b.mcap"):
        with RecordingReader(name) as reader:
            lost = reader.about["lost"]
        assert lost.endswith("50 messages from 2023-11-14T22:13:22.50Z to 2023-11-14T22:13:24.90Z")
