"""Recorders in robots keep their files, and others fill their gaps from them."""

import os
import random
import re
import time
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.builders import S, at
from tests.simulated_bus import Bus
from tfbus import Node, NodeSettings, TransformBroadcaster
from tfbus.bag import kept
from tfbus.bag.filling import _Gap, _Keeper
from tfbus.bag.keeping import Keep, PartsWritten
from tfbus.bag.kept import alone_in
from tfbus.base.errors import TfbusError
from tfbus.messages import Vector3
from tfbus.recording.items import EventItem, Item, TopicItem, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter
from tfbus.testing.network import Network
from tfbus.testing.programs import Program


class Robot:
    """A robot on a host of its own, which sends a frame and a topic, and records itself."""

    def __init__(self, bus: Bus, folder: Path, connect: tuple[str, ...] = ()) -> None:
        self.bus = Bus(bus.network, "robot")
        self.folder = folder
        self.connect = connect
        self.sent: list[int] = []
        with bus.network.process("robot", "sim"):
            self.node = Node(settings=NodeSettings("sim", namespace="robot7", connect=connect))
            broadcaster = TransformBroadcaster(self.node)
            flags = self.node.create_publisher(Vector3, "flag")

        def send() -> None:
            self.sent.append(self.node.now_ns())
            broadcaster.send_transform(at(len(self.sent), "base_link", self.sent[-1]))
            if len(self.sent) % 2 == 0:
                flags.publish(Vector3(1.0, 0.0, 0.0))

        self.node.create_timer(0.5, send)
        self.recorder = self.start()

    def start(self, name: str = "recorder", folder: Path | None = None) -> Program:
        """Its recorder, which is started again after a power cut."""
        started = self.bus.start(
            *("bag", "record", "--keep", "1h", "-o", str(folder or self.folder)),
            *("--namespace", "robot7", "--name", name),
            *(word for each in self.connect for word in ("--connect", each)),
        )
        started.wait_for_line("Keeping the last 60 min in")
        return started


@pytest.fixture
def robot(bus: Bus, tmp_path: Path) -> Robot:
    """A robot, and a link to it that is narrow."""
    base, host = bus.network.host("base"), bus.network.host("robot", offset_s=7.0)
    bus.network.path(host, base, delay_s=0.05, bytes_a_second=8_000.0)
    return Robot(bus, tmp_path / "kept")


def recording_of_base(bus: Bus, path: Path, *options: str) -> Program:
    """A recorder of the fleet at the base, which has just begun."""
    started = Bus(bus.network, "base").start("bag", "record", "--fleet", *options, "-o", str(path))
    started.wait_for_line("Recording to")
    return started


def items_of(path: Path) -> list[Item]:
    with RecordingReader(path) as reader:
        return list(reader.items())


def stamps_in(path: Path) -> list[int]:
    return [
        stamp
        for item in items_of(path)
        if isinstance(item, TransformItem) and not item.static
        for stamp in item.rows.stamps_as_ints()
    ]


def test_a_recording_of_the_base_fills_its_gap(bus: Bus, robot: Robot, tmp_path: Path) -> None:
    """After five minutes without a link, and another cut as the gap is filled: all that the robot
    recorded meanwhile is in the recording, once and in order, and no frame was gone.
    """
    network, path = bus.network, tmp_path / "base.mcap"
    process = recording_of_base(bus, path)
    network.run(20.0)
    begun = len(robot.sent)
    for away_s in (300.0, 30.0):
        network.partition("robot", "base")
        network.run(away_s)
        network.heal()
        network.run(until=lambda: "out of reach" in process.stderr.rpartition("Filled")[2])
        healed = len(process.stderr)
        network.run(5.0)
    network.run(until=lambda: "Filled the" in process.stderr[healed:], timeout_s=300.0)
    network.run(60.0)
    assert process.stop() == 0
    came = stamps_in(path)
    assert came == sorted(set(came))
    whole = [stamp for stamp in robot.sent if came[0] <= stamp <= came[-1]]
    assert came == whole and len(came) > begun + 600
    items = items_of(path)
    flags = [item for item in items if isinstance(item, TopicItem) and item.topic == "robot7/flag"]
    assert abs(len(flags) - len(came) // 2) <= 1
    assert [item.log_ns for item in items] == sorted(item.log_ns for item in items)
    events = [(item.kind, item.name) for item in items if isinstance(item, EventItem)]
    assert ("stream gone", "robot7/sim") not in events
    # Two, or one if the second cut came before the first part.
    assert events.count(("filled", "/robot7/recorder")) == process.stderr.count("Filled the") >= 1


@pytest.mark.parametrize("stopped_s", [8.0, 20.0])
def test_a_recorder_that_was_stopped_names_the_whole_outage(
    bus: Bus, robot: Robot, tmp_path: Path, stopped_s: float
) -> None:
    """A recorder that goes on after a stop was out of reach since that began, and has each message
    once, though some that waited in its socket come again from the robot's recorder.
    """
    network, path = bus.network, tmp_path / "base.mcap"
    process = recording_of_base(bus, path)
    network.run(20.0)
    network.stop(process.process)
    network.run(stopped_s)
    network.go_on(process.process)
    said = process.wait_for_line("was out of reach for")
    found = re.search(r"out of reach for ([0-9.]+) s", said)
    assert found is not None and stopped_s <= float(found[1]) < stopped_s + 10.0
    process.wait_for_line("Filled the")
    assert process.stop() == 0
    came = sorted(stamps_in(path))
    assert came == [stamp for stamp in robot.sent if came[0] <= stamp <= came[-1]]


def test_an_outage_shorter_than_a_lease_is_filled(bus: Bus, tmp_path: Path) -> None:
    """On a link of datagrams all that is sent in a second without it is lost, though no token is:
    by the missing numbers of a stream the recording asks for that time.
    """
    network, path = bus.network, tmp_path / "base.mcap"
    base, host = network.host("base"), network.host("robot")
    network.path(host, base, delay_s=0.05, multicast=False)
    process = recording_of_base(bus, path, "--listen", "udp/[::]:7447")
    robot = Robot(bus, tmp_path / "kept", ("udp/base:7447",))
    network.run(20.0)
    for _ in range(2):
        network.partition("robot", "base")
        network.run(1.3)
        network.heal()
        network.run(30.0)
    assert process.stop() == 0
    assert process.stderr.count("Filled the") == 2
    print(process.stderr)
    assert "stream 'robot7/sim' are missing" in process.stderr
    assert "out of reach" not in process.stderr
    came = sorted(stamps_in(path))
    assert came == [stamp for stamp in robot.sent if came[0] <= stamp <= came[-1]]
    assert len(came) > 100
    items = items_of(path)
    flags = [item for item in items if isinstance(item, TopicItem) and item.topic == "robot7/flag"]
    assert abs(len(flags) - len(came) // 2) <= 1
    assert not [item for item in items if isinstance(item, EventItem) and "gone" in item.kind]


def robot_with_arm(bus: Bus, tmp_path: Path) -> tuple[Program, list[int]]:
    """The recorder of a base, of a robot whose arm has a link of its own; what the arm sends. Their
    links are lost for a minute.
    """
    network = bus.network
    base, robot, arm = (network.host(name) for name in ("base", "robot", "arm"))
    network.path(robot, base, delay_s=0.05, multicast=False, bytes_a_second=2_500.0)
    network.path(arm, base, delay_s=0.05, multicast=False)
    process = recording_of_base(bus, tmp_path / "base.mcap", "--listen", "udp/[::]:7447")
    connect = ("udp/base:7447",)
    with network.process("arm", "sim"):
        node = Node(settings=NodeSettings("sim", namespace="robot7", connect=connect))
        broadcaster = TransformBroadcaster(node)
    sent: list[int] = []

    def send() -> None:
        sent.append(node.now_ns())
        broadcaster.send_transform(at(len(sent), "base_link", sent[-1]))

    node.create_timer(0.5, send)
    Bus(network, "robot").start(
        *("bag", "record", "--keep", "1h", "-o", str(tmp_path / "kept")),
        *("--namespace", "robot7", "--name", "recorder", "--connect", *connect),
    )
    network.run(20.0)
    network.partition("base")
    network.run(60.0)
    network.heal()
    return process, sent


def test_an_outage_while_another_gap_is_filled_is_filled_to_its_end(
    bus: Bus, tmp_path: Path
) -> None:
    """The robot has it on its disk only seconds after its end, however soon the gap before it has
    been filled.
    """
    process, sent = robot_with_arm(bus, tmp_path)
    network = bus.network
    network.run(until=lambda: "recorder was out of reach" in process.stderr)
    network.run(7.0)
    while "Filled the" not in process.stderr:
        network.partition("arm", "base")
        network.run(1.2)
        network.heal()
        network.run(0.3)
    network.run(60.0)
    assert process.stop() == 0
    assert "stream 'robot7/sim' are missing" in process.stderr
    came = stamps_in(tmp_path / "base.mcap")
    assert came == [stamp for stamp in sent if came[0] <= stamp <= came[-1]]


def test_a_stream_that_is_back_after_its_gap_was_filled_is_recorded_once(
    bus: Bus, tmp_path: Path
) -> None:
    """Only the messages after the last filled one are missing then."""
    process, sent = robot_with_arm(bus, tmp_path)
    network = bus.network
    network.partition("arm", "base")
    network.run(until=lambda: "Filled the" in process.stderr)
    network.run(2.0)
    network.heal()
    network.run(until=lambda: process.stderr.count("Filled the") == 2)
    network.run(10.0)
    assert process.stop() == 0
    came = stamps_in(tmp_path / "base.mcap")
    assert came == [stamp for stamp in sent if came[0] <= stamp <= came[-1]]


def keeper_of_one() -> _Keeper:
    """A recorder that keeps what it records."""
    return _Keeper("@tfbus/keeper/robot7", "/robot7/recorder")


@pytest.mark.parametrize("outage_until_s", [102, 200])
def test_a_lost_link_is_asked_for_from_30_s_before_it_though_an_outage_came_just_before(
    outage_until_s: int,
) -> None:
    """A link may have been silent for so long; the outage of a stream is asked for from 2 s before
    it, and is one with the gap of the link, also where it lasts longer.
    """
    keeper = keeper_of_one()
    assert keeper.add(_Gap(98 * S, 100 * S, outage_until_s * S, "sim"))
    assert not keeper.add(_Gap(71 * S, 101 * S, 110 * S))
    [gap] = keeper.gaps
    assert (gap.from_ns, gap.until_ns) == (71 * S, max(110, outage_until_s) * S)
    assert (gap.lost_ns, gap.stream) == (100 * S, "")


def test_gaps_are_few_while_one_of_them_is_being_filled() -> None:
    """Outages that meet are one, and beyond a hundred the last one grows."""
    keeper = keeper_of_one()
    asking: Any = object()
    for second in range(1000):
        from_ns = second * 100 * 10**9
        keeper.add(_Gap(from_ns, from_ns, from_ns + 10**9, "sim"))
        keeper.asking = asking
    assert len(keeper.gaps) == 100
    assert keeper.gaps[-1].until_ns == from_ns + 10**9
    assert keeper.gaps[0].until_ns == 10**9


def test_of_a_part_that_part_is_filled(bus: Bus, robot: Robot, tmp_path: Path) -> None:
    """A recording of one topic queries no more of what is kept."""
    network, path = bus.network, tmp_path / "base.mcap"
    process = recording_of_base(bus, path, "--topics", "robot7/flag")
    network.run(10.0)
    network.partition("robot", "base")
    network.run(60.0)
    network.heal()
    network.run(until=lambda: "Filled the" in process.stderr)
    network.run(5.0)
    assert process.stop() == 0
    items = items_of(path)
    assert not any(isinstance(item, TransformItem) for item in items)
    times = [item.log_ns for item in items if isinstance(item, TopicItem)]
    assert len(times) > 70
    assert max(later - former for former, later in pairwise(times)) < 1.3e9


def test_what_was_kept_before_a_power_cut_fills_the_gap_too(
    bus: Bus, robot: Robot, tmp_path: Path
) -> None:
    """A robot's recorder is killed while out of reach, and started again: of what it had recorded a
    second is missing, and its second recording goes on in the same folder.
    """
    network, path = bus.network, tmp_path / "base.mcap"
    process = recording_of_base(bus, path)
    network.run(20.0)
    network.partition("robot", "base")
    network.run(30.0)
    network.kill(robot.recorder.process)
    network.run(30.0)
    robot.start()
    network.run(30.0)
    network.heal()
    network.run(until=lambda: "Filled the" in process.stderr)
    network.run(5.0)
    assert process.stop() == 0
    came = stamps_in(path)
    missing = {stamp for stamp in robot.sent if came[0] < stamp < came[-1]} - {*came}
    span_s = (max(missing) - min(missing)) / 1e9
    assert 30.0 <= span_s < 32.5 and len(missing) == round(span_s * 2) + 1


def test_a_recorder_under_another_name_fills_the_gap(
    bus: Bus, robot: Robot, tmp_path: Path
) -> None:
    """It takes the place of the one that is gone."""
    network, path = bus.network, tmp_path / "base.mcap"
    process = recording_of_base(bus, path)
    network.run(20.0)
    network.partition("robot", "base")
    network.run(30.0)
    network.kill(robot.recorder.process)
    robot.start("blackbox")
    network.run(30.0)
    network.heal()
    network.run(until=lambda: "Filled the" in process.stderr)
    assert process.stop() == 0
    assert "/robot7/blackbox was out" in process.stderr


@pytest.mark.parametrize("first_to_end", ["second", "third"])
def test_of_three_recorders_of_a_robot_the_last_one_is_asked(
    bus: Bus, robot: Robot, tmp_path: Path, first_to_end: str
) -> None:
    """Whichever of those beside the first ends before it: the other one takes its place."""
    network, path = bus.network, tmp_path / "base.mcap"
    process = recording_of_base(bus, path)
    network.run(5.0)
    beside = {}
    for name in ("second", "third"):
        beside[name] = robot.start(name, tmp_path / name)
        network.run(5.0)
    for each in (beside.pop(first_to_end), robot.recorder):
        assert each.stop() == 0
        network.run(5.0)
    [left] = beside
    assert f"/robot7/{left} was out of reach" in process.stderr
    network.run(until=lambda: "Filled the" in process.stderr)
    assert process.stop() == 0
    assert "not filled" not in process.stderr


@pytest.mark.parametrize("is_suspended", [False, True])
def test_a_recorder_that_did_not_run_fills_that_time(
    bus: Bus, robot: Robot, tmp_path: Path, is_suspended: bool
) -> None:
    """Stopped, or with its laptop suspended, for longer than a link is silent before it is lost."""
    network, path = bus.network, tmp_path / "base.mcap"
    process = recording_of_base(bus, path)
    network.run(20.0)
    network.stop(process.process)
    network.run(50.0)
    if is_suspended:
        process.process.host.suspended_ns += 50 * S
    network.go_on(process.process)
    network.run(until=lambda: "Filled the" in process.stderr, timeout_s=120.0)
    network.run(10.0)
    assert process.stop() == 0
    # Messages that came until its link was lost were received when it went on.
    came = sorted(stamps_in(path))
    assert came == [stamp for stamp in robot.sent if came[0] <= stamp <= came[-1]]


def test_pages_read_a_growing_file_as_a_whole_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, network: Network
) -> None:
    """Not for each page again: it has no index until it is whole. What was written since then is in
    the pages of a later query.
    """
    opened: list[Path] = []

    class Counted(RecordingReader):
        def __init__(self, path: Path, **given: Any) -> None:
            opened.append(path)
            super().__init__(path, **given)

    monkeypatch.setattr(kept, "RecordingReader", Counted)
    path = tmp_path / "growing.mcap"
    with RecordingWriter(path) as writer, network.process(network.host("robot"), "recorder"):
        parts = cast(PartsWritten, SimpleNamespace(files=[path]))
        files = kept.KeptFiles(Node("recorder"), parts)
        written: list[int] = []

        def pages() -> list[list[int]]:
            begin_ns, end_ns = 0, time.time_ns() - 2 * S
            found = []
            while True:
                page = files.page(begin_ns, end_ns, 1_000)
                found.append([message.log_ns for message in page.messages])
                if not page.next:
                    return found
                begin_ns = int(page.next.partition(".")[0])

        for opened_in_all in (2, 3):
            for _ in range(100):
                written.append(time.time_ns())
                writer.write(TopicItem(written[-1], "noise", "", {"text": "x" * 50}))
                network.run(0.01)
            writer.flush()
            network.run(2.0)
            found = pages()
            assert len(found) > 5 and [stamp for page in found for stamp in page] == written
            assert len(opened) == opened_in_all
        files.close()


def test_what_is_kept_has_bounds(tmp_path: Path) -> None:
    """Of files beyond a size or a time the oldest go, those of an earlier recording first; the one
    that grows stays.
    """
    older = tmp_path / "older.mcap"
    older.write_bytes(bytes(50_000))
    for keep, left in ((Keep(most_bytes=45_000), 2), (Keep(most_bytes=10**9), 4)):
        older.write_bytes(bytes(50_000))
        first = tmp_path / f"{keep.most_bytes}.mcap"
        parts = PartsWritten(first, RecordingWriter, keep=keep, older=[older])
        for _ in range(3):
            parts.open()
            for number in range(200):
                noise = random.randbytes(100).hex()
                parts.write(TopicItem(number, "noise", "", {"text": noise}))
        parts.close()
        assert older.exists() is (left == 4)
        assert sum(path.exists() for path in [older, *parts.paths]) == left


def test_a_time_without_recorder_erases_nothing(tmp_path: Path) -> None:
    """The last 80 s that were recorded are kept, however long ago; the time since then counts as
    one file of 10 s.
    """
    older = [tmp_path / f"older-{number}.mcap" for number in range(11)]
    for number, path in enumerate(older):
        path.write_bytes(b"recorded")
        os.utime(path, (10.0 * number, 10.0 * number))
    parts = PartsWritten(tmp_path / "new.mcap", RecordingWriter, keep=Keep(80.0), older=older)
    parts.open()
    parts.close()
    assert [path.exists() for path in older] == [False] * 4 + [True] * 7


def test_a_folder_has_one_recorder_that_keeps(tmp_path: Path) -> None:
    """Another one is refused, as long as it is there: each would delete the files of the other."""
    first = alone_in(tmp_path)
    with first, pytest.raises(TfbusError, match="another recorder"), alone_in(tmp_path):
        pass
    with alone_in(tmp_path):
        pass
