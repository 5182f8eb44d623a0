"""`tfbus bag export` of clouds and images, and its files, read by others and back."""

import errno
import io
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from tests import needs
from tests.builders import in_recording
from tfbus import Recording, Transform, TransformStamped
from tfbus.base.errors import InvalidArgumentException
from tfbus.cli import main
from tfbus.messages import CompressedImage, Image, LaserScan, PointCloud
from tfbus.recording.items import TopicItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter
from tfbus.ros.schema import MessageCodec
from tfbus.sensor_files import (
    read_cloud,
    read_compressed_image,
    read_image,
    write_cloud_npz,
    write_pcd,
    write_pixels_npy,
    write_ply,
    write_png,
)
from tfbus.wire.codec import decode_map, encode_map, encode_message, type_name

S = 1_000_000_000
START_NS = 1_700_000_000 * S
# A file of $ points, which are the corners of a face.
PLY_OF = (
    b"ply\nformat ascii 1.0\ncomment by hand\nelement vertex $\nproperty float32 x\n"
    b"property float32 y\nproperty float32 z\nproperty double quality\nelement face 1\n"
    b"property list uchar int vertex_indices\nend_header\n"
)
JPEG = b"\xff\xd8\xff\xe0 not more than its first bytes"


def export(*arguments: object) -> Result:
    """`tfbus bag export` with these arguments."""
    return CliRunner().invoke(main, ["bag", "export", *map(str, arguments)], prog_name="tfbus")


def exported(*arguments: object) -> str:
    """The line of an export that must succeed."""
    done = export(*arguments)
    assert done.exit_code == 0, done.output
    return done.output


def cloud(stamp_ns: int = 0) -> PointCloud:
    """Six points with two further columns."""
    xyz = np.arange(18, dtype=np.float32).reshape(6, 3)
    rgb = np.full(6, 0x102030, np.uint32).view(np.float32)
    normals = np.arange(18.0).reshape(6, 3)
    return PointCloud.from_xyz(stamp_ns, "lidar", xyz, rgb=rgb, normal=normals)


def picture(stamp_ns: int = 0) -> Image:
    """An image with blue first."""
    pixels = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)
    return Image.from_pixels(stamp_ns, "camera", pixels, "bgr8")


@pytest.fixture
def seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording of three clouds and images, one a second, in the current folder."""
    monkeypatch.chdir(tmp_path)
    path = Path("seen.mcap")
    with RecordingWriter(path) as writer:
        for tick in range(3):
            now = START_NS + tick * S
            for topic, message in (
                ("points", cloud(now)),
                ("image", picture(now)),
                ("jpeg", CompressedImage(now, "camera", "jpeg", np.frombuffer(JPEG, np.uint8))),
            ):
                writer.write(
                    TopicItem(
                        now, topic, type_name(type(message)), decode_map(encode_message(message))
                    )
                )
    return path


def test_each_message_becomes_a_file_or_one_at_a_time(seen: Path) -> None:
    """The names have number and stamp; --at takes the newest message of then."""
    said = exported(seen, "--topic", "points", "-o", "cloud.ply")
    assert said.startswith("Wrote cloud_000000_") and said.endswith(", 3 messages\n")
    names = [f"cloud_{at:06d}_{START_NS + at * S}.ply" for at in range(3)]
    assert sorted(each.name for each in Path().glob("*.ply")) == names
    assert "a message of 'points'" in exported(
        seen, "--topic", "/points", "--at", "1.5", "-o", "one.npz"
    )
    with np.load("one.npz") as file:
        assert file["stamp_ns"] == START_NS + S
        assert file["frame_id"] == "lidar"
        assert np.array_equal(file["points"]["normal"], cloud()["normal"])
    exported(seen, "--topic", "jpeg", "--at", "0", "-o", "one.jpg")
    assert Path("one.jpg").read_bytes() == JPEG
    exported(seen, "--topic", "image", "--at", "0", "-o", "one.npy")
    assert np.array_equal(np.load("one.npy"), picture().pixels())


def test_scans_and_clouds_are_written_in_another_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each range by the transform at its own time, without those that measured nothing; a message
    from before the transforms is skipped, with the reason.
    """
    monkeypatch.chdir(tmp_path)
    with RecordingWriter("drive.mcap") as writer:
        for tick in range(4):
            now = START_NS + tick * S
            place = TransformStamped(now, "map", "laser", Transform((float(tick), 0.0, 0.0)))
            writer.write(in_recording(now, [place], seq=tick))
        empty = LaserScan(START_NS + S, "laser")
        values = decode_map(encode_message(empty))
        writer.write(TopicItem(START_NS + S, "scan", type_name(LaserScan), values))
        for now in (START_NS - S, START_NS):
            scan = LaserScan(
                now,
                "laser",
                angle_increment=0.1,
                time_increment=1.0,
                range_max=9.0,
                ranges=np.array([1.0, 9.0, 0.0, 1.0], np.float32),
                intensities=np.arange(4, dtype=np.float32),
            )
            values = decode_map(encode_message(scan))
            writer.write(TopicItem(now + 3 * S, "scan", type_name(LaserScan), values))
    exported("drive.mcap", "--topic", "scan", "--at", "3", "-o", "own.ply")
    assert np.allclose(read_cloud(Path("own.ply"))["x"], [1.0, np.cos(0.3)])
    done = export("drive.mcap", "--topic", "scan", "--in-frame", "map", "-o", "moved.npz")
    assert done.exit_code == 0 and "skipped 1 message of 'scan', which cannot be" in done.output
    assert "'map'" in done.output and done.output.endswith(", 2 messages\n")
    with np.load(next(Path().glob(f"moved_*_{START_NS}.npz"))) as moved:
        assert (moved["frame_id"], moved["stamp_ns"]) == ("map", START_NS)
        assert np.allclose(moved["points"]["x"], [1.0, 3.0 + np.cos(0.3)])
        assert moved["points"]["intensity"].tolist() == [0.0, 3.0]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--in-frame", "map", "-o", "a.npz"), "--in-frame is for the clouds or scans of a"),
        (("--topic", "image", "--in-frame", "map", "-o", "a.png"), "--in-frame is for the clouds"),
        (("--topic", "points", "--in-frame", "map", "-o", "a.ply"), "no frame 'map'"),
        (
            ("--topic", "image", "-o", "a.ply"),
            "of type PointCloud or LaserScan, and 'image' is of type sensor",
        ),
        (("--topic", "points", "--at", "9", "-o", "a.ply"), "--at: 9s is outside of the recording"),
        (("--topic", "jpeg", "-o", "a.png"), "the image is jpeg, not png: write .jpg"),
        (("--topic", "none", "-o", "a.ply"), "no topic 'none'"),
        (("-o", "a.ply"), "give --topic"),
        (("--topic", "points", "-o", "a.tum"), "tum has no messages"),
        (("--topic", "points", "-o", "a.csv", "--at", "1"), "--at is for one cloud, scan or"),
        (("--topic", "points", "-o", "a.ply", "--at", "1", "--to", "2"), "--at is one time"),
    ],
)
def test_a_mistake_is_named(seen: Path, arguments: tuple[str, ...], said: str) -> None:
    """In a sentence, and no file is written."""
    done = export(seen, *arguments)
    assert done.exit_code in (1, 2)
    assert said in " ".join(done.output.split())
    assert os.listdir() == [seen.name]


def test_a_cloud_comes_back_from_its_files(tmp_path: Path) -> None:
    """PCD and npz keep columns and rows; columns with hostile names cannot break a header."""
    grid = np.zeros((2, 3), [("x", "f4"), ("a b\nDATA ascii", "u2"), ("n", "f8", (2,))])
    grid["x"] = np.arange(6).reshape(2, 3)
    hostile = PointCloud.from_array(5, "a\nb", grid)
    for each in (cloud(), hostile):
        for name, write in (("a.pcd", write_pcd), ("a.npz", write_cloud_npz)):
            write(each, tmp_path / name)
            back = read_cloud(tmp_path / name).as_array()
            assert back.shape == each.as_array().shape
            for old, new in zip(each.as_array().dtype.names, back.dtype.names, strict=True):
                assert np.array_equal(back[new], each.as_array()[old])
    write_ply(cloud(), tmp_path / "a.ply")
    header, _, body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    kinds = [line.split()[1:] for line in header.decode().splitlines() if "property" in line]
    of_numpy = {"float": "<f4", "double": "<f8", "uchar": "u1"}
    rows = np.frombuffer(body, [(name, of_numpy[kind]) for kind, name in kinds])
    assert np.array_equal(rows["z"], cloud()["z"])
    assert [rows[name][0] for name in ("red", "green", "blue")] == [0x10, 0x20, 0x30]
    back = read_cloud(tmp_path / "a.ply")
    assert np.array_equal(back.xyz(), cloud().xyz())
    assert np.array_equal(back["rgb"], cloud()["rgb"])
    assert np.array_equal(back["normal_2"], cloud()["normal"][:, 2])


def test_ascii_ply_is_read(tmp_path: Path) -> None:
    """As programs for meshes write it, of which the points are read."""
    path = tmp_path / "a.PLY"
    path.write_bytes(
        PLY_OF.replace(b"$", b"2").replace(b"\n", b"\r\n")
        + b"1 2 3 0.5\r\nnan 5 6 0.25\r\n3 0 1 1\r\n"
    )
    found = read_cloud(path)
    assert np.array_equal(found.xyz(), [[1, 2, 3], [np.nan, 5, 6]], equal_nan=True)
    assert found["quality"].tolist() == [0.5, 0.25]


def test_ascii_pcd_is_read(tmp_path: Path) -> None:
    """As PCL writes it."""
    path = tmp_path / "a.pcd"
    path.write_text(
        "# .PCD v.7\nVERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\n"
        "HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n1 2 3\nnan 5 6\n"
    )
    assert np.array_equal(read_cloud(path).xyz(), [[1, 2, 3], [np.nan, 5, 6]], equal_nan=True)


def test_another_library_reads_a_png(tmp_path: Path) -> None:
    """Colours and 16 bits are as they were, and read back."""
    pillow = needs.module("PIL.Image")
    path = tmp_path / "a.png"
    write_png(picture(), path)
    with pillow.open(path) as image:
        assert np.array_equal(np.asarray(image), picture().pixels()[..., ::-1])
    deep = np.arange(20, dtype=np.uint16).reshape(4, 5) * 3000
    write_png(Image.from_pixels(0, "", deep), path)
    assert np.array_equal(read_image(path).pixels(), deep)
    assert read_compressed_image(path).format == "png"
    with pytest.raises(InvalidArgumentException, match=r"32FC1: write \.npy"):
        write_png(Image.from_pixels(0, "", deep.astype(np.float32)), path)


def archive(points: bytes) -> bytes:
    """An npz with an array of these bytes."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as parts:
        parts.writestr("points.npy", points)
    return made.getvalue()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.pcd", b""),
        ("a.pcd", b"FIELDS x\nSIZE 4\nTYPE F\nWIDTH 999999999999\nDATA binary\nabcd"),
        ("a.pcd", b"FIELDS x\nSIZE 4\nTYPE O\nWIDTH 1\nDATA binary\nabcdefgh"),
        ("a.pcd", b"FIELDS x\nSIZE 4\nTYPE F\nCOUNT 999999999\nWIDTH 1\nDATA binary\nabcd"),
        ("a.pcd", b"FIELDS x\nSIZE 4\nTYPE F\nWIDTH -1\nDATA ascii\n"),
        ("a.pcd", b"FIELDS x\nSIZE\nTYPE F\nWIDTH\nDATA\n"),
        ("a.pcd", b"FIELDS x\nSIZE 4\nTYPE F\nWIDTH 1\nDATA binary_compressed\nabcd"),
        ("a.pcd", b"FIELDS x\nSIZE 4\nTYPE F\nWIDTH\nDATA ascii\n1\n"),
        ("a.npz", b"PK no archive"),
        ("a.npz", archive(bytes(100)).replace(b"\x14\x00", b"\xff\x00")),
        ("a.npy", archive(bytes(100))),
        ("a.npy", b"\x93NUMPY\x01\x00\x10\x00{'descr': '|O',("),
        ("a.npy", b"\x93NUMPY\x01\x00\x10\x00{'descr': '|O'}\n"),
        ("a.pcd", b"FIELDS x\nSIZE 4\nTYPE F\nWIDTH 999999999999999999999\nDATA ascii\n1\n"),
        ("a.ply", b"ply"),
        ("a.ply", b""),
        ("a.ply", PLY_OF.replace(b"$", b"2") + b"1 2 3 4\n"),
        ("a.ply", PLY_OF.replace(b"$", b"1") + b"1 2 3\n"),
        ("a.ply", PLY_OF.replace(b"$", b"1") + b"1 2 3 x\n"),
        ("a.ply", PLY_OF.replace(b"$", b"-1") + b"1 2 3 4\n"),
        ("a.ply", PLY_OF.replace(b"$", b"9" * 25) + b"1 2 3 4\n"),
        ("a.ply", PLY_OF.replace(b"$", b"1").replace(b"float32 x", b"list uchar int x")),
        ("a.ply", PLY_OF.replace(b"$", b"1").replace(b"32 y", b"32 x")),
        ("a.ply", PLY_OF.replace(b"$", b"1").replace(b"ascii", b"binary_big_endian")),
        ("a.ply", PLY_OF.replace(b"$", b"1").replace(b"ascii", b"binary_little_endian") + b"abcd"),
    ],
)
def test_a_hostile_cloud_is_refused_in_a_sentence(
    tmp_path: Path, name: str, content: bytes
) -> None:
    """It names the file."""
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InvalidArgumentException, match=name):
        read_cloud(path)


def test_a_ply_has_all_columns_though_their_parts_have_names_of_others(tmp_path: Path) -> None:
    """As of a colour beside `red`, and of three normals beside `normal_0`."""
    kinds = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("rgb", "f4"), ("red", "u1"), ("n", "f4", (2,))]
    points = np.zeros(1, [*kinds, ("n_0", "f4")])
    points["red"], points["n"], points["n_0"] = 7, (1.0, 2.0), 3.0
    write_ply(PointCloud.from_array(0, "map", points), tmp_path / "a.ply")
    read = read_cloud(tmp_path / "a.ply")
    assert [read[name].tolist() for name in ("red_", "n_0", "n_1", "n_0_")] == [[7], [1], [2], [3]]


@pytest.mark.parametrize(
    "write",
    [
        lambda path: write_ply(cloud(), path),
        lambda path: write_pcd(cloud(), path),
        lambda path: write_cloud_npz(cloud(), path),
        lambda path: write_png(picture(), path),
        lambda path: write_pixels_npy(picture(), path),
    ],
    ids=["ply", "pcd", "npz", "png", "npy"],
)
def test_a_full_disk_is_the_reason(write: Callable[[Path], None]) -> None:
    """An error of the system, which the tool prints with the name of the file."""
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("only Linux has a file that is always full")
    with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)):
        write(full)


def test_arrays_of_a_recording_are_as_on_the_bus(tmp_path: Path) -> None:
    """As one binary each, which a program gets as an array, CSV as a list."""
    path = tmp_path / "scans.mcap"
    scan = LaserScan(
        *(START_NS, "lidar", 0.0, 1.0, 0.5, 0.0, 0.5, 0.5, 30.0), np.array([1.0, 2.5, 4.0])
    )
    sent = decode_map(encode_message(scan))
    codec = MessageCodec.of_type(LaserScan)
    data = codec.encode_fitted(sent)
    assert data is not None
    with RecordingWriter(path) as writer:
        writer.write(
            TopicItem(START_NS, "scan", type_name(LaserScan), sent, (codec.definition, data))
        )
    with RecordingReader(path) as reader:
        [item] = reader.items()
    assert isinstance(item, TopicItem)
    assert encode_map(item.values) == encode_message(scan)
    with Recording(path) as recording:
        [(_, fields)] = recording.messages("scan")
        [(_, message)] = recording.messages("scan", LaserScan)
    assert fields["ranges"].tolist() == [1.0, 2.5, 4.0]
    assert message == scan
    exported(path, "--topic", "scan", "-o", tmp_path / "scan.csv")
    assert '"[1.0, 2.5, 4.0]"' in (tmp_path / "scan.csv").read_text()
