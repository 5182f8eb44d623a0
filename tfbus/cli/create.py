"""`tfbus create`: a small package with a node of one's own, to begin from.

The folder `template` beside this file is that package, for the robot `my_robot` and the node
`my_node`; creating one is copying it with other names.
"""

import keyword
from pathlib import Path

import click

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
            "and begin with a letter"
        )
    return value


@click.command(epilog="Example: tfbus create my_robot --node my_node")
@click.argument("package", callback=_check_module_name)
@click.option(
    "--node", default="my_node", callback=_check_module_name, help="The node's name; my_node."
)
@click.option(
    "--directory", default=".", type=click.Path(path_type=Path), help="Where to write it; here."
)
def command(package: str, node: str, directory: Path) -> None:
    """Write a small package with a node of your own.

    It has a pyproject.toml with the entry point, one node, one launch file and one test, and
    installs and runs as written. Nothing that exists is overwritten.
    """
    if package == node:
        raise click.UsageError("the package and the node need different names")
    folder = directory / package
    if folder.exists():
        raise click.ClickException(f"{folder} exists already: choose another name or --directory")

    def renamed(text: str) -> str:
        return text.replace("my_robot", package).replace("my_node", node)

    for name in _FILES:
        path = folder / renamed(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(renamed((_TEMPLATE / name).read_text()))
        click.echo(path)
    click.echo(f"Next: cd {folder}, and do what its README.md says")
