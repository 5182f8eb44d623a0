"""Two hosts on one network: nodes of the real ROS 2 on one, a leg of tfbus on the other."""

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests import needs
from tests.buses import eventually
from tests.hosts.network import Hosts
from tests.live_bus import Process

DISTROS = ("kilted", "jazzy")
LEGS = ("dds", "rclpy")

_HERE = Path(__file__).parent
_DOMAIN = "77"


class Ros2Network:
    """Processes print what they hear and see; `Heard` reads it."""

    def __init__(self, via: str, distro: str) -> None:
        self.via = via
        self.distro = distro
        self._ros = needs.python_of_ros2(distro)
        if via == "dds":
            needs.module("cyclonedds")
        self.hosts = Hosts("robot", "desk")
        self._processes: list[Process] = []

    def start_node(self, name: str, *options: str) -> "Heard":
        """A node of ROS."""
        return self._start("robot", self._ros, "ros2_node.py", name, *options)

    def start_leg(self, dynamic: str, static: str, *connect: str) -> "Heard":
        """The leg: for rclpy in the environment of the same ROS."""
        python = self._ros if self.via == "rclpy" else sys.executable
        return self._start("desk", python, "leg_node.py", self.via, dynamic, static, *connect)

    def close(self) -> None:
        """End the processes and take the network down."""
        for process in self._processes:
            process.kill()
        self.hosts.close()

    def _start(self, host: str, python: str, script: str, *arguments: str) -> "Heard":
        env = {
            **{key: text for key, text in os.environ.items() if not key.startswith("ROS_")},
            "ROS_DOMAIN_ID": _DOMAIN,
            # For an hour, so that only who says that it ends is seen to end.
            "CYCLONEDDS_URI": "<Discovery><LeaseDuration>3600s</LeaseDuration></Discovery>",
            "FASTDDS_DEFAULT_PROFILES_FILE": str(_HERE / "no_lease.xml"),
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(_HERE / "no_lease.xml"),
            "PYTHONPATH": str(_HERE.parents[2]),
            "PYTHONUNBUFFERED": "1",
        }
        command = self.hosts.command(host, python, str(_HERE / script), *arguments)
        process = Process(command, env)
        self._processes.append(process)
        return Heard(process)


class Heard:
    """What a process has printed."""

    def __init__(self, process: Process) -> None:
        self.process = process

    def lines(self, key: str) -> Sequence[Any]:
        """All lines with this key."""
        lines = [json.loads(line) for line in list(self.process.out) if line.startswith("{")]
        return [line for line in lines if key in line]

    def last(self, key: str) -> Any:
        """The last value of this key; None before the first."""
        lines = self.lines(key)
        return lines[-1][key] if lines else None

    def of(self, topic: str, child: str) -> Sequence[Any]:
        """The messages on a topic with this frame."""
        lines = self.lines("heard")
        return [line for line in lines if line["heard"] == topic and child in line["children"]]

    def wait_for(self, topic: str, child: str, *, more_than: int = 0) -> Any:
        """The last message on a topic with this frame, once there are more than `more_than`."""

        def came() -> Any:
            found = self.of(topic, child)
            return found[-1] if len(found) > more_than else None

        try:
            return eventually(came)
        except AssertionError:
            shown = [*self.process.out[-5:], *self.process.err[-5:]]
            raise AssertionError(f"{child} did not come on {topic}; last: {shown}") from None
