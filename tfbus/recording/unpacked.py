"""Compressed bytes of recordings, unpacked; never more of them than may be. All raise DecodeError.

A few kilobytes can stand for gigabytes: nothing is made before its size is known to be small
enough, or it is made piece by piece.
"""

import bz2
from pathlib import Path
from shutil import disk_usage

from tfbus.errors import DecodeError
from tfbus.wire.limits import size_text

# What a disk keeps free where a file is unpacked onto it.
_LEAST_FREE = 10**9

_AT_A_TIME = 2**24


def of_zstd(data: bytes, most: int) -> bytes:
    """The bytes in zstd's, at most so many."""
    import zstandard

    try:
        said = zstandard.frame_content_size(data)
        if said > most:  # it would be taken in memory as it is
            raise _too_many(most)
        found: bytes = zstandard.ZstdDecompressor().decompress(data, max_output_size=most or 1)
    except zstandard.ZstdError as error:
        raise DecodeError("compressed bytes cannot be unpacked") from error
    return found


def of_lz4(data: bytes, most: int) -> bytes:
    """The bytes in a frame of lz4, at most so many."""
    import lz4.frame  # type: ignore[import-untyped]  # lz4 has no types

    unpacker = lz4.frame.LZ4FrameDecompressor()
    try:
        found: bytes = unpacker.decompress(data, max_length=most + 1)
    except (RuntimeError, EOFError) as error:
        raise DecodeError("compressed bytes cannot be unpacked") from error
    if len(found) > most:
        raise _too_many(most)
    return found


def of_bz2(data: bytes, most: int) -> bytes:
    """The bytes in a stream of bzip2, at most so many."""
    unpacker = bz2.BZ2Decompressor()
    try:
        found = unpacker.decompress(data, max_length=most + 1)
    except (OSError, EOFError) as error:
        raise DecodeError("compressed bytes cannot be unpacked") from error
    if len(found) > most:
        raise _too_many(most)
    return found


def unpack_zstd_file(packed: Path, plain: Path) -> None:
    """Unpack a file of zstd's, as long as 1 GB of the disk stays free. Raises OSError, too."""
    import zstandard

    with packed.open("rb") as source, plain.open("wb") as target:
        try:
            for part in zstandard.ZstdDecompressor().read_to_iter(source, write_size=_AT_A_TIME):
                if disk_usage(plain.parent).free < _LEAST_FREE + len(part):
                    raise DecodeError(
                        f"it unpacks to more than {size_text(target.tell())}, for which "
                        f"{plain.parent} has no room: TMPDIR names another folder"
                    )
                target.write(part)
        except zstandard.ZstdError as error:
            raise DecodeError("compressed bytes cannot be unpacked") from error


def _too_many(most: int) -> DecodeError:
    return DecodeError(f"compressed bytes unpack to more than {size_text(most)}")
