"""Completion of launch files and their arguments."""

from collections.abc import Sequence
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from tfbus.command.types import matching
from tfbus.errors import TfbusError
from tfbus.launch.read.find import (
    find_in,
    find_launch_file,
    installed_launch_files,
    launch_files_of,
    packages_with_nodes,
)
from tfbus.launch.read.reader import read_arguments


def complete_file(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """The launch files of tfbus, packages with launch files, and paths."""
    names = [*installed_launch_files(), *filter(_has_files, packages_with_nodes())]
    return [*matching(names, incomplete), CompletionItem(incomplete, "file")]


def chosen_file(file: str, arguments: Sequence[str]) -> tuple[Path, tuple[str, ...]]:
    """The launch file of `FILE ...` or `PACKAGE FILE ...`, and the rest of the arguments.

    Raises LaunchError if there is none.
    """
    if arguments and "=" not in arguments[0] and "/" not in file:
        return find_in(file, arguments[0]), tuple(arguments[1:])
    return find_launch_file(file), tuple(arguments)


def _has_files(package: str) -> bool:
    try:
        return bool(launch_files_of(package))
    except TfbusError:
        return False


def complete_argument(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """After a package its launch files; then `NAME:=` for each argument of the file, and after it
    its choices or its default.
    """
    first, typed = ctx.params.get("file") or "", ctx.params.get("arguments") or ()
    if not typed and "=" not in incomplete and _has_files(first):
        return matching(launch_files_of(first), incomplete)
    try:
        declared = read_arguments(chosen_file(first, typed)[0])
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
