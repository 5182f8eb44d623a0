"""The tree of frames as a whole: its publishers, its problems, and its pictures.

Nodes use two names: how `tfbus echo` writes a transform, and the bus that a page shows.
"""

from tfbus.base.lazy_exports import exported

# As in tfbus/__init__.py: names are imported when first used.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from tfbus.frames.command_listener import Listening as Listening
    from tfbus.frames.document import CSV_HEADER as CSV_HEADER
    from tfbus.frames.document import Numbers as Numbers
    from tfbus.frames.document import csv_line as csv_line
    from tfbus.frames.document import foxy_block as foxy_block
    from tfbus.frames.document import json_line as json_line
    from tfbus.frames.document import short_line as short_line
    from tfbus.frames.document import tf2_block as tf2_block
    from tfbus.frames.recorded_poses import recorded_transform as recorded_transform
    from tfbus.frames.recorded_poses import recorded_transforms as recorded_transforms

_MODULE_OF = {
    "recorded_transforms": "tfbus.frames.recorded_poses",
    "recorded_transform": "tfbus.frames.recorded_poses",
    "Listening": "tfbus.frames.command_listener",
    "CSV_HEADER": "tfbus.frames.document",
    "Numbers": "tfbus.frames.document",
    "csv_line": "tfbus.frames.document",
    "foxy_block": "tfbus.frames.document",
    "json_line": "tfbus.frames.document",
    "short_line": "tfbus.frames.document",
    "tf2_block": "tfbus.frames.document",
}

__all__ = sorted(_MODULE_OF)
__getattr__, __dir__ = exported(__name__, _MODULE_OF)
