"""Coordinate frames for distributed robots, without ROS.

The names listed here are public, and those of `tfbus.messages`, `tfbus.testing`, `tfbus.view`,
`tfbus.compat`, and `files`, `formats` and `trajectories` of `tfbus.buffer`; everything else is
private. Names are imported when first used, so that `import tfbus` costs nothing and a command
loads only what it needs.
"""

from tfbus.runtime.lazy_exports import imported

# As typing has it, whose import would take most of the time that this one takes.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from typing import Any

    from tfbus import inspect as inspect
    from tfbus import view as view
    from tfbus.broadcast.broadcaster import StaticTransformBroadcaster as StaticTransformBroadcaster
    from tfbus.broadcast.broadcaster import TransformBroadcaster as TransformBroadcaster
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
    from tfbus.core.sampling import Sampling as Sampling
    from tfbus.errors import BusError as BusError
    from tfbus.errors import ConnectivityException as ConnectivityException
    from tfbus.errors import DecodeError as DecodeError
    from tfbus.errors import ExtrapolationException as ExtrapolationException
    from tfbus.errors import FileError as FileError
    from tfbus.errors import FutureExtrapolationException as FutureExtrapolationException
    from tfbus.errors import GapException as GapException
    from tfbus.errors import InvalidArgumentException as InvalidArgumentException
    from tfbus.errors import InvalidNameError as InvalidNameError
    from tfbus.errors import LookupException as LookupException
    from tfbus.errors import LoopException as LoopException
    from tfbus.errors import MissingFileError as MissingFileError
    from tfbus.errors import NoDataException as NoDataException
    from tfbus.errors import ParameterError as ParameterError
    from tfbus.errors import PastExtrapolationException as PastExtrapolationException
    from tfbus.errors import RightsError as RightsError
    from tfbus.errors import ServiceError as ServiceError
    from tfbus.errors import SettingsError as SettingsError
    from tfbus.errors import SingleSampleException as SingleSampleException
    from tfbus.errors import StaleException as StaleException
    from tfbus.errors import TfbusError as TfbusError
    from tfbus.errors import TimeoutException as TimeoutException
    from tfbus.errors import TransformException as TransformException
    from tfbus.errors import UrdfError as UrdfError
    from tfbus.frames.recording import Recording as Recording
    from tfbus.geometry.batch import TransformBatch as TransformBatch
    from tfbus.geometry.transform import Transform as Transform
    from tfbus.geometry.transform import TransformStamped as TransformStamped
    from tfbus.geometry.transform_array import TransformArray as TransformArray
    from tfbus.geometry.twist import TwistStamped as TwistStamped
    from tfbus.listen.listener import TransformListener as TransformListener
    from tfbus.node.action import GoalHandle as GoalHandle
    from tfbus.node.action import GoalResult as GoalResult
    from tfbus.node.node import Node as Node
    from tfbus.node.parameters import Parameter as Parameter
    from tfbus.robot.model import Joint as Joint
    from tfbus.robot.model import Link as Link
    from tfbus.robot.robot import Robot as Robot
    from tfbus.runtime.callbacks import (
        MutuallyExclusiveCallbackGroup as MutuallyExclusiveCallbackGroup,
    )
    from tfbus.runtime.callbacks import ReentrantCallbackGroup as ReentrantCallbackGroup
    from tfbus.runtime.clock import SimulatedClock as SimulatedClock
    from tfbus.runtime.clock import SystemClock as SystemClock
    from tfbus.runtime.stamps import stamp_ns as stamp_ns
    from tfbus.trajectory import Trajectory as Trajectory
    from tfbus.wire.fleet import Fleet as Fleet
    from tfbus.wire.limits import Limits as Limits

    __version__: str

_MODULE_OF = {
    "Buffer": "tfbus.buffer.buffer",
    "BusError": "tfbus.errors",
    "Change": "tfbus.buffer.info",
    "ConnectivityException": "tfbus.errors",
    "DecodeError": "tfbus.errors",
    "ExtrapolationException": "tfbus.errors",
    "Fleet": "tfbus.wire.fleet",
    "FrameInfo": "tfbus.buffer.info",
    "FrameName": "tfbus.command.types",
    "FutureExtrapolationException": "tfbus.errors",
    "GapException": "tfbus.errors",
    "GoalHandle": "tfbus.node.action",
    "GoalResult": "tfbus.node.action",
    "InvalidArgumentException": "tfbus.errors",
    "InvalidNameError": "tfbus.errors",
    "Joint": "tfbus.robot.model",
    "Limits": "tfbus.wire.limits",
    "Link": "tfbus.robot.model",
    "LookupException": "tfbus.errors",
    "LoopException": "tfbus.errors",
    "MutuallyExclusiveCallbackGroup": "tfbus.runtime.callbacks",
    "NoDataException": "tfbus.errors",
    "Node": "tfbus.node.node",
    "NodeName": "tfbus.command.types",
    "NodeSettings": "tfbus.bus.settings",
    "Number": "tfbus.command.types",
    "Parameter": "tfbus.node.parameters",
    "ParameterError": "tfbus.errors",
    "PastExtrapolationException": "tfbus.errors",
    "ReentrantCallbackGroup": "tfbus.runtime.callbacks",
    "RightsError": "tfbus.errors",
    "Sampling": "tfbus.core.sampling",
    "Recording": "tfbus.frames.recording",
    "Robot": "tfbus.robot.robot",
    "ServiceError": "tfbus.errors",
    "ServiceName": "tfbus.command.types",
    "SettingsError": "tfbus.errors",
    "SimulatedClock": "tfbus.runtime.clock",
    "SingleSampleException": "tfbus.errors",
    "StaleException": "tfbus.errors",
    "StaticTransformBroadcaster": "tfbus.broadcast.broadcaster",
    "SystemClock": "tfbus.runtime.clock",
    "TfbusError": "tfbus.errors",
    "TimeoutException": "tfbus.errors",
    "TopicName": "tfbus.command.types",
    "Trajectory": "tfbus.trajectory",
    "Transform": "tfbus.geometry.transform",
    "TransformArray": "tfbus.geometry.transform_array",
    "TransformBatch": "tfbus.geometry.batch",
    "TransformBroadcaster": "tfbus.broadcast.broadcaster",
    "TransformException": "tfbus.errors",
    "TransformListener": "tfbus.listen.listener",
    "TransformStamped": "tfbus.geometry.transform",
    "TwistStamped": "tfbus.geometry.twist",
    "FileError": "tfbus.errors",
    "MissingFileError": "tfbus.errors",
    "UrdfError": "tfbus.errors",
    "fleet_options": "tfbus.command.options",
    "node_options": "tfbus.command.options",
    "stamp_ns": "tfbus.runtime.stamps",
}

# Names of rclpy, and what does the same here.
_IN_RCLPY = {
    "Time": "stamps in nanoseconds, as of node.now_ns() or tfbus.stamp_ns(seconds)",
    "init": "tfbus.Node(name), which needs no init",
    "spin": "node.spin()",
}

__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> "Any":
    if name == "__version__":
        value = imported("tfbus.runtime.installation").installed_version()
    elif name in ("inspect", "view"):
        # `import tfbus` is enough for `tfbus.view.show(buffer)`.
        value = imported(f"tfbus.{name}")
    elif name in _MODULE_OF:
        value = getattr(imported(_MODULE_OF[name]), name)
    else:
        ours = _IN_RCLPY.get(name)
        hint = f"; use: {ours}" if ours else ""
        raise AttributeError(f"module 'tfbus' has no attribute {name!r}{hint}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
