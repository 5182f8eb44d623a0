"""Faults of Zenoh's, among them declarations that a link loses for good."""

import logging
from collections.abc import Callable
from typing import Any

import pytest

import tfbus
from tests.builders import x_of
from tests.simulation.stages import SimulatedStage
from tfbus.base import scheduler
from tfbus.bus.session import Session
from tfbus.streams.stream import Stream
from tfbus.testing import Network
from tfbus.testing.fabric import Fabric


@pytest.fixture
def stage(network: Network) -> SimulatedStage:
    return SimulatedStage(network)


def test_a_lost_declaration_is_never_served(network: Network, stage: SimulatedStage) -> None:
    """A queryable whose declaration is lost is not asked."""
    network.faults.lost_declarations = 1.0
    a, b = stage.open("a", "h1"), stage.open("b", "h2")
    a.queryable("q", "q", "yes")
    b.expect("links", gives=[a.id()])
    network.run(5.0)
    assert b.ask("q") == []


def test_a_half_link_hides_one_end_until_it_is_ended(
    network: Network, stage: SimulatedStage
) -> None:
    """After a one-way failure one end knows nothing of the other, for about a lease."""
    network.faults.half_links = 1.0
    a, b = stage.open("a", "h1"), stage.open("b", "h2")
    a.token("t/a")
    b.token("t/b")
    a.expect("living", "t/*", gives=["t/a", "t/b"])
    b.expect("living", "t/*", gives=["t/a", "t/b"])
    network.cut("h2", "h1", both_ways=False)
    a.expect("links", gives=[])
    network.heal()
    network.faults.half_links = 0.0
    a.expect("links", gives=[b.id()])
    assert a.living("t/*") == ["t/a"]
    assert b.living("t/*") == ["t/a", "t/b"]
    a.expect("living", "t/*", gives=["t/a", "t/b"])


def test_one_end_of_a_deaf_link_knows_nothing_until_it_is_ended(
    network: Network, stage: SimulatedStage
) -> None:
    """The other end knows its token; some leases later it is linked anew, and knows it too."""
    network.faults.deaf_links = 1.0
    a, b = stage.open("a", "h1"), stage.open("b", "h2")
    a.token("t/a")
    b.token("t/b")
    network.run(1.0)
    known = [a.living("t/*"), b.living("t/*")]
    assert sorted(map(len, known)) == [1, 2]
    network.faults.deaf_links = 0.0
    a.expect("living", "t/*", gives=["t/a", "t/b"])
    b.expect("living", "t/*", gives=["t/a", "t/b"])


def _node(name: str, mode: str) -> tfbus.Node:
    connect = ("tcp/h1:7447",) if mode == "client" else ()
    return tfbus.Node(settings=tfbus.NodeSettings(name, mode=mode, connect=connect))


@pytest.mark.parametrize("mode", ["peer", "client"])
@pytest.mark.parametrize("seed", range(4))
def test_no_static_is_lost_by_a_deaf_link(seed: int, mode: str) -> None:
    """Whichever end reads nothing, a listener has the statics of before and of meanwhile once the
    link was ended, and those of later.
    """
    with Network(seed) as network:
        network.host("h2")
        if mode == "client":
            with network.process(network.host("h1"), "router"):
                router = tfbus.NodeSettings("router", mode="router", listen="tcp/[::]:7447")
                Session(router, logging.getLogger("router"))
        with network.process("h2", "listener"):
            buffer = tfbus.Buffer()
            tfbus.TransformListener(buffer, _node("listener", mode))
        network.faults.deaf_links = 1.0
        with network.process(network.host("h3"), "sim"):
            node = _node("sim", mode)
            static = tfbus.StaticTransformBroadcaster(node)

            def send(child: str) -> None:
                here = tfbus.Transform((1.0, 0.0, 0.0))
                static.send_transform(tfbus.TransformStamped(node.now_ns(), "world", child, here))

            send("before")
            network.run(2.0)
            send("meanwhile")
            assert not {"before", "meanwhile"} <= set(buffer.frames())
            network.faults.deaf_links = 0.0
            network.run(until=lambda: {"before", "meanwhile"} <= set(buffer.frames()))
            send("later")
            network.run(until=lambda: "later" in buffer.frames())


def test_a_late_token_comes_after_messages(network: Network, stage: SimulatedStage) -> None:
    """A message may come before the token of its publisher."""
    network.faults.late_tokens = 1.0
    a, b = stage.open("a", "h1"), stage.open("b", "h2")
    b.expect("links", gives=[a.id()])
    b.subscriber("in", "k")
    b.watch("seen", "t")
    a.publisher("k")
    a.expect("heard", "k", gives=True)
    a.token("t")
    a.put("k", "x")
    b.expects("in", "k=x")
    assert b.events("seen") == []
    a.end("token t")
    b.expects("seen", "+t", "-t")


def test_a_repeated_token_is_told_twice(network: Network, stage: SimulatedStage) -> None:
    """The news of a token come twice."""
    network.faults.repeated_tokens = 1.0
    a, b = stage.open("a", "h1"), stage.open("b", "h2")
    b.watch("seen", "t")
    a.token("t")
    b.expects("seen", "+t", "+t")
    a.end("token t")
    b.expects("seen", "+t", "+t", "-t", "-t")


def test_a_short_query_ends_without_its_answer(network: Network, stage: SimulatedStage) -> None:
    """The end of a query overtakes the answers of another session."""
    network.faults.short_queries = 1.0
    a, b = stage.open("a", "h1"), stage.open("b", "h2")
    a.queryable("q", "q", "1", "2")
    b.expect("served", "q", gives=True)
    assert b.ask("q") == []


def test_an_endless_query_ends_by_its_timeout(network: Network, stage: SimulatedStage) -> None:
    """The answers come, and the end only with the time of the query."""
    network.faults.endless_queries = 1.0
    a, b = stage.open("a", "h1"), stage.open("b", "h2")
    a.queryable("q", "q", "1")
    b.expect("served", "q", gives=True)
    begun_ns = network.now_ns
    assert "q=1" in b.ask("q", 5.0)
    assert network.now_ns - begun_ns >= 5e9


def _frames_known(
    network: Network,
    monkeypatch: pytest.MonkeyPatch,
    lost: int,
    *,
    delay_s: float = 0.0,
    after_s: float = 10.0,
) -> list[str]:
    """The frames that a listener knows some time after the declaration of this number was lost, by
    a path with this delay.
    """
    network.host("h1"), network.host("h2")
    declared = 0

    def loses_declaration(_: Fabric) -> bool:
        nonlocal declared
        declared += 1
        return declared == lost

    with network.process("h2", "listener"):
        listening = tfbus.Node("listener")
    with network.process("h1", "sim"):
        node = tfbus.Node("sim")
        network.run(1.0)
        monkeypatch.setattr(Fabric, "loses_declaration", loses_declaration)
        here = tfbus.Transform((1.0, 0.0, 0.0))
        tfbus.StaticTransformBroadcaster(node).send_transform(
            tfbus.TransformStamped(node.now_ns(), "world", "fixed", here)
        )
        dynamic = tfbus.TransformBroadcaster(node)
        dynamic.send_transform(tfbus.TransformStamped(node.now_ns(), "world", "robot", here))
    network.run(5.0)
    network.path("h1", "h2", delay_s=delay_s)
    with network.process("h2", "listener"):
        listener = tfbus.TransformListener(tfbus.Buffer(), listening, history_s=0.0)
        network.run(after_s)
        (info,) = listener.streams()
    return sorted(child for _, child, _ in info.frames) + sorted(listener.buffer.frames())


@pytest.mark.parametrize("lost", range(1, 7))
def test_a_late_listener_learns_a_stream_whichever_declaration_is_lost(
    network: Network, monkeypatch: pytest.MonkeyPatch, lost: int
) -> None:
    """It knows what the stream lists, and has its static transforms."""
    assert _frames_known(network, monkeypatch, lost) == ["fixed", "robot", "fixed", "world"]


@pytest.mark.parametrize("lost", range(7))
def test_a_late_listener_learns_a_stream_whose_answers_take_three_seconds(
    network: Network, monkeypatch: pytest.MonkeyPatch, lost: int
) -> None:
    """It waits for them, whichever declaration is lost."""
    known = _frames_known(network, monkeypatch, lost, delay_s=1.5, after_s=25.0)
    assert known == ["fixed", "robot", "fixed", "world"]


def test_a_publisher_of_an_earlier_version_answers_with_its_statics(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its answer to a query for the description is ignored, and is no reason to reject anything."""

    def answer(stream: Stream, query: object) -> None:
        query.answer(stream._static_key, stream._static_payload)  # type: ignore[attr-defined]
        query.close()  # type: ignore[attr-defined]

    monkeypatch.setattr(Stream, "_on_static_query", answer)
    assert _frames_known(network, monkeypatch, 0) == ["fixed", "robot", "fixed", "world"]


def test_no_half_link_follows_from_the_end_of_one(network: Network, stage: SimulatedStage) -> None:
    """Its connection is ended for both, so that they link anew, and see each other's tokens."""
    network.faults.half_links = 1.0
    a, b = stage.open("a", "h1"), stage.open("b", "h2")
    a.token("t/a")
    b.token("t/b")
    a.expect("living", "t/*", gives=["t/a", "t/b"])
    network.cut("h2", "h1", both_ways=False)
    a.expect("links", gives=[])
    network.heal()
    network.run(10.0)
    assert a.living("t/*") == b.living("t/*") == ["t/a", "t/b"]


def test_the_end_of_a_process_on_a_thread_that_waits_is_not_that_of_the_next(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The token of the next one comes first: its stream is alive, though it hardly ever sends."""
    watch_living = Session.watch_living

    def watch_late(session: Session, key: str, callback: Callable[[str, bool], None]) -> Any:
        def on_token(key: str, alive: bool) -> None:
            if not alive:
                scheduler.sleep(2.0)
            callback(key, alive)

        return watch_living(session, key, on_token)

    monkeypatch.setattr(Session, "watch_living", watch_late)

    def publish(x: float) -> None:
        node = tfbus.Node("sim")
        mount = tfbus.TransformStamped(node.now_ns(), "world", "mount", tfbus.Transform((x, 0, 0)))
        tfbus.StaticTransformBroadcaster(node).send_transform(mount)
        node.spin()

    with network.process(network.host("h3"), "listener"):
        buffer = tfbus.Buffer()
        listener = tfbus.TransformListener(buffer, tfbus.Node("listener"))

    network.start(network.host("h1"), "sim", publish, 1.0)
    network.run(until=lambda: x_of(buffer, "world", "mount") == 1.0)
    network.run(30.0)
    network.kill("h1/sim")
    network.start(network.host("h2"), "sim", publish, 2.0)
    network.run(until=lambda: x_of(buffer, "world", "mount") == 2.0)
    network.run(5.0)
    assert listener.streams()[0].alive
    assert not buffer.frame("mount").gone
    network.kill("h2/sim")
    network.run(until=lambda: buffer.frame("mount").gone)
