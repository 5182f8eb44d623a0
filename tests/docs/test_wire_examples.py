"""The programs of examples/wire, written by docs/reference/wire.md alone, speak with tfbus."""

import json
import random
import re
import struct
import subprocess
import sys
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import msgpack
import numpy as np
import pytest

from tests import needs
from tests.builders import rows_of
from tests.buses import eventually, keep_sending, send_static, send_until
from tests.docs.pages import ROOT
from tests.live_bus import Bus, Process
from tests.wire.frozen_wire import frozen_now
from tfbus import (
    Buffer,
    Recording,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)
from tfbus.base.errors import DecodeError
from tfbus.messages import PointCloud
from tfbus.wire.codec import encode_message
from tfbus.wire.descriptions import read_description
from tfbus.wire.numbered import NO_NUMBERS, numbers_of
from tfbus.wire.transforms import NumberedEncoder, decode_transforms

pytestmark = pytest.mark.real

FOLDER = ROOT / "examples" / "wire"
SANITIZED = "-fsanitize=address,undefined"
POSE = (1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8)


def compile_program(folder: Path, *flags: str, name: str = "tfbus_wire") -> str | None:
    """A C program, compiled; None where the compiler does not take these flags."""
    program = folder / name
    source = str(FOLDER / f"{name}.c")
    strict = ["-std=c99", "-pedantic", "-Wall", "-Wextra"]
    command = [needs.program("cc"), *strict, *flags, "-o", str(program), source, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode and flags:
        return None
    assert done.returncode == 0, done.stderr
    return str(program)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The C program, with the sanitizers where the compiler has them."""
    folder = tmp_path_factory.mktemp("wire")
    flags = ("-g", SANITIZED, "-fno-sanitize-recover=all")
    compiled = compile_program(folder, *flags) or compile_program(folder)
    assert compiled
    return compiled


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """examples/wire/tfbus_wire.py."""
    monkeypatch.syspath_prepend(str(FOLDER))
    return import_module("tfbus_wire")


def start(bus: Bus, tmp_path: Path, *command: str) -> Process:
    """A program of examples/wire on the bus, which Zenoh's own variable names to it."""
    config = tmp_path / "plain.json5"
    connect = f"connect: {{endpoints: ['{bus.endpoint}']}}, "
    config.write_text("{" + connect + bus.quick_config.read_text()[1:])
    name, *arguments = command
    line = [sys.executable, str(FOLDER / name), *arguments]
    return bus.start_command(line, env={"ZENOH_CONFIG": str(config)})


def talker(bus: Bus, tmp_path: Path, program: str) -> Process:
    """The program that sends the frames of `crow`: in Python, or in C where there is one."""
    if program:
        return start(bus, tmp_path, "shuttle.py", program, "talk", "crow")
    return start(bus, tmp_path, "talk.py", "crow")


def listener(bus: Bus, tmp_path: Path, program: str) -> Process:
    """The program that prints the frames of others: in Python, or in C where there is one."""
    if program:
        return start(bus, tmp_path, "shuttle.py", program, "listen")
    return start(bus, tmp_path, "listen.py")


@pytest.fixture(params=["python", "c"])
def language(request: pytest.FixtureRequest) -> str:
    """The path of the C program, or "" for those in Python."""
    return str(request.getfixturevalue("program")) if request.param == "c" else ""


def run_at_once(bus: Bus, *arguments: str) -> str:
    """What `tfbus ARGUMENTS` prints; it does not wait until it has found all others."""
    return bus.run(*arguments, env={"TFBUS_CONFIG": str(bus.quick_config)}).stdout


def shown_by_tfbus(bus: Bus) -> dict[str, Any] | None:
    """What `tfbus frames --json` shows, once it knows both frames and their stream."""
    shown: dict[str, Any] = json.loads(run_at_once(bus, "frames", "--json") or "{}")
    streams = [stream["name"] for stream in shown.get("streams", ()) if stream["node"]]
    found = {frame["name"] for frame in shown.get("frames", ())} >= {"crow", "crow_camera"}
    return shown if found and "crow" in streams else None


def test_its_frames_are_those_of_a_node_of_tfbus(bus: Bus, tmp_path: Path, language: str) -> None:
    """A buffer looks both up, `tfbus frames` names node and stream, and the end is noticed."""
    crow = talker(bus, tmp_path, language)
    buffer = Buffer()
    with TransformListener(buffer, bus.node("early")):
        eventually(lambda: buffer.can_transform("world", "crow_camera"))
        with TransformListener(Buffer(), bus.node("late")) as late:
            eventually(lambda: late.buffer.can_transform("crow", "crow_camera"))
        found = buffer.lookup_transform("crow", "crow_camera").transform.xyz
        assert found.tolist() == [0.1, 0.0, 0.3]
        shown = eventually(lambda: shown_by_tfbus(bus))
        assert shown
        frames = {frame["name"]: frame for frame in shown["frames"]}
        assert (frames["crow"]["node"], frames["crow"]["static"]) == ("/crow", False)
        assert (frames["crow_camera"]["node"], frames["crow_camera"]["static"]) == ("/crow", True)
        (stream,) = (each for each in shown["streams"] if each["name"] == "crow")
        assert (stream["node"], stream["alive"], stream["rejected"]) == ("/crow", True, 0)
        assert shown["problems"] == []
        eventually(lambda: run_at_once(bus, "node", "list") == "/crow\n/early\n/late\n")
        assert crow.stop() == 0
        eventually(lambda: [frame.name for frame in buffer.all_frames() if frame.gone])


def test_it_reads_what_tfbus_sends(bus: Bus, tmp_path: Path, language: str) -> None:
    """Late static frames, dynamic ones, a restart, and a stream that is gone."""
    sensors = bus.node("sensors")
    send_static(sensors, "base_link", "lidar")
    robot = bus.node("robot")
    keep_sending(robot, "odom", "base_link")
    reading = listener(bus, tmp_path, language)
    reading.wait_for_line(r"^base_link -> lidar: 0.* \(static")
    reading.wait_for_line(r"^odom -> base_link: 0.* \(dynamic")
    reading.wait_for_line(r"(node|of) '?/robot")
    robot.close()
    reading.wait_for_line(r"stream 'robot' is gone|gone @tfbus/stream/robot")
    before = len(reading.out)
    keep_sending(bus.node("robot"), "odom", "base_link")
    eventually(lambda: any("odom -> base_link" in line for line in reading.out[before:]))
    refused = [line for line in reading.out if line.startswith("refused")]
    assert refused == []
    assert reading.stop() == 0


def test_it_reads_frames_by_numbers_of_tfbus(
    bus: Bus, tmp_path: Path, language: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a compact stream that was there before, with the names of its description."""
    monkeypatch.setenv("TFBUS_POSES", "compact")
    robot = bus.node("robot")
    keep_sending(robot, "odom", "base_link")
    reading = listener(bus, tmp_path, language)
    reading.wait_for_line(r"^odom -> base_link: 0.* \(dynamic")
    keep_sending(bus.node("arm"), "base_link", "hand")
    reading.wait_for_line(r"^base_link -> hand: 0.* \(dynamic")
    assert [line for line in reading.out if line.startswith("refused")] == []
    assert reading.stop() == 0


def test_it_follows_a_stream_into_a_new_epoch(bus: Bus, tmp_path: Path, language: str) -> None:
    """A simulator was reset: what has earlier stamps is taken, and what came before is void."""
    reading = listener(bus, tmp_path, language)
    with bus.node("sim") as sim:
        broadcaster = TransformBroadcaster(sim)

        def send(second: int) -> None:
            pose = Transform((float(second), 0.0, 0.0))
            stamp_ns = second * 1_000_000_000
            broadcaster.send_transform(TransformStamped(stamp_ns, "world", "cart", pose))

        def shows(pattern: str) -> bool:
            return any(re.search(pattern, line) for line in reading.out)

        send_until(lambda: send(100), lambda: shows(r"world -> cart: 100"))
        send_until(lambda: send(20), lambda: shows(r"world -> cart: 20"))
        assert shows("^restarted sim|'sim' restarted")
    assert reading.stop() == 0


def mutated(payload: bytes, chance: random.Random) -> bytes:
    """The payload with up to four bytes changed, added or left out."""
    data = bytearray(payload)
    for _ in range(chance.choice([1, 1, 2, 4])):
        at = chance.randrange(len(data))
        data[at : at + chance.choice([0, 1])] = chance.choice([b"", chance.randbytes(1)])
    return bytes(data)


def with_odd_values(payload: bytes) -> list[bytes]:
    """The map with each of its values replaced by ones of other types."""
    message = msgpack.unpackb(payload)
    odd = [True, 0, 2, -1, 2**63, 1.5, "x", "\n", b"x", [], {}, ["a"], [["a", "b", 2]]]
    return [msgpack.packb({**message, key: value}) for key in [*message, "new"] for value in odd]


def rests(payload: bytes) -> list[bytes]:
    """What is too short, or not one map."""
    return [*(payload[:size] for size in range(len(payload))), payload * 2, b"\x90", b"\x80"]


def answers_of_c(program: str, lines: list[str]) -> list[str]:
    """What the C program prints for each of these messages."""
    given = "".join(f"lost @tfbus/stream/s\n{line}\n" for line in lines)
    done = subprocess.run([program, "listen"], input=given.encode(), capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    answers = done.stdout.decode().split("gone @tfbus/stream/s\n")[1:]
    assert len(answers) == len(lines)
    return answers


def test_all_refuse_the_same_messages(wire: ModuleType, program: str) -> None:
    """Python, C and tfbus agree on hundreds of changed messages, and none of them crashes."""
    edges = [("world", "a", 7, POSE), ("a", "b", 7, POSE)]
    good = wire.encode_transforms(5, 0, edges)
    chance = random.Random(16)
    payloads = [mutated(good, chance) for _ in range(1500)]
    payloads += with_odd_values(good) + rests(good)
    for name in ("", "/a", "a\n", "\u202ea", "a\x85", "é", "z" * 255, "z" * 256, "world"):
        payloads.append(wire.encode_transforms(5, 0, [("world", name, 7, POSE)]))
    assert_read_alike(wire, program, payloads)


def test_all_refuse_the_same_messages_with_numbers(wire: ModuleType, program: str) -> None:
    """Messages of either form, with the description of their stream, or before it comes."""
    named = [(0, "world", "a"), (1, "a", "b"), (3, "b", "c")]
    origins = struct.pack("<21d", *POSE * 3)
    good = wire.Description("/n", 5, [], poses="compact", next_number=5)
    good.numbered, good.origins = named, origins
    poses = struct.pack("=28d", *POSE, *(0.0, 9.0, 900.0, *POSE[3:]), *POSE, *POSE)
    chance = random.Random(16)
    payloads = []
    for is_short in (False, True):
        encoder = NumberedEncoder(5, (0, 1, 3, 7), origins + origins[:56], is_short=is_short)
        for stamps in ((7, 7, 7, 7), (1, 2, 3, 4)):
            payload = encoder.encode(0, struct.pack("=4q", *stamps), poses)
            payloads += [payload, *(mutated(payload, chance) for _ in range(500))]
            payloads += with_odd_values(payload) + rests(payload)
    message = msgpack.unpackb(payloads[0])
    for runs in (
        [0, -1],
        [-1, 4],
        [0, 300_001],
        [2**62, 4],
        [0, 4, 1],
        [4, 4],
        [0, 2, 0, 2],
        [2, 4],
    ):
        payloads.append(msgpack.packb({**message, "runs": runs}))
    for stamps in (bytes(8), b"", 2**63, None):
        payloads.append(msgpack.packb({**message, "stamps": stamps}))
    payloads.append(msgpack.packb({**message, "seq": None}))
    payloads.append(msgpack.packb({**message, "forms": b"\x04", "poses": b"\xff" * 24}))
    assert_read_alike(wire, program, payloads, wire.encode_description(good))
    assert_read_alike(wire, program, payloads[:50], b"")


def assert_read_alike(
    wire: ModuleType, program: str, payloads: list[bytes], described: bytes | None = None
) -> None:
    """Python, C and tfbus refuse the same of these messages, and count as many transforms in the
    others; those with numbers are of a stream that is described so, `b""` before it is.
    """
    lines = [f"message {payload.hex()} tf/s" for payload in payloads]
    numbers, ours = (wire.NO_NUMBERS, NO_NUMBERS) if described == b"" else (None, None)
    if described:
        lines = [f"message {described.hex()} @tfbus/stream/s\n{line}" for line in lines]
        numbers = wire.decode_description(described).numbers
        ours = numbers_of(read_description(described)[0])
    answers = answers_of_c(program, lines)
    assert any("refused tf/s" in answer for answer in answers)
    for payload, answer in zip(payloads, answers, strict=True):
        is_refused = refuses(partial(wire.decode_transforms, numbers=numbers), payload)
        of_tfbus = refuses(partial(decode_transforms, numbers=ours), payload)
        assert of_tfbus == is_refused or b"\xcf" in payload, payload
        assert ("refused tf/s" in answer) == is_refused, (payload, answer)
        if not is_refused:
            message = wire.decode_transforms(payload, numbers)
            assert len(re.findall(" -> ", answer)) == len(message.transforms), payload
            assert len(re.findall("refused transform", answer)) == len(message.refused), payload
            unnamed = re.findall(r"no name yet for number (\d+) ", answer)
            assert [*map(int, unnamed)] == message.unnamed, payload


def test_all_refuse_the_same_descriptions(wire: ModuleType, program: str) -> None:
    """As with messages of transforms."""
    edges = [("world", "a", False), ("a", "b", True)]
    plain = wire.Description("/n", 5, edges, "h", 3, "s")
    plain.numbered, plain.origins = [(0, "world", "a")], struct.pack("<7d", *POSE)
    good = wire.encode_description(plain)
    chance = random.Random(16)
    payloads = [mutated(good, chance) for _ in range(1500)] + with_odd_values(good) + rests(good)
    lines = [f"message {payload.hex()} @tfbus/stream/s" for payload in payloads]
    for payload, answer in zip(payloads, answers_of_c(program, lines), strict=True):
        is_refused = refuses(wire.decode_description, payload)
        assert refuses(read_description, payload) == is_refused or b"\xcf" in payload, payload
        assert answer.startswith("refused") == is_refused, (payload, answer)
        if not is_refused:
            count = len(wire.decode_description(payload).frames)
            assert f", {count} frames" in answer
            assert len(read_description(payload)[0].frames) == count


def refuses(decode: object, payload: bytes) -> bool:
    """Whether a decoder refuses the payload."""
    assert callable(decode)
    try:
        decode(payload)
    except (ValueError, DecodeError):
        return True
    return False


def test_the_c_program_keeps_to_the_limits(program: str) -> None:
    """More than a million values, or 16 MB, are refused; depth does not matter."""
    head = b"\x82\xa1v\x01\xa3new"
    many = head + b"\xdd" + (1_000_001).to_bytes(4, "big") + b"\xc0" * 1_000_001
    large = head + b"\xc6" + (16_000_000).to_bytes(4, "big") + bytes(16_000_000)
    deep = head + b"\x91" * 100_000 + b"\xc0"
    lines = [f"message {payload.hex()} tf/s" for payload in (many, large, deep)]
    values, size, depth = answers_of_c(program, lines)
    assert all(each.startswith("refused tf/s: ") for each in (values, size, depth))
    assert "more than 1000000 values" in values
    assert "more than 16000000 bytes" in size
    assert "'epoch' is missing" in depth


def test_keys_of_others_are_skipped(wire: ModuleType) -> None:
    """By the page's section on ROS 2; names come back from their chunks."""
    assert wire.stream_of("tf/a%2Fb/child") == "a/b"
    assert wire.chunk("a/b%") == "a%2Fb%25"
    assert wire.name_of(wire.chunk("a/b%#")) == "a/b%#"
    for key in ("tf", "tf/a/b/c", "tf_static/a/b", "tf/tf2_msgs::msg::dds_::TFMessage_", "rt/tf"):
        assert wire.stream_of(key) == ""


@pytest.mark.parametrize("language", ["c", "js"])
def test_the_points_of_a_cloud_are_read_where_they_lie(language: str, tmp_path: Path) -> None:
    """By C and by JavaScript; a message that is cut is refused."""
    xyz = np.arange(30_000, dtype=np.float32).reshape(-1, 3) / 64
    cloud = PointCloud.from_xyz(7, "lidar", xyz, intensity=np.ones(10_000, np.float32))
    if language == "c":
        flags = ("-g", SANITIZED, "-fno-sanitize-recover=all")
        command = [compile_program(tmp_path, *flags, name="points") or ""]
        command[0] = command[0] or compile_program(tmp_path, name="points") or ""
    else:
        command = [needs.program("node"), str(FOLDER / "points.js")]
    payload = encode_message(cloud)
    done = subprocess.run(command, input=payload, capture_output=True, check=True)
    count, *means = map(float, done.stdout.split())
    assert count == 10_000
    assert means == pytest.approx(xyz.astype(float).mean(axis=0).tolist(), rel=1e-5)
    for size in (0, 1, 50, 200, len(payload) // 2):
        assert subprocess.run(command, input=payload[:size], capture_output=True).returncode == 1


def rows_printed_by(
    language: str, program: str, described: Path, sent: Path
) -> tuple[int, list[list[str]]]:
    """The exit code and the words of each transform that a program prints of a message."""
    if language == "js":
        command = [needs.program("node"), str(FOLDER / "transforms.js"), str(described), str(sent)]
        done = subprocess.run(command, capture_output=True, text=True)
        return done.returncode, [line.split() for line in done.stdout.splitlines()]
    if language == "c":
        lines = f"message {described.read_bytes().hex()} @tfbus/stream/s\n"
        [answer] = answers_of_c(program, [f"{lines}message {sent.read_bytes().hex()} tf/s"])
        found = re.findall(r"^(\S+) -> (\S+): (.*), (.*) at (\d+)", answer, re.M)
        return int("refused" in answer or not found), [
            [parent, child, stamp, *xyz.split(), *quat.split()]
            for parent, child, xyz, quat, stamp in found
        ]
    command = [sys.executable, str(FOLDER / "tfbus_wire.py"), str(described)]
    done = subprocess.run(command, input=sent.read_bytes(), capture_output=True)
    found = re.findall(r"\('(\S+)', '(\S+)', (\d+), \((.*?)\)\)", done.stdout.decode())
    return done.returncode or not found, [[*row[:3], *row[3].split(", ")] for row in found]


@pytest.mark.parametrize("language", ["python", "c", "js"])
def test_frames_by_numbers_are_read(language: str, program: str, tmp_path: Path) -> None:
    """As tfbus reads them, both forms, and no message of another epoch or with bytes too few."""
    numbered = frozen_now()["numbered"]
    description = bytes.fromhex(numbered["description"])
    numbers = numbers_of(read_description(description)[0])
    described, sent = tmp_path / "description", tmp_path / "message"
    for poses in ("float32", "compact"):
        payload = bytes.fromhex(numbered[poses])
        described.write_bytes(description)
        sent.write_bytes(payload)
        code, rows = rows_printed_by(language, program, described, sent)
        assert code == 0
        expected = rows_of(decode_transforms(payload, numbers).batch)
        assert [(row[0], row[1], int(row[2])) for row in rows] == [row[:3] for row in expected]
        for row, (*_, pose) in zip(rows, expected, strict=True):
            # C prints nine digits, and quaternions of norm 1.
            assert [*map(float, row[3:])] == pytest.approx(pose, rel=1e-7)
        sent.write_bytes(payload[:-1])
        assert rows_printed_by(language, program, described, sent)[0] == 1
        sent.write_bytes(msgpack.packb(msgpack.unpackb(payload) | {"epoch": 1}))
        assert rows_printed_by(language, program, described, sent)[0] == 1


def test_no_program_of_the_wire_imports_tfbus() -> None:
    """Nor is one without a line that says how to run it."""
    for path in (*FOLDER.glob("*.py"), *FOLDER.glob("*.c"), *FOLDER.glob("*.js")):
        text = path.read_text()
        assert f"examples/wire/{path.name}" in text[:700], path
        assert not re.search(r"^\s*(import|from) tfbus\b", text, re.M), path


def test_history_is_answered(bus: Bus, tmp_path: Path) -> None:
    """A listener that joins late receives what talk.py sent before."""
    start(bus, tmp_path, "talk.py", "crow")
    early, late = Buffer(), Buffer()
    with TransformListener(early, bus.node("early")):
        eventually(lambda: early.can_transform("world", "crow"))
        sent_ns = early.lookup_transform("world", "crow").stamp_ns
        with TransformListener(late, bus.node("late"), history_s=60.0):
            eventually(lambda: late.can_transform("world", "crow", sent_ns))


def test_a_recording_that_was_written_without_tfbus_is_one(bus: Bus, tmp_path: Path) -> None:
    """The file of write_recording.py is whole, and its stream has its publisher and its rate."""
    needs.module("mcap")
    file = tmp_path / "mine.mcap"
    subprocess.run([sys.executable, str(FOLDER / "write_recording.py"), str(file)], check=True)
    shown = bus.run("bag", "info", str(file)).stdout
    assert "complete" in shown
    assert ["robot", "/robot", "1", "-", "101", "50", "20", "ms"] in [
        line.split() for line in shown.splitlines()
    ]
    with Recording(str(file)) as recording:
        place = recording.lookup_transform("map", "base_link", recording.end_ns - 1_000_000)
    assert place.transform.x == 2.0
