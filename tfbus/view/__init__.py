"""The page in a browser: frames in three dimensions.

Listed here is `show`, the page for a buffer of any program, and names that nodes use: the parts of
`tfbus view`, and of a guest on its page.
"""

from tfbus.base.lazy_exports import exported

# As in tfbus/__init__.py: names are imported when first used.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from tfbus.view.data.topics import DataOnBus as DataOnBus
    from tfbus.view.data.topics import ToolPublishers as ToolPublishers
    from tfbus.view.frames import Placed as Placed
    from tfbus.view.local import View as View
    from tfbus.view.local import show as show
    from tfbus.view.page import Page as Page
    from tfbus.view.page import Serving as Serving
    from tfbus.view.panels.markup import Channel as Channel
    from tfbus.view.panels.markup import Html as Html
    from tfbus.view.replay import RecordedData as RecordedData
    from tfbus.view.replay import Replay as Replay
    from tfbus.view.robots import GivenRobots as GivenRobots
    from tfbus.view.robots import RecordedRobots as RecordedRobots
    from tfbus.view.robots import RobotsOnBus as RobotsOnBus
    from tfbus.view.robots import RobotSource as RobotSource
    from tfbus.view.robots import ShownRobot as ShownRobot
    from tfbus.view.scene.drawn import FIXED_NODE as FIXED_NODE
    from tfbus.view.scene.drawn import Guest as Guest
    from tfbus.view.scene.drawn import Region as Region
    from tfbus.view.screenshot import Screenshot as Screenshot
    from tfbus.view.screenshot import find_browser as find_browser
    from tfbus.view.server import Access as Access
    from tfbus.view.settings import ViewSettings as ViewSettings
    from tfbus.view.settings import holds_settings as holds_settings
    from tfbus.view.settings import load_settings as load_settings
    from tfbus.view.settings import topic_named as topic_named

_MODULE_OF = {
    "Access": "tfbus.view.server",
    "ShownRobot": "tfbus.view.robots",
    "RecordedData": "tfbus.view.replay",
    "RecordedRobots": "tfbus.view.robots",
    "RobotsOnBus": "tfbus.view.robots",
    "RobotSource": "tfbus.view.robots",
    "GivenRobots": "tfbus.view.robots",
    "Channel": "tfbus.view.panels.markup",
    "DataOnBus": "tfbus.view.data.topics",
    "FIXED_NODE": "tfbus.view.scene.drawn",
    "Guest": "tfbus.view.scene.drawn",
    "Html": "tfbus.view.panels.markup",
    "Page": "tfbus.view.page",
    "Placed": "tfbus.view.frames",
    "Region": "tfbus.view.scene.drawn",
    "Replay": "tfbus.view.replay",
    "Screenshot": "tfbus.view.screenshot",
    "Serving": "tfbus.view.page",
    "ToolPublishers": "tfbus.view.data.topics",
    "View": "tfbus.view.local",
    "ViewSettings": "tfbus.view.settings",
    "find_browser": "tfbus.view.screenshot",
    "holds_settings": "tfbus.view.settings",
    "load_settings": "tfbus.view.settings",
    "show": "tfbus.view.local",
    "topic_named": "tfbus.view.settings",
}

__all__ = sorted(_MODULE_OF)
__getattr__, __dir__ = exported(__name__, _MODULE_OF)
