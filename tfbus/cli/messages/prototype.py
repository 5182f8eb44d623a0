"""Completion of messages and requests: one with defaults, to fill in."""

from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any, get_origin, get_type_hints

import click
from click.shell_completion import CompletionItem

from tfbus.cli.messages.message import supplied_names, supplied_type
from tfbus.command.types import matching, names_at
from tfbus.wire.codec import as_map

# The kind of such a candidate for a shell: a word with blanks, to quote as a whole.
MAP = "map"

_ZEROS: dict[Any, Any] = {bool: False, int: 0, float: 0.0, str: "", bytes: "", list: [], dict: {}}


def prototype(message_type: type) -> dict[str, Any]:
    """A message of this type with its defaults, or zeros where it has none."""
    hints = get_type_hints(message_type)
    return {entry.name: _value(entry, hints[entry.name]) for entry in fields(message_type)}


def complete_message(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """The types, then a message of the given type; or a message of the topic's type."""
    typed = ctx.params.get("message") or ()
    type_name = typed[0] if typed else names_at(ctx).topics.get(ctx.params.get("topic") or "", "")
    types = [] if typed else matching(supplied_names(), incomplete)
    return [*_items(supplied_type(type_name), incomplete), *types]


def complete_request(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """A request of the service's type, or a goal of the action's."""
    import tfbus.messages

    type_name = names_at(ctx).services.get(ctx.params.get("service") or "", "")
    service_type = getattr(tfbus.messages, type_name, None)
    request = getattr(service_type, "Request", None) or getattr(service_type, "Goal", None)
    return _items(request, incomplete)


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


def _value(entry: "Field[Any]", hint: Any) -> Any:
    if entry.default is not MISSING:
        return entry.default
    if entry.default_factory is not MISSING:
        made = entry.default_factory()
        return as_map(made) if is_dataclass(made) else made
    if isinstance(hint, type) and is_dataclass(hint):
        return prototype(hint)
    return _ZEROS.get(get_origin(hint) or hint)
