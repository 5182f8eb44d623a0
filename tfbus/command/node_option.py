"""The options that all commands share: a help leaves them out, and `--help-all` shows them."""

from typing import Any

import click

# In the context of a help that shows all.
SHOWS_ALL = "tfbus.help_all"


class NodeOption(click.Option):
    """An option that other commands have too."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Its line in the help; None if it leaves it out."""
        return super().get_help_record(ctx) if _shows_all(ctx) else None


class HelpAll(click.Option):
    """The option `--help-all`, in the help of a command that leaves options out."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Its line in the help; None if nothing is left out."""
        return None if _shows_all(ctx) else super().get_help_record(ctx)


def help_all_option(function: Any) -> Any:
    """Add `--help-all` to a click command."""

    def show(ctx: click.Context, _: click.Parameter, is_given: bool) -> None:
        if is_given and not ctx.resilient_parsing:
            ctx.meta[SHOWS_ALL] = True
            click.echo(ctx.get_help(), color=ctx.color)
            ctx.exit()

    option = click.option(
        "--help-all",
        cls=HelpAll,
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=show,
        help="Show the options that all commands share, too: --namespace, --connect, --secure, "
        "--log-level and others.",
    )
    return option(function)


def _shows_all(ctx: click.Context) -> bool:
    """Whether all options are shown: if asked for, and where there are no others."""
    own = (
        param
        for param in ctx.command.params
        if isinstance(param, click.Option) and not isinstance(param, NodeOption | HelpAll)
    )
    return bool(ctx.meta.get(SHOWS_ALL)) or not any(own)
