"""The bytes that a release writes on the bus, in a file for each: keys, messages and descriptions.

    python -m tests.wire.frozen_wire    # writes this version's

A file is written again and again until its version is released, and never after that.
"""

import inspect
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from itertools import chain
from pathlib import Path
from struct import pack
from typing import Any, get_args, get_origin, get_type_hints

import msgpack

from tests.builders import EPOCH_NS, SAMPLE, STAMP_NS, at, description, payload
from tfbus import messages
from tfbus.base.installation import installed_version
from tfbus.wire import keys
from tfbus.wire.codec import encode_message
from tfbus.wire.descriptions import (
    COMPACT,
    POSES,
    BufferDescription,
    NodeDescription,
    ParameterDescription,
    encode_stream,
)
from tfbus.wire.transforms import NumberedEncoder

FOLDER = Path(__file__).parent / "frozen"
SESSION = "f602e4"

STREAM = description(
    [("world", "turtle1", False), ("turtle1", "drone", False), ("world", "dock", True)],
    epoch=EPOCH_NS,
    host="lab",
    pid=4711,
    session=SESSION,
    priority=2,
    split=False,
    history_s=2.5,
    started_ns=EPOCH_NS,
)
PARAMETER = ParameterDescription("rate", 2.5, "number", "Turns a second.", 0.0, 10.0)
NODE = NodeDescription(
    name="/robot7/sim",
    host="lab",
    pid=4711,
    version="0.1.0",
    session=SESSION,
    started_ns=EPOCH_NS,
    streams=("sim",),
    parameters=(PARAMETER,),
    publishes={"turtle1/pose": "Pose"},
    subscribes={"turtle1/cmd_vel": "Twist"},
    serves={"spawn": "Spawn"},
    calls={"reset": "Empty"},
    unread=("sim",),
    buffers=(BufferDescription(10.0, 3, 0.5, 1),),
    retained=("turtle1/pose",),
    identity="robot7",
    rights="ab12",
)


# A mast that does not move, an arm that turns, and a robot that has driven ten metres.
_ORIGINS = ((0.0, 0.0, 1.5, 0, 0, 0, 1.0), (0.5, 0, 0, 0, 0, 0, 1.0), (5e5, 4e6, 2.0, 0, 0, 0, 1.0))
_POSES = (_ORIGINS[0], (0.5, 0, 0, 0, 0, 0.6, 0.8), (5e5 + 8, 4e6 - 6, 2.001, 0, 0, 0.6, 0.8))
_PAIRS = (("base", "mast"), ("mast", "arm"), ("map", "base"))
NUMBERED = description(
    [(*pair, False) for pair in _PAIRS],
    epoch=EPOCH_NS,
    poses=COMPACT,
    next_number=4,
    numbered=((0, *_PAIRS[0]), (1, *_PAIRS[1]), (3, *_PAIRS[2])),
    origins=pack("<21d", *chain(*_ORIGINS)),
)


def _numbered(*, is_short: bool) -> bytes:
    encoder = NumberedEncoder(
        EPOCH_NS, (0, 1, 3), pack("=21d", *chain(*_ORIGINS)), is_short=is_short
    )
    return encoder.encode(7, pack("=3q", *[STAMP_NS] * 3), pack("=21d", *chain(*_POSES)))


def frozen_now() -> dict[str, Any]:
    """What this build writes, as it stands in a file."""
    return {
        "keys": {
            "dynamic transforms": keys.transforms_key("a/b"),
            "static transforms": keys.static_transforms_key("a/b"),
            "stream": keys.stream_key("a/b"),
            "frame of a split stream": keys.transforms_key_beside(keys.stream_key("s"), "a/b%"),
            "kept transforms": keys.kept_transforms_selector(keys.transforms_key("s"), 2.5),
            "node": keys.node_key("sim"),
            "clock of a node": keys.clock_key("sim"),
            "parameter": keys.parameter_key("sim", "a/b"),
            "parameters of a node": keys.node_parameters_key("sim"),
            "setting of a parameter": keys.setting_key("sim", "a/b"),
            "simulated time": keys.CLOCK_TOPIC,
        },
        "transforms": {
            "dynamic": SAMPLE.hex(),
            "dynamic, counted": payload([at(2.5, stamp_ns=STAMP_NS)], EPOCH_NS, 7).hex(),
            "static": payload([at(3.5, "dock", stamp_ns=STAMP_NS)], EPOCH_NS, 0).hex(),
        },
        "descriptions": {
            type(each).__name__: (
                encode_stream(each) if each is STREAM else encode_message(each)
            ).hex()
            for each in (STREAM, NODE, PARAMETER)
        },
        "numbered": {
            "description": encode_stream(NUMBERED).hex(),
            **{poses: _numbered(is_short=poses == "float32").hex() for poses in POSES[1:]},
        },
        "messages": {
            kind.__qualname__: encode_message(example(kind)).hex() for kind in message_types()
        },
    }


def message_types() -> list[type]:
    """Every dataclass of `tfbus.messages`, those inside services and actions too; without types
    that are on the bus as in ROS, whose layout ROS says.
    """
    found = []
    for _, outer in inspect.getmembers(messages, inspect.isclass):
        if outer.__module__.startswith(messages.__name__):
            inner = [value for value in vars(outer).values() if inspect.isclass(value)]
            found += [
                one
                for one in (outer, *inner)
                if is_dataclass(one) and not hasattr(one, "__msgtype__")
            ]
    return found


def example(kind: Any) -> Any:
    """A value of the type, with each of its fields."""
    if is_dataclass(kind) and isinstance(kind, type):
        hints = get_type_hints(kind)
        values = {field.name: example(hints[field.name]) for field in fields(kind)}
        # A covariance has 36 numbers, as its default.
        whole = {each.name: each.default for each in fields(kind) if _is_whole(each.default)}
        return kind(**(values | whole))
    if get_origin(kind) is tuple:
        inner = get_args(kind)
        return tuple(map(example, inner[:1] if inner[-1] is Ellipsis else inner))
    if get_origin(kind) is list:
        return [example(get_args(kind)[0])]
    # A half: four of them are a unit quaternion.
    values = {float: 0.5, int: 7, str: "a text", bool: True, bytes: b"\x01\x02"}
    return values[kind]


def _is_whole(default: object) -> bool:
    return isinstance(default, tuple) and len(default) > 1


def read(path: Path) -> dict[str, Any]:
    """A frozen file."""
    content: dict[str, Any] = json.loads(path.read_text())
    return content


def values_of(frozen: str) -> Any:
    """What a payload says, as any implementation of MessagePack reads it."""
    return msgpack.unpackb(bytes.fromhex(frozen))


def lacks(new: Any, old: Any) -> str:
    """The first of the old values that the new ones lack; "" where all are there.

    More fields may have come, in maps and at the end of none of the lists.
    """
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for name, value in old.items():
            if name not in new:
                return f"no field {name!r}"
            if inner := lacks(new[name], value):
                return f"{name!r}: {inner}"
        return ""
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        return next(filter(None, map(lacks, new, old)), "")
    return "" if new == old else f"{new!r}, not {old!r}"


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    written = FOLDER / f"{installed_version()}.json"
    written.write_text(json.dumps(frozen_now(), indent=1) + "\n")
    print(written)
