"""Presence: nodes start, are listed and described, and end."""

import logging
from collections.abc import Callable

import pytest

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import BusError, Node, NodeSettings
from tfbus.bus.presence import (
    Described,
    NodeWatch,
    ask_nodes,
    describe_nodes,
    key_beside,
    list_nodes,
)
from tfbus.bus.query import Query
from tfbus.bus.remote_parameters import parameter_of, parameters_of, set_parameter
from tfbus.bus.session import Session
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import ALL_NODES_EVERYWHERE, node_key, relative_name
from tfbus.wire.limits import Limits


def look(bus: Bus, namespace: str = "") -> Session:
    """A session that is no node; the bus of the test ends it."""
    return bus.node("looker", namespace=namespace).session


def test_nodes_are_listed_by_their_full_names(bus: Bus) -> None:
    """All nodes are listed, those of namespaces below too, sorted."""
    for name, namespace in (("sim", ""), ("broadcaster1", ""), ("sim", "robot7"), ("a", "l/r")):
        bus.node(name, namespace=namespace)
    wanted = ["/broadcaster1", "/l/r/a", "/looker", "/robot7/sim", "/sim"]
    session = look(bus)
    eventually(lambda: list_nodes(session) == wanted)


def test_a_link_may_be_open_before_it_says_who_is_there(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A list that is asked for in that time waits for the first node, at most a second."""
    session = look(bus)
    bus.node("sim")
    eventually(lambda: "/sim" in list_nodes(session) and session.linked())
    late = [[], session.living(ALL_NODES_EVERYWHERE)]
    monkeypatch.setattr(session, "living", lambda _: late.pop(0))
    assert list_nodes(session) == ["/looker", "/sim"]
    monkeypatch.setattr(session, "living", lambda _: [])
    assert list_nodes(session) == []


def test_from_within_a_namespace_only_its_nodes_are_seen(bus: Bus) -> None:
    """A session in a namespace sees the nodes of that namespace and below, by their full names."""
    bus.node("sim")
    bus.node("sim", namespace="robot7")
    session = look(bus, "robot7")
    eventually(lambda: list_nodes(session) == ["/robot7/looker", "/robot7/sim"])


def test_a_closed_node_is_not_listed(bus: Bus) -> None:
    """A node that closes goes from the list."""
    session = look(bus)
    node = bus.node("sim")
    eventually(lambda: "/sim" in list_nodes(session))
    node.close()
    eventually(lambda: "/sim" not in list_nodes(session))


def test_a_killed_node_is_not_listed(bus: Bus) -> None:
    """A process that dies takes its node with it."""
    session = look(bus)
    process = bus.start_main(lambda: Node("doomed").spin())
    eventually(lambda: "/doomed" in list_nodes(session))
    process.kill()
    eventually(lambda: "/doomed" not in list_nodes(session))


def test_a_node_is_described_by_any_way_of_writing_its_name(bus: Bus) -> None:
    """`sim`, `/sim`, and a path from within its namespace all find the node."""
    bus.node("sim", namespace="robot7")
    outside, inside = look(bus), look(bus, "robot7")
    eventually(lambda: "/robot7/sim" in list_nodes(outside))
    eventually(lambda: "/robot7/sim" in list_nodes(inside))
    for session, name in (
        (outside, "robot7/sim"),
        (outside, "/robot7/sim"),
        (inside, "sim"),
        (inside, "/robot7/sim"),
    ):
        assert [node.name for node in describe_nodes(session, name)] == ["/robot7/sim"]


def test_nodes_that_share_a_name_are_all_described(bus: Bus) -> None:
    """Where two nodes share a name, both answer."""
    first, second = bus.node("sim"), bus.node("sim")
    session = look(bus)
    wanted = sorted([first.started_ns, second.started_ns])
    eventually(lambda: "/sim" in list_nodes(session))
    eventually(lambda: sorted(node.started_ns for node in describe_nodes(session, "sim")) == wanted)


def test_an_unknown_node_is_refused_with_the_nearest_name(bus: Bus) -> None:
    """A name that no node has is refused with the nearest name, or with all there are."""
    bus.node("simulator")
    session = look(bus)
    eventually(lambda: len(list_nodes(session)) == 2)
    with pytest.raises(BusError, match=r"'/simulater'; .*'/simulator'\?$"):
        describe_nodes(session, "/simulater")
    with pytest.raises(BusError, match=r"'xyz'; available: /looker, /simulator$"):
        describe_nodes(session, "xyz")


def test_a_node_that_does_not_answer_is_not_taken_for_absent(bus: Bus) -> None:
    """The error says that it is there, and proposes no other name."""
    held: list[Query] = []
    bus.node("stranger").session.queryable(node_key("busy"), held.append)
    session = look(bus)
    eventually(lambda: "/stranger" in list_nodes(session))
    with pytest.raises(BusError, match="'busy' did not answer"):
        describe_nodes(session, "busy")


@pytest.mark.parametrize(
    "asked",
    [
        lambda session: [node.name for node in describe_nodes(session, "sim")] == ["/sim"],
        lambda session: [each.name for each in parameters_of(session, "sim")] == ["radius"],
        lambda session: parameter_of(session, "/sim", "radius", print).value == 1.0,
        lambda session: set_parameter(session, "sim", "radius", 2.0, print).value == 2.0,
    ],
)
def test_a_node_that_has_not_said_what_it_serves_is_asked_again(
    bus: Bus, monkeypatch: pytest.MonkeyPatch, asked: Callable[[Session], bool]
) -> None:
    """It is there, but a link may be open before its far end has said all: it is not called
    unknown.
    """
    bus.node("sim").declare_parameter("radius", 1.0)
    session = look(bus)
    eventually(lambda: "/sim" in list_nodes(session))
    unheard = [iter(()), iter(())]
    ask = session.ask
    monkeypatch.setattr(
        session, "ask", lambda *args, **named: unheard.pop() if unheard else ask(*args, **named)
    )
    assert asked(session) and not unheard


def test_an_empty_bus_is_reported(bus: Bus) -> None:
    """Where there is no node at all, the message asks what may be wrong."""
    session = Session(NodeSettings("x"), logging.getLogger("test"))
    with session, pytest.raises(BusError, match=r"'sim', nor any other.*\?$"):
        describe_nodes(session, "sim")


def test_a_watch_knows_which_nodes_are_alive(bus: Bus) -> None:
    """A watch knows nodes that start before it, that start later, and that end."""
    first = bus.node("first")
    session = look(bus)
    watch = NodeWatch(session)
    assert watch.wait("/first", timeout_s=10)
    assert not watch.wait("/second", timeout_s=0.01)
    bus.node("second", namespace="robot7")
    assert watch.wait("/robot7/second", timeout_s=10)
    first.close()
    eventually(lambda: not watch.wait("/first", timeout_s=0))
    watch.close()


@pytest.mark.parametrize(
    ("name", "namespace", "relative"),
    [
        ("sim", "", "sim"),
        ("/sim", "", "sim"),
        ("/robot7/sim", "", "robot7/sim"),
        ("sim", "robot7", "sim"),
        ("/robot7/sim", "robot7", "sim"),
        ("/lab/robot7/sim", "lab", "robot7/sim"),
    ],
)
def test_names_as_they_are_written_within_a_namespace(
    name: str, namespace: str, relative: str
) -> None:
    """A name with a leading slash is a full name; one without is relative to the namespace."""
    assert relative_name(name, namespace) == relative


def test_a_node_outside_of_the_namespace_keeps_its_full_name() -> None:
    """The slash says that the name is no part of the namespace."""
    assert relative_name("/robot8/sim", "robot7") == "/robot8/sim"
    assert key_beside("/robot8/sim", node_key, "robot7") == "/robot8/@tfbus/node/sim"
    assert key_beside("/sim", node_key, "robot7") == "/@tfbus/node/sim"
    assert key_beside("/robot7/sim", node_key, "robot7") == "@tfbus/node/sim"
    assert key_beside("arm/sim", node_key, "robot7") == "arm/@tfbus/node/sim"


def test_a_node_of_another_namespace_is_described(bus: Bus) -> None:
    """A full name reaches a node from any namespace."""
    bus.node("sim", namespace="robot8")
    session = bus.node("asker", namespace="robot7").session
    described = eventually(lambda: attempt(session))
    assert [node.name for node in described] == ["/robot8/sim"]


def attempt(session: Session) -> list[NodeDescription]:
    """The descriptions of the other robot's node, [] while it is not found."""
    try:
        return describe_nodes(session, "/robot8/sim")
    except BusError:
        return []


def test_an_unreadable_answer_is_an_answer(bus: Bus) -> None:
    """The node it comes from is not said to be silent as well, whatever others are called."""

    def answer(query: Query) -> None:
        with query.answering("description"):
            query.answer(node_key("odd"), b"odd")

    session, other = look(bus), bus.node("sim").session
    declared = other.queryable(node_key("odd"), answer)
    tokens = [other.token(node_key(name)) for name in ("odd", "od")]

    def ask() -> Described:
        return ask_nodes(session, alive=session.living(ALL_NODES_EVERYWHERE))

    eventually(lambda: ask().silent_nodes == ("/od",) and bool(ask().unreadable))
    assert "'/odd'" in str(ask().unreadable[0])
    for each in (declared, *tokens):
        each.close()


def test_a_node_that_cannot_describe_itself_says_why(bus: Bus) -> None:
    """As where its description is larger than its limit."""
    bus.node("sim", limits=Limits(description=100))
    session = look(bus)
    eventually(lambda: "/sim" in list_nodes(session))
    with pytest.raises(BusError, match="limit of description is 100 B"):
        describe_nodes(session, "sim")
