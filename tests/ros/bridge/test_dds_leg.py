"""The leg over DDS without any ROS beside it: two in this process, on loopback."""

import logging
import math
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests import needs
from tests.buses import DEADLINE_S, eventually, send_until
from tests.ros.bridge.dds_domain import claim_domain
from tfbus.base.errors import SettingsError, TfbusError
from tfbus.ros.bridge.legs import TRANSFORMS_READER_DEPTH, Leg, LegSettings, RosTopic
from tfbus.ros.bridge.legs import open_leg as open_by_name
from tfbus.ros.bridge.legs.dds import configuration, dropped_datagrams, udp_sockets
from tfbus.ros.definitions import STRING, TF_MESSAGE
from tfbus.ros.rmw import NodeEntities, ParticipantNodes, domain_of, encode_nodes

pytestmark = pytest.mark.real

LOG = logging.getLogger("leg")
# "hi", in CDR.
HI = b"\x00\x01\x00\x00\x03\x00\x00\x00hi\x00"
CHATTER = RosTopic("/chatter", STRING)
# The same topic, of another type, and a message of that.
OTHER = RosTopic("/chatter", TF_MESSAGE)
NO_TRANSFORMS = b"\x00\x01\x00\x00" + bytes(4)
KEPT = RosTopic("/kept", STRING, retained=True, depth=1)


OpenLeg = Callable[..., Any]


@pytest.fixture(scope="module")
def domain() -> Iterator[int]:
    domain, claim = claim_domain()
    with claim:
        yield domain


@pytest.fixture
def open_leg(domain: int) -> Iterator[OpenLeg]:
    needs.module("cyclonedds")
    from tfbus.ros.bridge.legs import dds

    legs: list[Leg] = []

    def open_leg(node: str, namespace: str = "") -> Leg:
        settings = LegSettings(node, namespace, domain=domain, connect=("lo",))
        legs.append(dds.open_leg(settings, LOG))
        return legs[-1]

    yield open_leg
    for leg in legs:
        leg.close()


@pytest.fixture
def legs(open_leg: OpenLeg) -> tuple[Leg, Leg]:
    return open_leg("one"), open_leg("two", "robot1")


def test_messages_come_as_their_bytes_with_the_gid_of_the_sender(legs: tuple[Leg, Leg]) -> None:
    """Each message comes as it was sent, to the other leg alone."""
    one, two = legs
    heard: list[tuple[str, bytes, str]] = []
    one.subscribe(CHATTER, lambda data, gid: heard.append(("one", data[: len(HI)], gid)))
    two.subscribe(CHATTER, lambda data, gid: heard.append(("two", data[: len(HI)], gid)))
    sender = one.publisher(CHATTER)
    eventually(lambda: sender.heard)
    # The other side may not know the publisher yet.
    send_until(lambda: sender.send(HI), lambda: bool(heard))
    assert set(heard) == {("two", HI, sender.gid)}


def test_a_message_that_comes_with_its_publisher_has_its_gid(legs: tuple[Any, Any]) -> None:
    """Also where other messages were taken since ROS was last asked who publishes."""
    one, two = legs
    heard: list[str] = []
    goes_on = threading.Event()

    def hear(_: bytes, gid: str) -> None:
        heard.append(gid)
        assert goes_on.wait(DEADLINE_S)

    reader = one.subscribe(CHATTER, hear)._reader
    first = two.publisher(CHATTER)
    send_until(lambda: first.send(HI), lambda: bool(heard))
    second = two.publisher(CHATTER)
    eventually(lambda: second.heard and len(reader.get_matched_publications()) == 2)
    second.send(HI)
    # Then the reader has it.
    assert second.writer.wait_for_acks(int(DEADLINE_S * 1e9))
    goes_on.set()
    eventually(lambda: len(heard) > 1 and heard[-1] != first.gid)
    assert set(heard) == {first.gid, second.gid}


def test_a_topic_may_change_its_type(legs: tuple[Leg, Leg]) -> None:
    """One that has had another is published, and subscribed to, as what it is now."""
    one, two = legs
    for leg in legs:
        leg.subscribe(CHATTER, lambda *_: None).close()
        leg.publisher(CHATTER).close()
    heard: list[bytes] = []
    one.subscribe(OTHER, lambda data, _: heard.append(data))
    sender = two.publisher(OTHER)
    send_until(lambda: sender.send(NO_TRANSFORMS), lambda: bool(heard))
    assert heard[0].startswith(NO_TRANSFORMS)
    assert not one.warnings()


def test_a_publisher_that_is_closed_is_gone_at_once(legs: tuple[Any, Any]) -> None:
    """Also where something of cyclonedds is still referred to."""
    one, two = legs
    sender = two.publisher(CHATTER)
    writer = sender.writer
    eventually(lambda: one.watch.writers("rt/chatter"))
    sender.close()
    sender.close()
    eventually(lambda: not one.watch.writers("rt/chatter"))
    assert writer is not None and not sender.heard
    with pytest.raises(TfbusError, match="/chatter is closed"):
        sender.send(HI)


def test_retained_messages_reach_later_subscribers(legs: tuple[Leg, Leg]) -> None:
    """The last message of a retained topic is there for who comes later."""
    one, two = legs
    one.publisher(KEPT).send(HI)
    heard: list[bytes] = []
    two.subscribe(KEPT, lambda data, _: heard.append(data))
    eventually(lambda: heard)


def test_publishers_have_the_names_of_their_nodes_while_they_are_there(
    legs: tuple[Leg, Leg],
) -> None:
    """Each leg tells the other the full name of its node, and leaves its own publishers out."""
    one, two = legs
    sender = two.publisher(CHATTER)
    eventually(
        lambda: (
            [(each.gid, each.node) for each in one.publishers("/chatter")]
            == [(sender.gid, "/robot1/two")]
        )
    )
    assert two.publishers("/chatter") == []
    sender.close()
    eventually(lambda: not one.publishers("/chatter"))


def test_invented_participants_are_forgotten_first(
    legs: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The names of nodes are limited, and those of participants that publish stay."""
    from tfbus.ros.bridge.legs import dds_watch

    monkeypatch.setattr(dds_watch, "_MOST_PARTICIPANTS", 3)
    one, two = legs
    two.publisher(CHATTER)
    eventually(lambda: [each.node for each in one.publishers("/chatter")] == ["/robot1/two"])
    names = one.watch._names
    for number in range(1, 7):
        gid = bytes([number] * 16)
        info = ParticipantNodes(gid, [NodeEntities("/invented", [], [gid])])
        two.graph.write(two.graph.data_type(encode_nodes(info)))
        eventually(lambda gid=gid: gid.hex() in names)
    assert len(names) == 3
    assert [each.node for each in one.publishers("/chatter")] == ["/robot1/two"]


def test_an_only_node_that_tells_no_writers_has_them_all(legs: tuple[Any, Any]) -> None:
    """As roswell tells its node; otherwise each writer is of the node that tells it."""
    one, two = legs
    two.publisher(CHATTER)
    gid = two.gid.bytes
    for nodes, name in (
        ([NodeEntities("/rover")], "/rover"),
        ([NodeEntities("/a", [], [bytes(16)])], ""),
        ([NodeEntities("/rover")], "/rover"),
        ([NodeEntities("/rover"), NodeEntities("/other")], ""),
    ):
        info = encode_nodes(ParticipantNodes(gid, nodes))
        two.graph.write(two.graph.data_type(info))
        eventually(
            lambda name=name: (
                [one.watch.node_of(each) for each in one.watch.writers("rt/chatter")] == [name]
            )
        )


def test_a_publisher_of_another_type_is_named(legs: tuple[Leg, Leg]) -> None:
    """The warnings say who publishes the topic with another type."""
    one, two = legs
    one.subscribe(CHATTER, lambda *_: None)
    two.publisher(OTHER)
    eventually(lambda: any("/robot1/two" in said for said in one.warnings()))


def test_bytes_that_are_no_message_of_the_type_are_refused(legs: tuple[Leg, Leg]) -> None:
    """What no subscriber could read is not sent."""
    with pytest.raises(TfbusError, match="/chatter"):
        legs[0].publisher(CHATTER).send(HI[:4] + b"\xff\xff\xff\xff")


def test_a_leg_alone_says_so(open_leg: OpenLeg, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without any other node, once one would be found, the warnings say what to look at."""
    monkeypatch.setattr("tfbus.ros.bridge.legs.dds._DISCOVERY_S", math.inf)
    leg = open_leg("alone")
    assert not leg.warnings()
    monkeypatch.setattr("tfbus.ros.bridge.legs.dds._DISCOVERY_S", 0.0)
    [said] = leg.warnings()
    assert said.startswith("No ROS 2 node") and " domain " in said
    leg.close()
    leg.close()


def test_a_distribution_that_is_unknown_is_an_error(domain: int) -> None:
    """Before anything is opened; one that is known says how long a gid is."""
    needs.module("cyclonedds")
    with pytest.raises(SettingsError, match=r"'humbel'.*'humble'"):
        open_by_name("dds", LegSettings(distro="humbel"), LOG)
    open_by_name("dds", LegSettings(distro="humble", domain=domain, connect=("lo",)), LOG).close()


def test_the_domain_is_that_of_ros() -> None:
    """The domain is that of the settings, else that of ROS_DOMAIN_ID, else 0."""
    assert domain_of(5, {"ROS_DOMAIN_ID": "7"}) == 5
    assert domain_of(None, {"ROS_DOMAIN_ID": "7"}) == 7
    assert domain_of(None, {}) == 0
    with pytest.raises(TfbusError, match=r"ROS_DOMAIN_ID.*'x'"):
        domain_of(None, {"ROS_DOMAIN_ID": "x"})


def test_what_to_connect_to_is_an_interface_or_a_host() -> None:
    """A name of an interface of this host is one; all else are hosts to ask."""
    assert '<NetworkInterface name="lo"/>' in configuration(("lo",), LOG, {})
    assert '<Peer Address="10.0.0.2"/>' in configuration(("10.0.0.2",), LOG, {})


@pytest.mark.parametrize(
    "peer",
    [
        "no.such.host.invalid",
        "tcp/10.0.0.2:7447",
        "10.0.0.2:99999",
        "10.0.0.2:",
        "::1",
        "",
        "a" * 70,
    ],
)
def test_a_host_that_is_not_found_is_an_error(peer: str) -> None:
    """That says what is allowed: Cyclone DDS would abort the process."""
    with pytest.raises(SettingsError, match=r"interface .*lo"):
        configuration((peer,), LOG, {})


@pytest.mark.parametrize("peer", ["127.0.0.1", "127.0.0.1:7412", "localhost", "localhost:7412"])
def test_a_host_may_have_a_port(peer: str) -> None:
    """As Cyclone DDS has it."""
    assert f'<Peer Address="{peer}"/>' in configuration((peer,), LOG, {})


@pytest.mark.parametrize("peer", ["::1", "[::1]", "[::1]:7412"])
def test_hosts_have_the_addresses_of_the_transport(peer: str) -> None:
    """Of IPv6 where the configuration of Cyclone DDS says so."""
    environ = {"CYCLONEDDS_URI": "<General><Transport>udp6</Transport></General>"}
    assert f'<Peer Address="{peer}"/>' in configuration((peer,), LOG, environ)
    with pytest.raises(SettingsError, match="no host"):
        configuration(("127.0.0.1",), LOG, environ)


def test_a_static_peer_that_is_not_found_is_left_out(caplog: pytest.LogCaptureFixture) -> None:
    """With a warning; the others are asked."""
    environ = {"ROS_STATIC_PEERS": "no.such.host.invalid;10.0.0.2"}
    config = configuration((), LOG, environ)
    assert "invalid" not in config and '<Peer Address="10.0.0.2"/>' in config
    [record] = caplog.records
    assert record.levelname == "WARNING" and "'no.such.host.invalid'" in record.message


@pytest.mark.parametrize(
    ("environ", "expected"),
    [
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, 'address="127.0.0.1"'),
        ({"ROS_LOCALHOST_ONLY": "1"}, 'address="127.0.0.1"'),
        ({"ROS_STATIC_PEERS": "10.0.0.2; localhost"}, '<Peer Address="localhost"/>'),
        ({"CYCLONEDDS_URI": "file:///etc/cyclone.xml"}, ",file:///etc/cyclone.xml"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_it_looks_where_ros_does(environ: dict[str, str], expected: str) -> None:
    """Without anything to connect to, the variables of ROS and Cyclone say where ROS is."""
    assert expected in configuration((), LOG, environ)


def test_a_message_that_fails_costs_no_other(legs: tuple[Leg, Leg]) -> None:
    """Messages that wait behind it, and are taken with it, come all the same."""
    reader, writer = legs
    goes_on, came = threading.Event(), [0]

    def on_message(payload: bytes, gid: str) -> None:
        came[0] += 1
        assert goes_on.wait(DEADLINE_S)
        assert came[0] != 2, "no message"

    reader.subscribe(CHATTER, on_message)
    sender = writer.publisher(CHATTER)
    eventually(lambda: sender.heard)
    send_until(lambda: sender.send(HI), lambda: came[0] == 1)
    for _ in range(5):
        sender.send(HI)
    goes_on.set()
    eventually(lambda: came[0] >= 6)


@pytest.mark.parametrize(("sent", "is_lost"), [(3000, False), (9000, True)])
def test_a_reader_that_is_held_up(open_leg: OpenLeg, *, sent: int, is_lost: bool) -> None:
    """Some thousand transforms wait meanwhile; that more came than wait is noticed."""
    topic = RosTopic("/burst", STRING, depth=TRANSFORMS_READER_DEPTH)
    many = RosTopic("/burst", STRING, depth=2 * TRANSFORMS_READER_DEPTH)
    reader, writer = open_leg("reader"), open_leg("writer")
    goes_on, came = threading.Event(), [0]

    def on_message(payload: bytes, gid: str) -> None:
        came[0] += 1
        assert goes_on.wait(DEADLINE_S)

    reader.subscribe(topic, on_message)
    sender = writer.publisher(many)
    eventually(lambda: sender.heard)
    sender.send(HI)
    eventually(lambda: came[0] == 1)
    for _ in range(sent):
        sender.send(HI)
    # All are confirmed by then: the writer keeps them until that.
    goes_on.set()
    if is_lost:
        eventually(lambda: reader.lost().get("/burst"))
    else:
        eventually(lambda: came[0] == sent + 1)
        assert reader.lost() == {}


def test_what_the_system_drops_is_said(open_leg: OpenLeg, monkeypatch: pytest.MonkeyPatch) -> None:
    """DDS does not tell what was lost; the system tells that the process was too slow."""
    leg, _ = open_leg("reader"), open_leg("writer")
    assert leg.sockets and dropped_datagrams(leg.sockets) == 0
    others = udp_sockets()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as full:
        full.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        full.bind(("127.0.0.1", 0))
        for _ in range(100):
            full.sendto(bytes(1000), full.getsockname())
        monkeypatch.setattr(leg, "sockets", udp_sockets() - others)
        eventually(lambda: any("too slow for what came by DDS" in each for each in leg.warnings()))


def test_a_publisher_without_a_node_is_there(
    open_leg: OpenLeg, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program that speaks DDS and names no node of ROS is no reason to say that there is none."""
    monkeypatch.setattr("tfbus.ros.bridge.legs.dds._DISCOVERY_S", 0.0)
    reader = open_leg("reader")
    writer = open_leg("writer")
    monkeypatch.setattr(type(reader.watch), "sees_ros", False)
    reader.subscribe(CHATTER, lambda *_: None)
    assert reader.warnings()
    writer.publisher(CHATTER)
    eventually(lambda: not reader.warnings())
