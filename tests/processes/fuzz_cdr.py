"""Spoilt and random messages of ROS through all that decodes them.

    python -m tests.processes.fuzz_cdr [--payloads 1000000] [--seconds 60] [--seed N]

The seed is printed; with it and the same number of payloads all of them come again. For each it
holds that the bytes are read or refused by DecodeError, in little memory and in no time; that a
reader of transforms that has seen other messages reads as a new one does, one by one and many at
once; that the codec of any type reads the same rows; and that a message read of a topic can be
written, and comes back.

The process may not take more than 512 MB beyond its memory at the start, and ends with a
traceback if a round takes a minute.
"""

import argparse
import faulthandler
import math
import random
import resource
import struct
import time
import tracemalloc
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tests.builders import at
from tfbus.base.errors import DecodeError
from tfbus.geometry.columns import Columns
from tfbus.messages import JointState, RobotDescription
from tfbus.ros.definitions import SEPARATOR, TF_MESSAGE, Definition
from tfbus.ros.ros1 import decode_ros1_tf_message
from tfbus.ros.schema import RAW, MessageCodec
from tfbus.ros.tf_message import TFMessageReader, TFMessageWriter, equal_parts, read_many
from tfbus.wire.codec import as_map

# What a wrong count, length or stamp is likely to be, and the ends of the numbers.
_WORDS = (0, 1, 2, 3, 7, 255, 65_536, 10**9 - 1, 10**9, 2**31 - 1, 2**31, 2**32 - 1)
_FLOATS = (math.nan, math.inf, -math.inf, -0.0, 5e-324, 1e308)

# What a payload may take while it is read: a map takes some hundred bytes for the one of an empty
# message, and an error or a table of places is made once.
_BYTES_A_BYTE = 400
_BYTES_AT_ONCE = 200_000
# Memory is measured for one payload in this many, since that takes time.
_MEASURED_EVERY = 20

# After this many there are new readers; and the text of a definition is spoilt, too.
ROUND = 2_000
_DEFINED_EVERY = 20
_ROUND_WITHIN_S = 60
_MOST_MEMORY = 512 * 2**20

_SOME_TYPES = Definition(
    "a/msg/T",
    f"B[] parts\nfloat32[3] three\nstring[] names\nbool[] flags\nuint8[] raw\nNone none\n"
    f"B[2] two\nNone[] nothing\n{SEPARATOR}\nMSG: a/B\nfloat64 x\nint16[] y\n"
    f"{SEPARATOR}\nMSG: a/None\n",
)
_PART = {"x": 0.5, "y": [1, 2, 3]}
_VALUES: dict[str, Any] = {
    "parts": [_PART] * 3,
    "three": [0.0, 1.0, 2.0],
    "names": ["a", "bcd", ""],
    "flags": [True, False],
    "raw": b"12345",
    "none": {},
    "two": [_PART] * 2,
    "nothing": [{}] * 3,
}
_OWN_VALUES = {**_VALUES, "empty": [], "any": None, "map": {"é": [[1]]}}


@dataclass(frozen=True)
class Sample:
    """A valid message, and what reads it: a codec, or "transforms" or "transforms of ROS 1"."""

    data: bytes
    codec: MessageCodec | str


def samples() -> list[Sample]:
    """Messages as ROS has them: transforms in both byte orders and of ROS 1, and topics."""
    joints = JointState(10**18, ("a", "b"), (0.5, 1.0), (), (1.0, 2.0))
    robot = RobotDescription("<robot/>", "left/", "package://a/b.urdf")
    deep = RobotDescription("<robot/>\n<!-- tfbus: " + 5_000 * "[" + " -->", "", "")
    messages = [
        (MessageCodec.of_definition(_SOME_TYPES), _VALUES),
        (MessageCodec.of_values("T", _OWN_VALUES), _OWN_VALUES),
        (RAW, _VALUES),
        *((MessageCodec.of_type(type(each)), as_map(each)) for each in (joints, robot, deep)),
    ]
    found = [
        Sample(data, "transforms") for count in (0, 1, 2, 8, 30) for data in _transforms(count)
    ]
    found.append(Sample(_big_endian(), "transforms"))
    found += [Sample(_ros1(count), "transforms of ROS 1") for count in (0, 1, 5)]
    for codec, values in messages:
        data = codec.encode(values)
        assert data is not None
        found.append(Sample(data, codec))
    return found


def _transforms(count: int) -> list[bytes]:
    """The message with `count` transforms, and one of the same size with other names."""
    rows = [at(0.1 * row, f"joint{row}", 10**18 + row) for row in range(count)]
    others = [at(0.1 * row, f"wheel{row}", 10**18 + row) for row in range(count)]
    return [TFMessageWriter().write(Columns.of_transforms(each)) for each in (rows, others)]


def _big_endian() -> bytes:
    """The message with one transform, in the other byte order."""
    names = b"\0\0\0\2a\0\0\0" + b"\0\0\0\2b\0" + bytes(6)
    return bytes(4) + struct.pack(">IiI", 1, 2, 3) + names + struct.pack(">7d", *range(7))


def _ros1(count: int) -> bytes:
    rows = [
        struct.pack("<4I", row, 5, 6, 5) + b"world" + struct.pack("<I", 6) + b"frame%d" % row
        for row in range(count)
    ]
    pose = struct.pack("<7d", 1, 2, 3, 0, 0, 0, 1)
    return struct.pack("<I", count) + b"".join(row + pose for row in rows)


class Payloads:
    """Spoilt messages, the same ones from one seed."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self._samples = samples()

    def next(self) -> Sample:
        """One more: mostly a message with one to three mistakes, now and then random bytes."""
        sample = self.chance.choice(self._samples)
        if self.chance.random() < 0.05:
            random_bytes = self.chance.randbytes(self.chance.randrange(200))
            header = self.chance.choice((b"", sample.data[:4]))
            return Sample(header + random_bytes, sample.codec)
        return Sample(self.spoilt(sample.data), sample.codec)

    def spoilt(self, data: bytes) -> bytes:
        """The bytes with one to three mistakes."""
        chance, changed = self.chance, bytearray(data)
        for _ in range(chance.choice((0, 1, 1, 2, 3))):
            place = chance.randrange(len(changed) + 1)
            how = chance.randrange(8)
            if how == 0:
                del changed[place:]
            elif how == 1:
                changed[place:place] = chance.randbytes(chance.randrange(9))
            elif how == 2:
                changed[place : place + 1] = chance.randbytes(1)
            elif how == 3:
                del changed[place : place + chance.randrange(9)]
            elif how == 4:
                other = chance.choice(self._samples).data
                changed[place:] = other[chance.randrange(len(other)) :]
            elif how == 5:
                place -= place % 8
                changed[place : place + 8] = struct.pack("<d", chance.choice(_FLOATS))
            else:
                place -= place % 4
                changed[place : place + 4] = struct.pack("<I", chance.choice(_WORDS))
        return bytes(changed)


class Target:
    """All that decodes, with what it has seen before."""

    def __init__(self) -> None:
        self._reader = TFMessageReader()
        self._any = MessageCodec.of_definition(TF_MESSAGE)
        self._came: list[bytes] = []

    def receive(self, sample: Sample) -> bool:
        """Decode one; whether it could be read."""
        if isinstance(sample.codec, MessageCodec):
            return _read_message(sample.codec, sample.data)
        if sample.codec == "transforms":
            return self._read_transforms(sample.data)
        return _read(decode_ros1_tf_message, sample.data) is not None

    def examine(self) -> None:
        """Read all transforms that were read one by one at once: they are the same rows."""
        whole = {
            index: rows
            for indices, many in read_many(self._reader, self._came)
            for index, rows in zip(indices, equal_parts(many, len(indices)), strict=True)
        }
        assert len(whole) == len(self._came)
        for index, data in enumerate(self._came):
            assert _content(whole[index]) == _content(TFMessageReader().read(data))

    def _read_transforms(self, data: bytes) -> bool:
        expected = _read(TFMessageReader().read, data)
        found = _read(self._reader.read, data)
        message = _read(self._any.decode, data)
        if expected is None:
            assert found is None, "refused, and read once others have come"
            return False
        assert found is not None and _content(found) == _content(expected)
        assert message is not None and len(message["transforms"]) == expected.count
        pairs = [
            (row["header"]["frame_id"], row["child_frame_id"]) for row in message["transforms"]
        ]
        frames = expected.frames
        assert pairs == [(frames[parent], frames[child]) for parent, child in expected.pairs()]
        self._came.append(data)
        return True


def _read(read: Callable[[bytes], Any], data: bytes) -> Any:
    """What is read; None for a DecodeError, which is a sentence. Nothing else is raised."""
    try:
        return read(data)
    except DecodeError as error:
        assert 0 < len(str(error)) < 500
        return None


def _read_message(codec: MessageCodec, data: bytes) -> bool:
    values = _read(codec.decode, data)
    if values is None:
        return False
    assert isinstance(values, dict)
    written = codec.encode(values)
    # A description that says of itself what tfbus would write there is none that it writes.
    if written is not None:
        # By their text, since a number may be none.
        assert repr(codec.decode(written)) == repr(values)
    return True


def _content(rows: Columns) -> tuple[Any, ...]:
    """All that rows say, to the last bit."""
    columns = (rows.edges_bytes(), rows.stamps_bytes(), rows.poses_bytes())
    return rows.frames, rows.count, *columns


def fuzz(seed: int, payloads: int, seconds: float = math.inf) -> Counter[str]:
    """Decode this many payloads in at most this time: how many were read, and refused."""
    made = Payloads(seed)
    report: Counter[str] = Counter()
    ends = time.monotonic() + seconds
    while report["payloads"] < payloads and time.monotonic() < ends:
        target = Target()
        faulthandler.cancel_dump_traceback_later()
        faulthandler.dump_traceback_later(_ROUND_WITHIN_S, exit=True)
        for number in range(min(ROUND, payloads - report["payloads"])):
            sample = made.next()
            try:
                is_read = _measured(target, sample, report, is_due=not number % _MEASURED_EVERY)
                if number % _DEFINED_EVERY == 0:
                    report["definitions"] += 1
                    report["definitions read"] += _define(made)
            except BaseException:
                print(f"seed {seed}, payload {report['payloads']}: {sample.data.hex()}", flush=True)
                raise
            report["payloads"] += 1
            report["read" if is_read else "refused"] += 1
        target.examine()
    faulthandler.cancel_dump_traceback_later()
    return report


def _measured(target: Target, sample: Sample, report: Counter[str], *, is_due: bool) -> bool:
    """Decode one; where it is due, see what memory that takes."""
    if not is_due:
        return target.receive(sample)
    tracemalloc.start()
    try:
        is_read = target.receive(sample)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < _BYTES_AT_ONCE + _BYTES_A_BYTE * len(sample.data), f"it took {peak} bytes"
    report["most memory, bytes"] = max(report["most memory, bytes"], peak)
    return is_read


def _define(made: Payloads) -> bool:
    """Decode random bytes by a spoilt definition; whether that is one."""
    text = made.spoilt(made.chance.choice((_SOME_TYPES, TF_MESSAGE)).text.encode())
    definition = Definition("a/msg/T", text.decode(errors="replace"))
    try:
        codec = MessageCodec.of_definition(definition)
    except DecodeError:
        return False
    _read(codec.decode, b"\0\1\0\0" + made.chance.randbytes(200))
    return True


def main() -> None:
    """Fuzz, and say how it went."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=math.inf)
    parser.add_argument("--payloads", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=time.time_ns() % 2**32)
    arguments = parser.parse_args()
    print(f"seed {arguments.seed}", flush=True)
    with open("/proc/self/statm") as memory:
        size = int(memory.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + _MOST_MEMORY,) * 2)
    began_s = time.monotonic()
    report = fuzz(arguments.seed, arguments.payloads, arguments.seconds)
    for what, count in report.items():
        print(f"{what}: {count:,}")
    most_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"in {time.monotonic() - began_s:.0f} s, with at most {most_mb:.0f} MB")


if __name__ == "__main__":
    main()
