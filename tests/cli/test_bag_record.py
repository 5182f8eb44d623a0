"""`tfbus bag record` on a live bus."""

import json
import os
import re
import select
import signal
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from subprocess import Popen
from threading import Thread

import pytest
from click.testing import CliRunner

from tests.builders import at
from tests.buses import DEADLINE_S, eventually, keep_sending, send_static
from tests.simulated_bus import Bus
from tfbus import Node, NodeSettings, ServiceError, TransformBroadcaster
from tfbus.cli import main
from tfbus.messages import Empty, Pose, SaveRecording
from tfbus.recording.items import EventItem, Item, TopicItem, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.testing.programs import Program

POSE = Pose(5, 1.0, 2.0, 0.1, 0.0, 0.0)


def items_of(*paths: Path) -> list[Item]:
    """What the files hold by now; nothing where there is none."""
    if not all(path.exists() for path in paths):
        return []
    with RecordingReader(*paths) as reader:
        return list(reader.items())


def transforms(items: list[Item]) -> list[TransformItem]:
    return [item for item in items if isinstance(item, TransformItem)]


def topics(items: list[Item]) -> list[TopicItem]:
    return [item for item in items if isinstance(item, TopicItem)]


def events(items: list[Item]) -> list[tuple[str, str]]:
    return [(item.kind, item.name) for item in items if isinstance(item, EventItem)]


def children(items: list[Item]) -> set[str]:
    return {ts.child_frame_id for item in transforms(items) for ts in item.rows}


def eventually_in(path: Path, condition: Callable[[list[Item]], object]) -> None:
    """Wait until the file that grows holds something."""
    eventually(lambda: condition(items_of(path)))


def keep_publishing(node: Node, topic: str) -> None:
    publisher = node.create_publisher(Pose, topic)
    node.create_timer(0.05, lambda: publisher.publish(POSE))


def recording(bus: Bus, path: Path, *options: str) -> Program:
    process = bus.start("bag", "record", "-o", str(path), *options)
    process.wait_for_line("Recording to|Holding the last")
    return process


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of a recording."""
    return tmp_path / "run.mcap"


class TestWhat:
    def test_everything_on_the_bus_is_recorded(self, bus: Bus, path: Path) -> None:
        """Transforms with their streams and nodes, statics, topics with types, and who was there,
        also what comes later.
        """
        robot = bus.node("robot")
        keep_sending(robot, "odom", "base")
        send_static(robot, "base", "laser")
        keep_publishing(robot, "robot/pose")
        process = recording(bus, path)
        late = bus.node("late")
        keep_sending(late, "base", "arm")
        keep_publishing(late, "late/pose")
        eventually_in(path, lambda items: {"base", "laser", "arm"} <= children(items))
        eventually_in(path, lambda items: len({each.topic for each in topics(items)}) == 2)
        late.close()
        eventually_in(path, lambda items: ("stream gone", "late") in events(items))
        assert process.stop() == 0
        with RecordingReader(path) as reader:
            assert reader.is_complete
            items = list(reader.items())
        nodes = {item.stream.name: item.stream.node for item in transforms(items)}
        assert nodes == {"robot": "/robot", "late": "/late"}
        assert {item.stream.name for item in transforms(items) if item.static} == {"robot"}
        pose = next(each for each in topics(items) if each.topic == "robot/pose")
        assert (pose.type_name, pose.values["x"]) == ("Pose", 1.0)
        assert {("stream", "robot"), ("node", "/robot"), ("node gone", "/late")} <= {*events(items)}
        assert ("node", "/recorder") not in events(items)
        text = "\n".join(process.out)
        assert "to 1 file" in text and "2 streams (" in text and "2 topics (" in text
        shown = CliRunner().invoke(main, ["bag", "info", str(path)]).stdout
        held = r"with [0-9,]+ dynamic transforms, and 1 static transform$"
        assert re.findall(held, text, re.MULTILINE) == re.findall(held, shown, re.MULTILINE) != []

    def test_topics_alone(self, bus: Bus, path: Path) -> None:
        """Named topics are recorded from their first message on, and no transforms."""
        process = recording(bus, path, "--topics", "pose", "/other", "--disable-keyboard-controls")
        node = bus.node("robot")
        keep_sending(node, "odom", "base")
        keep_publishing(node, "pose")
        keep_publishing(node, "unwanted")
        eventually_in(path, lambda items: len(topics(items)) > 5)
        assert process.stop() == 0
        assert {each.topic for each in topics(items_of(path))} == {"pose"}
        assert {each.type_name for each in topics(items_of(path))} == {"Pose"}
        assert not transforms(items_of(path))

    @pytest.mark.parametrize(
        ("options", "wanted"),
        [
            (["--streams", "robot"], {"base", "wheel"}),
            (["--frames", "wheel", "hand"], {"wheel", "hand"}),
            (["--regex", "^ar"], {"hand"}),
            (["--exclude", "arm"], {"base", "wheel"}),
            (["--topics", "tf"], {"base", "wheel", "hand"}),
            (["tf", "--frames", "base"], {"base"}),
        ],
    )
    def test_a_part_of_the_transforms(
        self, bus: Bus, path: Path, options: list[str], wanted: set[str]
    ) -> None:
        """Streams, frames and regular expressions say which."""
        process = recording(bus, path, *options)
        robot, arm = bus.node("robot"), bus.node("arm")
        keep_sending(robot, "odom", "base")
        keep_sending(robot, "base", "wheel")
        keep_sending(arm, "base", "hand")
        eventually_in(path, lambda items: children(items) >= wanted)
        assert process.stop() == 0
        assert children(items_of(path)) == wanted

    @pytest.mark.parametrize(
        ("options", "wanted"),
        [
            (["--topics", "tf"], {"base"}),
            (["--topics", "/tf_static"], {"laser"}),
            (["--exclude-topics", "tf_static"], {"base"}),
        ],
    )
    def test_dynamic_or_static_transforms_alone(
        self, bus: Bus, path: Path, options: list[str], wanted: set[str]
    ) -> None:
        """The topics are those of ROS: tf for dynamic, tf_static for static ones."""
        process = recording(bus, path, *options)
        robot = bus.node("robot")
        send_static(robot, "base", "laser")
        keep_sending(robot, "odom", "base")
        eventually_in(path, lambda items: children(items) >= wanted)
        process.stop()
        assert children(items_of(path)) == wanted
        is_said = "Static transforms are left out" in "\n".join(process.err)
        assert is_said == (options == ["--topics", "tf"])

    def test_a_folder_is_made_for_the_file(self, bus: Bus, path: Path) -> None:
        """With -o folder/ its name is that of the time; what was noted is shown."""
        folder = path.parent / "new" / "er"
        process = bus.start(
            "bag", "record", "-o", f"{folder}/", "--custom-data", "driver=Ada", "n=1"
        )
        process.wait_for_line("Recording to")
        keep_sending(bus.node("robot"), "odom", "base")
        [file] = folder.iterdir()
        eventually_in(file, transforms)
        assert process.stop() == 0
        assert file.name.startswith("tfbus_20")
        assert "driver=Ada, n=1" in bus.run("bag", "info", str(file)).stdout

    def test_a_fleet(self, bus: Bus, path: Path) -> None:
        """All namespaces below are recorded, by the names that they have from outside."""
        robot = bus.node("base", namespace="robot7")
        keep_sending(robot, "odom", "base")
        keep_publishing(robot, "pose")
        process = recording(bus, path, "--fleet")
        eventually_in(path, lambda items: transforms(items) and topics(items))
        assert process.stop() == 0
        stream = transforms(items_of(path))[0].stream
        assert (stream.name, stream.namespace, stream.node) == (
            "robot7/base",
            "robot7",
            "/robot7/base",
        )
        assert topics(items_of(path))[0].topic == "robot7/pose"

    def test_one_robot_of_a_fleet(self, bus: Bus, path: Path) -> None:
        """In a namespace names are relative on the command line, and full in the file."""
        for namespace in ("robot7", "robot8"):
            robot = bus.node("base", namespace=namespace)
            keep_sending(robot, "odom", f"{namespace}_base")
            keep_publishing(robot, "pose")
        process = recording(bus, path, "--namespace", "robot7", "--topics", "pose", "/robot7/tf")
        eventually_in(path, lambda items: transforms(items) and topics(items))
        assert process.stop() == 0
        assert {item.stream.name for item in transforms(items_of(path))} == {"robot7/base"}
        assert {each.topic for each in topics(items_of(path))} == {"robot7/pose"}

    def test_what_publishers_still_hold(self, bus: Bus, path: Path) -> None:
        """With --history the recording begins before its start, without a gap."""
        robot = bus.node("robot")
        broadcaster = TransformBroadcaster(robot, history_s=100.0)
        sent = 0

        def send() -> None:
            nonlocal sent
            broadcaster.send_transform(at(sent, "base", robot.now_ns()))
            sent += 1

        robot.create_timer(0.05, send)
        eventually(lambda: sent > 20)
        process = recording(bus, path, "--history", "--frames", "base")
        last = sent + 5
        eventually_in(path, lambda items: x_of(items) > last)
        assert process.stop() == 0
        found = transforms(items_of(path))
        numbers = [ts.transform.x for item in found for ts in item.rows]
        assert numbers[0] == 0.0 and numbers == sorted(numbers)
        assert numbers == [float(number) for number in range(len(numbers))]
        logged = [item.log_ns for item in found]
        assert logged == sorted(logged)

    def test_what_publishers_hold_comes_by_pages(self, bus: Bus, path: Path) -> None:
        """Over a link that takes ten seconds for it all of it comes, in its order."""
        network = bus.network
        network.path(network.host("base"), network.host("robot"), bytes_a_second=12_000.0)
        with network.process("robot", "sim"):
            robot = Node(settings=NodeSettings("sim", namespace="robot7"))
            broadcaster = TransformBroadcaster(robot, history_s=100.0)
        frames = [f"frame{number}" for number in range(30)]
        sent = 0

        def send() -> None:
            nonlocal sent
            rows = [at(sent, frame, robot.now_ns()) for frame in frames]
            broadcaster.send_transform(rows)
            sent += 1

        robot.create_timer(0.5, send)
        network.run(50.0)
        before = sent
        process = recording(Bus(network, "base"), path, "--fleet", "--history")
        network.run(60.0)
        assert process.stop() == 0
        found = transforms(items_of(path))
        numbers = [next(iter(item.rows)).transform.x for item in found]
        assert numbers == [float(number) for number in range(len(numbers))]
        assert len(numbers) > before + 50


def x_of(items: list[Item]) -> float:
    """The last x that was recorded; -1 for none."""
    rows = [ts.transform.x for item in transforms(items) for ts in item.rows]
    return rows[-1] if rows else -1.0


class TestServices:
    def call(self, bus: Bus, name: str) -> str:
        """What `tfbus service call recorder/NAME` says to stderr."""
        return bus.run("service", "call", f"recorder/{name}").stderr

    def test_pause_resume_split_and_stop(self, bus: Bus, path: Path) -> None:
        """The services do as their names say."""
        client = bus.node("client")
        process = recording(bus, path, "--start-paused")
        keep_publishing(client, "pose")

        def call(name: str) -> None:
            kind = SaveRecording if name == "split" else Empty
            client.create_client(kind, f"recorder/{name}").call(
                kind.Request(), timeout_s=DEADLINE_S
            )

        call("resume")
        eventually_in(path, topics)
        call("split")
        second = path.with_name("run_1.mcap")
        eventually_in(second, topics)
        call("pause")
        assert "start it with --snapshot" in self.call(bus, "snapshot")
        done = bus.run("call", "recorder/split")
        whole = json.loads(done.stdout)
        assert whole["file"] == str(second) and whole["size"] == second.stat().st_size
        assert whole["seconds"] > 0.0
        call("stop")
        assert process.wait() == 0
        kinds = [kind for kind, _ in events(items_of(path, second)) if kind in PAUSES]
        assert kinds == ["paused", "resumed", "paused"]
        assert "to 3 files" in "\n".join(process.out)

    def test_snapshots_when_asked_and_when_a_frame_is_gone(self, bus: Bus, path: Path) -> None:
        """Each has what came since the one before, and the last the end of the publisher."""
        robot = bus.node("robot")
        keep_sending(robot, "odom", "base")
        process = recording(bus, path, "--snapshot", "60", "--on", "gone base")
        snapshot = bus.node("client").create_client(SaveRecording, "recorder/snapshot")
        assert not path.exists()

        def has_base() -> bool:
            with suppress(ServiceError):  # nothing has come
                snapshot.call(SaveRecording.Request(), timeout_s=DEADLINE_S)
            items = items_of(*path.parent.glob("*.mcap"))
            return ("stream", "robot") in events(items) and children(items) == {"base"}

        eventually(has_base)
        robot.close()
        line = process.wait_for_line(r"Wrote .*: stream 'robot' is gone, with base")
        last = Path(line.split("Wrote ")[1].split(": ")[0])
        assert events(items_of(last))[-1] == ("stream gone", "robot")
        assert process.stop() == 0


PAUSES = ("paused", "resumed")


class TestMistakes:
    def test_a_recording_is_never_overwritten(self, bus: Bus, path: Path) -> None:
        """A file of that name, or of one of its parts, is a usage error."""
        path.with_name("run_3.mcap").touch()
        done = bus.run("bag", "record", "-o", str(path))
        assert done.returncode == 2
        assert "run_3.mcap' is there" in done.stderr

    @pytest.mark.parametrize(
        ("options", "said"),
        [
            (["-o", "nowhere/run"], "there is no folder 'nowhere' to record into"),
            (["--max-size", "5 apples"], "'5 apples' is not a size: write a number of bytes"),
            (["--max-size", "1"], "must be at least 100 kB, not 1 B"),
            (["--max-duration", "0"], "must be at least 1, not 0"),
            (["--max-cache-size", "1kB"], "must be at least 1 MB, not 1 kB"),
            (["--max-files", "3"], "give --max-size, --max-duration or --snapshot"),
            (["-a", "--topics", "pose"], "-a records everything: leave it out"),
            (["-a", "pose"], "-a records everything: leave it out"),
            (["--custom-data", "driver"], "'driver' is not of the form KEY=VALUE"),
            (["--snapshot-mode"], "there is no option --snapshot-mode: use --snapshot SECONDS"),
            (["-o", "run", "--use-sim-time"], "no option --use-sim-time: not needed: stamps are"),
            (["--topicz", "pose"], "No such option"),
            (["--regex", "("], "'--regex': '(' is no regular expression"),
            (["--exclude", "["], "'--exclude' / '--exclude-regex': '[' is no regular expression"),
            (["--on", "gone"], "--on writes a snapshot: give --snapshot SECONDS too"),
            (["--snapshot", "5", "--on", "late map"], "'late map' is no condition"),
            (["--snapshot", "5", "--max-size", "1GB"], "each snapshot is a file of its own"),
            (["--topics", "a b"], "cannot be the name of a topic"),
            (["-s", "sqlite3"], "'sqlite3' is not 'mcap'"),
            (["--node-name", "a/b"], "'a/b' cannot be a node's name"),
        ],
    )
    def test_wrong_options_are_usage_errors(self, options: list[str], said: str) -> None:
        """Each ends in one sentence."""
        done = CliRunner().invoke(main, ["bag", "record", *options])
        assert done.exit_code == 2 and said in done.stderr

    def test_frames_have_the_names_of_a_fleet(self, bus: Bus, path: Path) -> None:
        """`--frames robot7/base` records the frame base of robot7 alone, and a name that no frame
        has is said, with the one that is meant.
        """
        for robot in ("robot7", "robot8"):
            keep_sending(bus.node("sim", namespace=robot), "odom", "base")
        process = recording(bus, path, "--fleet", "--frames", "robot7/base", "robot7/bsae")
        process.wait_for_line("So far no frame is called 'robot7/bsae'; did you mean 'robot7/base'")
        eventually_in(path, transforms)
        assert process.stop() == 0
        assert any("In the end" in line and "'robot7/bsae'" in line for line in process.err)
        assert {item.stream.name for item in transforms(items_of(path))} == {"robot7/sim"}
        assert children(items_of(path)) == {"base"}

    def test_where_nothing_comes_it_says_so(self, bus: Bus, path: Path) -> None:
        """A namespace that has frames is named."""
        keep_sending(bus.node("base", namespace="robot7"), "odom", "base")
        process = recording(bus, path)
        process.wait_for_line("Nothing to record so far: .* look with --namespace robot7")
        assert process.stop() == 0
        assert "No transforms" in process.out


# SIGHUP of a terminal that goes away is for the first process in it.
_FIRST = "import os, sys; os.login_tty(0); os.execv(sys.argv[1], sys.argv[1:])"
_SECOND = """
import os, signal, subprocess, sys
os.login_tty(0)
signal.signal(signal.SIGHUP, lambda *_: None)
sys.exit(subprocess.call(sys.argv[1:]))
"""


class Terminal:
    """A terminal of 80 columns with `tfbus bag record` in it, once that records."""

    def __init__(self, bus: Bus, *arguments: str, wrapper: str = _FIRST) -> None:
        self._master, slave = os.openpty()
        termios.tcsetwinsize(slave, (24, 80))
        command = [sys.executable, "-m", "tfbus", "bag", "record", *arguments]
        env = {name: text for name, text in bus.env.items() if name != "COLUMNS"}
        self.process = Popen([sys.executable, "-c", wrapper, *command], stdin=slave, env=env)
        os.close(slave)
        self._shown = b""
        self._is_up = True
        self._reader = Thread(target=self._read, daemon=True)
        self._reader.start()
        eventually(lambda: "space pauses, s begins a new file, q ends" in self.text)

    def _read(self) -> None:
        with suppress(OSError):  # the process has ended
            while self._is_up:
                if select.select([self._master], [], [], 0.1)[0]:
                    self._shown += os.read(self._master, 4096)

    @property
    def text(self) -> str:
        # Long lines of the log go on in the next one.
        return self._shown.decode(errors="replace").replace("\r\n  ", " ")

    def type(self, keys: str) -> None:
        os.write(self._master, keys.encode())

    def hang_up(self) -> None:
        if self._is_up:
            self._is_up = False
            self._reader.join()
            os.close(self._master)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(DEADLINE_S)
        self.hang_up()


@pytest.mark.real
class TestTerminal:
    @pytest.fixture
    def terminal(self, bus: Bus, path: Path) -> Iterator[Terminal]:
        """A recording in a terminal."""
        keep_sending(bus.node("robot"), "odom", "base")
        terminal = Terminal(bus, "-o", str(path))
        yield terminal
        terminal.close()

    def test_keys_pause_split_and_end(self, terminal: Terminal, path: Path) -> None:
        """One line says how it goes; keys do what services do."""
        eventually(lambda: "rec\x1b[0m 0:00:0" in terminal.text)
        terminal.type(" ")
        eventually(lambda: "paused" in terminal.text)
        terminal.type(" s")
        eventually(path.with_name("run_1.mcap").exists)
        terminal.type("q")
        assert terminal.process.wait(DEADLINE_S) == 0
        eventually(lambda: "to 2 files" in terminal.text)
        kinds = [kind for kind, _ in events(items_of(path)) if kind in PAUSES]
        assert kinds == ["paused", "resumed"]

    @pytest.mark.parametrize("wrapper", [_FIRST, _SECOND], ids=["signal", "no signal"])
    def test_a_terminal_that_goes_away_leaves_a_whole_file(
        self, bus: Bus, path: Path, wrapper: str
    ) -> None:
        """As when ssh loses its connection; also where SIGHUP goes to another process, or late."""
        keep_sending(bus.node("robot"), "odom", "base")
        terminal = Terminal(bus, "-o", str(path), wrapper=wrapper)
        eventually_in(path, transforms)
        terminal.hang_up()
        assert terminal.process.wait(DEADLINE_S) == 0
        with RecordingReader(path) as reader:
            assert reader.is_complete
        terminal.close()

    def test_ctrl_c_ends_it(self, terminal: Terminal, path: Path) -> None:
        """The usual end exits with 0, and prints what was recorded."""
        terminal.process.send_signal(signal.SIGINT)
        assert terminal.process.wait(DEADLINE_S) == 0
        eventually(lambda: "Look into it: tfbus bag info" in terminal.text)
