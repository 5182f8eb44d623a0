"""Point clouds and images in files: PLY, PCD and npz, PNG, JPEG and npy."""

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Container, Mapping
from pathlib import Path
from typing import Any, TypeVar

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.lazy_numpy import NDArray
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
# Some programs write sizes in bits.
_KINDS_OF_PLY = {name: kind for kind, name in _PLY_TYPES.items()} | {
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_PLY_FORMATS = ("ascii", "binary_little_endian")
_COLORS = ("red", "green", "blue")
_MAGIC = {b"\x89PNG\r\n\x1a\n": "png", b"\xff\xd8\xff": "jpeg", b"RIFF": "webp"}


def write_ply(cloud: PointCloud, path: Path) -> None:
    """Write a cloud as binary PLY. A packed colour, as PCL has it in `rgb`, becomes red, green and
    blue; a column of several numbers becomes several. Raises OSError.
    """
    columns: dict[str, NDArray[Any]] = {}
    for name, numbers in _columns(cloud):
        if name in ("rgb", "rgba") and numbers.ndim == 1 and numbers.dtype.itemsize == 4:
            packed = np.ascontiguousarray(numbers).view("<u4")
            for color, shift in zip(_COLORS, (16, 8, 0), strict=True):
                columns[_other_than(columns, color)] = (packed >> shift).astype("u1")
        elif numbers.ndim == 1:
            columns[_other_than(columns, name)] = numbers
        else:
            for at in range(numbers.shape[1]):
                columns[_other_than(columns, f"{name}_{at}")] = numbers[:, at]
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
    # Into a file numpy writes by C, and does not say why that failed.
    held = io.BytesIO()
    np.save(held, image.pixels())
    path.write_bytes(held.getbuffer())


def read_cloud(path: str | Path) -> PointCloud:
    """The cloud in a file, without stamp and frame: PLY and PCD (ascii or little-endian), `points`
    or `xyz` of an npz, or an array in npy; arrays are structured or (N, 3). A PLY's red, green and
    blue become `rgb`, as PCL has it. Raises InvalidArgumentException for other files, and OSError.
    """
    readers = {".ply": _read_ply, ".pcd": _read_pcd, ".npy": _cloud_npy, ".npz": _cloud_npz}
    return _read(Path(path), readers, "cloud")


def read_image(path: str | Path) -> Image:
    """The image in a file, without stamp and frame: pixels in npy, or PNG and JPEG by Pillow.
    Raises as `read_cloud`.
    """
    by_pillow = dict.fromkeys((".png", ".jpg", ".jpeg"), _image_by_pillow)
    return _read(Path(path), {".npy": _image_npy, **by_pillow}, "image")


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


def _read(path: Path, readers: Mapping[str, Callable[[Path], M]], what: str) -> M:
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InvalidArgumentException(
            f"{path} has no ending of a file with a {what}: {', '.join(readers)}"
        )
    try:
        return reader(path)
    except (InvalidArgumentException, OSError):
        raise
    except Exception as error:  # of numpy, zipfile and Pillow, which do not say all of theirs
        lines = str(error.args[0] if error.args else "").splitlines()
        said = (lines or [type(error).__name__])[0][:200]
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
    columns: dict[str, NDArray[Any]] = {}
    for each in cloud.fields:
        numbers = cloud[each.name]
        name = _other_than(columns, _word(each.name))
        columns[name] = numbers.astype(numbers.dtype.newbyteorder("<"), copy=False)
    return list(columns.items())


def _other_than(names: Container[str], name: str) -> str:
    """The name, with underlines behind it as long as there is another one of it."""
    while name in names:
        name += "_"
    return name


def _kind(numbers: NDArray[Any]) -> str:
    return f"{numbers.dtype.kind}{numbers.dtype.itemsize}"


def _table(columns: dict[str, NDArray[Any]], count: int) -> NDArray[Any]:
    """The columns as a structured array without gaps."""
    table = np.empty(count, [(name, each.dtype, each.shape[1:]) for name, each in columns.items()])
    for name, each in columns.items():
        table[name] = each
    return table


def _header(data: bytes, last: str) -> tuple[list[list[str]], int]:
    """The words of each line of a header up to that with the word `last`, and where that ends."""
    file = io.BytesIO(data[:_MOST_HEADER])
    lines: list[list[str]] = [[]]
    while lines[-1][:1] != [last]:
        line = file.readline()
        if not line.endswith(b"\n"):
            raise ValueError(f"its header must end with a line {last}")
        lines.append(line.decode("ascii", "replace").split())
    return list(filter(None, lines)), file.tell()


def _points(data: bytes, dtype: "np.dtype[Any]", count: int, *, is_text: bool) -> NDArray[Any]:
    """The points behind a header, as a structured array (count,); bytes after them are not read."""
    if is_text:
        have = data.count(b"\n") + (not data.endswith(b"\n"))
    else:
        have = len(data) // max(dtype.itemsize, 1)
    if count > have:
        raise ValueError(f"its header says {count} points, and it has {have}")
    if not is_text:
        points = np.frombuffer(data, dtype, count)
    elif not count or not data or data.isspace():
        points = np.empty(0, dtype)
    else:
        try:
            points = np.loadtxt(io.BytesIO(data), dtype, comments=None, ndmin=1, max_rows=count)
        except ValueError as error:
            # Behind the semicolon is advice for programs.
            said = str(error).partition(";")[0]
            raise ValueError(f"a line of its points has other numbers: {said}") from error
    if len(points) != count:
        raise ValueError(f"its header says {count} points, and it has {len(points)}")
    return points


def _read_ply(path: Path) -> PointCloud:
    data = _bytes_of(path)
    if not data.startswith(b"ply"):
        raise ValueError("it must begin with a line ply")
    lines, size = _header(data, "end_header")
    form = next((words[1] for words in lines if words[0] == "format" and len(words) > 1), "none")
    if form not in _PLY_FORMATS:
        raise ValueError(f"its format must be {' or '.join(_PLY_FORMATS)}, not {form[:40]!r}")
    elements = [at for at, words in enumerate(lines) if words[0] == "element"]
    first = lines[elements[0]] if elements else []
    if len(first) != 3 or first[1] != "vertex" or not first[2].isdecimal():
        raise ValueError("its first element must be vertex, the points, with their number")
    columns: dict[str, str] = {}
    for words in lines[elements[0] + 1 : [*elements, len(lines)][1]]:
        if words[0] != "property":
            continue
        if len(words) != 3 or words[1] not in _KINDS_OF_PLY:
            raise ValueError(f"a point must have single numbers, not {' '.join(words)[:60]!r}")
        if words[2] in columns:
            raise ValueError(f"it has {words[2][:60]!r} twice")
        columns[words[2]] = _KINDS_OF_PLY[words[1]]
    if not columns.keys() >= set("xyz"):
        raise ValueError("a point must have x, y and z")
    dtype = np.dtype([(name, f"<{kind}") for name, kind in columns.items()])
    points = _points(data[size:], dtype, int(first[2]), is_text=form == "ascii")
    if [columns.get(color) for color in _COLORS] == ["u1"] * 3:
        red, green, blue = (points[color].astype("<u4") for color in _COLORS)
        packed = (red << 16 | green << 8 | blue).view("<f4")
        others = {name: points[name] for name in columns if name not in _COLORS}
        points = _table({**others, "rgb": packed}, len(points))
    return PointCloud.from_array(0, "", points)


def _read_pcd(path: Path) -> PointCloud:
    data = _bytes_of(path)
    lines, size = _header(data, "DATA")
    facts = {words[0]: words[1:] for words in lines}
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
    if form not in ("ascii", "binary"):
        raise ValueError(f"its data must be ascii or binary, not {form[:40]!r}: convert it by PCL")
    points = _points(data[size:], dtype, width * height, is_text=form == "ascii")
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
