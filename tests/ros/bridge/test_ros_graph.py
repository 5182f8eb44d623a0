"""The graph of ROS over Zenoh, by the tokens that come and go."""

import pytest

from tests.builders import S
from tests.fakes import Clock
from tfbus.ros.bridge.legs import RosPublisher, zenoh
from tfbus.ros.bridge.legs.zenoh import RosGraph
from tfbus.ros.rmw_zenoh import Kind, RosToken, gid_of

TYPE = "tf2_msgs::msg::dds_::TFMessage_"
HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
WANTED = [("/tf", TYPE, HASH)]


def token(
    node: str,
    kind: Kind = "MP",
    *,
    domain: int = 0,
    session: str = "a1",
    topic: str = "/tf",
    dds_type: str = TYPE,
    type_hash: str = HASH,
) -> str:
    """The token of an endpoint."""
    qos = "::,100:,:,:,,"
    return RosToken(
        domain, session, "0", "1", kind, node, "/", "/", topic, dds_type, type_hash, qos
    ).text


def graph(*tokens: str, domain: int = 0) -> RosGraph:
    """A graph that has seen these."""
    graph = RosGraph(domain, own="0wn")
    for each in tokens:
        graph.on_token(each, True)
    return graph


def test_publishers_have_the_gids_of_their_tokens() -> None:
    """Subscribers, other topics, other domains and what is our own are left out."""
    camera, arm = token("camera"), token("arm", session="b2")
    seen = graph(
        camera,
        arm,
        token("rviz", "MS"),
        token("lidar", topic="/scan"),
        token("far", domain=7),
        token("tfbus_ros2", session="0wn"),
        "@ros2_lv/0/a1/0/0/NN/%/%/camera",
    )
    assert set(seen.publishers("/tf")) == {
        RosPublisher(gid_of(camera).hex(), "/camera"),
        RosPublisher(gid_of(arm).hex(), "/arm"),
    }
    assert seen.publishers("/nothing") == []
    seen.on_token(camera, False)
    seen.on_token(camera, False)
    assert [each.node for each in seen.publishers("/tf")] == ["/arm"]


def test_a_gid_without_a_token_is_that_of_the_only_publisher_of_its_session(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Once no token of its own is to be expected; until that publisher is gone, also where the
    session has others since.
    """
    camera = token("camera")
    seen = graph(camera, token("arm", session="b2"), token("arm2", session="b2"))
    clock = Clock(100 * S)
    monkeypatch.setattr(zenoh, "scheduler", clock)
    for gid, session in (("11", "a1"), ("22", "b2"), ("33", "")):
        seen.heard("/tf", gid, lambda session=session: session)
    seen.heard("/scan", "44", lambda: "a1")
    assert len(seen.publishers("/tf")) == 3
    clock.now_ns += S
    made_up = RosPublisher("11", "/camera")
    assert len(seen.publishers("/tf")) == 4 and made_up in seen.publishers("/tf")
    assert seen.publishers("/scan") == []
    seen.on_token(token("camera2"), True)
    assert made_up in seen.publishers("/tf")
    seen.on_token(camera, False)
    seen.on_token(token("camera3"), True)
    assert made_up not in seen.publishers("/tf")


def test_a_gid_whose_token_comes_late_is_never_that_of_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It may come after messages of the publisher, those of others of its session before."""
    early, late = token("early"), token("late")
    seen = graph(early)
    gid = gid_of(late).hex()
    seen.heard("/tf", gid, lambda: "a1")
    assert [each.node for each in seen.publishers("/tf")] == ["/early"]
    seen.on_token(late, True)
    monkeypatch.setattr(zenoh, "scheduler", Clock(10**9 * S))
    assert RosPublisher(gid, "/late") in seen.publishers("/tf")
    assert len(seen.publishers("/tf")) == 2


def test_made_up_gids_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest make room."""
    seen = graph(token("camera"))
    for number in range(2000):
        seen.heard("/tf", str(number), lambda: "a1")
    monkeypatch.setattr(zenoh, "scheduler", Clock(10**9 * S))
    assert len(seen.publishers("/tf")) == 1001
    assert RosPublisher("1999", "/camera") in seen.publishers("/tf")


def test_a_token_that_comes_twice_is_one() -> None:
    """As when a router is back."""
    seen = graph(token("camera"), token("camera"))
    assert len(seen.publishers("/tf")) == 1


def test_what_is_no_token_is_counted() -> None:
    """And does nothing else."""
    seen = graph("@ros2_lv/0/nonsense", "@ros2_lv/x/a1/0/1/MP/%/%/n/%tf/T/H/Q")
    assert seen.dropped == 2
    seen.on_token("@ros2_lv/0/nonsense", False)
    assert seen.publishers("/tf") == []


def test_nodes_in_another_domain_alone_are_told() -> None:
    """Where this one has some, the others are not missed."""
    far = token("far", domain=7)
    assert graph(far).other_domains() == [7]
    assert graph(far, token("near")).other_domains() == []
    assert graph().other_domains() == []
    seen = graph(far)
    seen.on_token(far, False)
    assert seen.other_domains() == []


def test_what_does_not_cross_is_said_with_the_remedy() -> None:
    """Another type, another definition of it, or none of Humble's."""
    assert graph(token("camera"), token("rviz", "MS")).mismatches(WANTED) == []
    text = token("talker", dds_type="std_msgs::msg::dds_::String_")
    [line] = graph(text).mismatches(WANTED)
    assert line.startswith("/tf ") and line.endswith("/talker has it as std_msgs/msg/String")
    humble = [token(name, type_hash="TypeHashNotSupported") for name in ("arm", "rviz")]
    [line] = graph(*humble).mismatches(WANTED)
    assert line.startswith("/tf ") and "/arm, /rviz" in line and line.endswith("--distro humble")
    [line] = graph(token("arm")).mismatches([("/tf", TYPE, "TypeHashNotSupported")])
    assert line.startswith("/tf ") and "/arm " in line and line.endswith("give no --distro")
    [line] = graph(token("arm", type_hash="RIHS01_00")).mismatches(WANTED)
    assert line.startswith("/tf ") and "/arm has another definition" in line
    assert "tf2_msgs/msg/TFMessage" in line and line.endswith(" RIHS01_00")
