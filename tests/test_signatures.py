"""The signatures that `help` and an IDE show of compiled classes are their sources'."""

import ast
import inspect
from pathlib import Path

import pytest

from tfbus import Buffer, Transform, TransformStamped

HERE = Path(__file__).parents[1]
CLASSES = {
    Buffer: "tfbus/buffer/buffer.py",
    Transform: "tfbus/geometry/transform.py",
    TransformStamped: "tfbus/geometry/transform.py",
}


def methods(kind: type, source: str) -> dict[str, ast.arguments]:
    """The public methods of a class in its source, and its `__init__`."""
    body = ast.parse((HERE / source).read_text()).body
    written = next(n for n in body if isinstance(n, ast.ClassDef) and n.name == kind.__name__)
    return {
        node.name: node.args
        for node in written.body
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (node.name == "__init__" or not node.name.startswith("_"))
        and not any(
            text in ("property",) or text.endswith(".setter")
            for text in map(ast.unparse, node.decorator_list)
        )
    }


def shape(arguments: ast.arguments) -> list[tuple[str, bool]]:
    """The names of the arguments, and which may be omitted."""
    placed = arguments.args
    needed = len(placed) - len(arguments.defaults)
    return [(a.arg, at >= needed) for at, a in enumerate(placed)] + [
        (a.arg, default is not None)
        for a, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
    ]


def shown(signature: inspect.Signature) -> list[tuple[str, bool]]:
    """The same of a signature."""
    return [
        (name, parameter.default is not inspect.Parameter.empty)
        for name, parameter in signature.parameters.items()
    ]


@pytest.mark.parametrize("kind", CLASSES)
def test_signatures_are_those_of_the_source(kind: type):
    """Of the class and of every public method: names, order and what may be omitted."""
    for name, arguments in methods(kind, CLASSES[kind]).items():
        if name == "__init__":
            assert shown(inspect.signature(kind)) == shape(arguments)[1:]
        else:
            bound = shape(arguments)[arguments.args[:1] != [] and arguments.args[0].arg == "cls" :]
            assert shown(inspect.signature(getattr(kind, name))) == bound, name


def test_defaults_and_types_are_shown():
    """Not only the names."""
    parameters = inspect.signature(Buffer).parameters
    assert parameters["cache_time_s"].default == 10.0
    assert parameters["cache_time_s"].annotation in (float, "float")
    assert parameters["sampling"].kind is inspect.Parameter.KEYWORD_ONLY


def test_a_subclass_has_its_own():
    """The signature of the base is not that of a class with another `__init__`."""

    class Named(Buffer):
        def __init__(self, name: str) -> None:
            super().__init__()

    class Other(Buffer):
        pass

    assert list(inspect.signature(Named).parameters) == ["name"]
    assert list(inspect.signature(Other).parameters) == [
        "cache_time_s",
        "sampling",
        "clock",
        "max_samples",
    ]
