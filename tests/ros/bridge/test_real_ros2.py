"""The legs to ROS 2 against nodes of the real one, on hosts of their own."""

import signal
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest

from tests import needs
from tests.buses import eventually
from tests.ros.bridge.ros2_network import DISTROS, LEGS, Heard, Ros2Network
from tfbus.ros.definitions import TF_MESSAGE
from tfbus.ros.rmw import type_hash

REASON = needs.why_no_hosts()
pytestmark = [
    pytest.mark.real,  # nodes of ROS 2
    pytest.mark.skipif(bool(REASON), reason=REASON or "-"),
]

TF, TF_STATIC = "/tf", "/tf_static"
NODE = "/tfbus_ros2"
# More messages than ever wait anywhere.
ENOUGH = 20
# A leg that disturbs others does so about every other time.
TRIES = 4


class Scene(NamedTuple):
    """`early` was there before the legs, the other nodes come once `leg` has sent its static frame:
    `late`, and two that tests end, as `first`, a leg too.
    """

    network: Ros2Network
    early: Heard
    leg: Heard
    late: Heard
    brief: Heard
    lossy: Heard
    first: Heard


@pytest.fixture(scope="module", params=[f"{leg}-{distro}" for leg in LEGS for distro in DISTROS])
def scene(request: pytest.FixtureRequest) -> Iterator[Scene]:
    network = Ros2Network(*request.param.split("-"))
    try:
        early = network.start_node("early", "--tf", "early_dynamic", "--static", "early_static")
        early.wait_for(TF, "early_dynamic")
        leg = network.start_leg("leg_dynamic", "leg_static")
        early.wait_for(TF_STATIC, "leg_static")
        yield Scene(
            network,
            early,
            leg,
            network.start_node("late"),
            network.start_node("brief", "--tf", "brief_dynamic"),
            network.start_node("lossy", "--tf", "lossy_dynamic", "--best-effort"),
            network.start_leg("first_dynamic", "first_static"),
        )
    finally:
        network.close()


def published_by(leg: Heard, topic: str) -> dict[str, str]:
    """The nodes of the publishers of a topic that the leg sees now, by gid."""
    publishers: Any = leg.last("publishers")
    return dict(publishers[topic]) if publishers else {}


def endpoints(node: Heard, topic: str) -> list[dict[str, Any]]:
    """What a node of ROS sees of the publishers of a topic."""
    return [each for each in node.last("endpoints") or () if each["topic"] == topic]


def test_messages_come_with_the_publisher_and_it_has_the_name_of_its_node(scene: Scene) -> None:
    """Each message has the gid of a publisher, whose node is that of ROS; where ROS tells it."""
    message = scene.leg.wait_for(TF, "early_dynamic")
    eventually(lambda: "/early" in published_by(scene.leg, TF).values())
    if scene.leg.last("tells_publishers"):
        assert published_by(scene.leg, TF)[message["gid"]] == "/early"
    else:
        assert scene.network.distro == "jazzy" and message["gid"] == ""


def test_static_frames_of_before_come(scene: Scene) -> None:
    """A leg that comes later has the static frames of ROS."""
    scene.leg.wait_for(TF_STATIC, "early_static")


def test_ros_has_the_frames(scene: Scene) -> None:
    """Nodes of ROS hear what a leg sends, those of before and those that come later."""
    scene.early.wait_for(TF, "leg_dynamic")
    scene.late.wait_for(TF, "leg_dynamic")
    eventually(lambda: scene.leg.last("heard_by_ros"))


def test_late_nodes_have_the_static_frames(scene: Scene) -> None:
    """A node of ROS that comes later has the static frames, in one message."""
    assert scene.late.wait_for(TF_STATIC, "leg_static")["children"] == ["leg_static"]


def test_ros_sees_a_node_with_its_publishers(scene: Scene) -> None:
    """The tools of ROS have the node by its name, and what it publishes."""
    eventually(lambda: (scene.late.last("published") or {}).get(NODE) == [TF, TF_STATIC])


@pytest.mark.parametrize(("topic", "retained"), [(TF, False), (TF_STATIC, True)])
def test_ros_sees_type_hash_and_qos(scene: Scene, topic: str, retained: bool) -> None:
    """`ros2 topic info --verbose` has type, hash, QoS and node as of a node of ROS."""
    expected = {
        "topic": topic,
        "gid": scene.leg.last("gids")[topic],
        "node": NODE,
        "type": TF_MESSAGE.name,
        "hash": type_hash(TF_MESSAGE),
        "reliable": True,
        "retained": retained,
    }
    if (scene.network.via, scene.network.distro) == ("dds", "kilted"):
        # Fast DDS 3 does not know whose the writers of Cyclone are, those of ROS neither.
        expected["node"] = "_CREATED_BY_BARE_DDS_APP_/_CREATED_BY_BARE_DDS_APP_"
    eventually(lambda: expected in endpoints(scene.late, topic))


def test_own_messages_do_not_come_back(scene: Scene) -> None:
    """Of all that a leg hears nothing is its own."""
    scene.late.wait_for(TF, "leg_dynamic", more_than=ENOUGH)
    scene.leg.wait_for(TF, "early_dynamic", more_than=ENOUGH)
    assert not scene.leg.of(TF, "leg_dynamic")
    assert not scene.leg.of(TF_STATIC, "leg_static")


def test_late_nodes_hear_each_other(scene: Scene) -> None:
    """While a leg is there, late nodes of ROS still have the frames of other nodes."""
    later = [scene.network.start_node(f"later_{number}") for number in range(TRIES)]
    for node in later:
        node.wait_for(TF, "early_dynamic")
        node.wait_for(TF_STATIC, "early_static")
    for node in later:
        node.process.stop(signal.SIGINT)


def test_the_end_of_a_publisher_is_seen(scene: Scene) -> None:
    """A publisher of ROS that has ended is no longer among those of the topic."""
    eventually(lambda: "/brief" in published_by(scene.leg, TF).values())
    scene.brief.process.stop(signal.SIGINT)
    eventually(lambda: "/brief" not in published_by(scene.leg, TF).values())


def test_a_publisher_that_cannot_be_heard_is_named(scene: Scene) -> None:
    """A node whose QoS does not match is in the warnings, by its name, until it is gone."""
    eventually(lambda: any("/lossy" in said for said in scene.leg.last("warnings") or ()))
    scene.lossy.process.stop(signal.SIGINT)
    eventually(lambda: scene.leg.last("warnings") == [])
    assert not scene.leg.of(TF, "lossy_dynamic")


def test_a_leg_ends_and_comes_again(scene: Scene) -> None:
    """A leg that ends tells ROS so; the next has all again, and ROS its frames."""
    scene.late.wait_for(TF_STATIC, "first_static")
    gid = scene.first.last("gids")[TF_STATIC]

    def is_seen() -> bool:
        return gid in [each["gid"] for each in endpoints(scene.late, TF_STATIC)]

    eventually(is_seen)
    assert scene.first.process.stop(signal.SIGINT) == 0
    eventually(lambda: not is_seen())
    second = scene.network.start_leg("second_dynamic", "second_static")
    for topic, child in ((TF, "early_dynamic"), (TF_STATIC, "early_static")):
        second.wait_for(topic, child)
    for topic, child in ((TF, "second_dynamic"), (TF_STATIC, "second_static")):
        scene.late.wait_for(topic, child)
    assert second.process.stop(signal.SIGINT) == 0
