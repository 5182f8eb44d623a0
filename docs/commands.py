"""Writes docs/reference/commands.md, the reference of the command line: `make docs-api`.

All of it comes from the commands themselves; of their texts the page has the first paragraph.
"""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path

import click

from tfbus import node_options
from tfbus.cli import NODES, TOOLS
from tfbus.cli import main as tfbus
from tfbus.command.options import SHOWS_ALL

PAGE = Path(__file__).parent / "reference" / "commands.md"

_HEAD = """\
# Commands

All commands and their options, generated from the commands themselves by `make docs-api`.
`tfbus COMMAND --help` says more, with examples, `--help-all` has the options of every node. It
exits with 0 on success, 1 if it failed, 2 if called wrongly: a mistake, a missing file, no
terminal. Commands that [join the bus](#options-of-every-command-that-joins-the-bus) have
`[NODE_OPTIONS]`; their help says which of the options they have that
[several share](#options-that-several-commands-share).
"""

_OF_NODES = """\
## Options of every command that joins the bus
"""

_OF_MANY = """\
## Options that several commands share
"""

# An option of so many commands is described once.
_SHARED_BY = 2

# The names of an option, and what it means.
Row = tuple[str, str]

_JSON = ("--json", "Print JSON; --help of the command says of which form.")


def page() -> str:
    """The whole page."""
    parts = [_HEAD]
    of_nodes = _rows(_node_parameters())
    root = click.Context(tfbus, info_name="tfbus", max_content_width=100)
    commands = [(each, tfbus.get_command(root, each)) for each in sorted(_texts())]
    known = [(name, command) for name, command in commands if command is not None]
    count = Counter(row for name, command in known for row in _all_rows(command, name, root))
    often = [row for row, times in count.items() if times >= _SHARED_BY and row not in of_nodes]
    meanings = Counter(names for names, _ in often)
    shared = [row for row in often if meanings[row[0]] == 1]
    parts += [_OF_NODES, _list(of_nodes), _OF_MANY, _list(sorted(shared))]
    for name, command in known:
        parts += _sections(command, name, root, of_nodes, shared)
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


def _below(command: click.Command, context: click.Context) -> Iterator[tuple[str, click.Command]]:
    """The commands of a group by their names."""
    for verb in command.list_commands(context) if isinstance(command, click.Group) else ():
        below = command.get_command(context, verb)
        if below is not None and not below.hidden:
            yield verb, below


def _all_rows(command: click.Command, name: str, parent: click.Context) -> Iterator[Row]:
    """The options of a command, and of those below it."""
    context = click.Context(command, info_name=name, parent=parent, max_content_width=100)
    yield from _rows(command.params)
    for verb, below in _below(command, context):
        yield from _all_rows(below, verb, context)


def _sections(
    command: click.Command,
    name: str,
    parent: click.Context,
    of_nodes: Sequence[Row],
    shared: Sequence[Row],
) -> Iterator[str]:
    """A command, then those below it."""
    context = click.Context(command, info_name=name, parent=parent, max_content_width=100)
    names_of_nodes = {names for names, _ in of_nodes}
    rows = _rows(command.params)
    own = [row for row in rows if row[0] not in names_of_nodes and row not in shared]
    is_node = any(names in names_of_nodes for names, _ in rows)
    yield f"{'##' if parent.parent is None else '###'} {context.command_path}\n"
    yield f"{_summary(command.help or '')}\n"
    usage = [each for each in _usage(command, context, is_node) if each != "[OPTIONS]"]
    if usage and not isinstance(command, click.Group):
        yield f"`{' '.join(usage)}`\n"
    if own:
        yield _list(own)
    for verb, below in _below(command, context):
        yield from _sections(below, verb, context, of_nodes, shared)


def _usage(command: click.Command, context: click.Context, is_node: bool) -> list[str]:
    pieces = command.collect_usage_pieces(context)
    return ["[NODE_OPTIONS]", *pieces] if is_node else pieces


def _rows(parameters: Sequence[click.Parameter]) -> list[Row]:
    """The names of options and what they mean."""
    context = click.Context(click.Command("tfbus"), max_content_width=100)
    context.meta[SHOWS_ALL] = True
    records = [each.get_help_record(context) for each in parameters]
    rows = [(_cell(names), _cell(_shown(text))) for names, text in filter(None, records) if text]
    return [_JSON if names == _JSON[0] else (names, text) for names, text in rows]


def _list(rows: Sequence[Row]) -> str:
    return "\n".join([*(f"- `{names}` {text}" for names, text in rows), ""])


def _shown(text: str) -> str:
    """The text with all that Markdown would read as its own escaped."""
    return re.sub(r"([*_<>\[\]])", r"\\\1", text)


def _cell(text: str) -> str:
    return " ".join(text.split())


def _summary(text: str) -> str:
    """The first paragraph of a help, as Markdown."""
    return _shown(_cell(re.split(r"\n\s*\n", text.strip())[0]))


if __name__ == "__main__":
    PAGE.write_text(page())
    print(f"wrote {PAGE} of tfbus {metadata.version('tfbus')}")
