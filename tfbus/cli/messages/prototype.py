"""Completion of messages and requests: one with defaults, to fill in."""

import click
from click.shell_completion import CompletionItem

from tfbus.cli.messages.fields import prototype, request_of
from tfbus.cli.messages.message import supplied_call, supplied_names, supplied_type
from tfbus.command.types import absolute, matching, names_at

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
