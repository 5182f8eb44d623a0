"""Completion of launch files and their arguments."""

import click
from click.shell_completion import CompletionItem

from tfbus.command.types import matching
from tfbus.errors import TfbusError
from tfbus.launch.read.find import find_launch_file, installed_launch_files
from tfbus.launch.read.reader import read_arguments


def complete_file(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """The launch files of tfbus, and paths."""
    return [*matching(installed_launch_files(), incomplete), CompletionItem(incomplete, "file")]


def complete_argument(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """`NAME:=` for each argument of the file; after it, its choices or its default."""
    try:
        declared = read_arguments(find_launch_file(ctx.params.get("file") or ""))
    except TfbusError:
        return []
    name, given, value = incomplete.partition(":=")
    if given:
        values = [
            choice
            for each in declared
            if each.name == name
            for choice in each.choices or (each.default or "",)
        ]
        return [
            CompletionItem(f"{name}:={each}") for each in values if each and each.startswith(value)
        ]
    taken = {text.partition(":=")[0] for text in ctx.params.get("arguments") or ()}
    return [
        CompletionItem(f"{each.name}:=", help=each.description or None)
        for each in declared
        if each.name.startswith(name) and each.name not in taken
    ]
