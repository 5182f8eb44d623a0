"""Foxglove's messages of transforms."""

import contextlib
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import needs
from tfbus import Transform, TransformStamped
from tfbus.base.errors import DecodeError
from tfbus.recording.foxglove_frames import of_json, of_protobuf

STAMP_NS = 1_700_000_000_123_456_789
LASER = TransformStamped(STAMP_NS, "base", "laser", Transform((1, 2, 0), (0, 0, 0.6, 0.8)))
CAMERA = TransformStamped(STAMP_NS, "base", "camera", Transform((-1, 0, 0)))


def fields_of(ts: TransformStamped) -> dict[str, Any]:
    """The message by the names of its fields."""
    sec, nsec = divmod(ts.stamp_ns, 10**9)
    return {
        "timestamp": {"sec": sec, "nsec": nsec},
        "parent_frame_id": ts.frame_id,
        "child_frame_id": ts.child_frame_id,
        "translation": dict(zip("xyz", ts.transform.xyz.tolist(), strict=True)),
        "rotation": dict(zip("xyzw", ts.transform.quat_xyzw.tolist(), strict=True)),
    }


def protobuf_of(ts: TransformStamped) -> Any:
    """The message of Foxglove's own library."""
    needs.module("foxglove")
    from foxglove.messages import FrameTransform, Quaternion, Timestamp, Vector3

    sec, nsec = divmod(ts.stamp_ns, 10**9)
    return FrameTransform(
        timestamp=Timestamp(sec=sec, nsec=nsec),
        parent_frame_id=ts.frame_id,
        child_frame_id=ts.child_frame_id,
        translation=Vector3(**fields_of(ts)["translation"]),
        rotation=Quaternion(**fields_of(ts)["rotation"]),
    )


def test_json_is_read() -> None:
    """One transform, and several."""
    assert list(of_json(json.dumps(fields_of(LASER)).encode())) == [LASER]
    both = {"transforms": [fields_of(LASER), fields_of(CAMERA)]}
    assert list(of_json(json.dumps(both).encode())) == [LASER, CAMERA]


def test_protobuf_of_foxglove_s_library_is_read() -> None:
    """One transform, and several; numbers that are zero are not in the bytes."""
    message = protobuf_of(LASER)
    from foxglove.messages import FrameTransforms

    assert list(of_protobuf(message.encode(), many=False)) == [LASER]
    both = FrameTransforms(transforms=[message, protobuf_of(CAMERA)])
    assert list(of_protobuf(both.encode(), many=True)) == [LASER, CAMERA]


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b"{}",
        b"\xff",
        b'{"transforms": 3}',
        b'{"transforms": [{"parent_frame_id": 1, "child_frame_id": "b"}]}',
        b'{"parent_frame_id": "a", "child_frame_id": "b", "timestamp": {"sec": 1e99}}',
        b'{"parent_frame_id": "a", "child_frame_id": "b", "timestamp": {"sec": 99999999999999}}',
        b'{"parent_frame_id": "\\ud800", "child_frame_id": "b"}',
        b"[" * 100_000,
    ],
    ids=lambda data: data[:50].decode(errors="replace"),
)
def test_json_of_another_kind_is_refused(data: bytes) -> None:
    """With a DecodeError."""
    with pytest.raises(DecodeError):
        of_json(data)


@given(st.binary(max_size=100), st.booleans())
def test_bytes_that_are_no_protobuf_are_refused(data: bytes, many: bool) -> None:
    """Whatever the bytes, there is a message or a DecodeError."""
    with contextlib.suppress(DecodeError):
        of_protobuf(data, many=many)
