"""`tfbus create`: a small package with a node, to start from.

The folder `template` next to this file is that package, for the robot `my_robot` and the node
`my_node`; `tfbus create` copies it with other names.
"""

import keyword
import re
import shutil
import sys
from pathlib import Path

import click

from tfbus.cli import NODES, TOOLS

_TEMPLATE = Path(__file__).with_name("template")
_FILES = (
    "pyproject.toml",
    "README.md",
    "my_robot/__init__.py",
    "my_robot/my_node.py",
    "my_robot/my_robot.yaml",
    "tests/test_my_node.py",
)


def _check_module_name(ctx: click.Context, param: click.Parameter, value: str) -> str:
    if not value.isidentifier() or keyword.iskeyword(value) or not value.isascii():
        raise click.BadParameter(
            f"{value!r} cannot be a Python package: use letters, digits and '_', "
            "and start with a letter"
        )
    return value


def _check_package(ctx: click.Context, param: click.Parameter, value: str) -> str:
    if value in {"tfbus", "tests"} | sys.stdlib_module_names:
        raise click.BadParameter(f"{value!r} is already the name of a Python package")
    return _check_module_name(ctx, param, value)


def _check_node(ctx: click.Context, param: click.Parameter, value: str) -> str:
    if value in {*TOOLS, *NODES}:
        raise click.BadParameter(f"`tfbus {value}` is already a command")
    return _check_module_name(ctx, param, value)


@click.command(epilog="Example: tfbus create my_robot --node my_node")
@click.argument("package", callback=_check_package)
@click.option(
    "--node",
    metavar="NAME",
    default="my_node",
    callback=_check_node,
    show_default=True,
    help="The node's name.",
)
@click.option(
    "--directory",
    default=".",
    type=click.Path(path_type=Path),
    show_default=True,
    help="Where to create it.",
)
def command(package: str, node: str, directory: Path) -> None:
    """Create a small package with a node, a launch file and a test.

    The package installs and runs unchanged; its pyproject.toml makes the node a command of tfbus.
    Existing files are not overwritten.
    """
    if package == node:
        raise click.UsageError("the package and the node need different names")
    folder = directory / package
    if folder.exists():
        raise click.ClickException(f"{folder} exists: choose another name or --directory")
    try:
        written = _write(folder, {"my_robot": package, "my_node": node})
    except OSError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise click.ClickException(f"{folder} cannot be written: {error.strerror}") from error
    click.echo("\n".join(map(str, written)))
    click.echo(f"Next: cd {folder}, and follow its README.md")


def _write(folder: Path, names: dict[str, str]) -> list[Path]:
    """Write the package, with these names in the place of the template's; its files."""

    def renamed(text: str) -> str:
        return re.sub("|".join(names), lambda found: names[found[0]], text)

    paths = [folder / renamed(name) for name in _FILES]
    for name, path in zip(_FILES, paths, strict=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(renamed((_TEMPLATE / name).read_text()))
    return paths
