"""Numbers as options take them: finite, and of a size that a clock can wait for."""

import math

import click


class Number(click.ParamType[float]):
    """A finite number, at most a thousand million; from nought, or more than that, where wanted."""

    name = "number"
    _LIMIT = 1e9

    def __init__(self, *, least: float = -math.inf, more_than_least: bool = False):
        self._least = least
        self._more = more_than_least

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number; a usage error where it is none, or out of range."""
        try:
            number = float(str(value))
        except ValueError:
            self.fail(f"{value!r} is not a number", param, ctx)
        if not math.isfinite(number) or abs(number) > self._LIMIT:
            self.fail(f"{value} is not a number of at most {self._LIMIT:g}", param, ctx)
        if number < self._least or (self._more and number == self._least):
            relation = "greater than" if self._more else "of at least"
            self.fail(f"{number:g} is not a number {relation} {self._least:g}", param, ctx)
        return number


FINITE = Number()
NOT_NEGATIVE = Number(least=0.0)
POSITIVE = Number(least=0.0, more_than_least=True)
