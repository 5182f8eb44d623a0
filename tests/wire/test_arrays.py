"""Messages with arrays: their bytes, and hostile senders."""

import struct
from typing import Any

import msgpack
import numpy as np
import pytest

from tests.builders import examples
from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import messages
from tfbus.base.errors import DecodeError
from tfbus.wire.codec import as_map, decode_map, decode_message, encode_message

HEADER = {"stamp": {"sec": 0, "nanosec": 7}, "frame_id": "lidar"}


def cloud_of(count: int) -> messages.PointCloud:
    """A cloud of so many points."""
    return messages.PointCloud.from_xyz(
        7, "lidar", np.arange(3 * count).reshape(-1, 3), intensity=np.arange(count, dtype=np.uint16)
    )


@pytest.mark.parametrize("count", [0, 1, 100, 5_000, 50_000])
def test_an_array_is_one_binary_and_read_where_it_is(count: int) -> None:
    """Little-endian and without gaps; a large one is not copied, and none can be written to."""
    cloud = cloud_of(count)
    payload = encode_message(cloud)
    assert msgpack.unpackb(payload)["data"] == cloud.data.tobytes()
    read = decode_message(messages.PointCloud, payload)
    assert read == cloud
    assert not read.data.flags.writeable and not (count and read.xyz().flags.writeable)
    if count == 50_000:
        assert np.shares_memory(read.data, np.frombuffer(payload, np.uint8))


def test_a_contiguous_array_is_not_copied_into_a_message() -> None:
    """It is that of the program, which may write to it, and the message may not."""
    pixels = np.zeros((4, 5, 3), np.uint8)
    image = messages.Image.from_pixels(7, "camera", pixels)
    assert np.shares_memory(image.data, pixels) and pixels.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        image.data[0] = 1


@pytest.mark.parametrize("count", [True, 1.0, "1", 0])
def test_columns_like_those_of_the_last_cloud_are_read_for_themselves(count: Any) -> None:
    """The columns of clouds are read once, and others that are equal to them in Python are not
    taken for them.
    """
    values = decode_map(encode_message(cloud_of(1)))
    first = decode_message(messages.PointCloud, msgpack.packb(values))
    assert decode_message(messages.PointCloud, msgpack.packb(values)).fields is first.fields
    values["fields"][0]["count"] = count
    if type(count) is int:
        assert decode_message(messages.PointCloud, msgpack.packb(values)).fields[0].count == count
    else:
        with pytest.raises(DecodeError, match=r"fields\[0\].count"):
            decode_message(messages.PointCloud, msgpack.packb(values))


def test_several_large_binaries_keep_their_places() -> None:
    """Also within messages of a list, and beside small ones."""
    rng = np.random.default_rng(1)
    markers = tuple(
        messages.Marker(
            7,
            "map",
            id=at,
            type=messages.Marker.POINTS,
            points=rng.normal(size=(count, 3)),
            colors=rng.random(size=(count, 4)).astype(np.float32),
        )
        for at, count in enumerate((3, 5_000, 0, 4_000))
    )
    array = messages.MarkerArray(markers)
    assert decode_message(messages.MarkerArray, encode_message(array)) == array


def test_former_messages_are_read() -> None:
    """Numbers as lists, and points, colours and poses as maps, as ported programs sent them."""
    values = {"header": HEADER, "ranges": [1.0, 2, float("inf")], "intensities": []}
    scan = decode_message(messages.LaserScan, msgpack.packb(values))
    np.testing.assert_array_equal(scan.ranges, np.array([1, 2, np.inf], np.float32))
    point, color = {"x": 1.0, "y": 2, "z": 3.0}, {"r": 1.0, "g": 0.5, "b": 0, "a": 1.0}
    marker = decode_message(
        messages.Marker,
        msgpack.packb({"header": HEADER, "type": 8, "points": [point], "colors": [color]}),
    )
    assert marker.points.tolist() == [[1.0, 2.0, 3.0]]
    assert marker.colors.tolist() == [[1.0, 0.5, 0.0, 1.0]]
    pose = {"position": point, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    poses = decode_message(messages.PoseArray, msgpack.packb({"header": HEADER, "poses": [pose]}))
    assert poses.poses.tolist() == [[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]]


FIELD = {"name": "x", "offset": 0, "datatype": 7, "count": 1}
CLOUD: dict[str, Any] = {
    "header": HEADER,
    "height": 1,
    "width": 2,
    "fields": [FIELD],
    "is_bigendian": False,
    "point_step": 4,
    "row_step": 8,
    "data": bytes(8),
    "is_dense": True,
}
IMAGE: dict[str, Any] = {
    "header": HEADER,
    "height": 2,
    "width": 2,
    "encoding": "rgb8",
    "is_bigendian": 0,
    "step": 6,
    "data": bytes(12),
}


@pytest.mark.parametrize(
    ("kind", "base", "changes", "said"),
    [
        (messages.PointCloud, CLOUD, {"data": bytes(7)}, "data must have 8 items"),
        (messages.PointCloud, CLOUD, {"width": 2**32 - 1}, "row_step"),
        (messages.PointCloud, CLOUD, {"width": 2**32}, "width must be from 0"),
        (messages.PointCloud, CLOUD, {"height": 2**31, "row_step": 2**31}, "data must have"),
        (messages.PointCloud, CLOUD, {"point_step": 0}, "end within point_step"),
        (messages.PointCloud, CLOUD, {"point_step": 0, "fields": []}, "at least 1 byte"),
        (messages.PointCloud, CLOUD, {"fields": [{**FIELD, "offset": 2}]}, "end within point_step"),
        (messages.PointCloud, CLOUD, {"fields": [{**FIELD, "offset": -4}]}, "offset must be"),
        (messages.PointCloud, CLOUD, {"fields": [{**FIELD, "count": 2**32 - 1}]}, "end within"),
        (messages.PointCloud, CLOUD, {"fields": [{**FIELD, "datatype": 9}]}, "datatype must be"),
        (messages.PointCloud, CLOUD, {"fields": [FIELD, FIELD]}, "once, not twice"),
        (messages.PointCloud, CLOUD, {"fields": [FIELD] * 1001}, "at most 1000"),
        (messages.PointCloud, CLOUD, {"data": "text"}, "must be a binary of uint8"),
        (messages.PointCloud, CLOUD, {"data": [256] * 8}, "must be from 0 to 255"),
        (messages.PointCloud, CLOUD, {"data": [0.5] * 8}, "must be an array of uint8"),
        (messages.Image, IMAGE, {"step": 5}, "step must be at least 6 bytes"),
        (messages.Image, IMAGE, {"step": 2**32 - 1}, "data must have"),
        (messages.Image, IMAGE, {"encoding": "rgb9"}, "encoding must be one of ROS's"),
        (messages.Image, IMAGE, {"encoding": "8UC" + "9" * 1000}, "encoding must be"),
        (messages.Image, IMAGE, {"encoding": "64FC4"}, "step must be at least"),
        (messages.LaserScan, {"header": HEADER}, {"ranges": bytes(7)}, "a multiple of 4 bytes"),
        (messages.LaserScan, {"header": HEADER}, {"ranges": ["1"]}, "must be of numbers"),
        (
            messages.LaserScan,
            {"header": HEADER},
            {"ranges": [1.0], "intensities": [1.0, 2.0]},
            "intensities",
        ),
        (messages.Marker, {"header": HEADER}, {"points": bytes(32)}, "a multiple of 24 bytes"),
        (messages.Marker, {"header": HEADER}, {"points": [[1.0, 2.0]]}, "of the numbers x, y, z"),
        (
            messages.Marker,
            {"header": HEADER},
            {"points": struct.pack("<3d", 0, 0, float("nan"))},
            "must be finite",
        ),
        (
            messages.Marker,
            {"header": HEADER},
            {"type": 8, "points": bytes(48), "colors": bytes(16)},
            "colors must have 2",
        ),
        (messages.PoseArray, {"header": HEADER}, {"poses": bytes(56)}, "unit quaternion"),
        (
            messages.OccupancyGrid,
            {"header": HEADER, "data": bytes(3)},
            {"info": {"width": 2, "height": 2, "resolution": 0.1}},
            "data must have 4 items",
        ),
    ],
)
def test_what_does_not_fit_is_refused(
    kind: type[Any], base: dict[str, Any], changes: dict[str, Any], said: str
) -> None:
    """Lengths, strides, offsets, counts, encodings and numbers; the error says which."""
    with pytest.raises(DecodeError, match=said):
        decode_message(kind, msgpack.packb(base | changes))


def test_a_payload_may_not_name_a_binary_that_is_elsewhere() -> None:
    """An extension as this side uses it inside, in a payload large enough for it to be."""
    forged = msgpack.packb({"header": HEADER, "data": msgpack.ExtType(100, b"\\0\\0\\0\\0")})
    padded = msgpack.packb({"zeros": bytes(70_000)})
    whole = b"\x83" + forged[1:] + padded[1:]
    with pytest.raises(DecodeError):
        decode_message(messages.CompressedImage, whole)


@pytest.mark.parametrize("seed", range(examples(20)))
def test_damaged_messages_are_read_or_refused(seed: int) -> None:
    """Nothing else is raised, whatever bytes are changed."""
    rng = np.random.default_rng(seed)
    sent = (cloud_of(6_000), messages.LaserScan(7, "laser", ranges=np.zeros(20_000, np.float32)))
    for message in sent:
        payload = bytearray(encode_message(message))
        for at in rng.integers(0, min(len(payload), 400), 3).tolist():
            payload[at] = int(rng.integers(0, 256))
        cut = bytes(payload[: len(payload) - int(rng.integers(0, 3))])
        try:
            read = decode_message(type(message), cut)
            encode_message(read)
            if isinstance(read, messages.PointCloud):
                read.as_array().tobytes()
        except DecodeError:
            pass


def test_a_refused_message_is_counted_and_the_next_one_comes(bus: Bus) -> None:
    """The subscription goes on."""
    node, other = bus.node("robot"), bus.node("sensor")
    got: list[Any] = []
    subscription = node.create_subscription(messages.Image, "image", got.append)
    raw = other.create_raw_publisher("image", type_name="sensor_msgs/msg/Image")
    bad = msgpack.packb(IMAGE | {"step": 1})
    eventually(lambda: raw.publish(bad) or subscription.rejected)
    eventually(lambda: raw.publish(msgpack.packb(IMAGE)) or got)
    assert got[0].pixels().shape == (2, 2, 3)


def test_maps_of_messages_are_as_before() -> None:
    """Who reads a map gets bytes, and who asks for a map of a message gets arrays."""
    cloud = cloud_of(50_000)
    assert type(decode_map(encode_message(cloud))["data"]) is bytes
    assert as_map(cloud)["data"] is cloud.data
