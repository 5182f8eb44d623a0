"""Reads many messages of transforms at once, all with the same frames in one step."""

import sys
from collections.abc import Collection, Iterator, Sequence
from functools import lru_cache
from struct import iter_unpack
from typing import TYPE_CHECKING

from tfbus.core.packed import EDGE_SIZE, POSE_SIZE, STAMP_SIZE
from tfbus.geometry.columns import Columns
from tfbus.ros.cdr import HEADER, HEADER_SIZE
from tfbus.ros.tf_message import TFMessageReader

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
else:
    from tfbus.core import lazy_numpy as np

_SECOND_NS = 1_000_000_000
_STAMP_AT = HEADER_SIZE + 4
_NAMES_AT = _STAMP_AT + STAMP_SIZE
_ONE = HEADER + b"\x01\x00\x00\x00"

# Below this number of messages reading each for itself is faster.
_FEW = 4


def read_many(
    reader: TFMessageReader,
    messages: Sequence[bytes],
    children: Collection[str] | None = None,
) -> list[tuple[list[int], Columns]]:
    """The transforms of these messages with all child frames or these, bit by bit: groups of
    messages with the same frames, as their indices and the rows of all of them, each message's
    after the other's.

    Raises as `TFMessageReader.read`.
    """
    alike: dict[object, list[int]] = {}
    for at, data in enumerate(messages):
        # Names of one transform are between its numbers; those of several are compared later.
        is_one = data[:_STAMP_AT] == _ONE
        alike.setdefault(data[_NAMES_AT:-POSE_SIZE] if is_one else len(data), []).append(at)
    groups = []
    for members in alike.values():
        groups += _groups(reader, messages, members, children)
    return groups


def equal_parts(rows: Columns, count: int) -> Iterator[Columns]:
    """The rows in this number of parts with the same edges, one message each."""
    size = rows.count // count
    edges = rows.edges_bytes()[: EDGE_SIZE * size]
    stamps, poses = rows.stamps_bytes(), rows.poses_bytes()
    for start in range(0, size * count, size) if size else [0] * count:
        end = start + size
        yield Columns.of_bytes(
            rows.frames,
            edges,
            stamps[STAMP_SIZE * start : STAMP_SIZE * end],
            poses[POSE_SIZE * start : POSE_SIZE * end],
        )


def _groups(
    reader: TFMessageReader,
    messages: Sequence[bytes],
    members: list[int],
    children: Collection[str] | None,
) -> list[tuple[list[int], Columns]]:
    """The same of messages that have one size."""
    groups: list[tuple[list[int], Columns]] = []
    while len(members) >= _FEW and len(groups) < _FEW:
        found = _like_first(reader, [messages[at] for at in members], children)
        if found is None:
            break
        rows, taken = found
        groups.append(([at for at, is_in in zip(members, taken, strict=True) if is_in], rows))
        members = [at for at, is_in in zip(members, taken, strict=True) if not is_in]
    for at in members:
        rows = reader.read(messages[at])
        groups.append(([at], rows if children is None else rows.only(children)))
    return groups


def _like_first(
    reader: TFMessageReader, messages: list[bytes], children: Collection[str] | None
) -> tuple[Columns, list[bool]] | None:
    """The rows of the messages with the frames of the first, and which these are; None if the
    first is not as others are written, or a stamp is none.
    """
    first = reader.read(messages[0])
    if not first.count:
        return None
    places = _places(first.frames, first.edges_bytes(), len(messages[0]))
    if places is None or messages[0][:HEADER_SIZE] != HEADER:
        return None
    stamp_at, pose_at = places
    words = np.frombuffer(b"".join(messages), "<u4").reshape(len(messages), -1)
    is_fixed = np.ones(words.shape[1], bool)
    is_fixed[stamp_at] = is_fixed[stamp_at + 1] = is_fixed[pose_at] = False
    same = (words[:, is_fixed] == words[0, is_fixed]).all(axis=1)
    if not same.all():
        words = words[same]
    if words[:, stamp_at + 1].max() >= _SECOND_NS:
        return None
    edges = first.edges_bytes()
    if children is not None:
        pairs = np.frombuffer(edges, np.uint32).reshape(-1, 2)
        kept = np.array([frame in children for frame in first.frames], bool)[pairs[:, 1]]
        edges, stamp_at = pairs[kept].tobytes(), stamp_at[kept]
        pose_at = pose_at.reshape(len(kept), -1)[kept].ravel()
    nanoseconds = words[:, stamp_at + 1]
    stamps = words[:, stamp_at].astype(np.int32) * np.int64(_SECOND_NS) + nanoseconds
    poses = words[:, pose_at]
    if sys.byteorder != "little":
        poses = poses.astype("<u4").view("<f8").astype(np.float64)
    rows = Columns.of_bytes(first.frames, edges * len(words), stamps.tobytes(), poses.tobytes())
    return rows, same.tolist()


@lru_cache(256)
def _places(
    frames: tuple[str, ...], edges: bytes, size: int
) -> "tuple[NDArray[np.intp], NDArray[np.intp]] | None":
    """The offsets of the stamps and of the numbers of the poses in a message, in words of four
    bytes; None if the message has another size.
    """
    lengths = [len(name.encode()) + 1 for name in frames]
    stamp_at, pose_at, at = [], [], _STAMP_AT
    for edge in iter_unpack("=2I", edges):
        stamp_at.append(at)
        at += STAMP_SIZE
        for frame in edge:
            at += -at % 4 + 4 + lengths[frame]
        at += (HEADER_SIZE - at) % 8
        pose_at.append(at)
        at += POSE_SIZE
    if at != size:
        return None
    of_pose = np.array(pose_at)[:, None] // 4 + np.arange(POSE_SIZE // 4)
    return np.array(stamp_at) // 4, of_pose.ravel()
