"""The page in a browser: frames in three dimensions.

Listed here are the public names: `show`, the page for a buffer of any program, and its `View`.
"""

from tfbus.base.lazy_exports import exported

# As in tfbus/__init__.py: names are imported when first used.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from tfbus.view.local import View as View
    from tfbus.view.local import show as show

_MODULE_OF = {"View": "tfbus.view.local", "show": "tfbus.view.local"}

__all__ = sorted(_MODULE_OF)
__getattr__, __dir__ = exported(__name__, _MODULE_OF)
