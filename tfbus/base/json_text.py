"""Values of messages and measurements as JSON, which other programs can read."""

import json
import math
from collections.abc import Callable, Mapping
from typing import Any


def json_text(
    value: object, *, indent: int | None = None, of_bytes: Callable[[bytes], str] = bytes.hex
) -> str:
    """The value as JSON: numbers that are not finite are null, arrays of numpy lists, bytes texts
    by `of_bytes`, names in maps texts, and what JSON does not know its `str`.

    Raises RecursionError if it is nested too deeply.
    """

    def plain(each: Any) -> Any:
        if isinstance(each, Mapping):
            return {name(key): plain(item) for key, item in each.items()}
        if isinstance(each, list | tuple):
            return [plain(item) for item in each]
        if isinstance(each, float):
            return each if math.isfinite(each) else None
        return each if isinstance(each, bool | int | str | None) else plain(other(each))

    def name(key: Any) -> str:
        return key if isinstance(key, str) else str(other(key))

    def other(each: Any) -> Any:
        if isinstance(each, bytes | bytearray | memoryview):
            return of_bytes(bytes(each))
        return each.tolist() if hasattr(each, "dtype") else str(each)

    try:
        return json.dumps(value, default=other, indent=indent, allow_nan=False)
    except (TypeError, ValueError):  # a name that is no text, or a number that is not finite
        return json.dumps(plain(value), indent=indent)
