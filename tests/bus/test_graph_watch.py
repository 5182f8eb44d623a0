"""The watch of the graph: nodes come, change, fall silent, and go."""

import logging
from collections.abc import Callable, Iterator
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import Node
from tfbus.base import scheduler
from tfbus.bus.graph_watch import GraphWatch
from tfbus.bus.query import Answer, Query
from tfbus.bus.session import Session
from tfbus.messages import Pose, Twist
from tfbus.testing.network import Network
from tfbus.wire.codec import encode_message
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import node_key

LOG = logging.getLogger("test")


class Seen:
    """A watch of all nodes, and what it told of each: its topics, or that it is gone."""

    def __init__(self, session: Session) -> None:
        self.told: list[tuple[str, list[str] | None]] = []
        self.answers = 0
        self._ask = session.ask_later
        session.ask_later = self._count_answers  # type: ignore[method-assign]
        self.watch = GraphWatch(session, LOG, everywhere=True, on_change=self._on_change)

    def _on_change(self, name: str, node: NodeDescription | None) -> None:
        self.told.append((name, None if node is None else sorted(node.publishes)))

    def _count_answers(
        self, key: str, payload: None, on_answer: Callable[[Any], None], *given: Any, **more: Any
    ) -> None:
        def on_counted(answer: Any) -> None:
            self.answers += 1
            on_answer(answer)

        self._ask(key, payload, on_counted, *given, **more)

    @property
    def names(self) -> list[str]:
        """The names of the nodes that are there, sorted."""
        return sorted(each.name for each in self.watch.nodes())


@pytest.fixture
def seen(bus: Bus) -> Iterator[Seen]:
    """The nodes that a node of the test sees."""
    found = Seen(bus.node("looker").session)
    yield found
    found.watch.close()


def test_each_change_of_a_node_is_told_once(bus: Bus, seen: Seen) -> None:
    """It comes, has topics, loses one, and is gone; a node of a namespace below does too."""
    for namespace in ("", "robot7"):
        name = f"/{namespace}/sim".replace("//", "/")
        node = bus.node("sim", namespace=namespace)
        eventually(lambda name=name: seen.told == [(name, [])])
        pose = node.create_publisher(Pose, "pose")
        eventually(lambda name=name: seen.told[1:] == [(name, ["pose"])])
        scheduler.sleep(30.0)
        node.create_publisher(Twist, "twist")
        eventually(lambda name=name: seen.told[2:] == [(name, ["pose", "twist"])])
        pose.close()
        eventually(lambda name=name: seen.told[3:] == [(name, ["twist"])])
        node.close()
        eventually(lambda name=name: seen.told[4:] == [(name, None)])
        assert seen.names == []
        seen.told.clear()


def test_a_topic_is_seen_a_second_later_and_the_end_of_a_node_at_once(bus: Bus, seen: Seen) -> None:
    """However long the node has been there; the times are virtual."""
    node = bus.node("sim")
    scheduler.sleep(65.4)
    node.create_publisher(Pose, "pose")
    scheduler.sleep(1.2)
    assert seen.told[-1] == ("/sim", ["pose"])
    node.close()
    scheduler.sleep(0.1)
    assert seen.told[-1] == ("/sim", None)


def test_nodes_that_do_not_change_answer_seldom(bus: Bus, seen: Seen) -> None:
    """All answer every 10 s; in between only a node that has changed, by more than counts."""
    for number in range(10):
        bus.node(f"node{number}")
    eventually(lambda: len(seen.names) == 10)
    scheduler.sleep(20.0)
    seen.answers = 0
    scheduler.sleep(100.0)
    assert seen.answers <= 11 * 11


def test_a_node_is_gone_with_its_process(network: Network, bus: Bus, seen: Seen) -> None:
    """A process that is killed takes its node with it, and one that is started anew brings it."""
    process = bus.start_main(lambda: Node("doomed").spin())
    eventually(lambda: seen.names == ["/doomed"])
    process.kill()
    eventually(lambda: seen.told == [("/doomed", []), ("/doomed", None)])


def test_a_node_beyond_a_partition_is_gone_and_comes_back(network: Network, bus: Bus) -> None:
    """Though its description is the one that it had, which it changed long ago."""

    def run() -> None:
        with Node("sim") as node:
            node.create_publisher(Pose, "pose")
            node.spin()

    network.host("robot")
    network.start("robot", "sim", run)
    seen = Seen(bus.node("looker").session)
    network.run(until=lambda: seen.told[-1:] == [("/sim", ["pose"])])
    network.run(60.0)
    network.partition("robot")
    network.run(until=lambda: seen.told[-1:] == [("/sim", None)])
    network.run(60.0)
    assert seen.names == []
    network.heal()
    network.run(until=lambda: seen.told[-1:] == [("/sim", ["pose"])])
    seen.watch.close()


def test_a_node_that_does_not_answer_is_silent_and_holds_up_no_other(bus: Bus, seen: Seen) -> None:
    """Its queries end late; until it answers, no description is there. Others are gone at once."""
    held: list[Query] = []
    other = bus.node("other")
    queryable = other.session.queryable(node_key("busy"), held.append)
    token = other.session.token(node_key("busy"))
    eventually(lambda: seen.watch.silent() == ["/busy"])
    bus.node("sim")
    eventually(lambda: seen.names == ["/other", "/sim"])
    assert seen.watch.silent() == ["/busy"]
    for _ in range(10):
        sim = bus.node("late")
        eventually(lambda: seen.names == ["/late", "/other", "/sim"])
        scheduler.sleep(0.37)
        sim.close()
        scheduler.sleep(0.1)
        assert seen.names == ["/other", "/sim"]
    queryable.close()
    token.close()
    eventually(lambda: not seen.watch.silent())


def test_of_nodes_that_share_a_name_the_last_counts_while_it_is_there(bus: Bus, seen: Seen) -> None:
    """No token says which of them ended."""
    first, second = bus.node("sim"), bus.node("sim")
    first.create_publisher(Pose, "of_first")
    second.create_publisher(Pose, "of_second")
    eventually(lambda: seen.names == ["/sim", "/sim"])
    eventually(lambda: seen.told[-1] == ("/sim", ["of_second"]))
    second.close()
    eventually(lambda: seen.told[-1] == ("/sim", ["of_first"]))
    assert seen.names == ["/sim"]
    assert ("/sim", None) not in seen.told


def test_all_nodes_are_shown_again_and_again(bus: Bus) -> None:
    """Also while none changes, and without the watch's own."""
    shown: list[list[str]] = []
    watch = GraphWatch(
        bus.node("looker", namespace="robot7").session,
        LOG,
        on_nodes=lambda nodes: shown.append([each.name for each in nodes]),
    )
    eventually(lambda: shown[-3:] == [[], [], []])
    bus.node("sim", namespace="robot7")
    bus.node("sim", namespace="robot7/arm")
    eventually(lambda: shown[-3:] == [["/robot7/sim"]] * 3)
    watch.close()


def test_a_node_that_cannot_be_read_is_passed_over(
    bus: Bus, seen: Seen, caplog: pytest.LogCaptureFixture
) -> None:
    """That is logged once, however often it is asked."""

    def answer(query: Query) -> None:
        with query.answering("description"):
            query.answer(node_key("odd"), b"odd")

    other = bus.node("sim").session
    declared = [other.queryable(node_key("odd"), answer), other.token(node_key("odd"))]
    eventually(lambda: seen.names == ["/sim"] and bool(caplog.messages))
    scheduler.sleep(20.0)
    assert sum("odd" in line for line in caplog.messages) == 1
    for each in declared:
        each.close()


class NoNodes:
    """A session without answers, and whose tokens come as the test says."""

    id = "own"
    settings = SimpleNamespace(namespace="")

    def __init__(self) -> None:
        self.asked = 0
        self.on_token: Callable[[str, bool], None]

    def has_asked_since(self, before: int) -> bool:
        """Whether a further question was asked."""
        return self.asked > before

    def watch_living(self, key: str, callback: Callable[[str, bool], None]) -> Any:
        """Keep what tokens are given to."""
        self.on_token = callback
        return SimpleNamespace(close=lambda: None)

    def ask_later(self, key: str, payload: None, on_answer: Any, on_end: Any, **_: Any) -> None:
        """No node answers."""
        self.asked += 1
        on_end()

    def living_later(self, key: str, on_end: Callable[[list[str]], None]) -> None:
        """No token is there."""
        on_end([])


@pytest.mark.usefixtures("network")
def test_tokens_that_come_and_go_make_one_question_wait() -> None:
    """However often, the questions do not pile up, and the last state counts."""
    session = NoNodes()
    watch = GraphWatch(cast(Session, session), LOG)
    for number in range(300):
        asked = session.asked
        session.on_token("@tfbus/node/sim", True)
        if number < 5:
            eventually(partial(session.has_asked_since, asked))
        scheduler.sleep(1e-3)
        session.on_token("@tfbus/node/sim", False)
        scheduler.sleep(1e-3)
    session.on_token("@tfbus/node/sim", True)
    asked = session.asked
    scheduler.sleep(3.0)
    assert asked < session.asked <= asked + 16
    session.on_token("@tfbus/node/sim", False)
    scheduler.sleep(1.0)
    asked = session.asked
    scheduler.sleep(30.0)
    assert session.asked == asked
    watch.close()


class OneName(NoNodes):
    """A session in which the processes of one node come and go; their answers may be held back."""

    def __init__(self) -> None:
        super().__init__()
        self.present: list[str] = []
        self.is_holding = False
        self._held: list[Callable[[], None]] = []

    def ask_later(self, key: str, payload: None, on_answer: Any, on_end: Any, **_: Any) -> None:
        """Answer for all that are there now, at once or on `release`."""
        nodes = [
            NodeDescription("/sim", "host", 1, "1", session, number, (), (), {}, {}, {}, {})
            for number, session in enumerate(self.present)
        ]

        def answer() -> None:
            for node in nodes:
                on_answer(Answer(NODE, encode_message(node)))
            on_end()

        self.asked += 1
        self._held.append(answer)
        if not self.is_holding:
            self.release()

    def release(self) -> None:
        """Let the answers come that were held back."""
        self.is_holding = False
        while self._held:
            self._held.pop(0)()

    def living_later(self, key: str, on_end: Callable[[list[str]], None]) -> None:
        """The token is there as long as a process is."""
        on_end([key] if self.present else [])


NODE = "@tfbus/node/sim"


@pytest.fixture
def one_name(network: Network) -> Iterator[tuple[OneName, Callable[[], list[str]]]]:
    """A session with the process `first` of a node; the processes that a watch lists."""
    session = OneName()
    watch = GraphWatch(cast(Session, session), LOG)
    session.present = ["first"]
    session.on_token(NODE, True)

    def listed() -> list[str]:
        return [each.session for each in watch.nodes()]

    eventually(lambda: listed() == ["first"])
    # Past the questions to all nodes with which a watch begins.
    scheduler.sleep(12.0)
    yield session, listed
    watch.close()


def test_a_node_that_restarts_twice_is_listed_once(
    one_name: tuple[OneName, Callable[[], list[str]]],
) -> None:
    """Also if the watch hears of the end and the next begin at the same time."""
    session, listed = one_name
    for process in ("second", "third"):
        session.present = [process]
        session.on_token(NODE, False)
        session.on_token(NODE, True)
        scheduler.sleep(0.9)
        assert listed() == [process]


def test_a_late_answer_of_a_process_that_has_ended_lists_it_no_more(
    one_name: tuple[OneName, Callable[[], list[str]]],
) -> None:
    """It was sent before the node began again."""
    session, listed = one_name
    session.is_holding = True
    before = session.asked
    eventually(lambda: session.has_asked_since(before))
    for alive in (False, True):
        session.on_token(NODE, alive)
        scheduler.sleep(0.001)
    session.present = ["second"]
    session.release()
    scheduler.sleep(0.9)
    assert listed() == ["second"]


def test_the_end_of_a_process_may_be_told_after_the_begin_of_the_next(
    one_name: tuple[OneName, Callable[[], list[str]]],
) -> None:
    """They come on two threads; the node is there as long as its token is."""
    session, listed = one_name
    session.present = ["second"]
    session.on_token(NODE, True)
    session.on_token(NODE, False)
    scheduler.sleep(0.9)
    assert listed() == ["second"]
    session.present = []
    session.on_token(NODE, False)
    scheduler.sleep(0.9)
    assert listed() == []
