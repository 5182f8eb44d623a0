"""Imports and docstrings of source files, each parsed once."""

import ast
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]

_DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


class Source(NamedTuple):
    """The imports of a file, anywhere in it, and the docstrings that it has."""

    imports: frozenset[str]  # absolute: dotted names
    is_relative: bool
    docstrings: tuple[str, ...]  # that of the module is the first


@cache
def source_of(path: Path) -> Source:
    """The source of a file; its tree is not kept, which would slow the collector of garbage."""
    imports: set[str] = set()
    is_relative = False
    docstrings: list[str] = []
    statements: list[ast.AST] = [ast.parse(path.read_text())]
    while statements:
        node = statements.pop()
        if isinstance(node, ast.Import):
            imports |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            is_relative |= node.level > 0
            if not node.level:
                imports |= {f"{node.module}.{alias.name}" for alias in node.names}
        else:  # statements only: no expression has an import or a docstring
            if isinstance(node, _DOCUMENTED):
                docstrings.append(ast.get_docstring(node) or "")
            for part in ("body", "orelse", "handlers", "finalbody", "cases"):
                inner = getattr(node, part, ())
                statements += inner if isinstance(inner, list) else ()
    return Source(frozenset(imports), is_relative, tuple(docstrings))
