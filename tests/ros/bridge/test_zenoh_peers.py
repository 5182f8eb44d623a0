"""The leg by rmw_zenoh's wire beside implementations of it that others wrote, and an old Zenoh."""

import logging
import os
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from tests import needs
from tests.buses import eventually, send_until
from tests.live_bus import Process
from tests.ros.bridge.ros_router import RosRouter
from tfbus.ros.bridge.legs import LegSettings, RosPublisher, RosTopic
from tfbus.ros.bridge.legs.zenoh import ZenohLeg
from tfbus.ros.definitions import TF_MESSAGE
from tfbus.ros.rmw import type_hash
from tfbus.ros.tf_message import TFMessageReader

pytestmark = pytest.mark.real

HERE = Path(__file__).parent

TF = RosTopic("/tf", TF_MESSAGE, depth=100)
TF_STATIC = RosTopic("/tf_static", TF_MESSAGE, retained=True, depth=1)
HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"


def tf_message(child: str) -> bytes:
    """A message of one transform, base -> child, 1.5 m ahead; names have four letters."""
    text = b"\x05\0\0\0%s\0\0\0\0"
    return b"".join(
        [
            b"\0\1\0\0\1\0\0\0\x0c\0\0\0\x22\0\0\0",
            text % b"base",
            text % child.encode(),
            b"\0" * 4,
            bytes.fromhex("000000000000f83f"),
            b"\0" * 40,
            bytes.fromhex("000000000000f03f"),
        ]
    )


def children(payload: bytes) -> list[str]:
    """The child frames of a message."""
    return sorted(TFMessageReader().read(payload).children())


class Heard(list[tuple[bytes, str]]):
    """The messages that a leg heard, with the gids of their publishers."""

    def add(self, payload: bytes, gid: str) -> None:
        """Take a message."""
        self.append((payload, gid))

    def gids_of(self, payload: bytes) -> set[str]:
        """Whose this message was."""
        return {gid for each, gid in self if each == payload}


class Around:
    """A router, what runs beside it, and the leg."""

    def __init__(self) -> None:
        self.router = RosRouter()
        self._legs: list[ZenohLeg] = []
        self._processes: list[Process] = []

    def leg(self, node: str = "tfbus_ros2") -> ZenohLeg:
        """A leg on the router."""
        settings = LegSettings(node, connect=(self.router.endpoint,), domain=0)
        self._legs.append(ZenohLeg(settings, logging.getLogger("test")))
        return self._legs[-1]

    def start(self, command: Sequence[str], stdin: str = "") -> Process:
        """A program of the ROS side, with this on its standard input."""
        env = {name: text for name, text in os.environ.items() if not name.startswith("ZENOH_")}
        env |= {"ROS_DOMAIN_ID": "0", "PYTHONUNBUFFERED": "1"}
        # pyzeros would write what it compiles where it runs.
        env["CYDR_CACHE_DIR"] = str(Path(command[0]).parents[1] / "compiled")
        process = Process(["sh", "-c", 'printf %s "$0" | exec "$@"', stdin, *command], env)
        self._processes.append(process)
        return process

    def close(self) -> None:
        """End all."""
        for process in self._processes:
            process.kill()
        for leg in self._legs:
            leg.close()
        self.router.stop()


@pytest.fixture
def around() -> Iterator[Around]:
    """A ROS network to be."""
    around = Around()
    yield around
    around.close()


class TestPyzeros:
    """pyzeros 0.1.0 and ours."""

    def test_each_hears_the_other_and_knows_who_it_is(self, around: Around) -> None:
        """/tf crosses both ways; the gid of its messages is that of its token, and its hash of the
        type ours.
        """
        python = needs.python_of_rmw_zenoh()
        config = next(Path(python).parents[1].glob("lib/*/site-packages/zenoh_ros2_sdk/config/*"))
        around.router.start()
        command = [python, str(HERE / "rmw_pyzeros.py"), around.router.endpoint, str(config)]
        process = around.start(command)
        leg = around.leg()
        heard = Heard()
        leg.subscribe(TF, heard.add)
        gid = process.wait_for_line("^gid ").split()[1]
        # The first time it compiles how it writes an attachment.
        eventually(lambda: heard)
        assert {gid} == {each for _, each in heard}
        eventually(lambda: leg.publishers("/tf") == [RosPublisher(gid, "/robot1/pyzeros_node")])
        assert children(heard[0][0]) == ["pyzeros_arm"]
        assert leg.warnings() == []
        sender = leg.publisher(TF)
        eventually(lambda: sender.heard)
        send_until(
            lambda: sender.send(tf_message("ours")),
            lambda: "heard ours 1.5" in process.out,
        )


class TestZenohRos2Sdk:
    """zenoh-ros2-sdk 0.1.8 and ours."""

    def test_each_hears_the_other_and_it_has_our_statics_late(self, around: Around) -> None:
        """/tf crosses both ways, and what we sent on /tf_static before it came."""
        python = needs.python_of_rmw_zenoh()
        around.router.start()
        leg = around.leg()
        leg.publisher(TF_STATIC).send(tf_message("bolt"))
        heard = Heard()
        leg.subscribe(TF, heard.add)
        port = str(around.router.port)
        process = around.start(
            [python, str(HERE / "rmw_sdk.py"), port, type_hash(TF_MESSAGE)], TF_MESSAGE.text
        )
        process.wait_for_line("^heard /tf_static bolt 1.5$")
        eventually(lambda: heard)
        assert children(heard[0][0]) == ["sdk_arm"]
        # It puts a gid of its own making into its messages.
        made_up = RosPublisher(heard[-1][1], "/sdk_node")
        eventually(lambda: made_up in leg.publishers("/tf"))
        sender = leg.publisher(TF)
        send_until(
            lambda: sender.send(tf_message("ours")),
            lambda: "heard /tf ours 1.5" in process.out,
        )

    def test_its_tools_show_our_node_types_hashes_and_qos(self, around: Around) -> None:
        """`zenoh-ros2 topic list -t` and `info -v`."""
        tool = str(Path(needs.python_of_rmw_zenoh()).with_name("zenoh-ros2"))
        around.router.start()
        settings = LegSettings("tfbus_ros2", "robot1", 0, (around.router.endpoint,))
        leg = ZenohLeg(settings, logging.getLogger("test"))
        try:
            leg.publisher(TF_STATIC)
            leg.subscribe(TF, lambda payload, gid: None)
            eventually(lambda: not leg.warnings())
            router = ["--router", f"127.0.0.1:{around.router.port}", "--timeout", "5"]
            listing = around.start([tool, *router, "--no-daemon", "topic", "list", "-t"])
            listing.wait_for_line(r"^/tf \[tf2_msgs/msg/TFMessage\]$")
            listing.wait_for_line(r"^/tf_static \[tf2_msgs/msg/TFMessage\]$")
            info = around.start([tool, *router, "--no-daemon", "topic", "info", "-v", "/tf_static"])
            info.wait_for_line("QoS")
            shown = [line.strip() for line in info.out if line]
            assert shown[:7] == [
                "Type: tf2_msgs/msg/TFMessage",
                "Publisher count: 1",
                "Node name: tfbus_ros2",
                "Node namespace: /robot1",
                "Topic type: tf2_msgs/msg/TFMessage",
                f"Type hash: {HASH}",
                "QoS: :1:,1:,:,:,,",
            ]
        finally:
            leg.close()


class TestOldZenoh:
    """Zenoh 1.6.2, which is in ROS 2 Jazzy and Kilted, on the side of ROS."""

    def test_statics_of_both_sides_reach_the_other_late(self, around: Around) -> None:
        """With a router of 1.6.2; its node comes after our statics, and one of ours after its."""
        python = needs.python_of_old_zenoh()
        program = str(HERE / "rmw_plain_zenoh.py")
        version = [
            python,
            "-c",
            "from importlib.metadata import version; print(version('eclipse-zenoh'))",
        ]
        assert subprocess.check_output(version, text=True).startswith("1.6.")
        around.start([python, program, "router", around.router.endpoint]).wait_for_line("ready")
        leg = around.leg()
        leg.publisher(TF_STATIC).send(tf_message("bolt"))
        messages = f"{tf_message('oldd').hex()}\n{tf_message('olds').hex()}\n"
        process = around.start([python, program, "node", around.router.endpoint], messages)
        process.wait_for_line(f"heard /tf_static 33 {tf_message('bolt').hex()}")
        later = around.leg("tfbus_later")
        dynamics, statics = Heard(), Heard()
        later.subscribe(TF, dynamics.add)
        later.subscribe(TF_STATIC, statics.add)
        eventually(lambda: dynamics.gids_of(tf_message("oldd")))
        eventually(lambda: statics.gids_of(tf_message("olds")))
        eventually(lambda: statics.gids_of(tf_message("bolt")))
        sender = leg.publisher(TF)
        send_until(
            lambda: sender.send(tf_message("ours")),
            lambda: f"heard /tf 33 {tf_message('ours').hex()}" in process.out,
        )
        assert {each.node for each in leg.publishers("/tf_static")} == {"/plain_node"}
