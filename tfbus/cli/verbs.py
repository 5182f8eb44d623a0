"""Commands that answer what they do not have: with a near name, all names, or a hint."""

from collections.abc import Mapping
from typing import Any

import click

from tfbus.wording import did_you_mean

_NO_QOS = "not needed: there is no QoS"
_NO_DAEMON = "not needed: there is no daemon, each command asks the nodes"
_ALL_LISTED = "not needed: topics, services and parameters are never hidden"

# Options of many commands of ros2.
_OF_MANY = {
    "--qos-profile": _NO_QOS,
    "--qos-depth": _NO_QOS,
    "--qos-history": _NO_QOS,
    "--qos-reliability": _NO_QOS,
    "--qos-durability": "not needed: static transforms and retained topics reach late subscribers",
    "--qos-liveliness": _NO_QOS,
    "--qos-liveliness-lease-duration-seconds": _NO_QOS,
    "--no-daemon": _NO_DAEMON,
    "--spin-time": _NO_DAEMON,
    "--include-hidden": _ALL_LISTED,
    "--include-hidden-topics": _ALL_LISTED,
    "--include-hidden-services": _ALL_LISTED,
    "--include-hidden-interfaces": _ALL_LISTED,
    "--include-hidden-nodes": "use tfbus node list --all for names that start with _",
}


class Answering(click.Command):
    """A command that answers options of ROS that it does not have: by its `hints`, or those of
    many commands.
    """

    def __init__(self, *args: Any, hints: Mapping[str, str] | None = None, **given: Any) -> None:
        super().__init__(*args, **given)
        self.hints = {**_OF_MANY, **(hints or {})}

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """As click's own; a usage error with the hint for an option that has one."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            hint = self.hints.get(error.option_name)
            if hint is None:
                raise
            ctx.fail(f"there is no option {error.option_name}: {hint}")


class Verbs(click.Group):
    """A group such as `tfbus topic`; `hints` answer commands of ROS that it does not have."""

    command_class = Answering

    def __init__(self, *args: Any, hints: Mapping[str, str] | None = None, **given: Any) -> None:
        super().__init__(*args, **given)
        self.hints = hints or {}

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click's own; a usage error with a hint for an unknown command."""
        name = args[0]
        is_known = name.startswith("-") or self.get_command(ctx, name) is not None
        if not is_known and not ctx.resilient_parsing:
            ctx.fail(f"there is no command {name!r}{self._hint(ctx, args)}")
        return super().resolve_command(ctx, args)

    def _hint(self, ctx: click.Context, args: list[str]) -> str:
        name = args[0]
        if name in self.hints:
            return f"; {self.hints[name]}"
        return did_you_mean(name, self.list_commands(ctx))
