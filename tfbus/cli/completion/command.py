"""`tfbus completion`: the script that completes tfbus in a shell."""

import os
from pathlib import Path

import click

from tfbus.cli.completion.shells import SHELLS, script

_PLACES = {
    "bash": "~/.local/share/bash-completion/completions/tfbus",
    "zsh": "~/.zfunc/_tfbus",
    "fish": "~/.config/fish/completions/tfbus.fish",
}
_MORE = {
    "bash": "which the package bash-completion reads; or: source FILE in ~/.bashrc",
    "zsh": "with `fpath+=~/.zfunc; autoload -Uz compinit; compinit` in ~/.zshrc",
    "fish": "which fish reads by itself",
}


@click.command(epilog=f"Example: tfbus completion bash > {_PLACES['bash']}")
@click.argument("shell", type=click.Choice(list(SHELLS)), required=False)
def command(shell: str | None) -> None:
    """Print the script that completes tfbus in your shell.

    It completes commands, options, launch files and their arguments, and names on the bus: frames,
    nodes, topics, services and parameters. The default is the shell of $SHELL.
    """
    shell = shell or _own_shell()
    click.echo(script(shell, click.get_current_context().find_root().command), nl=False)
    click.echo(f"# To keep it: tfbus completion {shell} > {_PLACES[shell]}")
    click.echo(f"# {_MORE[shell]}; then open another shell.")


def _own_shell() -> str:
    name = Path(os.environ.get("SHELL", "")).name
    if name not in SHELLS:
        raise click.UsageError(f"$SHELL is none of {', '.join(SHELLS)}: name a shell")
    return name
