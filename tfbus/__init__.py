"""Coordinate frames for distributed robots, without ROS.

The names listed here are public, and the names of `tfbus.messages`, `tfbus.testing`, `tfbus.view`,
`tfbus.compat`, and `files`, `formats` and `trajectories` of `tfbus.buffer`; everything else is
private. Names are imported when first used, so that `import tfbus` costs nothing and a command
loads only the modules that it needs.
"""

from tfbus.base.lazy_exports import imported

# As typing has it, whose import would take most of the time that this one takes.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from typing import Any

    from tfbus import inspect as inspect
    from tfbus import view as view
    from tfbus.base.callbacks import (
        MutuallyExclusiveCallbackGroup as MutuallyExclusiveCallbackGroup,
    )
    from tfbus.base.callbacks import ReentrantCallbackGroup as ReentrantCallbackGroup
    from tfbus.base.clock import SimulatedClock as SimulatedClock
    from tfbus.base.clock import SystemClock as SystemClock
    from tfbus.base.errors import BusError as BusError
    from tfbus.base.errors import ConnectivityException as ConnectivityException
    from tfbus.base.errors import DecodeError as DecodeError
    from tfbus.base.errors import ExtrapolationException as ExtrapolationException
    from tfbus.base.errors import FileError as FileError
    from tfbus.base.errors import FutureExtrapolationException as FutureExtrapolationException
    from tfbus.base.errors import GapException as GapException
    from tfbus.base.errors import InvalidArgumentException as InvalidArgumentException
    from tfbus.base.errors import InvalidNameError as InvalidNameError
    from tfbus.base.errors import LookupException as LookupException
    from tfbus.base.errors import LoopException as LoopException
    from tfbus.base.errors import MissingFileError as MissingFileError
    from tfbus.base.errors import NoDataException as NoDataException
    from tfbus.base.errors import ParameterError as ParameterError
    from tfbus.base.errors import PastExtrapolationException as PastExtrapolationException
    from tfbus.base.errors import RightsError as RightsError
    from tfbus.base.errors import ServiceError as ServiceError
    from tfbus.base.errors import SettingsError as SettingsError
    from tfbus.base.errors import SingleSampleException as SingleSampleException
    from tfbus.base.errors import StaleException as StaleException
    from tfbus.base.errors import TfbusError as TfbusError
    from tfbus.base.errors import TimeoutException as TimeoutException
    from tfbus.base.errors import TransformException as TransformException
    from tfbus.base.errors import UrdfError as UrdfError
    from tfbus.base.stamps import stamp_ns as stamp_ns
    from tfbus.buffer.buffer import Buffer as Buffer
    from tfbus.buffer.info import Change as Change
    from tfbus.buffer.info import FrameInfo as FrameInfo
    from tfbus.bus.settings import NodeSettings as NodeSettings
    from tfbus.command.options import fleet_options as fleet_options
    from tfbus.command.options import node_options as node_options
    from tfbus.command.types import FrameName as FrameName
    from tfbus.command.types import NodeName as NodeName
    from tfbus.command.types import Number as Number
    from tfbus.command.types import ServiceName as ServiceName
    from tfbus.command.types import TopicName as TopicName
    from tfbus.frames.recording import Recording as Recording
    from tfbus.geometry.batch import TransformBatch as TransformBatch
    from tfbus.geometry.sampling import Sampling as Sampling
    from tfbus.geometry.trajectory import Trajectory as Trajectory
    from tfbus.geometry.transform import Transform as Transform
    from tfbus.geometry.transform import TransformStamped as TransformStamped
    from tfbus.geometry.transform_array import TransformArray as TransformArray
    from tfbus.geometry.twist import TwistStamped as TwistStamped
    from tfbus.node.action import GoalHandle as GoalHandle
    from tfbus.node.action import GoalResult as GoalResult
    from tfbus.node.node import Node as Node
    from tfbus.node.parameters import Parameter as Parameter
    from tfbus.robot.model import Joint as Joint
    from tfbus.robot.model import Link as Link
    from tfbus.robot.robot import Robot as Robot
    from tfbus.streams.broadcaster import StaticTransformBroadcaster as StaticTransformBroadcaster
    from tfbus.streams.broadcaster import TransformBroadcaster as TransformBroadcaster
    from tfbus.streams.listener import TransformListener as TransformListener
    from tfbus.wire.fleet import Fleet as Fleet
    from tfbus.wire.limits import Limits as Limits

    __version__: str

_MODULE_OF = {
    "Buffer": "tfbus.buffer.buffer",
    "BusError": "tfbus.base.errors",
    "Change": "tfbus.buffer.info",
    "ConnectivityException": "tfbus.base.errors",
    "DecodeError": "tfbus.base.errors",
    "ExtrapolationException": "tfbus.base.errors",
    "Fleet": "tfbus.wire.fleet",
    "FrameInfo": "tfbus.buffer.info",
    "FrameName": "tfbus.command.types",
    "FutureExtrapolationException": "tfbus.base.errors",
    "GapException": "tfbus.base.errors",
    "GoalHandle": "tfbus.node.action",
    "GoalResult": "tfbus.node.action",
    "InvalidArgumentException": "tfbus.base.errors",
    "InvalidNameError": "tfbus.base.errors",
    "Joint": "tfbus.robot.model",
    "Limits": "tfbus.wire.limits",
    "Link": "tfbus.robot.model",
    "LookupException": "tfbus.base.errors",
    "LoopException": "tfbus.base.errors",
    "MutuallyExclusiveCallbackGroup": "tfbus.base.callbacks",
    "NoDataException": "tfbus.base.errors",
    "Node": "tfbus.node.node",
    "NodeName": "tfbus.command.types",
    "NodeSettings": "tfbus.bus.settings",
    "Number": "tfbus.command.types",
    "Parameter": "tfbus.node.parameters",
    "ParameterError": "tfbus.base.errors",
    "PastExtrapolationException": "tfbus.base.errors",
    "ReentrantCallbackGroup": "tfbus.base.callbacks",
    "RightsError": "tfbus.base.errors",
    "Sampling": "tfbus.geometry.sampling",
    "Recording": "tfbus.frames.recording",
    "Robot": "tfbus.robot.robot",
    "ServiceError": "tfbus.base.errors",
    "ServiceName": "tfbus.command.types",
    "SettingsError": "tfbus.base.errors",
    "SimulatedClock": "tfbus.base.clock",
    "SingleSampleException": "tfbus.base.errors",
    "StaleException": "tfbus.base.errors",
    "StaticTransformBroadcaster": "tfbus.streams.broadcaster",
    "SystemClock": "tfbus.base.clock",
    "TfbusError": "tfbus.base.errors",
    "TimeoutException": "tfbus.base.errors",
    "TopicName": "tfbus.command.types",
    "Trajectory": "tfbus.geometry.trajectory",
    "Transform": "tfbus.geometry.transform",
    "TransformArray": "tfbus.geometry.transform_array",
    "TransformBatch": "tfbus.geometry.batch",
    "TransformBroadcaster": "tfbus.streams.broadcaster",
    "TransformException": "tfbus.base.errors",
    "TransformListener": "tfbus.streams.listener",
    "TransformStamped": "tfbus.geometry.transform",
    "TwistStamped": "tfbus.geometry.twist",
    "FileError": "tfbus.base.errors",
    "MissingFileError": "tfbus.base.errors",
    "UrdfError": "tfbus.base.errors",
    "fleet_options": "tfbus.command.options",
    "node_options": "tfbus.command.options",
    "stamp_ns": "tfbus.base.stamps",
}

__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> "Any":
    if name == "__version__":
        value = imported("tfbus.base.installation").installed_version()
    elif name in ("inspect", "view"):
        # `import tfbus` is enough for `tfbus.view.show(buffer)`.
        value = imported(f"tfbus.{name}")
    elif name in _MODULE_OF:
        value = getattr(imported(_MODULE_OF[name]), name)
    else:
        hint = imported("tfbus.base.ros_names").hint("tfbus", name)
        raise AttributeError(f"module 'tfbus' has no attribute {name!r}{hint}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
