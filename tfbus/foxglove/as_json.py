"""Messages as JSON, and the JSON schemas of dataclasses, for Foxglove."""

import json
import math
from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, get_args, get_origin, get_type_hints

from tfbus.wire.codec import as_map, type_name


def json_of(values: Mapping[Any, Any]) -> bytes:
    """A message as JSON. Bytes become base64, numbers that are not finite null.

    Raises ValueError if it is nested too deeply.
    """
    try:
        return json.dumps(_plain(values), allow_nan=False).encode()
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {_key(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, bytes):
        return b64encode(value).decode()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, bool | int | str | None) else str(value)


def _key(key: Any) -> str:
    return key if isinstance(key, str) else str(key)


def values_of(payload: bytes, message_type: type | None) -> dict[str, Any]:
    """A message that came as JSON; base64 becomes bytes if the type has bytes.

    Raises ValueError if it is no JSON object.
    """
    try:
        values = json.loads(payload) if payload else {}
    except (UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"not JSON: {error}") from error
    if not isinstance(values, dict):
        raise ValueError("a message must be a JSON object")
    return values if message_type is None else _with_bytes(values, message_type)


def _with_bytes(values: dict[str, Any], message_type: type) -> dict[str, Any]:
    hints = get_type_hints(message_type)
    return {name: _read(value, hints.get(name)) for name, value in values.items()}


def _read(value: Any, expected: Any) -> Any:
    if expected is bytes and isinstance(value, str):
        return b64decode(value)
    if is_dataclass(expected) and isinstance(expected, type) and isinstance(value, dict):
        return _with_bytes(value, expected)
    if get_origin(expected) in (list, tuple) and isinstance(value, list):
        return [_read(each, get_args(expected)[0]) for each in value]
    return value


def json_schema(message_type: type) -> dict[str, Any]:
    """The JSON schema of a dataclass, with its defaults."""
    hints = get_type_hints(message_type)
    properties = {}
    for entry in fields(message_type):
        schema = _schema_of(hints[entry.name])
        default: Any = entry.default
        if entry.default_factory is not MISSING:
            default = entry.default_factory()
        if default is not MISSING and not isinstance(default, bytes):
            schema["default"] = as_map(default) if is_dataclass(default) else default
        properties[entry.name] = schema
    return {"title": type_name(message_type), "type": "object", "properties": properties}


_PLAIN: dict[Any, dict[str, Any]] = {
    bool: {"type": "boolean"},
    bytes: {"type": "string", "contentEncoding": "base64"},
    float: {"type": "number"},
    int: {"type": "integer"},
    str: {"type": "string"},
}


def _schema_of(expected: Any) -> dict[str, Any]:
    if is_dataclass(expected) and isinstance(expected, type):
        return json_schema(expected)
    origin, args = get_origin(expected), get_args(expected)
    if origin is dict:
        return {"type": "object", "additionalProperties": _schema_of(args[1])}
    if origin in (list, tuple):
        same = origin is list or Ellipsis in args
        return {"type": "array", "items": _schema_of(args[0]) if same else {}}
    return dict(_PLAIN.get(expected, {}))
