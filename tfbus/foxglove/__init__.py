"""The bus, or a recording, as Foxglove shows it live.

Listed here is what the node `tfbus foxglove` uses.
"""

from importlib import import_module

# As in tfbus/__init__.py: names are imported when first used.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from typing import Any

    from tfbus.foxglove.live import LiveBridge as LiveBridge
    from tfbus.foxglove.playback import PlaybackBridge as PlaybackBridge
    from tfbus.foxglove.serving import Serving as Serving

_MODULE_OF = {
    "LiveBridge": "tfbus.foxglove.live",
    "PlaybackBridge": "tfbus.foxglove.playback",
    "Serving": "tfbus.foxglove.serving",
}

__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> "Any":
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'tfbus.foxglove' has no attribute {name!r}")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
