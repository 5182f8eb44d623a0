"""Spoilt and random payloads through the real decoder and a listener's reception.

    python -m tests.processes.fuzz_transforms --seconds 60 [--seed N] [--payloads 1000000]

The seed is printed; with it and the same number of payloads all of them come again. For each
payload it holds that nothing is raised, that the fast way to read it finds the same as the
other one, and that it is counted: as a message, as one that cannot be read, with the reason, or as
one of an earlier epoch, or of the future. Each row is taken, or refused for a reason that is
counted, or too old. And another publisher's transforms are as before. Spoilt descriptions come
between the messages, and the tools show the state after a round.
"""

import argparse
import logging
import math
import random
import struct
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import msgpack

from tests.builders import description
from tests.processes.fuzz_tools import Tools
from tests.streams.received import appear
from tfbus import Buffer, DecodeError, Transform, TransformException, TransformStamped
from tfbus.geometry.batch import TransformBatch
from tfbus.streams.info import StreamInfo, StreamState
from tfbus.streams.reception import DynamicReception, StreamReception
from tfbus.wire.codec import encode_message
from tfbus.wire.descriptions import StreamDescription, read_description
from tfbus.wire.keys import stream_key
from tfbus.wire.transform_bytes import NameTables, scan_message
from tfbus.wire.transforms import (
    TransformMessage,
    TransformReader,
    decode_transforms,
    encode_transforms,
)

S = 10**9
# What is sent to one buffer before it is examined as a whole, and another takes its place.
ROUND = 500
# After this many the publisher restarts, on a host with another clock.
REAPPEARS = 5

# A description comes once in this many messages.
_DESCRIBED_EVERY = 10

# Bytes that mean something to MessagePack, or stand at the ends of ranges.
_TELLING = bytes([0x00, 0x7F, 0x80, 0x8F, 0x90, 0xA0, 0xBF, 0xC0, 0xC1, 0xC2, 0xC3, 0xC4, 0xC6])
_TELLING += bytes([0xC7, 0xC9, 0xCA, 0xCB, 0xCF, 0xD3, 0xD9, 0xDB, 0xDC, 0xDD, 0xDE, 0xDF, 0xFF])
_FLOATS = [math.nan, math.inf, -math.inf, 0.0, -0.0, 1e308, 5e-324, 1.0 + 1e-9, -1.0]
_INTEGERS = [0, 1, -1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, -(2**63), 2**64 - 1]


def samples() -> list[bytes]:
    """Messages as tfbus sends them: of no, one, two and many transforms, deep and wide."""

    def transform(parent: str, child: str, number: int) -> TransformStamped:
        pose = Transform((number, 0.5, -2.0), (0.0, 0.0, 0.6, 0.8))
        return TransformStamped(1000 * S + number, parent, child, pose)

    chains = [
        [],
        [transform("world", "turtle1", 0)],
        [transform("world", "turtle1", 1), transform("turtle1", "drone", 2)],
        [transform(f"link{i}", f"link{i + 1}", i) for i in range(20)],
        [transform("world", f"turtle{i}", i) for i in range(40)],
        [transform("world", "t" * 255, 3)],
        [transform("wörld", "\N{TURTLE}", 4)],
    ]
    return [
        encode_transforms(TransformMessage(TransformBatch.from_transforms(chain), epoch_ns, seq))
        for chain in chains
        for epoch_ns, seq in ((5 * S, None), (5 * S, 0), (6 * S, 70_000))
    ]


def descriptions() -> list[bytes]:
    """Descriptions as tfbus sends them: of no and of many frames, with all fields and with few."""
    rows = [[("world", f"turtle{i}", i % 2 == 0) for i in range(count)] for count in (0, 1, 30)]
    few = [description(each, epoch=5 * S) for each in rows]
    more: dict[str, Any] = {"host": "h", "pid": 7, "session": "ab12", "priority": 2, "split": True}
    full = [description(each, epoch=6 * S, history_s=3.0, started_ns=S, **more) for each in rows]
    return [encode_message(each) for each in (*few, *full)]


class Payloads:
    """Payloads that are one like another, from a seed; spoilt ones of these samples."""

    def __init__(self, seed: int, good: list[bytes]) -> None:
        self._random = random.Random(seed)
        self._samples = good
        self._spoil: list[Callable[[bytearray], None]] = [
            self._flip,
            self._put_telling,
            self._insert,
            self._delete,
            self._double,
            self._cut,
            self._splice,
            self._put_number,
        ]

    def next(self) -> bytes:
        """One more: mostly a message with something wrong, now and then bytes without sense."""
        kind = self._random.random()
        if kind < 0.05:
            return self._random.randbytes(self._random.randrange(200))
        if kind < 0.30:
            return self._changed(self._random.choice(self._samples))
        spoilt = bytearray(self._random.choice(self._samples))
        for _ in range(self._random.choice((0, 1, 1, 1, 2, 4, 8))):
            self._random.choice(self._spoil)(spoilt)
        return bytes(spoilt)

    def _changed(self, sample: bytes) -> bytes:
        """A message with another value for a column."""
        columns: dict[str, Any] = msgpack.unpackb(sample)
        key = self._random.choice([*columns, "seq", "more"])
        columns[key] = self._value(key, columns.get(key))
        if self._random.random() < 0.1:
            del columns[self._random.choice([*columns])]
        return bytes(msgpack.packb(columns))

    def _value(self, key: str, former: object) -> object:
        pick = self._random.choice
        if isinstance(former, bytes) and former and pick((True, True, False)):
            spoilt = bytearray(former)
            self._put_number(spoilt)
            return bytes(spoilt)
        if isinstance(former, list) and former and pick((True, True, False)):
            names = [*former]
            other = pick(["", "/world", "world", 7, "a\0b", "\ufffd", "x" * 2000, former[0]])
            names[self._random.randrange(len(names))] = other
            return names
        depth: list[object] = []
        for _ in range(self._random.randrange(600)):
            depth = [depth]
        many = [
            pick(_INTEGERS),
            pick(_FLOATS),
            None,
            True,
            "",
            "text",
            b"",
            b"1234567",
            {},
            {"v": 1},
        ]
        return pick([*many, [], ["world"], depth, {1: 2}, msgpack.Timestamp(1, 2)])

    def _place(self, spoilt: bytearray, width: int = 1) -> int:
        return self._random.randrange(max(1, len(spoilt) - width + 1))

    def _flip(self, spoilt: bytearray) -> None:
        if spoilt:
            spoilt[self._place(spoilt)] ^= 1 << self._random.randrange(8)

    def _put_telling(self, spoilt: bytearray) -> None:
        if spoilt:
            spoilt[self._place(spoilt)] = self._random.choice(_TELLING)

    def _insert(self, spoilt: bytearray) -> None:
        at = self._place(spoilt)
        spoilt[at:at] = self._random.randbytes(self._random.randrange(1, 9))

    def _delete(self, spoilt: bytearray) -> None:
        at = self._place(spoilt)
        del spoilt[at : at + self._random.randrange(1, 9)]

    def _double(self, spoilt: bytearray) -> None:
        at = self._place(spoilt)
        spoilt[at:at] = spoilt[at : at + self._random.randrange(1, 64)]

    def _cut(self, spoilt: bytearray) -> None:
        del spoilt[self._place(spoilt) :]

    def _splice(self, spoilt: bytearray) -> None:
        other = self._random.choice(self._samples)
        spoilt[self._place(spoilt) :] = other[self._random.randrange(len(other)) :]

    def _put_number(self, spoilt: bytearray) -> None:
        number = struct.pack("<d", self._random.choice(_FLOATS))
        if self._random.random() < 0.5:
            number = (self._random.choice(_INTEGERS) % 2**64).to_bytes(8, "little")
        at = self._place(spoilt, 8)
        spoilt[at : at + 8] = number[: len(spoilt) - at]


class CountingBuffer(Buffer):
    """Knows how many rows it was given, and what became of them."""

    given = taken = refused = 0

    def set_transforms(self, batch: Any, **how: Any) -> int:
        """As a buffer's; it may come to itself, where a change lets refused statics try again."""
        before, before_here = self.rejected.rows, self.refused
        taken = super().set_transforms(batch, **how)
        refused = self.rejected.rows - before - (self.refused - before_here)
        self.refused += refused
        too_old = len(batch) - taken - refused
        assert too_old >= 0, f"{len(batch)} rows: more were taken or refused"
        self.given += len(batch)
        self.taken += taken
        return taken


class Logged(logging.Handler):
    """Keeps what is logged."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep one."""
        self.texts.append(record.getMessage())


class Target:
    """A listener's reception of a stream that sends anything, beside a publisher that is sane."""

    def __init__(self) -> None:
        self.buffer = CountingBuffer()
        self.sane = [
            TransformStamped(S, "sane_root", "sane_arm", Transform((1, 2, 3), (0, 0, 0, 1))),
            TransformStamped(S, "sane_arm", "sane_tool", Transform((0, 0, 1), (0, 0, 0.6, 0.8))),
        ]
        for transform in self.sane:
            self.buffer.set_transform(transform, authority="sane")
        self.before = self._sane_now()
        self.log = logging.getLogger("fuzz")
        self.logged = Logged()
        self.log.handlers = [self.logged]
        self.log.propagate = False
        self.stream = StreamReception(
            "fuzz", self.buffer, self.log, time.time_ns, TransformReader()
        )
        self.keys = [DynamicReception(self.stream), self.stream.statics]
        self.described: StreamDescription | None = None
        self.tools = Tools(self.buffer, self._infos)
        self.reasons: Counter[str] = Counter()
        self.received = self.refused = self.fast = 0

    def receive(self, payload: bytes, *, static: bool) -> None:
        """Let it come in as from Zenoh, and see that it is counted as what it is."""
        reason = self._reason(payload)
        stream = self.stream
        if self.received % REAPPEARS == 0:
            # So an epoch that a spoilt message made up does not outlive it for long.
            stream.vanish()
            appear(stream)
        self.received += 1
        before = self._counts()
        self.keys[static].receive(payload)
        self.tools.receive("tf/fuzz", payload)
        after = self._counts()
        counted = [now - then for now, then in zip(after, before, strict=True)]
        if reason is None:
            assert counted in ([1, 0, 0], [0, 0, 1]), f"a message was counted as {counted}"
            return
        assert counted == [0, 1, 0], f"refused ({reason}), but counted as {counted}"
        assert 0 < len(reason) < 500, "a reason is a sentence"
        self.reasons[reason.partition(" ")[0]] += 1
        self.refused += 1
        if self.refused == 1:
            assert reason in self.logged.texts[-1], "the first reason is logged"

    def _counts(self) -> tuple[int, int, int]:
        counts = self.stream.counts
        return counts.messages, counts.rejected, counts.outdated + counts.disputed

    def describe(self, payload: bytes) -> bool:
        """Let a description come in; whether it can be read."""
        try:
            described, mistake = read_description(payload)
        except DecodeError as error:
            assert 0 < len(str(error)) < 1000, "a reason is a sentence"
            return False
        assert len(mistake) < 500
        self.described = described
        children = frozenset(child for _, child, _ in described.frames)
        statics = frozenset(child for _, child, static in described.frames if static)
        self.stream.describe(described.epoch, children, statics)
        return True

    def _infos(self) -> list[StreamInfo]:
        state = StreamState("fuzz", True, self.described, stream_key("fuzz"))
        return [self.stream.report(state), StreamInfo("sane", alive=True)]

    def _reason(self, payload: bytes) -> str | None:
        """Why it is refused, None where it is read; and the fast way agrees."""
        found = scan_message(payload, NameTables())
        try:
            message = decode_transforms(payload)
        except DecodeError as error:
            assert found is None, "the fast way reads what must be refused"
            return str(error)
        if found is not None:
            self.fast += 1
            _check_equal(found, message)
        return None

    def examine(self) -> None:
        """What is in the buffer makes sense, what another sent is as it was, and the tools live."""
        self.tools.look(self.described)
        assert self._sane_now() == self.before, "edges of another publisher were harmed"
        assert self.buffer.given >= self.buffer.taken + self.buffer.rejected.rows
        assert len(self.buffer.rejected) <= 101, "reasons are kept without bound"
        for info in self.buffer.all_frames():
            assert info.name and not info.name.startswith("/"), f"a frame is called {info.name!r}"
            if info.parent is None or not info.samples:
                continue
            with_parent = self._pose(info.parent, info.name)
            if with_parent is not None:
                assert all(map(math.isfinite, with_parent)), f"{info.name!r} is nowhere"
                norm = math.hypot(*with_parent[3:])
                assert abs(norm - 1.0) < 1e-6, f"the quaternion of {info.name!r} has norm {norm}"

    def _pose(self, parent: str, child: str) -> tuple[float, ...] | None:
        try:
            return self.buffer.lookup_transform(parent, child).transform.as_pose()
        except TransformException:
            return None

    def _sane_now(self) -> list[object]:
        frames = [self.buffer.frame(name) for name in ("sane_root", "sane_arm", "sane_tool")]
        return [*frames, self.buffer.lookup_transform("sane_root", "sane_tool", S)]


def _check_equal(scanned: TransformMessage, message: TransformMessage) -> None:
    batch, found = message.batch, scanned.batch
    assert (scanned.epoch_ns, scanned.seq) == (message.epoch_ns, message.seq)
    assert found.frames == batch.frames
    for one, other in (
        (found.edges, batch.edges),
        (found.stamps_ns, batch.stamps_ns),
        (found.poses, batch.poses),
    ):
        assert one.tobytes() == other.tobytes(), "the fast way reads something else"


def fuzz(seed: int, payloads: int, seconds: float = math.inf) -> Counter[str]:
    """Send this many payloads in at most this time: how many were sent, read, and refused why."""
    made, told = Payloads(seed, samples()), Payloads(seed, descriptions())
    report: Counter[str] = Counter()
    ends = time.monotonic() + seconds
    while report["payloads"] < payloads and time.monotonic() < ends:
        target = Target()
        for number in range(min(ROUND, payloads - report["payloads"])):
            payload = made.next()
            try:
                target.receive(payload, static=number % 5 == 0)
                if number % _DESCRIBED_EVERY == 0:
                    payload = told.next()
                    report["descriptions"] += 1
                    report["descriptions read"] += target.describe(payload)
            except BaseException:
                print(f"seed {seed}, payload {report['payloads']}: {payload.hex()}", flush=True)
                raise
            report["payloads"] += 1
        target.examine()
        report["read"] += target.stream.counts.messages
        report["read fast"] += target.fast
        report["outdated"] += target.stream.counts.outdated + target.stream.counts.disputed
        report["refused"] += target.refused
        report["rows"] += target.buffer.given
        report["rows refused"] += target.buffer.rejected.rows
        report.update({f"  {reason}": count for reason, count in target.reasons.items()})
    return report


def main() -> None:
    """Fuzz, and say how it went."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=math.inf)
    parser.add_argument("--payloads", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=time.time_ns() % 2**32)
    arguments = parser.parse_args()
    print(f"seed {arguments.seed}", flush=True)
    for what, count in fuzz(arguments.seed, arguments.payloads, arguments.seconds).items():
        print(f"{what}: {count:,}")


if __name__ == "__main__":
    main()
