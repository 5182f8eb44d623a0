"""Values as people type them, for parameters and requests: YAML 1.2, whose words have no traps.

PyYAML reads YAML 1.1, in which `no`, `off` and `y: 1` hold booleans, 010 is eight, 1:30 is ninety,
1e-3 is a text and 2022-12-07 is a date. Here a plain word is nothing (`null`, `~`), true or
false, a number, or else a text, and the key of a map is always a text.
"""

import re
from typing import Any

import yaml

_TAG = "tag:yaml.org,2002:"
_BASES = {"0o": 8, "0x": 16}

# Of a text that came over the network. PyYAML's time grows with the square of the nesting.
_MOST_LETTERS = 10_000
_MOST_NESTED = 100

# The core schema: https://yaml.org/spec/1.2.2/#1032-tag-resolution
_WORDS = {
    "null": r"null|~|",
    "bool": r"true|false",
    "int": r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-f]+",
    "float": r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)(e[-+]?[0-9]+)?|[-+]?\.inf|\.nan",
}


def read_value(text: str) -> Any:
    """The value of the text; a text that is not YAML is its own value."""
    try:
        return yaml.load(text, _LOADER)
    except Exception:  # a tag that does not fit may raise any: `!!bool 5` a KeyError
        return text


def read_strangers_value(text: str) -> Any:
    """As `read_value`, for a text that came over the network.

    A text is its own value if it has anchors, which let a few letters stand for billions of
    values, or more than 10,000 letters or 100 lists and maps, which could take seconds to read.
    """
    if len(text) > _MOST_LETTERS or text.count("[") + text.count("{") > _MOST_NESTED:
        return text
    try:
        return yaml.load(text, _STRANGERS_LOADER)
    except Exception:
        return text


def _read_int(loader: Any, node: Any) -> int:
    return int(node.value, _BASES.get(node.value[:2].lower(), 10))


def _read_map(loader: Any, node: Any) -> dict[str, Any]:
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise yaml.YAMLError("the key of a map must be a text")
    return {key.value: loader.construct_object(value, deep=True) for key, value in node.value}


def _without_anchors(loader: Any, parent: Any, index: Any) -> Any:
    event = loader.peek_event()
    if getattr(event, "anchor", None) is not None:
        raise yaml.YAMLError("there are no anchors and aliases here")
    return yaml.SafeLoader.compose_node(loader, parent, index)


def _make_loader() -> Any:
    # Not a class statement: without PyYAML's types, mypy does not know its base.
    loader: Any = type("_Loader", (yaml.SafeLoader,), {"yaml_implicit_resolvers": {}})
    for name, pattern in _WORDS.items():
        word = re.compile(rf"(?:{pattern})\Z", re.IGNORECASE)
        loader.add_implicit_resolver(_TAG + name, word, [None])
    loader.add_constructor(f"{_TAG}int", _read_int)
    loader.add_constructor(f"{_TAG}map", _read_map)
    return loader


_LOADER = _make_loader()
_STRANGERS_LOADER: Any = type("_Loader", (_LOADER,), {"compose_node": _without_anchors})
