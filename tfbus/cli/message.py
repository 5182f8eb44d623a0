"""Types of messages by name, and maps that become messages of a type.

The bus has names of types, not definitions. Types of `tfbus.messages` are found by their name,
ROS's by their full name, others by their place in Python: `my_robot.messages:Battery`.
"""

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, get_args, get_type_hints

import click
from click.shell_completion import CompletionItem

from tfbus.cli.message_fields import is_called, prototype, request_of
from tfbus.command.types import absolute, matching, names_at
from tfbus.discover.graph import TRANSFORMS_TYPE
from tfbus.errors import BusError, DecodeError
from tfbus.runtime.clock import SYSTEM_CLOCK
from tfbus.wire.codec import as_map, encode_map, from_map, renewed, type_name
from tfbus.wording import did_you_mean


def supplied_type(name: str) -> type | None:
    """The message type of this name in `tfbus.messages`, or None."""
    return _supplied().get(name)


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

    Raises click.UsageError, which says what else to do.
    """
    module, colon, name = text.partition(":")
    if colon:
        return _imported(module, name, is_dataclass, "no dataclass {!r}; a message must be one")
    found = type_of_ros(text) or supplied_type(bare(text))
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
    from tfbus.compat.bus_types import bus_type_of  # which tfbus's own types do not need
    from tfbus.compat.message_classes import message_class

    try:
        found = message_class(text)
    except DecodeError:
        return None
    return supplied_type(type_name(bus_type_of(found, "", SYSTEM_CLOCK).type)) or found


def call_of_ros(text: str) -> type | None:
    """The type of a service or action of ROS, `std_srvs/srv/Trigger`; None for any other text."""
    if text.split("/")[1:-1] not in (["srv"], ["action"]):
        return None
    from tfbus.compat.message_classes import interface_class  # which tfbus's own do not need

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
    those that ROS has of it, `{header: {frame_id: map}, ...}`, or have their former names.

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
    from tfbus.compat.bus_types import bus_type_of  # which most types of tfbus's do not need
    from tfbus.compat.message_classes import message_class
    from tfbus.ros.counterparts import AS_IN_ROS, BY_ROS_TYPE

    types = {**BY_ROS_TYPE, **AS_IN_ROS}
    names = [
        name for name, each in types.items() if supplied_type(bare(each.type_name)) is message_type
    ]
    in_ros = message_class(names[0]) if names else None
    if in_ros is None or not values.keys() <= in_ros.__codecs__.keys():
        raise mistake
    try:
        message = from_map(in_ros, values, unknown_fields=False)
        return as_map(bus_type_of(in_ros, "", SYSTEM_CLOCK).to_bus(message))
    except (DecodeError, TypeError, ValueError) as error:
        if values.keys() <= {entry.name for entry in fields(message_type)}:
            raise mistake from None
        raise click.UsageError(f"not a valid {names[0]}: {error}") from error


def _merged(
    message_type: object, defaults: Mapping[str, Any], values: Mapping[str, Any]
) -> dict[str, Any]:
    """The values, and the defaults of fields that they do not have, also nested ones."""
    hints = get_type_hints(message_type) if isinstance(message_type, type) else {}
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
    from tfbus.runtime.yaml_file import read_value  # YAML, which `--help` does not need

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
def _supplied_calls() -> dict[str, type]:
    return {name: value for name, value in _all_messages().items() if is_called(value)}


def _all_messages() -> dict[str, Any]:
    import tfbus.messages  # 50 classes, which `--help` does not need

    return vars(tfbus.messages)


def _imported(module: str, name: str, is_one: Callable[[Any], bool], else_: str) -> type:
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


class _Typed(Protocol):
    @property
    def types(self) -> tuple[str, ...]: ...


def bare(type_name: str) -> str:
    """The name of a type without ROS's package: `geometry_msgs/msg/Twist` is `Twist`."""
    return type_name.rpartition("/")[2]


def is_of_type(announced: str, type_name: str) -> bool:
    """Whether a type announced on the bus is the one typed in: by its name there, or with ROS's
    package before it, or without.
    """
    return announced in (type_name, bare(type_name)) or bare(announced) == type_name


def names_of_type(known: Mapping[str, _Typed], type_name: str, kind: str) -> list[str]:
    """The names of those of this type.

    Raises BusError, with a near type, if there is none; `kind` is "topic" or "service".
    """
    found = sorted(
        name
        for name, info in known.items()
        if any(is_of_type(each, type_name) for each in info.types)
    )
    if not found:
        types = {each for info in known.values() for each in info.types}
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
