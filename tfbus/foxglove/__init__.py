"""The bus, or a recording, as Foxglove shows it live.

Listed here are the names that the node `tfbus foxglove` uses.
"""

from tfbus.base.lazy_exports import exported

# As in tfbus/__init__.py: names are imported when first used.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from tfbus.foxglove.front import Serving as Serving
    from tfbus.foxglove.live import LiveBridge as LiveBridge
    from tfbus.foxglove.playback import PlaybackBridge as PlaybackBridge

_MODULE_OF = {
    "LiveBridge": "tfbus.foxglove.live",
    "PlaybackBridge": "tfbus.foxglove.playback",
    "Serving": "tfbus.foxglove.front",
}

__all__ = sorted(_MODULE_OF)
__getattr__, __dir__ = exported(__name__, _MODULE_OF)
