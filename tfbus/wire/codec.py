"""Messages of topics and services: small dataclasses on the wire as msgpack maps.

A field is an int, float, bool, str, bytes, another dataclass, a list or a dict by str of one of
these, or a tuple with a type for each item; Any is taken as it comes. An array of numpy that a type
declares (`messages.fields.ArrayOf`) is one binary. An int may stand for a float,
and 0 and 1 for false and true; numbers, booleans and texts of numpy, and arrays of these, are sent
as Python's own. Nothing else is converted.

The fields are as in ROS, but for a `header`, which is `stamp_ns` and `frame_id` here; former names
of fields are read as well. A payload is read only if it has at most a million values.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import cache, lru_cache, partial
from operator import attrgetter
from typing import Any, NamedTuple, Protocol, TypeVar, cast, get_args, get_origin, get_type_hints

import msgpack

from tfbus.base.bounded import MadeOf
from tfbus.base.errors import BusError, DecodeError
from tfbus.base.structs import Struct, fields_of
from tfbus.base.wording import printable

# The header of a message in CDR: a zero, the encoding, and two bytes of options.
_CDR_HEADER_SIZE = 4
_LAST_CDR = 0x0B

M = TypeVar("M")
Reader = Callable[[object, str], Any]

# Classes of most fields, which need no look at their contents.
_AS_THEY_ARE = frozenset((float, int, str, bytes, bool))


def encode_map(value: Mapping[str, Any]) -> bytes:
    """The bytes of a plain map, for a message without a type.

    Raises BusError with the name of the field if a value cannot be sent, or if a text has a
    lone surrogate: UTF-8 cannot hold it.
    """
    return _encoded(value if value.__class__ is dict else dict(value), _PLAIN)


class _Packing:
    """Packs values by msgpack; `convert(value)` makes known ones of those that it does not know.

    Packers are used again: to make one takes as long as to pack a small message.
    """

    def __init__(self, convert: Callable[[Any], Any]) -> None:
        self._convert = convert
        # Those that no thread uses now; changed by single operations.
        self._idle: list[Any] = []

    def pack(self, values: Any) -> bytes:
        """The bytes of a map, or of another value."""
        try:
            packer = self._idle.pop()
        except IndexError:
            packer = msgpack.Packer(default=self._convert)
        payload: bytes = packer.pack(values)
        if len(payload) <= _LARGE:  # it keeps as much memory as it needed
            self._idle.append(packer)
        return payload

    def pack_large(self, values: dict[str, Any]) -> bytes:
        """The same, of a map with memory that is large."""
        packer = msgpack.Packer(default=self._convert)
        parts: list[Any] = [packer.pack_map_header(len(values))]
        for name, value in values.items():
            parts.append(packer.pack(name))
            if type(value) is memoryview:
                parts += (b"\xc6" + value.nbytes.to_bytes(4, "big"), value)
            else:
                parts.append(packer.pack(value))
        return b"".join(parts)


def _encoded(values: dict[str, Any], packing: _Packing) -> bytes:
    try:
        for value in values.values():
            if value.__class__ is memoryview and value.nbytes >= _LARGE:
                return packing.pack_large(values)
        return packing.pack(values)
    except UnicodeEncodeError as error:
        text = printable(str(error.object), 60)
        raise BusError(f"could not send the text '{text}': it is not valid Unicode") from error
    except (TypeError, OverflowError) as error:
        raise BusError(
            _why_unsendable(values, "") or f"could not send a message: {error}"
        ) from error
    except ValueError as error:  # it is in itself, or nested too deep
        raise BusError(f"could not send a message: {error}") from error


# A binary of so many bytes is put into the message at once: msgpack copies it three times.
_LARGE = 16 * 1024


def _of_numpy(value: Any) -> Any:
    """A number, boolean or text of numpy, or an array of these, as Python's own, exactly.

    Raises TypeError for all else.
    """
    dtype: Any = getattr(value, "dtype", None)
    if (
        dtype is None
        or type(value).__module__.partition(".")[0] != "numpy"
        or (f"{dtype.kind}{dtype.itemsize}" not in _EXACT and dtype.kind != "U")
    ):
        raise TypeError(f"cannot send a {type(value).__name__}")
    return value.tolist()


# Kinds of numpy's numbers and their bytes: a longer float has no place in a message.
_EXACT = {"b1", *(f"{kind}{size}" for kind in "iu" for size in (1, 2, 4, 8)), "f2", "f4", "f8"}


_PLAIN = _Packing(_of_numpy)


def _why_unsendable(value: Any, path: str) -> str:
    """A sentence about the first value that cannot be sent, and its field; "" for none."""
    if _is_message(value.__class__):
        value = as_map(value)
    if isinstance(value, Mapping):
        inside = ((f"{path}.{name}" if path else str(name), item) for name, item in value.items())
    elif isinstance(value, list | tuple):
        inside = ((f"{path}[{at}]", item) for at, item in enumerate(value))
    else:
        try:
            msgpack.packb(value, default=_of_numpy)
        except UnicodeEncodeError:
            return ""
        except (TypeError, OverflowError):
            dtype = getattr(value, "dtype", None)
            kind = f"{type(value).__name__}{f' of {dtype}' if dtype is not None else ''}"
            if isinstance(value, int):
                kind = "integer beyond 64 bits"
            return (
                f"could not send field '{printable(path, 100)}', a value of the kind {kind}: a "
                "field is an int, float, bool, str, bytes, list, dict or a dataclass; convert it, "
                "as by list(...) or float(...)"
            )
        return ""
    return next(filter(None, (_why_unsendable(item, name) for name, item in inside)), "")


def decode_map(data: bytes, *, in_place: bool = False) -> dict[str, Any]:
    """The map in the bytes; `in_place`, large binaries in it are memoryviews of the bytes.

    Raises DecodeError if they are not one msgpack map, or hold more than a million values.
    """
    binaries: list[tuple[int, int, int]] | None = [] if in_place else None
    if len(data) > HARMLESS_SIZE and (mistake := too_many_items(data, binaries=binaries)):
        raise DecodeError(mistake)
    try:
        value = _with_views(data, binaries) if binaries else unpacked(data)
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        raise DecodeError(f"not msgpack ({type(error).__name__}: {error})") from error
    if not isinstance(value, dict):
        raise DecodeError(f"a message must be a msgpack map, not {_kind(value)}")
    return value


def stamp_in(message: Mapping[str, Any]) -> int | None:
    """The stamp_ns of a message or of its header, or the stamp of ROS; None if it has none."""
    header = message.get("header")
    for fields in (message, header if isinstance(header, dict) else {}):
        stamp_ns = fields.get("stamp_ns")
        if type(stamp_ns) is int:
            return stamp_ns
        stamp = fields.get("stamp")
        if isinstance(stamp, dict):
            sec, nanosec = stamp.get("sec"), stamp.get("nanosec")
            if type(sec) is int and type(nanosec) is int:
                return sec * 1_000_000_000 + nanosec
    return None


def is_of_ros(data: bytes) -> bool:
    """Whether a message is one of ROS 2, in CDR, which is never a msgpack map.

    zenoh-bridge-ros2dds sends them at the keys of topics: skip them without a word.
    """
    return len(data) >= _CDR_HEADER_SIZE and data[0] == 0 and data[1] <= _LAST_CDR


def encode_message(message: Any) -> bytes:
    """The bytes of a message, an instance of a dataclass."""
    if hasattr(message, "__bus_map__"):
        return encode_map(message.__bus_map__())
    shape = _shape(message.__class__)
    layout = shape.is_as_in_ros
    return _encoded(_sent_map(message, shape, layout), _PACKING[layout])


def _sent_map(message: Any, shape: "_Shape", as_in_ros: bool) -> dict[str, Any]:
    """The fields of a message for msgpack: arrays are their memory, and messages in it are left
    for `_convert`.
    """
    values = dict(zip(shape.fields, shape.values_of(message)))  # noqa: B905  # slower if strict
    for name in shape.rows:
        rows = values[name]
        values[name] = _maps_of_rows.get(rows) or _sent_rows(rows)
    for name, array in shape.arrays:
        values[name] = array.memory_of(values[name])
    if not as_in_ros:
        return values
    if shape.times:
        values = as_time(values, shape.times)
    return with_header(values) if shape.has_header else values


def _convert(as_in_ros: bool, value: Any) -> Any:
    """A value that msgpack does not know, in a message of this layout, as values that it knows."""
    if not _is_message(value.__class__):
        return _of_numpy(value)
    if hasattr(value, "__bus_map__"):
        return value.__bus_map__()
    return _sent_map(value, _shape(value.__class__), as_in_ros)


# By whether the layout is ROS's.
_PACKING = (_Packing(partial(_convert, False)), _Packing(partial(_convert, True)))


def _sent_rows(rows: Any) -> Any:
    """The maps of a tuple of messages of which most are sent again, as the columns of a cloud."""
    if rows.__class__ is not tuple or not 0 < len(rows) <= _LONGEST_REMEMBERED:
        return rows
    if not all(_is_remembered(each.__class__) for each in rows):
        return rows
    maps = [_map_of(each, False) for each in rows]
    if all(value.__class__ in _AS_THEY_ARE for each in maps for value in each.values()):
        _maps_of_rows.keep(maps, rows)
    return maps


def decode_message(message_type: type[M], data: bytes, *, unknown_fields: bool = True) -> M:
    """The message of this type in the bytes.

    Raises DecodeError with the name of the field if one is missing, of the wrong type, or, with
    `unknown_fields=False`, unknown to the type; otherwise unknown fields are ignored.
    """
    kind: type = message_type
    if len(data) > HARMLESS_SIZE and _is_read_in_place(kind):
        values = decode_map(data, in_place=True)
    else:
        values = decode_map(data)
    return cast(M, _read_fields(message_type, values, "", unknown_fields))


def bytes_that_change(message_type: type) -> tuple[str, str, tuple[str, ...]]:
    """The field of a type that is an array of bytes, any of which are right (`__changes__`), their
    type as numpy names it, and the names of its other fields but the stamp; "" without such one.
    """
    name = vars(message_type).get("__changes__", "")
    if not name:
        return "", "", ()
    shape = _shape(message_type)
    others = tuple(each for each in shape.fields if each not in (name, "stamp_ns"))
    return name, dict(shape.arrays)[name].dtype, others


@cache
def _is_read_in_place(message_type: type) -> bool:
    return not hasattr(message_type, "__of_bus_map__") and _shape(message_type).has_arrays


def as_map(message: Any) -> dict[str, Any]:
    """The fields of a message by name, nested messages included, as they go over the bus; arrays
    stay arrays.
    """
    return _map_of(message, None)


def renewed_map(message_type: type, values: Mapping[str, Any]) -> Mapping[str, Any]:
    """The values of a message of a dataclass as it is sent today: without ROS's header, and under
    today's names of its fields. Raises DecodeError for a header that is none.
    """
    return _under_todays_names(_shape(message_type), values, "")


def from_map(message_type: type[M], values: Mapping[str, Any], *, unknown_fields: bool = True) -> M:
    """The message of this type with these fields; errors as `decode_message`."""
    return cast(M, _read_fields(message_type, values, "", unknown_fields))


def type_name(message_type: type) -> str:
    """The name of a message type as people read it: `Pose`, `Spawn.Request`; for a type of ROS,
    which says its own as `__msgtype__`, `sensor_msgs/msg/LaserScan`.
    """
    said = vars(message_type).get("__msgtype__")
    return said if isinstance(said, str) else message_type.__qualname__


class _ArrayOf(Protocol):
    """A `messages.fields.ArrayOf`; to import that would import all messages."""

    kind: str
    columns: tuple[str, ...]

    @property
    def dtype(self) -> str: ...

    def made(self, value: Any, name: str) -> Any: ...

    def of_memory(self, data: Any, name: str) -> Any: ...

    def memory_of(self, array: Any) -> bytes | memoryview: ...


def _is_array(hint: object) -> bool:
    return hasattr(hint, "memory_of")


class _Field(NamedTuple):
    """A value whose class is `plain` is taken as it is, without `read`."""

    read: Reader
    required: bool
    array: _ArrayOf | None
    plain: type | None


class _Shape(NamedTuple):
    """The fields of a dataclass, and their `former` names. A type that `is_as_in_ros` goes over the
    bus in ROS's layout; any with ROS's `has_header`, or `times` that ROS has, is read in it, too.
    With that, or with former names, it `has_other_names` to be read by. `has_arrays` says whether
    it, or a message in it, has arrays. `values_of(message)` are the values of its fields, of which
    `arrays` are arrays, and `rows` tuples of messages that are remembered.
    """

    fields: dict[str, _Field]
    values_of: Callable[[Any], Iterable[Any]]
    arrays: tuple[tuple[str, _ArrayOf], ...]
    rows: tuple[str, ...]
    former: Mapping[str, str | tuple[str, ...]]
    has_header: bool
    is_as_in_ros: bool
    has_other_names: bool
    times: tuple[str, ...]
    has_arrays: bool


@cache
def _is_message(type_: type) -> bool:
    return is_message_type(type_)


# So many rows of small messages, such as the columns of a cloud, are remembered, each of at most so
# many: each message has the same again, and to read them takes as long as all the rest.
_MOST_REMEMBERED = 256
_LONGEST_REMEMBERED = 32
_LARGEST_REMEMBERED = 2048

_maps_of_rows: MadeOf[list[dict[str, Any]]] = MadeOf(_MOST_REMEMBERED)

# Two of these that are equal are sent as the same bytes.
_EXACT_FIELDS = {int, str, bytes}


@cache
def _is_remembered(type_: type) -> bool:
    """Whether messages of a type may be shared: they cannot change, and hold plain values."""
    parameters = getattr(type_, "__dataclass_params__", None)
    if parameters is None or not parameters.frozen or not parameters.eq:
        return False
    shape = _shape(type_)
    kinds = {each.plain for each in shape.fields.values()}
    return kinds <= _EXACT_FIELDS and not shape.has_other_names


@cache
def _shape(message_type: type) -> _Shape:
    if not is_message_type(message_type):
        raise TypeError(f"{message_type!r} is not a message: make it a dataclass")
    hints = get_type_hints(message_type)
    fields = {
        name: _Field(
            _reader(hints[name]),
            required,
            hints[name] if _is_array(hints[name]) else None,
            hints[name] if hints[name] in _AS_THEY_ARE else None,
        )
        for name, required in _fields_of(message_type).items()
    }
    former = getattr(message_type, "__former__", {})
    times = getattr(message_type, "__times__", ())
    of_ros = has_header(fields)
    is_as_in_ros = "/" in type_name(message_type)
    has_other_names = of_ros or bool(former) or bool(times)
    has_arrays = any(_has_arrays(hint, {message_type}) for hint in hints.values())
    arrays = tuple((name, each.array) for name, each in fields.items() if each.array is not None)
    rows = tuple(name for name in fields if _is_of_remembered(hints[name]))
    return _Shape(
        fields,
        _getter(tuple(fields)),
        arrays,
        rows,
        former,
        of_ros,
        is_as_in_ros,
        has_other_names,
        times,
        has_arrays,
    )


def _getter(names: tuple[str, ...]) -> Callable[[Any], Iterable[Any]]:
    if len(names) > 1:
        return attrgetter(*names)
    return lambda message: [getattr(message, name) for name in names]


def _is_of_remembered(hint: Any) -> bool:
    """Whether a field is a tuple of messages that may be shared."""
    item = get_args(hint)[0] if get_origin(hint) is tuple else None
    return isinstance(item, type) and _is_message(item) and _is_remembered(item)


def _has_arrays(hint: Any, inside: set[type]) -> bool:
    """Whether there are arrays in a field; a message may be in itself."""
    if _is_array(hint):
        return True
    if is_message_type(hint):
        if hint in inside or hasattr(hint, "__of_bus_map__"):
            return False
        hints = get_type_hints(hint)
        return any(_has_arrays(each, {*inside, hint}) for each in hints.values())
    return any(_has_arrays(each, inside) for each in get_args(hint))


def is_message_type(type_: object) -> bool:
    """Whether it is a dataclass, or a Struct, which need not become one for that; or has a map of
    its own, as messages of ROS have.
    """
    return isinstance(type_, type) and (
        hasattr(type_, "__bus_map__")
        or any("__dataclass_fields__" in vars(base) for base in type_.__mro__)
    )


def _fields_of(message_type: type) -> dict[str, bool]:
    """The names of the fields, and whether each must be there."""
    if issubclass(message_type, Struct):
        return {each.name: each.is_required for each in fields_of(message_type)}
    from dataclasses import MISSING, fields  # slow to import: see `Struct`

    return {
        each.name: each.default is MISSING and each.default_factory is MISSING
        for each in fields(cast(Any, message_type))
    }


def _map_of(message: Any, as_in_ros: bool | None) -> dict[str, Any]:
    """The fields of a message in ROS's layout or ours; None for the type's own."""
    if hasattr(message, "__bus_map__"):
        return cast(dict[str, Any], message.__bus_map__())
    shape = _shape(message.__class__)
    if as_in_ros is None:
        as_in_ros = shape.is_as_in_ros
    values = {
        name: value
        if (value := getattr(message, name)).__class__ in _AS_THEY_ARE
        else _plain(value, as_in_ros)
        for name in shape.fields
    }
    if as_in_ros and shape.times:
        values = as_time(values, shape.times)
    return with_header(values) if as_in_ros and shape.has_header else values


def _plain(value: Any, as_in_ros: bool) -> Any:
    if isinstance(value, list | tuple):
        return [
            item if item.__class__ in _AS_THEY_ARE else _plain(item, as_in_ros) for item in value
        ]
    return _map_of(value, as_in_ros) if _is_message(value.__class__) else value


def _under_todays_names(shape: _Shape, values: Mapping[Any, Any], path: str) -> Mapping[Any, Any]:
    if shape.has_header and is_in_ros_layout(values):
        try:
            values = without_header(values)
        except (KeyError, TypeError) as error:
            raise DecodeError(
                f"field '{path}{HEADER}' must have a stamp of sec and nanosec, and a frame_id"
            ) from error
    for name in shape.times:
        try:
            values = of_time(values, name)
        except (KeyError, TypeError) as error:
            raise DecodeError(
                f"field '{path}{name.removesuffix('_ns')}' must have sec and nanosec"
            ) from error
    return renewed(values, shape.former, shape.fields) if shape.former else values


def _read_fields(
    message_type: type, values: Mapping[Any, Any], path: str, unknown_fields: bool
) -> Any:
    if hasattr(message_type, "__of_bus_map__"):
        return message_type.__of_bus_map__(values, path, unknown_fields)
    shape = _shape(message_type)
    fields = shape.fields
    if shape.has_other_names:
        values = _under_todays_names(shape, values, path)
    if not unknown_fields:
        for name in values:
            if name not in fields:
                raise DecodeError(
                    f"there is no field '{printable(path + str(name), 60)}'; "
                    f"{type_name(message_type)} has {', '.join(fields) or 'no fields'}"
                )
    read = {}
    for name, entry in fields.items():
        if name in values:
            value = values[name]
            read[name] = value if value.__class__ is entry.plain else entry.read(value, path + name)
        elif entry.required:
            raise DecodeError(f"field {path + name!r} is missing")
    try:
        return message_type(**read)
    except ValueError as error:
        raise DecodeError(str(error)) from error


def _reader(expected: Any) -> Reader:
    if is_message_type(expected):
        return _nested_reader(cast(type, expected))
    if get_origin(expected) is tuple and Ellipsis not in get_args(expected):
        return _row_reader(expected)
    if get_origin(expected) in (list, tuple):
        return _list_reader(expected)
    if get_origin(expected) is dict:
        return _dict_reader(expected)
    if _is_array(expected):
        return _array_reader(expected)
    if expected is Any:
        return lambda value, path: bytes(value) if type(value) is memoryview else value
    if expected is float:
        return _read_float
    if expected is bool:
        return _read_bool
    if expected in (int, str, bytes):
        return _scalar_reader(expected)
    raise TypeError(f"a message cannot have a field of type {expected!r}")


def _nested_reader(message_type: type) -> Reader:
    def read(value: object, path: str) -> Any:
        if not isinstance(value, dict):
            raise _wrong_type(path, "a map", value)
        return _read_fields(message_type, value, f"{path}.", True)

    return read


def _list_reader(expected: Any) -> Reader:
    item_type = get_args(expected)[0]
    read_item = _reader(item_type)
    make = get_origin(expected)
    # Most lists need no look at each item: 30 numbers took ten times as long with it.
    plain = {item_type} if item_type in (bytes, float, int, str) else set()

    def read(value: object, path: str) -> Any:
        if not isinstance(value, list):
            raise _wrong_type(path, "a list", value)
        if set(map(type, value)) <= plain:
            return make(value)
        return make(read_item(item, f"{path}[{at}]") for at, item in enumerate(value))

    if not _is_of_remembered(expected):
        return read

    @lru_cache(_MOST_REMEMBERED)
    def read_once(packed: bytes, path: str) -> Any:
        return read(unpacked(packed), path)

    def read_again(value: object, path: str) -> Any:
        if value.__class__ is not list or len(value) > _LONGEST_REMEMBERED:
            return read(value, path)
        try:
            packed = _PLAIN.pack(value)
        except (TypeError, ValueError):  # it does not come from a payload
            return read(value, path)
        return read_once(packed, path) if len(packed) <= _LARGEST_REMEMBERED else read(value, path)

    return read_again


def _row_reader(expected: Any) -> Reader:
    read_items = [_reader(item) for item in get_args(expected)]

    def read(value: object, path: str) -> Any:
        if not isinstance(value, list) or len(value) != len(read_items):
            raise DecodeError(f"field {path!r} must be a list of {len(read_items)}")
        items = enumerate(zip(read_items, value, strict=True))
        return tuple(read_item(item, f"{path}[{at}]") for at, (read_item, item) in items)

    return read


def _dict_reader(expected: Any) -> Reader:
    read_item = _reader(get_args(expected)[1])

    def read(value: object, path: str) -> Any:
        if not isinstance(value, dict):
            raise _wrong_type(path, "a map", value)
        if not all(isinstance(key, str) for key in value):
            raise DecodeError(f"field {path!r} has a key that is not a text")
        return {key: read_item(item, f"{path}.{key}") for key, item in value.items()}

    return read


def _read_float(value: object, path: str) -> float:
    if isinstance(value, float | int) and not isinstance(value, bool):
        return float(value)
    raise _wrong_type(path, "a number", value)


def _read_bool(value: object, path: str) -> bool:
    if isinstance(value, bool | int) and value in (0, 1):
        return bool(value)
    raise _wrong_type(path, "a boolean", value)


def _scalar_reader(expected: type) -> Reader:
    def read(value: object, path: str) -> object:
        if type(value) is expected:
            return value
        if type(value) is memoryview and expected is bytes:
            return bytes(value)
        raise _wrong_type(path, _KINDS[expected], value)

    return read


def _array_reader(expected: _ArrayOf) -> Reader:
    """Reads a binary, an array of a message in CDR, and a list, as former messages have it."""

    def read(value: Any, path: str) -> Any:
        try:
            if isinstance(value, (bytes, memoryview)):  # `|` would take longer
                return expected.of_memory(value, path)
            if hasattr(value, "dtype"):
                return expected.made(value, path)
            if not isinstance(value, list):
                raise _wrong_type(path, f"a binary of {expected.kind}", value)
            return expected.made(_numbers(value, expected.columns, path), path)
        except ValueError as error:
            raise DecodeError(str(error)) from error

    return read


def _numbers(items: list[Any], columns: tuple[str, ...], path: str) -> list[Any]:
    """The numbers of a list, or of each of its maps or lists as a row."""
    if not columns:
        if wrong := set(map(type, items)) - {int, float}:
            raise DecodeError(f"field {path!r} must be of numbers, not {_KINDS.get(wrong.pop())}")
        return items
    rows = []
    for at, item in enumerate(items):
        row = _row(item, columns) if isinstance(item, dict) else item
        if type(row) is not list or len(row) != len(columns) or {*map(type, row)} - {int, float}:
            raise DecodeError(f"field '{path}[{at}]' must be of the numbers {', '.join(columns)}")
        rows.append(row)
    return rows


def _row(item: dict[Any, Any], columns: tuple[str, ...]) -> list[Any]:
    row = []
    for column in columns:
        value: Any = item
        for name in column.split("."):
            value = value.get(name) if isinstance(value, dict) else None
        row.append(value)
    return row


_KINDS = {
    bool: "a boolean",
    bytes: "bytes",
    dict: "a map",
    float: "a number",
    int: "an integer",
    list: "a list",
    str: "a text",
    type(None): "nothing",
}


def _wrong_type(path: str, expected: str, value: object) -> DecodeError:
    shown = printable(path, 100)
    return DecodeError(f"field '{shown}' must be {expected}, not {_kind(value)}")


def _kind(value: object) -> str:
    return _KINDS.get(type(value), type(value).__name__)


# More values in a payload are refused: they take at most some ten megabytes, and a fraction of a
# second to read. A value of one byte takes up to seventy bytes in Python: 8 MB of empty maps took
# 600 MB. So a limit of the payload's size alone does not bound that.
MOST_ITEMS = 1_000_000

# A payload of this size cannot hold enough values to harm.
HARMLESS_SIZE = 64 * 1024


_AS_NANOSECONDS = 2


def _refuse_extension(code: int, data: bytes) -> object:
    raise ValueError(f"it has an extension of type {code}")


# The value in the bytes. Messages have no extensions: a time of msgpack's is taken as its
# nanoseconds. Raises msgpack's errors, and ValueError for other extensions. A keyword
# `strict_map_key=False` takes maps with keys that are no texts.
unpacked: Callable[..., Any] = partial(
    msgpack.unpackb, timestamp=_AS_NANOSECONDS, ext_hook=_refuse_extension
)


# Stands for a binary that is left where it is, with its number.
_LEFT = 100
_AS_LEFT = b"\xd6" + bytes([_LEFT])


def _with_views(data: bytes, binaries: list[tuple[int, int, int]]) -> Any:
    """As `unpacked`, but these binaries, as `values_in` has found them, are memoryviews of the
    payload: nothing of them is copied.
    """
    if binaries[-1][2] > len(data):
        return unpacked(data)
    pieces: list[bytes] = []
    at = 0
    for number, (head, _, end) in enumerate(binaries):
        pieces += (data[at:head], _AS_LEFT, number.to_bytes(4, "big"))
        at = end
    pieces.append(data[at:])
    whole = memoryview(data)

    def left(code: int, number: bytes) -> object:
        # A payload may have such an extension, too; it has no number as ours.
        at = int.from_bytes(number, "big")
        if code != _LEFT or len(number) != 4 or at >= len(binaries):
            return _refuse_extension(code, number)
        _, start, end = binaries[at]
        return whole[start:end]

    return msgpack.unpackb(
        b"".join(pieces), strict_map_key=True, timestamp=_AS_NANOSECONDS, ext_hook=left
    )


# A binary of so many bytes is not worth a copy.
_LARGE_BINARY = 4096


def too_many_items(
    data: bytes,
    most: int = MOST_ITEMS,
    *,
    binaries: list[tuple[int, int, int]] | None = None,
) -> str:
    """Why the payload is not read, as a sentence; "" if it has at most `most` values. `values_in`
    fills `binaries`, if the payload is larger than 64 KiB.

    Binary data and text are one value, however long. Bytes that are no msgpack are not found here.
    """
    if len(data) <= HARMLESS_SIZE or values_in(data, most, binaries) <= most:
        return ""
    return f"it has more than {most} values; send many numbers as bytes"


# By the first byte of a value: how many bytes follow, or how many values, or how wide the length is
# that follows. https://github.com/msgpack/msgpack/blob/master/spec.md#formats
_BYTES = [0] * 256
_VALUES = [0] * 256
_LENGTH_WIDTH = [0] * 256
_BINARIES = range(0xC4, 0xC7)
_EXTENSIONS = range(0xC7, 0xCA)
_ARRAYS = range(0xDC, 0xDE)
_MAPS = range(0xDE, 0xE0)


def _fill_tables() -> None:
    _VALUES[0x80:0x90] = range(0, 32, 2)  # maps
    _VALUES[0x90:0xA0] = range(16)  # arrays
    _BYTES[0xA0:0xC0] = range(32)  # texts
    _LENGTH_WIDTH[0xC4:0xCA] = (1, 2, 4, 1, 2, 4)  # binary data, extensions
    _BYTES[0xCA:0xD4] = (4, 8, 1, 2, 4, 8, 1, 2, 4, 8)  # floats and integers
    _BYTES[0xD4:0xD9] = (2, 3, 5, 9, 17)  # extensions of one size, with their type
    _LENGTH_WIDTH[0xD9:0xE0] = (1, 2, 4, 2, 4, 2, 4)  # texts, arrays, maps


_fill_tables()


def values_in(data: bytes, most: int, binaries: list[tuple[int, int, int]] | None = None) -> int:
    """How many values the payload says it has; if they are more than `most`, some number above
    it. `binaries` gets the places of binaries of 4 kB or more: of the head, the data and the end.
    """
    at, end = 0, len(data)
    seen, announced = 0, 1
    while announced and at < end:
        head = data[at]
        at += 1 + _BYTES[head]
        seen += 1
        announced += _VALUES[head] - 1
        if width := _LENGTH_WIDTH[head]:
            length = int.from_bytes(data[at : at + width], "big")
            at += width
            if head in _ARRAYS:
                announced += length
            elif head in _MAPS:
                announced += 2 * length
            else:
                at += length + (head in _EXTENSIONS)
                if length >= _LARGE_BINARY and head in _BINARIES and binaries is not None:
                    binaries.append((at - length - width - 1, at - length, at))
        if seen + announced > most:
            break
    return seen + announced


_SECOND_NS = 1_000_000_000

HEADER = "header"
OF_HEADER = ("stamp_ns", "frame_id")


def has_header(fields: Mapping[str, object]) -> bool:
    """Whether a type with these fields of ours has a header in ROS."""
    return HEADER not in fields and all(name in fields for name in OF_HEADER)


def is_in_ros_layout(values: Mapping[Any, object]) -> bool:
    """Whether the values of a type that has a header in ROS have that; beside a stamp of ours
    a `header` is an unknown field.
    """
    return HEADER in values and "stamp_ns" not in values


def with_header(values: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a message with the header of ROS. Raises KeyError if one of ours is missing,
    TypeError for a stamp that is no integer, a frame that is no text, and if there is a header.
    """
    if HEADER in values:
        raise TypeError("it has a header beside stamp_ns")
    stamp_ns = values["stamp_ns"]
    if type(stamp_ns) is not int:
        raise TypeError("stamp_ns must be an integer")
    if not isinstance(values["frame_id"], str):
        raise TypeError(f"frame_id must be a text, not {values['frame_id']!r:.60}")
    seconds, nanoseconds = divmod(stamp_ns, _SECOND_NS)
    stamp = {"sec": seconds, "nanosec": nanoseconds}
    made = {HEADER: {"stamp": stamp, "frame_id": values["frame_id"]}, **values}
    del made["stamp_ns"], made["frame_id"]
    return made


def without_header(values: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a message of ROS as ours. Raises KeyError and TypeError if its header has
    other fields than ROS's own.
    """
    others = dict(values)
    header = others.pop(HEADER)
    stamp = header["stamp"]
    seconds, nanoseconds = stamp["sec"], stamp["nanosec"]
    # Before they are multiplied: a billion times a list would take all memory.
    if type(seconds) is not int or type(nanoseconds) is not int:
        raise TypeError("the stamp must be of integers")
    others["stamp_ns"] = seconds * _SECOND_NS + nanoseconds
    others["frame_id"] = header["frame_id"]
    return others


def as_time(values: Mapping[str, Any], names: Iterable[str]) -> dict[str, Any]:
    """The fields of a message with these times, `lifetime_ns`, as ROS has them: a `lifetime` of
    seconds and nanoseconds.
    """
    made = {}
    for name, value in values.items():
        if name in names:
            sec, nanosec = divmod(value, _SECOND_NS)
            made[name.removesuffix("_ns")] = {"sec": sec, "nanosec": nanosec}
        else:
            made[name] = value
    return made


def of_time(values: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """The fields of a message of ROS with a time as ours, `lifetime_ns`; if it has that already, as
    it is. Raises KeyError and TypeError for a time with other fields than ROS's own.
    """
    in_ros = name.removesuffix("_ns")
    if name in values or in_ros not in values:
        return values
    sec, nanosec = values[in_ros]["sec"], values[in_ros]["nanosec"]
    if type(sec) is not int or type(nanosec) is not int:
        raise TypeError("the time must be of integers")
    others = {key: value for key, value in values.items() if key != in_ros}
    return {**others, name: sec * _SECOND_NS + nanosec}


def renewed(
    values: Mapping[str, Any],
    former: Mapping[str, str | tuple[str, ...]],
    fields: Mapping[str, object],
) -> Mapping[str, Any]:
    """The values of a message under today's names of its `fields`, if it has `former` ones;
    otherwise the same. Of a former name there is the path of today; of a list, each item's.
    """
    if not any(name in former and name not in fields for name in values):
        return values
    made: dict[str, Any] = {}
    for name, value in values.items():
        path = former.get(name, name)
        if isinstance(path, str):
            _put(made, path, value)
        elif (
            isinstance(path, tuple) and isinstance(value, list | tuple) and len(value) == len(path)
        ):
            for each, item in zip(path, value, strict=True):
                _put(made, each, item)
        else:
            made[name] = value  # it has this name only
    return made


def _put(values: dict[str, Any], path: str, value: Any) -> None:
    """Set the value at a path, `pose.position`."""
    *above, name = path.split(".")
    for each in above:
        below = values.get(each)
        values[each] = dict(below) if isinstance(below, dict) else {}
        values = values[each]
    values[name] = value
