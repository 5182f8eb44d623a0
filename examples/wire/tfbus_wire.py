"""Reads and writes tfbus's wire without tfbus: what to port to another language first.

    pip install eclipse-zenoh msgpack
    python examples/wire/tfbus_wire.py [DESCRIPTION] < MESSAGE

Keys and bytes; talk.py and listen.py, beside this file, send and receive them. Run as a program it
prints the message of transforms that it reads; DESCRIPTION is a file with the description of its
stream, which names frames that have numbers. Each comment names the section of
docs/reference/wire.md that the lines below it follow.
"""

import math
import os
import struct
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgpack
import zenoh

Transform = tuple[str, str, int, tuple[float, ...]]  # parent, child, stamp_ns, x y z qx qy qz qw

# How large messages may be
MOST_BYTES = 16_000_000
MOST_VALUES = 1_000_000
MOST_ROWS = 300_000  # Frames by numbers


def open_session() -> closing[zenoh.Session]:
    """A session by the file that ZENOH_CONFIG names, or one that finds its peers by multicast.

    A session's own `with` raises at its end if another thread uses the session.
    """
    if "ZENOH_CONFIG" in os.environ:
        return closing(zenoh.open(zenoh.Config.from_env()))
    config = zenoh.Config()
    config.insert_json5("timestamping/enabled", "true")  # How messages are sent
    return closing(zenoh.open(config))


# ------------------------------------------------------------------------ Keys: Names in keys


def chunk(name: str) -> str:
    """A name as one chunk of a key."""
    return "".join(f"%{ord(letter):02X}" if letter in "%*$?#/@" else letter for letter in name)


def name_of(chunk: str) -> str:
    """The name that a chunk stands for."""
    first, *rest = chunk.split("%")
    return first + "".join(chr(int(part[:2], 16)) + part[2:] for part in rest)


def stream_of(key: str) -> str:
    """The stream that sends transforms at this key, "" where it is not tfbus's (Beside ROS 2)."""
    root, *chunks = key.split("/")
    most = {"tf": 2, "tf_static": 1}.get(root, 0)
    if not 1 <= len(chunks) <= most or "::dds_::" in chunks[0]:
        return ""
    return name_of(chunks[0])


def is_cdr(payload: bytes) -> bool:
    """Whether it is a message of a bridge to ROS 2 (Beside ROS 2)."""
    return len(payload) >= 4 and payload[0] == 0 and payload[1] <= 11


def is_name(name: str) -> bool:
    """Whether it can be the name of a stream, node or host (Names in keys)."""
    return len(name) <= 255 and name.isprintable()


def is_frame_name(name: str) -> bool:
    """Whether it can be the name of a frame (Names in keys)."""
    return is_name(name) and name != "" and not name.startswith("/")


# ------------------------------------------------------------------- A message of transforms


@dataclass(frozen=True)
class Numbers:
    """The frames of a stream that have numbers in one epoch (Frames by numbers): parent, child and
    origin of each; `next_number` is the first that has not been given.
    """

    epoch: int
    next_number: int = 0
    named: dict[int, tuple[str, str, tuple[float, ...]]] = field(default_factory=dict)


NO_NUMBERS = Numbers(-1)


@dataclass
class Message:
    """What one message holds, the reasons why single transforms of it are refused, and the numbers
    of rows whose frames the description does not name so far.
    """

    epoch: int
    seq: int | None
    transforms: list[Transform] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    unnamed: list[int] = field(default_factory=list)

    def add(self, parent: str, child: str, stamp_ns: int, pose: tuple[float, ...]) -> None:
        """Add a transform as it came, or the reason why it is refused."""
        mistake = _mistake(parent, child, pose)
        if mistake:
            self.refused.append(mistake)
            return
        norm = math.sqrt(sum(part * part for part in pose[3:]))
        unit = (*pose[:3], *(part / norm for part in pose[3:]))
        self.transforms.append((parent, child, stamp_ns, unit))


def encode_transforms(epoch: int, seq: int, transforms: list[Transform]) -> bytes:
    """The payload for tf/<stream>, or of all static transforms for tf_static/<stream>."""
    index: dict[str, int] = {}
    edges = stamps = poses = b""
    for parent, child, stamp_ns, pose in transforms:
        indices = [index.setdefault(name, len(index)) for name in (parent, child)]
        edges += struct.pack("<2I", *indices)
        stamps += struct.pack("<q", stamp_ns)
        poses += struct.pack("<7d", *pose)
    columns = {"edges": edges, "stamps": stamps, "poses": poses}
    message = {"v": 1, "epoch": epoch, "seq": seq, "frames": list(index), **columns}
    payload: bytes = msgpack.packb(message)
    return payload


def decode_transforms(payload: bytes, numbers: Numbers | None = None) -> Message:
    """What a payload holds; ValueError where the whole is refused (What to ignore and refuse).

    `numbers` are those of its stream, NO_NUMBERS before it is described; None refuses all messages
    with numbers, as static transforms have names.
    """
    message = _map(payload)
    if message["v"] == 2:
        if numbers is None:
            raise ValueError("its frames have numbers, and static transforms have names")
        return _decode_numbered(message, numbers)
    frames = _typed(message, "frames", list)
    edges: list[tuple[int, int]] = list(_rows(message, "edges", "<2I"))
    stamps = list(_rows(message, "stamps", "<q"))
    poses = list(_rows(message, "poses", "<7d"))
    if not all(isinstance(name, str) for name in frames):
        raise ValueError("'frames' is not an array of texts")
    if not len(edges) == len(stamps) == len(poses):
        raise ValueError("the columns differ in their number of rows")
    if any(index >= len(frames) for edge in edges for index in edge):
        raise ValueError("an index in 'edges' is not one of 'frames'")
    seq = _typed(message, "seq", int) if "seq" in message else None
    result = Message(_typed(message, "epoch", int), seq)
    for (parent, child), (stamp_ns,), pose in zip(edges, stamps, poses, strict=True):
        result.add(frames[parent], frames[child], stamp_ns, pose)
    return result


def _decode_numbered(message: dict[str, Any], numbers: Numbers) -> Message:
    result = Message(
        _typed(message, "epoch", int), _typed(message, "seq", int) if "seq" in message else None
    )
    rows = list(_numbers_in(_typed(message, "runs", list)))
    stamps = message.get("stamps")
    if type(stamps) is int:
        times = [_typed(message, "stamps", int)] * len(rows)
    else:
        times = [stamp_ns for (stamp_ns,) in _rows(message, "stamps", "<q")]
        times = times * len(rows) if len(times) == 1 else times
    forms, poses = _typed(message, "forms", bytes), _typed(message, "poses", bytes)
    if len(times) != len(rows) or len(forms) not in (1, len(rows)):
        raise ValueError("'stamps' or 'forms' has not one for each row, or one for all")
    named = numbers.named if numbers.epoch == result.epoch else {}
    given = numbers.next_number if numbers.epoch == result.epoch else 0
    at = 0
    for row, (number, stamp_ns) in enumerate(zip(rows, times, strict=True)):
        form = forms[row if len(forms) == len(rows) else 0]
        size = _size_of(form)
        if size is None or at + size > len(poses):
            raise ValueError("'poses' has not the bytes that 'forms' say")
        if number in named:
            parent, child, origin = named[number]
            result.add(parent, child, stamp_ns, _pose(form, poses[at : at + size], origin))
        elif number >= given:
            result.unnamed.append(number)
        at += size
    if at != len(poses):
        raise ValueError("bytes follow the poses")
    return result


def _numbers_in(runs: list[Any]) -> Iterator[int]:
    if len(runs) % 2 or not all(type(each) is int and 0 <= each < 2**63 for each in runs):
        raise ValueError("'runs' is not pairs of a number and how many follow")
    if sum(runs[1::2]) > MOST_ROWS:
        raise ValueError(f"it has more than {MOST_ROWS} rows")
    for first, count in zip(runs[::2], runs[1::2], strict=True):
        yield from range(first, first + count)


def _size_of(form: int) -> int | None:
    if form < 8:
        return 3 * (0, 2, 3, 4)[form & 3] + (6 if form & 4 else 0)
    return {8: 28, 9: 56}.get(form)


def _pose(form: int, data: bytes, origin: tuple[float, ...]) -> tuple[float, ...]:
    if form == 9:
        return struct.unpack("<7d", data)
    if form == 8:
        x, y, z, *rotation = struct.unpack("<7f", data)
        return (x + origin[0], y + origin[1], z + origin[2], *rotation)
    size = (0, 2, 3, 4)[form & 3]
    axes = [data[size * axis : size * (axis + 1)] for axis in range(3)]
    steps = [int.from_bytes(each, "little", signed=True) for each in axes]
    xyz = (part + step * 0.0001 for part, step in zip(origin[:3], steps, strict=True))
    return (*xyz, *(_rotation(data[3 * size :]) if form & 4 else origin[3:]))


def _rotation(data: bytes) -> list[float]:
    bits = int.from_bytes(data, "little")
    parts = [((bits >> at & 32767) - 16383) / (16383 * math.sqrt(2.0)) for at in (2, 17, 32)]
    square = 1.0 - sum(part * part for part in parts)
    # Bits that are no rotation: the transform is refused, as its number is not finite.
    parts.insert(bits & 3, math.sqrt(square) if square >= 0.0 else math.nan)
    return parts


def _mistake(parent: str, child: str, pose: tuple[float, ...]) -> str:
    # The edge that would close a loop is for the listener: only it knows the tree.
    for name in (parent, child):
        if not is_frame_name(name):
            return f"{name!r:.100} is no frame name"
    if parent == child:
        return f"{child!r} is its own parent"
    if not all(math.isfinite(part) for part in pose):
        return f"{child!r} has a number that is not finite"
    if abs(sum(part * part for part in pose[3:]) - 1.0) > 0.01:
        return f"{child!r} has a quaternion that is not of length 1"
    return ""


def _map(payload: bytes, versions: tuple[int, ...] = (1, 2)) -> dict[str, Any]:
    if len(payload) > MOST_BYTES:
        raise ValueError(f"{len(payload)} bytes are more than {MOST_BYTES}")
    # ValueError for all that is not exactly one MessagePack value
    value = msgpack.unpackb(payload, max_array_len=MOST_VALUES, max_map_len=MOST_VALUES)
    if not isinstance(value, dict):
        raise ValueError("it is not a map")
    version = _typed(value, "v", int)
    if version not in versions:
        read = " and ".join(map(str, versions))
        raise ValueError(f"it is of version {version}, and this program reads {read}")
    return value


def _typed(message: dict[str, Any], key: str, kind: type) -> Any:
    if key not in message:
        raise ValueError(f"{key!r} is missing")
    value = message[key]
    if type(value) is int and (kind is float or (kind is bool and value in (0, 1))):
        value = kind(value)  # Topics says what stands for what
    if type(value) is not kind:
        raise ValueError(f"{key!r} is not of type {kind.__name__}")
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ValueError(f"{key!r} is beyond a signed 64-bit integer")
    return value


def _rows(message: dict[str, Any], key: str, row: str) -> Any:
    column = _typed(message, key, bytes)
    if len(column) % struct.calcsize(row):
        raise ValueError(f"{key!r} is not a whole number of rows")
    return struct.iter_unpack(row, column)


# ------------------------------------------------------------------------- Streams and nodes


@dataclass
class Description:
    """What a stream says about itself."""

    node: str
    epoch: int
    frames: list[tuple[str, str, bool]]  # parent, child, whether it is static
    host: str = ""
    pid: int = 0
    session: str = ""
    priority: int = 0
    split: bool = False
    history_s: float = 0.0
    started_ns: int = 0
    poses: str = "float64"
    next_number: int = 0
    numbered: list[tuple[int, str, str]] = field(default_factory=list)
    origins: bytes = b""

    @property
    def numbers(self) -> Numbers:
        """The numbers of its frames."""
        origins = struct.iter_unpack("<7d", self.origins)
        named = {
            number: (parent, child, origin)
            for (number, parent, child), origin in zip(self.numbered, origins, strict=True)
        }
        return Numbers(self.epoch, self.next_number, named)


def encode_description(description: Description) -> bytes:
    """The payload for @tfbus/stream/<stream>."""
    payload: bytes = msgpack.packb({"v": 1, **vars(description)})
    return payload


def decode_description(payload: bytes) -> Description:
    """What a stream says about itself; ValueError where it cannot be read."""
    message = _map(payload, versions=(1,))
    result = Description(_typed(message, "node", str), _typed(message, "epoch", int), [])
    for edge in _typed(message, "frames", list):
        if not isinstance(edge, list) or len(edge) != 3:
            raise ValueError("'frames' is not an array of [text, text, boolean]")
        named = dict(zip(("parent", "child", "static"), edge, strict=True))
        parent, child = _typed(named, "parent", str), _typed(named, "child", str)
        if is_frame_name(parent) and is_frame_name(child):
            result.frames.append((parent, child, _typed(named, "static", bool)))
    for row in _typed(message, "numbered", list) if "numbered" in message else ():
        if not isinstance(row, list) or len(row) != 3:
            raise ValueError("'numbered' is not an array of [integer, text, text]")
        pair = dict(zip(("number", "parent", "child"), row, strict=True))
        number = _typed(pair, "number", int)
        result.numbered.append((number, _typed(pair, "parent", str), _typed(pair, "child", str)))
    for key in (
        *("host", "pid", "session", "priority", "split", "history_s", "started_ns"),
        *("poses", "next_number", "origins"),
    ):
        if key in message:
            setattr(result, key, _typed(message, key, type(getattr(result, key))))
    if len(result.origins) != struct.calcsize("<7d") * len(result.numbered):
        raise ValueError("'origins' has not a pose for each of 'numbered'")
    for name in (result.node, result.host, result.session, result.poses):
        if not is_name(name):
            raise ValueError(f"{name!r:.100} is no name")
    return result


if __name__ == "__main__":
    described = [decode_description(Path(path).read_bytes()).numbers for path in sys.argv[1:]]
    print(decode_transforms(sys.stdin.buffer.read(), *described[:1] or [NO_NUMBERS]))
