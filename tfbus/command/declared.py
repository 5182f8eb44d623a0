"""Parameters that a node's command lists in its `--help`, and its node declares."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import click

Value = bool | int | float | str

_TYPE_NAMES: dict[type, str] = {bool: "boolean", int: "integer", float: "number", str: "text"}


class _Declares(Protocol):
    """The part of a Node that declares parameters."""

    @property
    def declare_parameter(self) -> Callable[..., Any]: ...


@dataclass(frozen=True)
class Declared:
    """A parameter: its default and so its type, a description, and bounds if it is a number."""

    name: str
    default: Value
    description: str
    minimum: float | None = None
    maximum: float | None = None

    def on(self, node: _Declares, **more: Any) -> Any:
        """Declare it on a node, with more arguments of `declare_parameter`; the Parameter."""
        return node.declare_parameter(
            self.name,
            self.default,
            description=self.description,
            minimum=self.minimum,
            maximum=self.maximum,
            **more,
        )

    @property
    def help(self) -> str:
        """`Seconds for one circle. [number from 0.1; default 10.0]`."""
        bounds = [
            f"{word} {bound:g}"
            for word, bound in (("from", self.minimum), ("to", self.maximum))
            if bound is not None
        ]
        kind = " ".join((_TYPE_NAMES[type(self.default)], *bounds))
        is_text = isinstance(self.default, str) and self.default
        default = self.default if is_text else json.dumps(self.default)
        return f"{self.description}  [{kind}; default {default}]"


class NodeCommand(click.Command):
    """The command of a node; its help lists the `declared` parameters."""

    def __init__(self, *args: Any, declared: Sequence[Declared] = (), **given: Any) -> None:
        super().__init__(*args, **given)
        self.declared = tuple(declared)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The parameters after the options."""
        super().format_options(ctx, formatter)
        if self.declared:
            with formatter.section("Parameters, set by --param NAME=VALUE or `tfbus param set`"):
                formatter.write_dl([(each.name, each.help) for each in self.declared])
