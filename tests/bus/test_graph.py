"""The graph: topics and services with their ends, from descriptions of nodes and streams."""

import re

import pytest

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import StaticTransformBroadcaster, Transform, TransformBroadcaster, TransformStamped
from tfbus.bus.graph import Endpoint, ServiceInfo, TopicInfo, graph_of, where_to_look
from tfbus.bus.presence import ask_streams
from tfbus.cli.bus import look
from tfbus.wire.descriptions import NodeDescription, StreamDescription


def node(name: str, **interfaces: dict[str, str]) -> NodeDescription:
    """The description of a node of this full name, with these endpoints."""
    ends = {kind: interfaces.get(kind, {}) for kind in ("publishes", "subscribes", "serves")}
    return NodeDescription(name, "host", 7, "0.1.0", "session", 0, (), (), **ends, calls={})


def end(name: str, type_: str) -> Endpoint:
    """One end at a node of `node`."""
    return Endpoint(name, type_, "host", 7)


def test_a_topic_has_all_its_ends() -> None:
    """What several nodes say and hear on one name is one topic, its ends sorted by node."""
    nodes = [
        node("/teleop", publishes={"cmd_vel": "Twist"}),
        node("/sim", subscribes={"cmd_vel": "Twist"}),
        node("/draw", publishes={"cmd_vel": "Twist"}),
    ]
    assert graph_of(nodes, {}).topics == {
        "cmd_vel": TopicInfo(
            "cmd_vel",
            (end("/draw", "Twist"), end("/teleop", "Twist")),
            (end("/sim", "Twist"),),
        )
    }


def test_names_are_those_within_the_namespace_of_who_looks() -> None:
    """A node's names stand below its namespace, which is left out by who looks from within it."""
    robot = node("/robot7/sim", publishes={"turtle1/pose": "Pose"}, serves={"spawn": "Spawn"})
    outside, inside = graph_of([robot], {}), graph_of([robot], {}, "robot7")
    assert list(outside.topics) == ["robot7/turtle1/pose"]
    assert list(inside.topics) == ["turtle1/pose"]
    assert inside.services == {"spawn": ServiceInfo("spawn", (end("/robot7/sim", "Spawn"),))}


def test_types_that_differ_are_all_told() -> None:
    """Where two nodes tell different types of one topic, it has both; one that tells none has
    none.
    """
    nodes = [
        node("/a", publishes={"x": "Pose", "y": ""}),
        node("/b", subscribes={"x": "Color"}),
    ]
    topics = graph_of(nodes, {}).topics
    assert (topics["x"].types, topics["y"].types) == (("Color", "Pose"), ())


def test_streams_are_topics_of_what_they_carry() -> None:
    """A stream is a topic of dynamic frames, of static ones, or both; subscribers are unknown."""
    stream = StreamDescription(
        1, "/robot7/sim", 0, (("w", "a", False), ("w", "b", True)), host="h", pid=3
    )
    ends = (Endpoint("/robot7/sim", "TransformMessage", "h", 3),)
    assert graph_of([], {"robot7/@tfbus/stream/a%2Fb": stream}).topics == {
        name: TopicInfo(name, ends, None) for name in ("robot7/tf/a%2Fb", "robot7/tf_static/a%2Fb")
    }


def test_streams_are_asked_for_at_once(bus: Bus) -> None:
    """The descriptions of living streams can be queried, by their keys."""
    sim, camera = bus.node("sim", namespace="robot7"), bus.node("camera")
    pose = TransformStamped(1, "world", "turtle1", Transform.identity())
    TransformBroadcaster(sim).send_transform(pose)
    StaticTransformBroadcaster(camera).send_transform(pose)
    session = bus.node("looker").session
    eventually(lambda: len(ask_streams(session).streams) == 2)
    streams = ask_streams(session).streams
    assert {key: (it.node, it.frames) for key, it in streams.items()} == {
        "@tfbus/stream/camera": ("/camera", (("world", "turtle1", True),)),
        "robot7/@tfbus/stream/sim": ("/robot7/sim", (("world", "turtle1", False),)),
    }


def test_streams_that_do_not_answer_are_named(bus: Bus, capsys: pytest.CaptureFixture[str]) -> None:
    """A process that hangs is told from one that is not there, and commands say so."""
    with bus.network.process("outside", "sim") as process:
        pose = TransformStamped(1, "world", "turtle1", Transform.identity())
        TransformBroadcaster(bus.node("sim")).send_transform(pose)
    session = bus.node("looker").session
    eventually(lambda: ask_streams(session).streams)
    bus.network.stop(process)
    found = ask_streams(session)
    assert (found.streams, found.silent_streams) == ({}, ("@tfbus/stream/sim",))
    look(session)
    assert "'/sim'" in capsys.readouterr().err
    bus.network.go_on(process)


def test_namespaces_that_have_a_frame_are_named() -> None:
    """At most three, and only those that have it."""
    frames = {("robot7", "base"), ("robot8", "base"), ("robot9", "arm")}
    hint = where_to_look(frames, "base")
    assert hint.startswith("'base' is known")
    assert re.findall(r"--\w+|robot\d", hint) == ["--namespace", "robot7", "robot8", "--fleet"]
    assert where_to_look(frames, "wheel") == ""


def test_what_is_in_no_namespace_is_seen_without_one() -> None:
    """The hint has no empty name in it."""
    hint = where_to_look({("", "map"), ("robot7", "map")}, "map")
    assert hint.startswith("'map' is known outside") and hint.endswith("without --namespace")
