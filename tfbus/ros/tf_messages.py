"""Reads many messages of transforms at once: those with the same frames in one step."""

import sys
from collections.abc import Sequence

from tfbus.core import lazy_numpy as np
from tfbus.core.packed import POSE_SIZE, STAMP_SIZE
from tfbus.geometry.columns import Columns
from tfbus.ros.cdr import HEADER, HEADER_SIZE
from tfbus.ros.tf_message import TFMessageReader

_SECOND_NS = 1_000_000_000
_STAMP_AT = HEADER_SIZE + 4
_NAMES_AT = _STAMP_AT + STAMP_SIZE
_ONE = HEADER + b"\x01\x00\x00\x00"

# Below this number of messages reading each for itself is faster.
_FEW = 4


def read_many(
    reader: TFMessageReader, messages: Sequence[bytes]
) -> list[tuple[list[int], Columns]]:
    """The transforms of these messages, bit by bit: groups of messages with the same frames, as
    their indices and the rows of all of them, each message's after the other's.

    Raises as `TFMessageReader.read`.
    """
    alike: dict[object, list[int]] = {}
    for at, data in enumerate(messages):
        # Names of one transform are between its numbers; those of several are compared later.
        is_one = data[:_STAMP_AT] == _ONE
        alike.setdefault(data[_NAMES_AT:-POSE_SIZE] if is_one else len(data), []).append(at)
    return [group for members in alike.values() for group in _groups(reader, messages, members)]


def _groups(
    reader: TFMessageReader, messages: Sequence[bytes], members: list[int]
) -> list[tuple[list[int], Columns]]:
    """The same of messages that have one size."""
    groups: list[tuple[list[int], Columns]] = []
    while len(members) >= _FEW and len(groups) < _FEW:
        found = _like_first(reader, [messages[at] for at in members])
        if found is None:
            break
        rows, taken = found
        groups.append(([at for at, is_in in zip(members, taken, strict=True) if is_in], rows))
        members = [at for at, is_in in zip(members, taken, strict=True) if not is_in]
    return groups + [([at], reader.read(messages[at])) for at in members]


def _like_first(
    reader: TFMessageReader, messages: list[bytes]
) -> tuple[Columns, list[bool]] | None:
    """The rows of the messages with the frames of the first, and which these are; None where the
    first is not as others are written, or a stamp is none.
    """
    first = reader.read(messages[0])
    places = _places(first, len(messages[0]))
    if places is None or messages[0][:HEADER_SIZE] != HEADER:
        return None
    stamp_at, pose_at = places
    words = np.frombuffer(b"".join(messages), "<u4").reshape(len(messages), -1)
    is_fixed = np.ones(words.shape[1], bool)
    is_fixed[stamp_at] = is_fixed[stamp_at + 1] = is_fixed[pose_at] = False
    same = (words[:, is_fixed] == words[0, is_fixed]).all(axis=1)
    if not same.all():
        words = words[same]
    nanoseconds = words[:, stamp_at + 1]
    if not first.count or nanoseconds.max() >= _SECOND_NS:
        return None
    stamps = words[:, stamp_at].astype(np.int32) * np.int64(_SECOND_NS) + nanoseconds
    poses = words[:, pose_at]
    if sys.byteorder != "little":
        poses = poses.astype("<u4").view("<f8").astype(np.float64)
    edges = first.edges_bytes() * len(words)
    rows = Columns.of_bytes(first.frames, edges, stamps.tobytes(), poses.tobytes())
    return rows, same.tolist()


def _places(rows: Columns, size: int) -> "tuple[np.ndarray, np.ndarray] | None":
    """Where the stamps and the numbers of the poses are in a message, in words of four bytes; None
    where the message has another size.
    """
    lengths = [len(name.encode()) + 1 for name in rows.frames]
    stamp_at, pose_at, at = [], [], _STAMP_AT
    for edge in rows.pairs():
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
