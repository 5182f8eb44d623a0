"""Options that take several values after one name, as those of ROS do."""

from typing import Any

import click

from tfbus.wording import printable


class Several(click.Option):
    """An option with `multiple=True` whose values may follow one another: `--topics a b`, as well
    as `--topics a --topics b`. The next word that begins with `-` ends them; where it is the first,
    it is a usage error.
    """

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        """Have the parser take all values that follow."""
        super().add_to_parser(parser, ctx)
        for name in self.opts:
            option = parser._long_opt.get(name) or parser._short_opt.get(name)
            option.process = self._taking_several(option.process)

    def takes(self, word: str) -> bool:
        """Whether the next word is a value."""
        return not word.startswith("-")

    def _taking_several(self, process: Any) -> Any:
        def take(value: Any, state: Any) -> None:
            if value.startswith("-"):
                name = max(self.opts, key=len)
                raise click.BadOptionUsage(
                    name,
                    f"option '{name}' needs at least one value, and {printable(value, 60)!r} is an "
                    "option",
                )
            process(value, state)
            while state.rargs and self.takes(state.rargs[0]):
                process(state.rargs.pop(0), state)

        return take
