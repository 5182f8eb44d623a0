"""A buffer in a file: an .npz archive of numpy without pickle, safe to load from strangers.

docs/reference/saved-buffer.md describes the format. All that is in a file is checked: sizes
against the size of the file, names, numbers, and that parents form no loop.
"""

import io
import json
import math
import os
import struct
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from itertools import pairwise
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tfbus.base.errors import DecodeError, InvalidArgumentException
from tfbus.base.whole_file import replacing
from tfbus.base.wording import mistake_in, printable
from tfbus.buffer.buffer import Buffer, default_max_samples
from tfbus.geometry.kernel import LONGEST_NS, NO_DATA
from tfbus.geometry.sampling import Contents, Held, Pose, Sampling
from tfbus.geometry.transform_array import are_valid

FORMAT = "tfbus buffer"
VERSION = 1

# The arrays of a file: their types, and the numbers in a row.
_ARRAYS = {
    "header": ("|u1", ()),
    "stamps_ns": ("<i8", ()),
    "parents": ("<i4", ()),
    "poses": ("<f8", (7,)),
}

# In place of the index of a sample's parent that was removed.
_REMOVED = -1

_LONGEST_AUTHORITY = 65_536


def save(buffer: Buffer, path: str | os.PathLike[str]) -> None:
    """Write all samples, static transforms and settings of a buffer to a file, for `load`.

    It is an .npz archive of numpy; a former file is replaced in one step. Raises OSError.
    """
    contents = buffer._contents()
    index: dict[str | None, int] = {name: at for at, name in enumerate(contents.frames)}
    index[None] = _REMOVED
    held = list(contents.frames.values())
    parents = [[index[name] for name in _parents(each)] for each in held]
    header = {
        "format": FORMAT,
        "version": VERSION,
        "cache_time_s": None if math.isinf(contents.cache_time_s) else contents.cache_time_s,
        "max_samples": contents.max_samples,
        # A limit that is not there is left out, for older releases.
        "sampling": {
            name: value for name, value in asdict(contents.sampling).items() if value is not None
        },
        "frames": [_row(name, each) for name, each in contents.frames.items()],
    }
    with replacing(path) as file:
        np.savez(
            file,
            header=np.frombuffer(json.dumps(header).encode(), np.uint8),
            stamps_ns=_joined([each.stamps_ns for each in held], "<i8"),
            parents=_joined(parents, "<i4"),
            poses=_joined([each.poses.ravel() for each in held], "<f8").reshape(-1, 7),
        )


def load(path: str | os.PathLike[str]) -> Buffer:
    """The buffer that was saved to a file: every lookup has the same answer, to the last bit.

    It runs no code of the file, and checks it. Raises DecodeError for another file, or one cut
    short; OSError.
    """
    with open(path, "rb") as file:
        try:
            contents = _contents(_arrays(file))
        except _Unusable as error:
            raise DecodeError(f"{path} is not a buffer that can be loaded: {error}") from error
    limit = contents.max_samples
    if limit is None:
        most = max((len(held.stamps_ns) for held in contents.frames.values()), default=0)
        limit = max(default_max_samples(contents.cache_time_s), most)
    buffer = Buffer(contents.cache_time_s, sampling=contents.sampling, max_samples=limit)
    buffer._restore(contents.frames)
    return buffer


class _Unusable(Exception):
    """Why a file is not loaded."""


def _row(name: str, held: Held) -> dict[str, Any]:
    """The entry of a frame in the header."""
    return {
        "name": name,
        "parent": held.parent,
        "authority": held.authority,
        "gone": held.gone,
        "ended": held.ended,
        "conflicts": held.conflicts,
        "refused": held.refused,
        "crowded_out": held.crowded_out,
        "static": {"stamp_ns": held.static_stamp_ns, "pose": list(held.static_pose)}
        if held.is_static
        else None,
        "samples": len(held.stamps_ns),
        "mixed_until_ns": None if held.parents is None else held.mixed_until_ns,
        "interruptions": list(held.interruptions.items()),
    }


def _parents(held: Held) -> Iterable[str | None]:
    """The parent of each sample; None if it was removed."""
    if held.parents is not None:
        return held.parents
    return [held.parent] * len(held.stamps_ns)


def _joined(parts: Iterable[Any], dtype: str) -> NDArray[Any]:
    return np.concatenate([np.zeros(0, dtype), *(np.asarray(part, dtype) for part in parts)])


# Reading


def _arrays(file: BinaryIO) -> dict[str, NDArray[Any]]:
    size = os.fstat(file.fileno()).st_size
    try:
        with zipfile.ZipFile(file) as archive:
            members = {info.filename: info for info in archive.infolist()}
            if len(members) != len(archive.infolist()) or {
                name.removesuffix(".npy") for name in members
            } != set(_ARRAYS):
                raise _Unusable(f"it has not the arrays {', '.join(_ARRAYS)}")
            for info in members.values():
                # A compressed member may be a thousand times as large as the file.
                if info.compress_type != zipfile.ZIP_STORED or info.file_size > size:
                    raise _Unusable("it is compressed")
            return {
                name: _array(archive.read(f"{name}.npy"), *kind) for name, kind in _ARRAYS.items()
            }
    except (
        zipfile.BadZipFile,
        EOFError,
        KeyError,
        NotImplementedError,
        OSError,
        RuntimeError,
        ValueError,
        struct.error,
    ) as error:
        raise _Unusable("it is another kind of file, or cut short") from error


def _array(data: bytes, dtype: str, row: tuple[int, ...]) -> NDArray[Any]:
    """The array of a member in numpy's format, as large as its bytes are."""
    start = io.BytesIO(data)
    if np.lib.format.read_magic(start) != (1, 0):
        raise ValueError("another version of numpy's format")
    shape, by_columns, given = np.lib.format.read_array_header_1_0(start)
    if given != np.dtype(dtype) or by_columns or shape[1:] != row:
        raise ValueError(f"expected {dtype} in rows of {row}")
    array = np.frombuffer(data, np.dtype(dtype), offset=start.tell())
    return array.reshape(shape)


def _contents(arrays: dict[str, NDArray[Any]]) -> Contents:
    header = _header(arrays["header"].tobytes())
    try:
        cache_time_s = header["cache_time_s"]
        cache_time_s = math.inf if cache_time_s is None else _number(cache_time_s)
        max_samples = header.get("max_samples")
        if max_samples is not None:
            _whole(max_samples, 1, LONGEST_NS)
        sampling = Sampling(**header["sampling"])
        rows = {_name(row["name"]): row for row in header["frames"]}
        if len(rows) != len(header["frames"]):
            raise _Unusable("it has two frames of one name")
        frames = dict(_frames(rows, arrays))
    except (ArithmeticError, InvalidArgumentException, KeyError, TypeError, ValueError) as error:
        said = printable(f"{type(error).__name__}: {error}")
        raise _Unusable(f"its header has a field that is wrong or missing ({said})") from error
    if not cache_time_s >= 0.0:
        raise _Unusable("its cache_time_s is not 0 or more")
    if max_samples is not None and any(
        len(held.stamps_ns) > max_samples for held in frames.values()
    ):
        raise _Unusable("a frame has more samples than max_samples")
    _check_loops({name: held.parent for name, held in frames.items()})
    return Contents(cache_time_s, max_samples, sampling, frames)


def _header(text: bytes) -> dict[str, Any]:
    try:
        header = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise _Unusable("its header is not JSON") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise _Unusable(f"its header has no format {FORMAT!r}")
    if header.get("version") != VERSION:
        raise _Unusable(
            f"it has version {printable(repr(header.get('version')), 20)} of the format, and this "
            f"tfbus reads version {VERSION}: load it with the tfbus that saved it, or a newer one"
        )
    return header


def _frames(
    rows: dict[str, dict[str, Any]], arrays: dict[str, NDArray[Any]]
) -> Iterator[tuple[str, Held]]:
    stamps, parents, poses = (arrays[name] for name in ("stamps_ns", "parents", "poses"))
    counts = [_whole(row["samples"], 0, len(stamps)) for row in rows.values()]
    if not len(stamps) == len(parents) == len(poses) == sum(counts):
        raise _Unusable("the number of its samples is not that of its frames")
    _check_poses(poses)
    names = list(rows)
    if len(parents) and not _REMOVED <= int(parents.min()) <= int(parents.max()) < len(names):
        raise _Unusable("a sample has a parent that is not there")
    ends = np.cumsum([0, *counts]).tolist()
    for (name, row), (start, end) in zip(rows.items(), pairwise(ends), strict=True):
        part = slice(start, end)
        held = _held(row, names, stamps[part], poses[part], parents[part])
        _check_parents(name, held, rows)
        yield name, held


def _held(
    row: dict[str, Any],
    names: list[str],
    stamps_ns: NDArray[np.int64],
    poses: NDArray[np.float64],
    parents: NDArray[np.int32],
) -> Held:
    if len(stamps_ns) and (
        (stamps_ns[1:] <= stamps_ns[:-1]).any()
        or int(stamps_ns[0]) <= -LONGEST_NS
        or int(stamps_ns[-1]) >= LONGEST_NS
    ):
        raise _Unusable("its stamps do not rise, or are not within 146 years of 1970")
    static = row["static"]
    pose: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    if static is not None:
        x, y, z, qx, qy, qz, qw = map(_number, static["pose"])
        pose = (x, y, z, qx, qy, qz, qw)
        _check_poses(np.array([pose]))
    until = row["mixed_until_ns"]
    if until is None and (parents == _REMOVED).any():
        raise _Unusable("a sample has a parent that is not there")
    return Held(
        parent=None if row["parent"] is None else _name(row["parent"]),
        authority=_text(row["authority"]),
        gone=row["gone"] is True,
        conflicts=_whole(row["conflicts"], 0, LONGEST_NS),
        refused=_whole(row["refused"], 0, LONGEST_NS),
        is_static=static is not None,
        static_stamp_ns=0
        if static is None
        else _whole(static["stamp_ns"], -LONGEST_NS, LONGEST_NS),
        static_pose=pose,
        stamps_ns=stamps_ns,
        poses=poses,
        parents=None
        if until is None
        else [None if at == _REMOVED else names[at] for at in parents.tolist()],
        mixed_until_ns=NO_DATA if until is None else _whole(until, NO_DATA, LONGEST_NS),
        # Files of earlier releases do not have these.
        ended=row.get("ended") is True,
        crowded_out=_whole(row.get("crowded_out", 0), 0, LONGEST_NS),
        interruptions={
            _whole(stamp_ns, -LONGEST_NS, LONGEST_NS): _text(reason)
            for stamp_ns, reason in row.get("interruptions", ())
        },
    )


def _check_poses(poses: NDArray[np.float64]) -> None:
    if not are_valid(poses).all():
        raise _Unusable("a pose is not finite, or its quaternion has not norm 1")


def _check_parents(name: str, held: Held, rows: dict[str, Any]) -> None:
    """Check that a frame has a parent, a known one, wherever it has a place."""
    has_place = held.is_static or len(held.stamps_ns) > 0
    of_samples = set(held.parents or ())
    if has_place and held.parent is None:
        raise _Unusable(f"frame {name!r} has samples, but no parent")
    if name in of_samples or held.parent == name:
        raise _Unusable(f"frame {name!r} is its own parent")
    if held.parent is not None and held.parent not in rows:
        raise _Unusable(f"the parent of frame {name!r} is not there")
    if held.parents and not held.is_static and held.parents[-1] != held.parent:
        raise _Unusable(f"the parent of frame {name!r} is not that of its newest sample")


def _check_loops(parent_of: dict[str, str | None]) -> None:
    ends: set[str] = set()
    for start in parent_of:
        walked: dict[str, None] = {}
        name: str | None = start
        while name is not None and name not in ends:
            if name in walked:
                raise _Unusable(f"frame {name!r} is above itself")
            walked[name] = None
            name = parent_of[name]
        ends.update(walked)


def _name(value: Any) -> str:
    if mistake := mistake_in(value):
        raise _Unusable(f"the name of a frame {mistake}")
    return str(value)


def _text(value: Any) -> str:
    if not isinstance(value, str) or len(value) > _LONGEST_AUTHORITY:
        raise TypeError("expected a text")
    return value


def _whole(value: Any, least: int, most: int) -> int:
    if type(value) is not int or not least <= value <= most:
        raise ValueError(f"expected a whole number from {least} to {most}")
    return value


def _number(value: Any) -> float:
    if type(value) not in (int, float) or not math.isfinite(value):
        raise ValueError("expected a finite number")
    return float(value)
