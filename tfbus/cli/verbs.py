"""Groups of commands that say what is meant, or what there is, where a command is unknown."""

import difflib
from collections.abc import Mapping
from typing import Any

import click


class Verbs(click.Group):
    """A group such as `tfbus topic`; `hints` are for commands of ROS that are not there."""

    def __init__(self, *args: Any, hints: Mapping[str, str] | None = None, **given: Any) -> None:
        super().__init__(*args, **given)
        self.hints = hints or {}

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click's own, where there is such a command."""
        name = args[0]
        is_known = name.startswith("-") or self.get_command(ctx, name) is not None
        if not is_known and not ctx.resilient_parsing:
            ctx.fail(f"there is no command {name!r}; {self._hint(ctx, name)}")
        return super().resolve_command(ctx, args)

    def _hint(self, ctx: click.Context, name: str) -> str:
        if name in self.hints:
            return self.hints[name]
        known = self.list_commands(ctx)
        close = difflib.get_close_matches(name, known, n=1)
        return f"did you mean {close[0]!r}?" if close else f"there are: {', '.join(known)}"
