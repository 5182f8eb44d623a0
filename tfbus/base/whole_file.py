"""Files that are replaced whole: a full disk or an interrupt leaves the former one as it was."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A file to write bytes to, which takes the place of `path` at the end of the `with`.

    It is written beside that one and renamed; after an error nothing has changed. A device or a
    pipe, such as /dev/stdout, is written to directly. Raises OSError, which names `path`.
    """
    place = Path(os.path.realpath(path))
    if place.exists() and not place.is_file():
        with place.open("wb") as file:
            yield file
        return
    with taking_place_of(path) as beside, beside.open("xb") as file:
        if place.exists():
            os.chmod(beside, place.stat().st_mode & 0o7777)
        yield file


@contextmanager
def taking_place_of(path: str | os.PathLike[str]) -> Iterator[Path]:
    """The path of a file to make, beside `path`, which takes its place at the end of the `with`.

    After an error, or an interrupt, that file is removed and nothing has changed. Raises OSError,
    which names `path`.
    """
    place = Path(os.path.realpath(path))
    beside = place.with_name(f".{place.name[:200]}.{secrets.token_hex(4)}")
    try:
        yield beside
        with beside.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(beside, place)
    except BaseException as error:
        if isinstance(error, OSError) and str(error.filename) == str(beside):
            error.filename = os.fspath(path)
            del error.filename2  # that of the renaming
        with suppress(OSError):
            beside.unlink()
        raise
