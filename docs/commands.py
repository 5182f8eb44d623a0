"""Writes docs/reference/commands.md, the reference of the command line: `make docs-api`.

All of it comes from the commands themselves, as `--help` prints it.
"""

import re
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path

import click

from tfbus import node_options
from tfbus.cli import NODES, TOOLS
from tfbus.cli import main as tfbus
from tfbus.command.node_option import SHOWS_ALL

PAGE = Path(__file__).parent / "reference" / "commands.md"

_HEAD = """\
# Commands

All commands and their options, generated from the commands themselves by `make docs-api`.
`tfbus COMMAND --help` prints the same, but for the options that all have in common, which
`--help-all` has. Commands exit with 0 where all went well, with 1 where they failed, and with 2
where the command line was wrong.
"""

_OF_NODES = """\
## Options of every command that joins the bus

A command below that has `[NODE OPTIONS]` in its usage takes these too.
"""


def page() -> str:
    """The whole page."""
    parts = [_HEAD, "| command | what it does |\n| --- | --- |"]
    parts[-1] += "".join(
        f"\n| [`{name}`](#tfbus-{name}) | {text} |" for name, text in sorted(_texts().items())
    )
    parts[-1] += "\n"
    parts += [_OF_NODES, _options(_node_parameters())]
    shared = {_declared(parameter) for parameter in _node_parameters()}
    root = click.Context(tfbus, info_name="tfbus", max_content_width=100)
    for name in sorted(_texts()):
        command = tfbus.get_command(root, name)
        assert command is not None
        parts += _sections(command, name, root, shared)
    return "\n".join(parts)


def _texts() -> dict[str, str]:
    return {**TOOLS, **NODES}


def _node_parameters() -> Sequence[click.Parameter]:
    """The options that nodes have in common."""

    @click.command()
    @node_options("node")
    def anything(**_: object) -> None:
        """Not called."""

    return anything.params


def _declared(parameter: click.Parameter) -> tuple[str, ...]:
    return tuple(parameter.opts)


def _sections(
    command: click.Command, name: str, parent: click.Context, shared: set[tuple[str, ...]]
) -> Iterator[str]:
    """A command, then those below it."""
    context = click.Context(command, info_name=name, parent=parent, max_content_width=100)
    own = [each for each in command.params if _declared(each) not in shared]
    is_node = len(own) < len(command.params)
    yield f"{'##' if parent.parent is None else '###'} {context.command_path}\n"
    yield f"{_paragraphs(command.help or '')}\n"
    pieces = [context.command_path, *_usage(command, context, is_node)]
    yield f"```text\nUsage: {' '.join(pieces)}\n```\n"
    if text := _options(own):
        yield text
    if command.epilog:
        yield _examples(command.epilog)
    if isinstance(command, click.Group):
        for verb in command.list_commands(context):
            below = command.get_command(context, verb)
            if below is not None and not below.hidden:
                yield from _sections(below, verb, context, shared)


def _usage(command: click.Command, context: click.Context, is_node: bool) -> list[str]:
    pieces = command.collect_usage_pieces(context)
    return ["[NODE OPTIONS]", *pieces] if is_node else pieces


def _examples(epilog: str) -> str:
    """What stands at the end of the help: mostly `Examples: tfbus one; tfbus two`."""
    word, colon, text = " ".join(epilog.split()).partition(": ")
    if not colon or not word.startswith("Example"):
        return f"{_paragraphs(epilog)}\n"
    lines = text.replace("; tfbus ", "\ntfbus ")
    return f"{word}:\n\n```text\n{lines}\n```\n"


def _options(parameters: Sequence[click.Parameter]) -> str:
    """A table of options, "" where there are none."""
    context = click.Context(click.Command("tfbus"), max_content_width=100)
    context.meta[SHOWS_ALL] = True
    records = [each.get_help_record(context) for each in parameters]
    rows = [
        f"| `{_cell(names)}` | {_cell(_shown(text))} |"
        for names, text in filter(None, records)
        if text
    ]
    return "\n".join(["| option | |", "| --- | --- |", *rows, ""]) if rows else ""


def _shown(text: str) -> str:
    """What a table of Markdown would read as its own."""
    return re.sub(r"([*_<>\[\]])", r"\\\1", text)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _paragraphs(text: str) -> str:
    """Help as Markdown: blocks that click keeps as they are stay so."""
    found = []
    for paragraph in re.split(r"\n\s*\n", text.strip()):
        if paragraph.startswith("\b"):
            body = paragraph.removeprefix("\b").strip("\n")
            found.append(f"```text\n{body}\n```")
        else:
            found.append(_shown(" ".join(paragraph.split())))
    return "\n\n".join(found)


if __name__ == "__main__":
    PAGE.write_text(page())
    print(f"wrote {PAGE} of tfbus {metadata.version('tfbus')}")
