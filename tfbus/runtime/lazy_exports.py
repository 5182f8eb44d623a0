"""Names of a package that are imported when first used."""

import sys
from importlib import import_module

# As in tfbus/__init__.py: typing takes long to import.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Any


def exported(package: str, module_of: "Mapping[str, str]") -> "Callable[[str], Any]":
    """The `__getattr__` of a package whose names are in these modules."""

    def find(name: str) -> "Any":
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(module_of[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return find
