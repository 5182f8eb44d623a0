"""Shared by the parts of a bridge."""

from dataclasses import dataclass

from tfbus.bridge.bus_streams import BusStreams
from tfbus.bridge.crossed import Crossed
from tfbus.bridge.frame_names import FrameNames
from tfbus.bridge.options import BridgeOptions
from tfbus.bridge.ros_publishers import RosPublishers
from tfbus.node.node import Node
from tfbus.runtime.executor import Executor
from tfbus.runtime.log_once import LogOnce


@dataclass(frozen=True)
class Common:
    """Of one bridge: its node and options, who publishes on either side, what has crossed, and the
    thread on which its parts decide.
    """

    node: Node
    options: BridgeOptions
    names: FrameNames
    publishers: RosPublishers
    bus: BusStreams
    crossed: Crossed
    executor: Executor
    once: LogOnce
