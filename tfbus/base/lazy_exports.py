"""Names of a package that are imported when first used."""

import sys
from importlib import import_module

# As in tfbus/__init__.py: typing takes long to import.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from types import ModuleType
    from typing import Any


def imported(module: str) -> "ModuleType":
    """A module, imported without a break: Ctrl-C counts once it is."""
    signals = sys.modules.get("tfbus.base.signals")
    # Where that is not imported, or not yet whole, there is no handler of tfbus.
    postponed = getattr(signals, "postponed", None)
    if postponed is None:
        return import_module(module)
    with postponed():
        return import_module(module)


def exported(
    package: str, module_of: "Mapping[str, str]"
) -> "tuple[Callable[[str], Any], Callable[[], list[str]]]":
    """The `__getattr__` and `__dir__` of a package whose names are in these modules."""

    def find(name: str) -> "Any":
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(imported(module_of[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return find, lambda: sorted(module_of)
