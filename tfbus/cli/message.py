"""Types of messages by name, their fields as they are printed, and maps that become messages.

The bus has names of types, not definitions. Types of `tfbus.messages` are found by their name,
ROS's by their full name, others by their place in Python: `my_robot.messages:Battery`.
"""

import inspect
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import MISSING, Field, asdict, dataclass, fields, is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, get_args, get_origin, get_type_hints

import click
from click.shell_completion import CompletionItem

from tfbus.base.clock import SYSTEM_CLOCK
from tfbus.base.errors import BusError, DecodeError
from tfbus.base.json_text import json_text
from tfbus.base.wording import did_you_mean, wrapped
from tfbus.bus.graph import TRANSFORMS_TYPE
from tfbus.cli.output import paint, print_json, print_lines, width
from tfbus.command.types import absolute, matching, names_at
from tfbus.wire.codec import (
    OF_HEADER,
    as_map,
    encode_map,
    from_map,
    is_in_ros_layout,
    renewed,
    type_name,
)


def supplied_type(name: str) -> type | None:
    """The message type of this name in `tfbus.messages`, or on the bus; None for another."""
    return _supplied().get(name) or _by_bus_name().get(name)


def supplied_names() -> list[str]:
    """The names of all message types in `tfbus.messages`."""
    return sorted(_supplied())


def supplied_call(name: str) -> type | None:
    """The type of a service or action of this name in `tfbus.messages`, or None."""
    return _supplied_calls().get(name)


def supplied_calls() -> list[type]:
    """The types of services and actions in `tfbus.messages`, by name."""
    return [each for _, each in sorted(_supplied_calls().items())]


def find_call(text: str) -> type:
    """The type of a service or action that `Spawn`, ROS's `turtlesim/srv/Spawn`, or
    `my_robot.services:Dock` stands for.

    Raises click.UsageError.
    """
    module, colon, name = text.partition(":")
    if colon:
        return _imported(
            module, name, is_called, "no class {!r} with a Request or a Goal, as a service has"
        )
    found = supplied_call(bare(text))
    if found is None:
        hint = did_you_mean(bare(text), _supplied_calls(), none="")
        raise click.UsageError(
            f"tfbus.messages has no service {text!r} (write your own as package.module:Name){hint}"
        )
    return found


def find_type(text: str, otherwise: str = "") -> type:
    """The type that `Pose`, ROS's `sensor_msgs/msg/Imu`, or `my_robot.messages:Battery` stands for.

    Raises click.UsageError with a hint.
    """
    module, colon, name = text.partition(":")
    if colon:
        return _imported(module, name, is_dataclass, "no dataclass {!r}; a message must be one")
    found = supplied_type(text) or type_of_ros(text) or supplied_type(bare(text))
    if found is None:
        hint = did_you_mean(bare(text), _supplied(), none="")
        raise click.UsageError(
            f"tfbus.messages has no message {text!r} (write your own as package.module:Name"
            f"{otherwise}){hint}"
        )
    return found


def type_of_ros(text: str) -> type | None:
    """The type on the bus of ROS's `sensor_msgs/msg/LaserScan`; None for any other text."""
    if text.split("/")[1:-1] != ["msg"]:
        return None
    try:
        found, on_bus = _of_ros(text)
    except DecodeError:
        return None
    return supplied_type(type_name(on_bus.type)) or found


def _of_ros(name: str) -> tuple[Any, Any]:
    """The class of a message of ROS, and its type on the bus. Raises DecodeError."""
    from tfbus.compat.bus_types import bus_type_of  # which tfbus's own types do not need
    from tfbus.ros.message_classes import message_class

    found = message_class(name)
    return found, bus_type_of(found, "", SYSTEM_CLOCK)


def call_of_ros(text: str) -> type | None:
    """The type of a service or action of ROS, `std_srvs/srv/Trigger`; None for any other text."""
    if text.split("/")[1:-1] not in (["srv"], ["action"]):
        return None
    from tfbus.ros.message_classes import interface_class  # which tfbus's own do not need

    try:
        return interface_class(text)
    except DecodeError:
        return None


def encode_values(values: Mapping[str, Any], what: str) -> bytes:
    """The bytes of a map typed in for the argument `what`.

    Raises click.BadParameter for a value that no field can have.
    """
    try:
        return encode_map(values)
    except (OverflowError, TypeError, ValueError) as error:
        raise click.BadParameter(
            "values must be texts, booleans, numbers of at most 64 bits, lists and maps",
            param_hint=what,
        ) from error


def complete_values(values: Mapping[str, Any], message_type: type) -> dict[str, Any]:
    """The fields of a message of this type, with defaults for missing ones, or zeros; they may be
    ROS's fields of it, `{header: {frame_id: map}, ...}`, or have their former names.

    Raises click.UsageError if the values are no such message.
    """
    if is_dataclass(message_type):
        names = [entry.name for entry in fields(message_type)]
        values = renewed(values, getattr(message_type, "__former__", {}), dict.fromkeys(names))
        try:
            _check_names(message_type, values, "")
        except click.UsageError as mistake:
            values = _values_of_ros(values, message_type, mistake)
        else:
            values = _merged(message_type, prototype(message_type), values)
    try:
        return as_map(from_map(message_type, values, unknown_fields=False))
    except (DecodeError, TypeError, ValueError) as error:
        raise click.UsageError(f"not a valid {type_name(message_type)}: {error}") from error


def _values_of_ros(
    values: Mapping[str, Any], message_type: type, mistake: click.UsageError
) -> dict[str, Any]:
    """The values of a type of tfbus, given with ROS's fields. Raises the mistake if ROS has no
    such fields of it either, and click.UsageError if only the values are wrong.
    """
    from tfbus.ros.counterparts import AS_IN_ROS, BY_ROS_TYPE  # which most types do not need

    types = {**BY_ROS_TYPE, **AS_IN_ROS}
    if type_name(message_type) in AS_IN_ROS:
        with suppress(DecodeError):  # such as a header without a stamp, which a type of ROS takes
            return as_map(from_map(message_type, values, unknown_fields=False))
    names = [name for name, each in types.items() if supplied_type(each.type_name) is message_type]
    if not names:
        raise mistake
    in_ros, on_bus = _of_ros(names[0])
    if not values.keys() <= in_ros.__codecs__.keys():
        raise mistake
    try:
        message = from_map(in_ros, values, unknown_fields=False)
        return as_map(on_bus.to_bus(message))
    except (DecodeError, TypeError, ValueError) as error:
        if values.keys() <= {entry.name for entry in fields(message_type)}:
            raise mistake from None
        raise click.UsageError(f"not a valid {names[0]}: {error}") from error


def _merged(
    message_type: object, defaults: Mapping[str, Any], values: Mapping[str, Any]
) -> dict[str, Any]:
    """The values, and the defaults of fields that they do not have, also nested ones."""
    hints = get_type_hints(message_type) if isinstance(message_type, type) else {}
    if is_in_ros_layout(values):  # a nested one, as ROS has it
        defaults = {name: defaults[name] for name in defaults if name not in OF_HEADER}
    defaults = {
        name: value for name, value in defaults.items() if name.removesuffix("_ns") not in values
    }
    return {**defaults} | {
        name: _completed(hints.get(name), defaults.get(name), value)
        for name, value in values.items()
    }


def _completed(expected: object, default: object, value: Any) -> Any:
    if isinstance(value, Mapping) and isinstance(default, Mapping):
        return _merged(expected, default, value)
    item = next(iter(get_args(expected)), None)
    if isinstance(value, list) and isinstance(item, type) and is_dataclass(item):
        return [_completed(item, prototype(item), each) for each in value]
    return value


def read_map(text: str) -> dict[str, Any] | None:
    """The YAML map in a text; None for anything else."""
    from tfbus.base.yaml_file import read_value  # YAML, which `--help` does not need

    value = read_value(text)
    return value if isinstance(value, dict) else None


def checked_map(text: str, what: str) -> dict[str, Any]:
    """The YAML map typed in for the argument `what`; a usage error for anything else."""
    values = read_map(text)
    if values is None:
        raise click.BadParameter(
            f"expected a YAML map of fields, as in '{{x: 2, y: 3}}', got {text!r}",
            param_hint=what,
        )
    return values


@cache
def _supplied() -> dict[str, type]:
    return {
        name: value
        for name, value in _all_messages().items()
        if isinstance(value, type) and is_dataclass(value)
    }


@cache
def _by_bus_name() -> dict[str, type]:
    return {type_name(each): each for each in _supplied().values()}


@cache
def _supplied_calls() -> dict[str, type]:
    return {name: value for name, value in _all_messages().items() if is_called(value)}


def _all_messages() -> dict[str, Any]:
    import tfbus.messages  # 50 classes, which `--help` does not need

    return vars(tfbus.messages)


def _imported(module: str, name: str, is_one: Callable[[Any], bool], else_: str) -> type:
    if not module or module.startswith("."):
        raise click.UsageError(f"{module!r} is no module: write package.module:{name}")
    sys.path.insert(0, str(Path.cwd()))  # as `python -m` does
    try:
        found = getattr(import_module(module), name, None)
    except ImportError as error:
        raise click.UsageError(f"{module!r} cannot be imported: {error}") from error
    if not isinstance(found, type) or not is_one(found):
        raise click.UsageError(f"{module} has {else_.format(name)}")
    return found


def _check_names(message_type: type, values: Mapping[Any, Any], path: str) -> None:
    """Raise click.UsageError for a field that the type, or a nested one, does not have."""
    hints = get_type_hints(message_type)
    names = [entry.name for entry in fields(message_type)]
    for name, value in values.items():
        if name not in names:
            hint = did_you_mean(str(name), names, none="; it has none")
            raise click.UsageError(
                f"{type_name(message_type)} has no field {path + str(name)!r}{hint}"
            )
        if is_dataclass(hints[name]) and isinstance(value, Mapping):
            _check_names(hints[name], value, f"{path}{name}.")


class _HasTypes(Protocol):
    @property
    def types(self) -> tuple[str, ...]: ...


def bare(type_name: str) -> str:
    """The name of a type without ROS's package: `geometry_msgs/msg/Twist` is `Twist`."""
    return type_name.rpartition("/")[2]


def shown_type(announced: str) -> str:
    """The name of a type for people: of a class of tfbus.messages its name there, `PointCloud`,
    though it is ROS's `sensor_msgs/msg/PointCloud2` on the bus; of any other that on the bus.
    """
    supplied = supplied_type(announced)
    return supplied.__qualname__ if supplied else announced or "unknown"


def is_of_type(announced: str, type_name: str) -> bool:
    """Whether a type announced on the bus is the one typed in: by its name there, or with ROS's
    package before it, or without; or by that of its class.
    """
    if announced in (type_name, bare(type_name)) or bare(announced) == type_name:
        return True
    supplied = supplied_type(type_name)
    return supplied is not None and supplied is supplied_type(announced)


def names_of_type(known: Mapping[str, _HasTypes], type_name: str, kind: str) -> list[str]:
    """The names of the topics or services of this type.

    Raises BusError, with a near type, if there is none; `kind` is "topic" or "service".
    """
    found = sorted(
        name
        for name, info in known.items()
        if any(is_of_type(each, type_name) for each in info.types)
    )
    if not found:
        types = {shown_type(each) for info in known.values() for each in info.types}
        hint = did_you_mean(type_name, types, none=f", nor any other {kind}: is a node running?")
        raise BusError(f"there is no {kind} of type {type_name!r}{hint}")
    return found


# The name here, and that of ROS.
TRANSFORMS_TYPES = (TRANSFORMS_TYPE, "TFMessage")


@dataclass(frozen=True)
class TransformMessage:
    """The transforms of a stream, as tfbus topic echo prints them; a TransformBroadcaster sends
    them. Each has stamp_ns, frame_id, child_frame_id, and a transform of a translation (x, y, z)
    and a rotation (x, y, z, w). epoch is the start of the stream, and seq counts its messages.
    """

    epoch: int
    seq: int
    transforms: list[dict[str, Any]]


# The kind of such a candidate for a shell: a word with blanks, to quote as a whole.
MAP = "map"


def complete_message(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """The types, then a message of the given type; or a message of the topic's type."""
    typed = ctx.params.get("message") or ()
    type_name = typed[0] if typed else names_at(ctx).topics.get(_name(ctx, "topic"), "")
    types = [] if typed else matching(supplied_names(), incomplete)
    return [*_items(supplied_type(type_name), incomplete), *types]


def complete_request(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """A request of the service's type, or a goal of the action's."""
    type_name = names_at(ctx).services.get(_name(ctx, "service"), "")
    return _items(request_of(supplied_call(type_name)), incomplete)


def _name(ctx: click.Context, param: str) -> str:
    return str(ctx.params.get(param) or "").removeprefix(absolute("", ctx))


def _items(message_type: type | None, incomplete: str) -> list[CompletionItem]:
    """The message, if nothing of one is typed yet."""
    if message_type is None or incomplete:
        return []
    import yaml

    text = yaml.safe_dump(
        prototype(message_type), default_flow_style=True, sort_keys=False, width=2**31 - 1
    )
    # Shells put single quotes around it, in which double ones need no escape.
    return [CompletionItem(text.strip().replace("''", '""'), MAP)]


_ZEROS: dict[Any, Any] = {bool: False, int: 0, float: 0.0, str: "", bytes: "", list: [], dict: {}}

# The parts of a service, and of an action, in the order of a call.
_PARTS = ("Request", "Response", "Goal", "Result", "Feedback")


@dataclass(frozen=True)
class FieldInfo:
    """A field of a message: its type's name, its default (None if it has none), and the fields
    of a nested message.
    """

    name: str
    type: str
    default: Any
    fields: "tuple[FieldInfo, ...]" = ()


@dataclass(frozen=True)
class PartInfo:
    """A message, or the request, response, goal, result or feedback of a service or action."""

    name: str
    doc: str
    fields: tuple[FieldInfo, ...]


def prototype(message_type: type) -> dict[str, Any]:
    """A message of this type with its defaults, or zeros if it has none."""
    hints = get_type_hints(message_type)
    return {entry.name: _value(entry, hints[entry.name]) for entry in fields(message_type)}


def parts_of(type_: type) -> Iterator[PartInfo]:
    """The message itself, or the parts of a service or action."""
    for name, part in [
        (type_.__name__, type_),
        *((name, getattr(type_, name, None)) for name in _PARTS),
    ]:
        if isinstance(part, type) and is_dataclass(part):
            yield PartInfo(name, doc_of(part), tuple(_fields(part)))
        elif isinstance(part, type) and hasattr(part, "get_fields_and_field_types"):
            yield PartInfo(name, doc_of(part), tuple(_fields_of_ros(part)))


def is_called(type_: object) -> bool:
    """Whether this is the type of a service or an action."""
    return isinstance(type_, type) and request_of(type_) is not None


def request_of(type_: type | None) -> type | None:
    """The type of the requests of a service, or of the goals of an action; None for another."""
    part = getattr(type_, "Request", None) or getattr(type_, "Goal", None)
    return part if isinstance(part, type) and is_dataclass(part) else None


def doc_of(type_: type) -> str:
    """The docstring in one line; "" for the one that Python writes for a dataclass."""
    doc = inspect.getdoc(type_) or ""
    return "" if doc.startswith(f"{type_.__name__}(") else " ".join(doc.split())


def _fields(message_type: type) -> Iterator[FieldInfo]:
    hints = get_type_hints(message_type)
    for entry in fields(message_type):
        hint = hints[entry.name]
        nested = tuple(_fields(hint)) if isinstance(hint, type) and is_dataclass(hint) else ()
        has_default = entry.default is not MISSING or entry.default_factory is not MISSING
        default = _value(entry, hint) if has_default and not nested else None
        yield FieldInfo(entry.name, _type_name(hint), default, nested)


def _fields_of_ros(message_type: Any) -> Iterator[FieldInfo]:
    """The fields of a message of ROS; defaults are shown unless they are zero or empty."""
    made = message_type()
    for name, shown in message_type.get_fields_and_field_types().items():
        value = getattr(made, name)
        if hasattr(value, "get_fields_and_field_types"):
            yield FieldInfo(name, shown, None, tuple(_fields_of_ros(type(value))))
        else:
            is_scalar = isinstance(value, bool | int | float | str)
            yield FieldInfo(name, shown, value if is_scalar and value else None)


def _type_name(hint: Any) -> str:
    is_plain = isinstance(hint, type) and get_origin(hint) is None
    return hint.__qualname__ if is_plain else str(hint).replace("typing.", "")


def _value(entry: "Field[Any]", hint: Any) -> Any:
    if entry.default is not MISSING:
        return _plain(entry.default)
    if entry.default_factory is not MISSING:
        return _plain(entry.default_factory())
    if isinstance(hint, type) and is_dataclass(hint):
        return prototype(hint)
    return _ZEROS.get(get_origin(hint) or hint)


def _plain(value: Any) -> Any:
    """A default as the wire has it: maps and lists."""
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return as_map(value) if is_dataclass(value) and not isinstance(value, type) else value


def print_type(type_: type, *, as_json: bool) -> None:
    """Print the purpose of a type, and the fields of each of its parts."""
    if as_json:
        parts = [asdict(part) for part in parts_of(type_)]
        print_json({"type": type_.__qualname__, "doc": doc_of(type_), "parts": parts})
    else:
        print_lines(_type_lines(type_))


def print_types(types: Iterable[type]) -> None:
    """Print one line for each type: its name, and the first sentence of its docstring."""
    rows = {type_.__qualname__: _brief(type_) for type_ in types}
    room = max(map(len, rows), default=0)
    print_lines(
        f"{paint(name, 'type')}{' ' * (room - len(name))}  {brief}" for name, brief in rows.items()
    )


def _brief(type_: type) -> str:
    return textwrap.shorten(doc_of(type_).partition(". ")[0].rstrip("."), 80, placeholder=" …")


def _type_lines(type_: type) -> Iterator[str]:
    yield from _headed(type_.__qualname__, doc_of(type_))
    for part in parts_of(type_):
        if part.name != type_.__name__:
            yield ""
            yield from _headed(part.name, part.doc)
        yield from _field_lines(part.fields, "  ")


def _headed(name: str, doc: str) -> list[str]:
    lines = wrapped(f"{name}: {doc}" if doc else name, max(width(), 40))
    return [
        line.replace(name, paint(name, "type"), 1) if not at else line
        for at, line in enumerate(lines)
    ]


def _field_lines(fields: Iterable[FieldInfo], lead: str) -> Iterator[str]:
    for field in fields:
        default = "" if field.default is None else f" = {json_text(field.default)}"
        yield f"{lead}{paint(field.name, 'name')}: {field.type}{default}"
        yield from _field_lines(field.fields, lead + "  ")
