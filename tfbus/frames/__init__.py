"""The tree of frames as a whole: who publishes what, what is wrong with it, and its pictures.

Listed here is what nodes use: how `tfbus echo` writes a transform.
"""

from importlib import import_module

# As in tfbus/__init__.py: names are imported when first used.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from typing import Any

    from tfbus.frames.blocks import CSV_HEADER as CSV_HEADER
    from tfbus.frames.blocks import Numbers as Numbers
    from tfbus.frames.blocks import csv_line as csv_line
    from tfbus.frames.blocks import foxy_block as foxy_block
    from tfbus.frames.blocks import json_line as json_line
    from tfbus.frames.blocks import tf2_block as tf2_block

_MODULE_OF = {
    "CSV_HEADER": "tfbus.frames.blocks",
    "Numbers": "tfbus.frames.blocks",
    "csv_line": "tfbus.frames.blocks",
    "foxy_block": "tfbus.frames.blocks",
    "json_line": "tfbus.frames.blocks",
    "tf2_block": "tfbus.frames.blocks",
}

__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> "Any":
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'tfbus.frames' has no attribute {name!r}")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
