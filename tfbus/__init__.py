"""Coordinate frames for distributed robots, without ROS.

What is listed here is public; everything else is private. Names are imported when first used,
so that `import tfbus` costs nothing and a command loads only what it needs.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tfbus.batch import TransformBatch as TransformBatch
    from tfbus.buffer import Buffer as Buffer
    from tfbus.errors import ConnectivityException as ConnectivityException
    from tfbus.errors import ExtrapolationException as ExtrapolationException
    from tfbus.errors import InvalidArgumentException as InvalidArgumentException
    from tfbus.errors import LookupException as LookupException
    from tfbus.errors import TfbusError as TfbusError
    from tfbus.errors import TimeoutException as TimeoutException
    from tfbus.errors import TransformException as TransformException
    from tfbus.transform import Transform as Transform
    from tfbus.transform import TransformStamped as TransformStamped

_MODULE_OF = {
    "Buffer": "buffer",
    "ConnectivityException": "errors",
    "ExtrapolationException": "errors",
    "InvalidArgumentException": "errors",
    "LookupException": "errors",
    "TfbusError": "errors",
    "TimeoutException": "errors",
    "Transform": "transform",
    "TransformBatch": "batch",
    "TransformException": "errors",
    "TransformStamped": "transform",
}

__all__ = sorted(_MODULE_OF)  # noqa: PLE0605 - one list of names, not two


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'tfbus' has no attribute {name!r}")
    value = getattr(import_module(f"tfbus.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
