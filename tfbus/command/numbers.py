"""Numbers as options take them: finite, and within bounds."""

import math

import click


class Number(click.ParamType[float]):
    """A finite number from `least`, or above it where `more_than_least`, to `most`."""

    name = "number"

    def __init__(
        self,
        *,
        least: float = -math.inf,
        most: float = math.inf,
        more_than_least: bool = False,
    ):
        self._least = least
        self._most = most
        self._more = more_than_least

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number; a usage error where it is none, or out of range."""
        try:
            number = float(str(value))
        except ValueError:
            self.fail(f"{value!r} is not a number", param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a number that is finite", param, ctx)
        if number > self._most:
            self.fail(f"{number:g} is not a number of at most {self._most:g}", param, ctx)
        if number < self._least or (self._more and number == self._least):
            relation = "greater than" if self._more else "of at least"
            self.fail(f"{number:g} is not a number {relation} {self._least:g}", param, ctx)
        return number


# Seconds: what a clock can wait for, thirty years.
NOT_NEGATIVE = Number(least=0.0, most=1e9)
POSITIVE = Number(least=0.0, most=1e9, more_than_least=True)
