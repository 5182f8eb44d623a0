"""The signature of a compiled class, which Python cannot see, from its source."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import ast
    import inspect


class SourceSignature:
    """As `__signature__` of a class: that of the `__init__` in the .py file beside the module.

    Read when `help` or an IDE asks. A subclass with another `__init__` has its own.
    """

    def __get__(self, instance: object, owner: type) -> "inspect.Signature":
        written = next(each for each in owner.__mro__ if vars(each).get("__signature__") is self)
        above = owner.__mro__[: owner.__mro__.index(written)]
        module = sys.modules[written.__module__]
        source = Path(module.__file__ or "")
        if any("__init__" in vars(each) for each in above):
            raise AttributeError("__signature__")
        source = source.with_name(source.name.partition(".")[0] + ".py")
        try:
            arguments = _init_of(source, written.__name__)
        except (OSError, StopIteration, SyntaxError):
            raise AttributeError("__signature__") from None
        return _signature(arguments, vars(module))


def _init_of(source: Path, name: str) -> ast.arguments:
    import ast  # slow, as is inspect below, and a node needs neither

    body = ast.parse(source.read_text(encoding="utf-8")).body
    written = next(node for node in body if isinstance(node, ast.ClassDef) and node.name == name)
    return next(
        node.args
        for node in written.body
        if isinstance(node, ast.FunctionDef) and node.name == "__init__"
    )


def _signature(arguments: ast.arguments, names: dict[str, Any]) -> "inspect.Signature":
    """That of a function with these arguments, without `self`."""
    import inspect

    def parameter(argument: ast.arg, kind: Any, default: ast.expr | None) -> inspect.Parameter:
        return inspect.Parameter(
            argument.arg,
            kind,
            default=inspect.Parameter.empty if default is None else _value(default, names),
            annotation=inspect.Parameter.empty
            if argument.annotation is None
            else _value(argument.annotation, names),
        )

    placed = arguments.args[1:]
    defaults = [None] * (len(placed) - len(arguments.defaults)) + list(arguments.defaults)
    by_place, by_name = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    return inspect.Signature(
        [
            *(parameter(a, by_place, d) for a, d in zip(placed, defaults, strict=True)),
            *(
                parameter(a, by_name, d)
                for a, d in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
            ),
        ],
        return_annotation=None,
    )


def _value(expression: ast.expr, names: dict[str, Any]) -> Any:
    """Its value in the module; its text if a name is there for type checkers only."""
    import ast

    text = ast.unparse(expression)
    try:
        return eval(compile(ast.Expression(expression), "<signature>", "eval"), names)
    except NameError:
        return text
