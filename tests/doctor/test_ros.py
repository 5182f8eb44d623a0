"""The ROS that the doctor finds around a host, and its finding."""

import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from tests.buses import eventually
from tests.live_bus import Bus, free_port
from tests.ros.bridge.dds_domain import claim_domain
from tests.ros2_on_zenoh import Ros2
from tfbus import Buffer, NodeSettings
from tfbus.bus.session import Session
from tfbus.doctor import examine
from tfbus.doctor.examination import Examination, Participant, RosAround
from tfbus.doctor.examine import RosWatch, RtpsWatch, nodes_of_master, participant_of, read_tokens
from tfbus.doctor.host_checks import check_ros
from tfbus.frames.moment import BusMoment
from tfbus.frames.snapshot import frame_tree
from tfbus.wire.descriptions import NodeDescription

# The beginnings of announcements, of ROS 2 Kilted with Fast DDS and of a program with Cyclone DDS.
FAST_DDS = bytes.fromhex(
    "525450530202010f010f7f0122650b530000000009010800b51f036bc0322fee1505dc010000100000"
    "0100c7000100c2000000000100000000030000150004000202000016000400010f0000008004000302"
    "02000f0004000000000050001000010f7f0122650b5300000000000001c10780040013000000"
    "2c0010000b000000656e636c6176653d2f3b0000"
)
CYCLONE = bytes.fromhex(
    "525450530205011001107f32bb84109bf96b4aea0e010c0000000000000000000000000009010800"
    "471e036b006a5ae5150564010000100000000000000100c200000000010000000003000002000800"
    "0a00000000000000"
)
FAST = Participant(FAST_DDS[8:20], "Fast DDS", is_ros=True)


class TestDds:
    def test_an_announcement_tells_its_participant(self) -> None:
        """Its id, the DDS that it uses, and whether it is of ROS 2."""
        assert participant_of(FAST_DDS) == FAST
        assert participant_of(CYCLONE) == Participant(CYCLONE[8:20], "Cyclone DDS", is_ros=False)

    @pytest.mark.parametrize("end", range(20))
    def test_a_packet_that_is_cut_tells_nothing(self, end: int) -> None:
        """Nor does one that is no announcement, or no RTPS at all."""
        assert participant_of(FAST_DDS[:end]) is None
        assert participant_of(b"RTPX" + FAST_DDS[4:]) is None
        assert participant_of(FAST_DDS[:40]) is None

    @pytest.mark.real
    def test_announcements_are_heard_beside_another_listener(self) -> None:
        """Also where the port is taken, which says that DDS is on this host."""
        domain, claim = claim_domain()
        with claim, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            loopback = socket.inet_aton("127.0.0.1")
            other.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
            watch = RtpsWatch(domain)

            def is_heard() -> bool:
                for packet in (FAST_DDS, b"RTPS", b"", CYCLONE):
                    other.sendto(packet, ("239.255.0.1", 7400 + 250 * domain))
                return len(watch.participants()) == 2

            eventually(is_heard)
            assert not watch.is_port_taken
            second = RtpsWatch(domain)
            assert second.is_port_taken
            assert second.listened_s > 0
            second.close()
            watch.close()
            watch.close()


class TestZenoh:
    def test_tokens_tell_nodes_and_bridges(self) -> None:
        """Nodes by domain; endpoints and what is not understood count as none."""
        lead = "@ros2_lv/0/ab12"
        tokens = [
            f"{lead}/0/0/NN/%/%/talker",
            f"{lead}/1/1/NN/%/%robot1%arm/driver",
            f"{lead}/1/2/MP/%/%robot1/driver/%tf/T/H/::,100:,:,:,,",
            "@ros2_lv/7/cd34/0/0/NN/%/%/listener",
            "@ros2_lv/0",
            "@ros2_lv",
            "@ros2_lv/0/x/NN",
            "@/ab56/@ros2_lv",
            "@/ab56/@ros2_lv/MP/tf/tf2_msgs§msg§TFMessage/:::1,100",
            "@ros2_lv/ab78",
        ]
        nodes, bridges = read_tokens(tokens)
        assert nodes == {0: {"/talker", "/robot1/arm/driver"}, 7: {"/listener"}}
        assert bridges == 2

    @pytest.mark.real
    @pytest.mark.parametrize("namespace", ["", "robot1"])
    def test_nodes_on_the_bus_are_found(self, bus: Bus, namespace: str) -> None:
        """Nodes of rmw_zenoh and zenoh-bridge-ros2dds are, from within any namespace."""
        ros2 = Ros2(bus.endpoint, domain=3)
        ros2.rmw_zenoh()
        ros2.bridge()
        node = bus.node("doctor", namespace=namespace)

        def found(session: Session) -> bool:
            with RosWatch(node.settings) as watch:
                around = watch.around(session)
            is_all = (
                around.nodes.get(3) == frozenset({"/talker", "/robot1/talker"})
                and around.bridges == 1
            )
            return is_all and around.at == bus.endpoint

        eventually(lambda: found(node.session))
        ros2.close()

    @pytest.mark.real
    def test_nothing_is_within_zenoh_once_it_has_ended(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A thread that waits there for a stranger's answer would abort Python's end."""
        with socket.create_server(("127.0.0.1", 0)) as silent:
            monkeypatch.setattr(examine, "ROS_ROUTER", silent.getsockname())
            RosWatch(NodeSettings("doctor")).close()
        assert "ros router" not in {thread.name for thread in threading.enumerate()}


@pytest.mark.real
class TestMaster:
    @pytest.fixture
    def master(self) -> Iterator[str]:
        """A master that knows three nodes."""
        with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as server:
            publishers = [["/tf", ["/talker", "/sim"]], ["/rosout", ["/talker"]]]
            subscribers = [["/tf", ["/rviz"]]]
            server.register_function(
                lambda caller: [1, "current system state", [publishers, subscribers, []]],
                "getSystemState",
            )
            thread = threading.Thread(target=server.serve_forever)
            thread.start()
            yield f"http://127.0.0.1:{server.server_address[1]}"
            server.shutdown()
            thread.join()

    def test_a_master_tells_its_nodes(self, master: str) -> None:
        """Each once, whatever it publishes."""
        # A master that takes longer than a second is as good as none.
        assert eventually(lambda: nodes_of_master(master)) == 3

    @pytest.mark.parametrize(
        "uri", ["", "localhost", "ftp://localhost", "http://[", "http://:99999"]
    )
    def test_what_is_no_master_answers_nothing(self, uri: str) -> None:
        """Whatever ROS_MASTER_URI says, and where nothing runs there."""
        assert nodes_of_master(uri) is None
        assert nodes_of_master(f"http://127.0.0.1:{free_port()}") is None

    @pytest.mark.parametrize("answer", [[], [1, "", 7], [0, "", [[], [], []]], {"a": 1}, "no"])
    def test_another_server_is_no_master(self, answer: Any) -> None:
        """Nor is one that answers something else."""
        with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as server:
            server.register_function(lambda caller: answer, "getSystemState")
            thread = threading.Thread(target=server.handle_request)
            thread.start()
            assert nodes_of_master(f"http://127.0.0.1:{server.server_address[1]}") is None
            thread.join()


BRIDGE = NodeDescription("/ros2", "h", 7, "0.1.0", "s", 0, ("ros2/talker",), (), {}, {}, {}, {})
IMPORTED = "its frames come to tfbus by `tfbus ros2"


@pytest.mark.parametrize(
    ("around", "sentences"),
    [
        (
            RosAround(nodes={0: frozenset({"/a", "/b", "/c"})}),
            [f"ROS 2 is on this network (rmw_zenoh, domain 0, 3 nodes): {IMPORTED} --via zenoh`"],
        ),
        (
            RosAround(nodes={7: frozenset({"/a"})}, at="tcp/10.0.0.5:7447"),
            [
                f"ROS 2 is on this network (rmw_zenoh, domain 7, 1 node): {IMPORTED} --via zenoh "
                "--domain 7 --ros-connect tcp/10.0.0.5:7447`"
            ],
        ),
        (
            RosAround(nodes={0: frozenset({"/a", "/tfbus_ros2"})}),
            [
                "ROS 2 is on this network (rmw_zenoh, domain 0, 1 node): /tfbus_ros2 bridges it to "
                "tfbus"
            ],
        ),
        (RosAround(nodes={0: frozenset({"/tfbus_ros2"})}, listened_s=3.2), None),
        (
            RosAround(bridges=1),
            [
                f"ROS 2 is on this network (zenoh-bridge-ros2dds): {IMPORTED} --via dds` where its "
                "DDS is"
            ],
        ),
        (
            RosAround(participants=(FAST, replace(FAST, id=b"2")), domain=4),
            [
                f"ROS 2 is on this network (Fast DDS, domain 4, 2 participants): {IMPORTED} "
                "--via dds`"
            ],
        ),
        (
            RosAround(participants=(replace(FAST, is_ros=False),)),
            [
                "DDS is on this network (Fast DDS, domain 0, 1 participant): if it is ROS 2, "
                f"{IMPORTED} --via dds`"
            ],
        ),
        (
            RosAround(is_dds_here=True),
            [f"DDS is on this host (domain 0): if it is ROS 2, {IMPORTED} --via dds`"],
        ),
        (
            RosAround(distro="kilted", domain=-1),
            [
                "ROS_DOMAIN_ID is no domain of ROS 2: 0 to 232 are allowed",
                "ROS 2 kilted is sourced here: `tfbus ros2 --via rclpy` can use it",
            ],
        ),
        (
            RosAround(distro="noetic", is_ros1=True, master="http://lab:11311", master_nodes=2),
            [
                "ROS 1 noetic is sourced here: `tfbus ros1` can use it",
                "ROS 1 is at http://lab:11311 (2 nodes): its frames come to tfbus by `tfbus ros1`",
            ],
        ),
        (RosAround(master="http://lab:11311", listened_s=3.2), None),
        (RosAround(), ["none on Zenoh; DDS could not be heard"]),
    ],
)
def test_it_says_what_is_there_and_what_to_run(
    around: RosAround, sentences: list[str] | None
) -> None:
    """It is information, in one sentence for each middleware; or that there is none."""
    finding = check_ros(_examined(around))
    assert finding.verdict == "ok"
    none = ["none on Zenoh, and no DDS in domain 0 in 3 s"]
    assert list(finding.evidence) == (sentences or none)


@pytest.mark.parametrize(
    "around",
    [
        RosAround(nodes={0: frozenset({"/a"})}),
        RosAround(bridges=1),
        RosAround(participants=(FAST,)),
        RosAround(is_dds_here=True),
    ],
)
def test_a_bridge_that_runs_is_named(around: RosAround) -> None:
    """Then there is nothing to run."""
    (sentence,) = check_ros(_examined(around, BRIDGE)).evidence
    assert ": /ros2 bridges it" in sentence


def test_a_bridge_of_another_name_is_named() -> None:
    """It is known by the topic on which bridges tell each other of themselves."""
    bridge = replace(
        BRIDGE, name="/mine", streams=("mine/talker",), publishes={"ros_bridges": "RosBridge"}
    )
    (sentence,) = check_ros(_examined(RosAround(participants=(FAST,)), bridge)).evidence
    assert ": /mine bridges it" in sentence


def _examined(around: RosAround, *nodes: NodeDescription) -> Examination:
    moment = BusMoment(at_ns=0, tree=frame_tree(Buffer(), (), 0), nodes=nodes)
    return Examination(NodeSettings("doctor"), moment, (), {}, 3.0, ros=around)
