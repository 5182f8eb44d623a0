"""The bus at one moment, live or recorded, and its changes: for dashboards and own checks."""

from tfbus.base.lazy_exports import exported

# As in tfbus/__init__.py: names are imported when first used.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from tfbus.bus.graph import Endpoint as Endpoint
    from tfbus.bus.graph import ServiceInfo as ServiceInfo
    from tfbus.bus.graph import TopicInfo as TopicInfo
    from tfbus.frames.changes import BusChange as BusChange
    from tfbus.frames.changes import Recorded as Recorded
    from tfbus.frames.command_listener import Watch as Watch
    from tfbus.frames.moment import BusMoment as BusMoment
    from tfbus.frames.moment import FrameStatus as FrameStatus
    from tfbus.frames.snapshot import Problem as Problem
    from tfbus.streams.info import StreamInfo as StreamInfo
    from tfbus.wire.descriptions import NodeDescription as NodeDescription

_MODULE_OF = {
    "Watch": "tfbus.frames.command_listener",
    "Recorded": "tfbus.frames.changes",
    "BusMoment": "tfbus.frames.moment",
    "FrameStatus": "tfbus.frames.moment",
    "Problem": "tfbus.frames.snapshot",
    "BusChange": "tfbus.frames.changes",
    "StreamInfo": "tfbus.streams.info",
    "NodeDescription": "tfbus.wire.descriptions",
    "TopicInfo": "tfbus.bus.graph",
    "ServiceInfo": "tfbus.bus.graph",
    "Endpoint": "tfbus.bus.graph",
}

__all__ = sorted(_MODULE_OF)
__getattr__, __dir__ = exported(__name__, _MODULE_OF)
