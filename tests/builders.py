"""Functions of tests that build transforms, messages and descriptions, and read a buffer."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from tfbus import Buffer, Transform, TransformBatch, TransformStamped
from tfbus.buffer.store import Store
from tfbus.geometry.columns import Columns
from tfbus.recording.items import Item, RecordedStream, TransformItem
from tfbus.streams.info import StreamState
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.transforms import TransformMessage, encode_transforms

S = 1_000_000_000

Row = tuple[str, str, bool]

# The frozen bytes of a message of two transforms.
STAMP_NS = 1670400305709085026
EPOCH_NS = 1670400300000064000
SAMPLE = bytes.fromhex(
    "86"
    "a176 01"
    "a565706f6368 cf 172e74390235b200"
    "a66672616d6573 93 a5776f726c64 a7747572746c6531 a564726f6e65"
    "a56564676573 c410 00000000 01000000  01000000 02000000"
    "a67374616d7073 c410 62717e563a742e17 62717e563a742e17"
    "a5706f736573 c470"
    "000000000000f83f 00000000000000c0 0000000000000000"
    "0000000000000000 0000000000000000 333333333333e33f 9a9999999999e93f"
    "000000000000e0bf 0000000000000000 000000000000f03f"
    "0000000000000000 0000000000000000 0000000000000000 000000000000f03f"
)


def at(
    x: float = 0.0, child: str = "turtle1", stamp_ns: int = S, *, parent: str = "world"
) -> TransformStamped:
    """`child` at (x, 0, 0) in `parent`, for tests of what is sent: the frame is what matters."""
    return TransformStamped(stamp_ns, parent, child, Transform((x, 0, 0)))


def moved(stamp_ns: int, parent: str, child: str, x: float = 0.0) -> TransformStamped:
    """The same, for tests of the buffer: stamp and parent are always given."""
    return at(x, child, stamp_ns, parent=parent)


def message(
    transforms: Iterable[TransformStamped], epoch_ns: int = 1, seq: int | None = None
) -> TransformMessage:
    """The message that a stream sends of these transforms."""
    return TransformMessage(TransformBatch.from_transforms(transforms), epoch_ns, seq)


def payload(
    transforms: Iterable[TransformStamped], epoch_ns: int = 1, seq: int | None = None
) -> bytes:
    """The bytes of `message`."""
    return encode_transforms(message(transforms, epoch_ns, seq))


def description(rows: Iterable[Row], *, epoch: int = 1, **more: Any) -> StreamDescription:
    """The description of a stream with these rows of parent, child and whether it is static."""
    return StreamDescription(1, "/node", epoch, tuple(rows), **more)


def live_stream(stream: str, description: StreamDescription) -> StreamState:
    """The state of a live stream that has this description."""
    return StreamState(stream, True, description, f"@tfbus/stream/{stream}")


def store_of(buffer: Buffer) -> Store:
    """The inside of a buffer, for promises that no call shows: its lock, and how much it keeps."""
    return buffer._store


def x_of(buffer: Buffer, target: str = "world", source: str = "turtle1") -> float | None:
    """The source's x in the target, to the nanometre; None without a transform."""
    if not buffer.can_transform(target, source):
        return None
    return round(buffer.lookup_transform(target, source).transform.x, 9)


def rows_of(batch: TransformBatch) -> list[tuple[str, str, int, tuple[float, ...]]]:
    """A batch as plain rows, to be compared."""
    return [
        (batch.frames[parent], batch.frames[child], stamp, tuple(pose))
        for (parent, child), stamp, pose in zip(
            batch.edges.tolist(), batch.stamps_ns.tolist(), batch.poses.tolist(), strict=True
        )
    ]


# For hypothesis


def examples(count: int) -> int:
    """How many examples a test draws that draws `count` in `make test`: fewer in `make quick`."""
    return max(2, count * settings().max_examples // 100)


lengths = st.floats(-10, 10)
units = st.floats(-1, 1)
names = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
int64 = st.integers(-(2**63), 2**63 - 1)
poses = st.tuples(*[st.floats(allow_nan=False)] * 7)


@st.composite
def transforms(draw: st.DrawFn) -> Transform:
    """Any translation within ten metres a side, with any rotation."""
    quaternion = np.array(draw(st.tuples(units, units, units, units)))
    norm = np.linalg.norm(quaternion)
    if norm < 0.1:
        quaternion, norm = np.array((0, 0, 0, 1.0)), 1.0
    return Transform(draw(st.tuples(lengths, lengths, lengths)), quaternion / norm)


@st.composite
def messages(draw: st.DrawFn) -> TransformMessage:
    """Any message of up to eight transforms, with numbers that no robot sends."""
    frames = draw(st.lists(names, min_size=1, max_size=6, unique=True))
    index = st.integers(0, len(frames) - 1)
    edges = draw(st.lists(st.tuples(index, index), max_size=8))
    count = len(edges)
    batch = TransformBatch(
        tuple(frames),
        np.array(edges, dtype=np.uint32).reshape(count, 2),
        np.array(draw(st.lists(int64, min_size=count, max_size=count)), dtype=np.int64),
        np.array(draw(st.lists(poses, min_size=count, max_size=count)), dtype=float).reshape(-1, 7),
    )
    return TransformMessage(batch, draw(st.integers(0, 2**63 - 1)))


def in_recording(
    log_ns: int,
    transforms: Iterable[TransformStamped],
    *,
    stream: str = "sim",
    epoch_ns: int = 1,
    static: bool = False,
    seq: int | None = None,
) -> TransformItem:
    """A message of transforms as a recording holds it."""
    told = RecordedStream(stream, f"/{stream}", "", epoch_ns)
    return TransformItem(log_ns, told, Columns.of_transforms(transforms), static, seq)


def as_values(item: Item) -> tuple[object, ...]:
    """All that an item of a recording says, to be compared."""
    if not isinstance(item, TransformItem):
        return (item,)
    rows = item.rows
    edges = [(rows.frames[parent], rows.frames[child]) for parent, child in rows.pairs()]
    told = (item.log_ns, item.stream, item.static, item.seq)
    return (*told, edges, rows.stamps_bytes(), rows.poses_bytes())
