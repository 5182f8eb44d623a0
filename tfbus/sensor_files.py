"""Point clouds and images in files: PLY, PCD and npz, PNG, JPEG and npy."""

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from tfbus.core import lazy_numpy as np
from tfbus.core.lazy_numpy import NDArray
from tfbus.errors import InvalidArgumentException
from tfbus.messages import CompressedImage, Image, PointCloud

M = TypeVar("M")

# No more is read from a file, also after it is unpacked: a message has at most 1 GiB.
_MOST_BYTES = 1 << 30
_MOST_HEADER = 1 << 16

_PLY_TYPES = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}
_MAGIC = {b"\x89PNG\r\n\x1a\n": "png", b"\xff\xd8\xff": "jpeg", b"RIFF": "webp"}


def write_ply(cloud: PointCloud, path: Path) -> None:
    """Write a cloud as binary PLY. A packed colour, as PCL has it in `rgb`, becomes red, green and
    blue; a column of several numbers becomes several. Raises OSError.
    """
    columns: dict[str, NDArray[Any]] = {}
    for name, numbers in _columns(cloud):
        if name in ("rgb", "rgba") and numbers.ndim == 1 and numbers.dtype.itemsize == 4:
            packed = np.ascontiguousarray(numbers).view("<u4")
            for color, shift in (("red", 16), ("green", 8), ("blue", 0)):
                columns[color] = (packed >> shift).astype("u1")
        elif numbers.ndim == 1:
            columns[name] = numbers
        else:
            columns |= {f"{name}_{at}": numbers[:, at] for at in range(numbers.shape[1])}
    header = ["ply", "format binary_little_endian 1.0", f"comment stamp_ns {cloud.stamp_ns}"]
    header += [f"comment frame_id {_word(cloud.frame_id)}", f"element vertex {len(cloud)}"]
    header += [f"property {_PLY_TYPES[_kind(each)]} {name}" for name, each in columns.items()]
    _write(path, [*header, "end_header"], _table(columns, len(cloud)))


def write_pcd(cloud: PointCloud, path: Path) -> None:
    """Write a cloud as binary PCD 0.7, with its rows. Raises OSError."""
    columns = dict(_columns(cloud))
    kinds = [_kind(each) for each in columns.values()]
    counts = [each.shape[1] if each.ndim > 1 else 1 for each in columns.values()]
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        f"# stamp_ns {cloud.stamp_ns}",
        f"# frame_id {_word(cloud.frame_id)}",
        "VERSION 0.7",
        f"FIELDS {' '.join(columns)}",
        f"SIZE {' '.join(kind[1] for kind in kinds)}",
        f"TYPE {' '.join(kind[0].upper() for kind in kinds)}",
        f"COUNT {' '.join(map(str, counts))}",
        f"WIDTH {cloud.width}",
        f"HEIGHT {cloud.height}",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(cloud)}",
        "DATA binary",
    ]
    _write(path, header, _table(columns, len(cloud)))


def write_cloud_npz(cloud: PointCloud, path: Path) -> None:
    """Write a cloud as `points`, a structured array (N,) or (height, width) with its columns, and
    `stamp_ns` and `frame_id`. Raises OSError.
    """
    points = _table(dict(_columns(cloud)), len(cloud))
    if cloud.height != 1:
        points = points.reshape(cloud.height, cloud.width)
    with path.open("wb") as file:
        np.savez_compressed(
            file, points=points, stamp_ns=np.int64(cloud.stamp_ns), frame_id=np.str_(cloud.frame_id)
        )


def write_png(image: Image | CompressedImage, path: Path) -> None:
    """Write an image of 8 or 16 bits as PNG, with red first; one that is a PNG as it is.

    Raises InvalidArgumentException for numbers that PNG does not have, and OSError.
    """
    if isinstance(image, CompressedImage):
        _write_as_it_is(image, path, "png", ".jpg")
        return
    pixels = image.pixels()
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    if pixels.dtype.kind != "u" or pixels.dtype.itemsize > 2 or channels not in (1, 3, 4):
        raise InvalidArgumentException(
            f"PNG has no pixels of {image.encoding}: write .npy, which has all"
        )
    if not image.height or not image.width:
        raise InvalidArgumentException("PNG has no image without pixels")
    if image.encoding.startswith("bgr"):
        pixels = pixels[..., [2, 1, 0, *range(3, channels)]]
    size = pixels.dtype.itemsize
    lines = np.ascontiguousarray(pixels.astype(f">u{size}")).view("u1").reshape(image.height, -1)
    # Each line begins with its filter: 0, none.
    lines = np.pad(lines, ((0, 0), (1, 0)))
    form = {1: 0, 3: 2, 4: 6}[channels]
    head = struct.pack(">IIBBBBB", image.width, image.height, 8 * size, form, 0, 0, 0)
    with path.open("wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        for name, data in (
            (b"IHDR", head),
            (b"IDAT", zlib.compress(lines.data, 3)),
            (b"IEND", b""),
        ):
            file.write(struct.pack(">I", len(data)) + name + data)
            file.write(struct.pack(">I", zlib.crc32(name + data)))


def write_jpeg(image: CompressedImage, path: Path) -> None:
    """Write an image that is a JPEG, as it is. Raises InvalidArgumentException for another, and
    OSError.
    """
    _write_as_it_is(image, path, "jpeg", ".png")


def write_pixels_npy(image: Image, path: Path) -> None:
    """Write the pixels (height, width), or (height, width, channels), as the encoding has them.
    Raises OSError.
    """
    with path.open("wb") as file:
        np.save(file, image.pixels())


def read_cloud(path: Path) -> PointCloud:
    """The cloud in a file, without stamp and frame: PCD (ascii, binary), `points` of an npz, or an
    array in npy, structured or (N, 3). Raises InvalidArgumentException, and OSError.
    """
    return _read(path, {".pcd": _read_pcd, ".npy": _cloud_npy, ".npz": _cloud_npz}, "cloud")


def read_image(path: Path) -> Image:
    """The image in a file, without stamp and frame: pixels in npy, or PNG and JPEG by Pillow.
    Raises InvalidArgumentException, and OSError.
    """
    by_pillow = dict.fromkeys((".png", ".jpg", ".jpeg"), _image_by_pillow)
    return _read(path, {".npy": _image_npy, **by_pillow}, "image")


def read_compressed_image(path: Path) -> CompressedImage:
    """The image in a file as it is, without stamp and frame: PNG, JPEG or WebP. Raises
    InvalidArgumentException, and OSError.
    """
    data = _bytes_of(path)
    form = _form_of(data)
    if not form:
        raise InvalidArgumentException(f"{path} must be a PNG, JPEG or WebP, by its first bytes")
    return CompressedImage(0, "", form, np.frombuffer(data, np.uint8))


# Reads a message from a file, by the type of the message.
READERS: dict[type, Callable[[Path], Any]] = {
    PointCloud: read_cloud,
    Image: read_image,
    CompressedImage: read_compressed_image,
}


def _read(path: Path, readers: dict[str, Callable[[Path], M]], what: str) -> M:
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InvalidArgumentException(
            f"{path} has no ending of a file with a {what}: {', '.join(readers)}"
        )
    try:
        return reader(path)
    except InvalidArgumentException:
        raise
    except (
        ValueError,
        KeyError,
        TypeError,
        MemoryError,
        EOFError,
        SyntaxError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        said = str(error.args[0] if error.args else type(error).__name__).splitlines()[0][:200]
        raise InvalidArgumentException(f"{path} has no {what} that can be read: {said}") from error


def _bytes_of(path: Path) -> bytes:
    with path.open("rb") as file:
        data = file.read(_MOST_BYTES + 1)
    if len(data) > _MOST_BYTES:
        raise InvalidArgumentException(f"{path} must have at most 1 GiB")
    return data


def _form_of(data: bytes) -> str:
    return next((form for magic, form in _MAGIC.items() if data.startswith(magic)), "")


def _write_as_it_is(image: CompressedImage, path: Path, form: str, other: str) -> None:
    data = image.data.tobytes()
    found = _form_of(data)
    if found != form:
        raise InvalidArgumentException(
            f"the image is {found or 'neither PNG nor JPEG'}, not {form}: write {other}"
        )
    path.write_bytes(data)


def _write(path: Path, header: list[str], table: NDArray[Any]) -> None:
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in header).encode("ascii"))
        file.write(table.tobytes())


def _word(text: str) -> str:
    """A name as one word of ASCII, which cannot end a line of a header."""
    return re.sub(r"[^A-Za-z0-9_/.-]", "_", text)[:200] or "_"


def _columns(cloud: PointCloud) -> list[tuple[str, NDArray[Any]]]:
    """The columns, each by a name of its own that is one word."""
    names: set[str] = set()
    columns = []
    for each in cloud.fields:
        name = _word(each.name)
        while name in names:
            name += "_"
        names.add(name)
        numbers = cloud[each.name]
        columns.append((name, numbers.astype(numbers.dtype.newbyteorder("<"), copy=False)))
    return columns


def _kind(numbers: NDArray[Any]) -> str:
    return f"{numbers.dtype.kind}{numbers.dtype.itemsize}"


def _table(columns: dict[str, NDArray[Any]], count: int) -> NDArray[Any]:
    """The columns as a structured array without gaps."""
    table = np.empty(count, [(name, each.dtype, each.shape[1:]) for name, each in columns.items()])
    for name, each in columns.items():
        table[name] = each
    return table


def _read_pcd(path: Path) -> PointCloud:
    data = _bytes_of(path)
    facts: dict[str, list[str]] = {}
    file = io.BytesIO(data[:_MOST_HEADER])
    while "DATA" not in facts:
        line = file.readline()
        if not line:
            raise ValueError("its header must end with DATA")
        words = line.decode("ascii", "replace").split()
        if words and not words[0].startswith("#"):
            facts[words[0]] = words[1:]
    names = facts["FIELDS"]
    counts = [int(each) for each in facts.get("COUNT", ["1"] * len(names))]
    columns = zip(names, facts["TYPE"], facts["SIZE"], counts, strict=True)
    dtype = np.dtype(
        [
            # Columns without meaning, which fill a gap, are all called _.
            (f"_{at}" if name == "_" else name, f"<{kind.lower()}{int(size)}", _shape(count))
            for at, (name, kind, size, count) in enumerate(columns)
        ]
    )
    width = int(facts["WIDTH"][0])
    height = int(facts.get("HEIGHT", ["1"])[0])
    form = facts["DATA"][0] if facts["DATA"] else ""
    if width < 0 or height < 0:
        raise ValueError("WIDTH and HEIGHT must not be negative")
    if form == "binary":
        have = (len(data) - file.tell()) // max(dtype.itemsize, 1)
        if width * height > have:
            raise ValueError(f"its header says {width * height} points, and it has {have}")
        points = np.frombuffer(data, dtype, width * height, file.tell())
    elif form == "ascii":
        points = np.loadtxt(io.BytesIO(data[file.tell() :]), dtype, ndmin=1)
        if len(points) != width * height:
            raise ValueError(f"its header says {width * height} points, and it has {len(points)}")
    else:
        raise ValueError(f"its data must be ascii or binary, not {form[:40]!r}: convert it by PCL")
    return PointCloud.from_array(0, "", points.reshape(height, width) if height != 1 else points)


def _shape(count: int) -> tuple[int, ...]:
    if not 1 <= count <= _MOST_HEADER:
        raise ValueError(f"COUNT must be at least 1 and at most {_MOST_HEADER}, not {count}")
    return () if count == 1 else (count,)


def _array_npy(path: Path) -> NDArray[Any]:
    # Mapped, so that a length that lies is found before it takes memory.
    found = np.load(path, mmap_mode="r", allow_pickle=False)
    if found.nbytes > _MOST_BYTES:
        raise ValueError("it must have at most 1 GiB")
    return np.array(found)


def _cloud_npy(path: Path) -> PointCloud:
    return _cloud_of(_array_npy(path))


def _cloud_npz(path: Path) -> PointCloud:
    with zipfile.ZipFile(path) as parts:
        sizes = {part.filename: part.file_size for part in parts.infolist()}
        name = next((each for each in ("points.npy", "xyz.npy") if each in sizes), None)
        if name is None:
            raise ValueError("it must have an array `points` or `xyz`")
        if sizes[name] > _MOST_BYTES:
            raise ValueError("it must have at most 1 GiB")
        with parts.open(name) as file:
            data = file.read(sizes[name])
    found = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    return _cloud_of(found)


def _cloud_of(points: NDArray[Any]) -> PointCloud:
    if points.dtype.names is None:
        return PointCloud.from_xyz(0, "", points)
    return PointCloud.from_array(0, "", points)


def _image_npy(path: Path) -> Image:
    return Image.from_pixels(0, "", _array_npy(path))


def _image_by_pillow(path: Path) -> Image:
    try:
        import PIL.Image
    except ImportError as error:
        raise InvalidArgumentException(
            f"{path} needs Pillow to be unpacked: pip install pillow, or publish it as it is, as a "
            "CompressedImage"
        ) from error
    try:
        with PIL.Image.open(io.BytesIO(_bytes_of(path)), formats=("PNG", "JPEG")) as image:
            is_plain = image.mode in ("L", "RGB", "RGBA", "I;16")
            pixels = np.asarray(image if is_plain else image.convert("RGB"))
    except (OSError, PIL.Image.DecompressionBombError) as error:
        raise ValueError(str(error)) from error
    return Image.from_pixels(0, "", pixels)
