"""A closed bus: the keys that an identity, or none, can read and write, by any program."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import msgpack
import pytest
import zenoh

from tests.buses import DEADLINE_S, eventually, keep_sending
from tests.live_bus import free_port
from tfbus import (
    Buffer,
    Node,
    RightsError,
    StaticTransformBroadcaster,
    Transform,
    TransformListener,
    TransformStamped,
)
from tfbus.bus.callbacks import direct
from tfbus.bus.presence import ask_nodes
from tfbus.bus.remote_parameters import set_parameter
from tfbus.bus.retained import ask_retained, declare_retained_subscriber
from tfbus.messages import Pose

pytest.importorskip("cryptography", reason="needs cryptography: pip install cryptography")

from tests.closed_bus import ClosedBus
from tfbus.bus.rights import Identity

pytestmark = pytest.mark.real

# What only the arm may send, or no identity.
OF_OTHERS = [
    "robot7/tf/arm",
    "robot7/tf/arm/hand",
    "robot7/tf_static/arm",
    "robot7/@tfbus/stream/arm",
    "robot7/@tfbus/node/arm",
    "robot7/tf_static/arm/@adv/pub/1",
    "robot7/clock",
    "robot8/tf/leg",
    "robot8/scan",
    "tf/leg",
    "clock",
]


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[ClosedBus]:
    bus = ClosedBus(
        tmp_path,
        Identity("arm", "publisher", "robot7", frames=("arm/*",)),
        Identity("leg", "publisher", "robot7"),
        Identity("laptop", "reader"),
        Identity("witness", "admin"),
        Identity("ben", "operator"),
        Identity("gone", "publisher", "robot7"),
        Identity("beside", "reader", "robot8"),
        Identity("leg8", "publisher", "robot8"),
    )
    bus.keystore.revoke("gone")
    bus.open()
    yield bus
    bus.close()


class Witness:
    """Notes each message that comes to an honest process, by its key, before its link goes on."""

    def __init__(self, bus: ClosedBus) -> None:
        self.node = bus.node("witness")
        self.keys: list[str] = []
        for expression in ("**", "**/@tfbus/**", "**/@adv/**", "**/@tfbus/**/@adv/**"):
            self.node.session.zenoh.declare_subscriber(expression, direct(self._note))

    def _note(self, sample: zenoh.Sample) -> None:
        if sample.payload.to_bytes() == b"forged":
            self.keys.append(str(sample.key_expr))

    def alive(self) -> set[str]:
        return {
            key
            for expression in ("**", "**/@tfbus/**")
            for key in self.node.session.living(expression)
        }


def meets(session: zenoh.Session, witness: Witness) -> None:
    """Wait until a session has a link to the witness."""
    eventually(lambda: witness.node.session.id in map(str, session.info.peers_zid()))


def sent_all(session: zenoh.Session) -> None:
    """Wait until what a session has sent was taken or refused: it has an answer to a question that
    every identity may ask, and messages stay in their order.
    """

    def has_answer() -> bool:
        return any(reply.ok for reply in session.get("@tfbus/node/witness", timeout=5.0))

    eventually(has_answer)


def test_a_reader_reads_and_cannot_write(bus: ClosedBus) -> None:
    """A reader's program that obeys no rights is still refused by all others."""
    witness, honest = Witness(bus), bus.node("arm")
    keep_sending(honest, "base", "arm/hand")
    laptop = bus.raw(bus.path("laptop"))
    heard: list[str] = []
    laptop.declare_subscriber("robot7/tf/**", lambda sample: heard.append(str(sample.key_expr)))
    meets(laptop, witness)
    for key in (*OF_OTHERS, "robot7/tf/leg", "robot7/cmd_vel", "robot7/tf/laptop"):
        laptop.put(key, b"forged")
        laptop.liveliness().declare_token(key)
    laptop.declare_queryable("robot7/spawn", lambda query: query.reply("robot7/spawn", b"forged"))
    sent_all(laptop)
    assert witness.keys == []
    assert not {key for key in witness.alive() if "laptop" in key or "leg" in key}
    assert not [r for r in witness.node.session.zenoh.get("robot7/spawn", timeout=0.3) if r.ok]
    assert eventually(lambda: heard)[0] == "robot7/tf/arm"


def test_a_publisher_sends_its_own_and_nothing_of_others(bus: ClosedBus) -> None:
    """A publisher cannot send another's stream, speak in another namespace, or set the clock."""
    witness = Witness(bus)
    leg = bus.raw(bus.path("leg"))
    # Once it knows of the witness's subscription: before, it sends nothing.
    eventually(lambda: leg.put("robot7/scan", b"forged") or witness.keys)
    for key in OF_OTHERS:
        leg.put(key, b"forged")
        leg.liveliness().declare_token(key)
    for key in ("robot7/tf/leg", "robot7/tf_static/leg", "robot7/end"):
        leg.put(key, b"forged")
    eventually(lambda: "robot7/end" in witness.keys)
    own = ["robot7/tf/leg", "robot7/tf_static/leg", "robot7/end"]
    assert [key for key in witness.keys if key != "robot7/scan"] == own
    assert not witness.alive() & set(OF_OTHERS)


def test_only_who_may_set_parameters_sets_them(bus: ClosedBus) -> None:
    """A publisher reads the parameters of others, and cannot set them."""
    honest = bus.node("arm")
    speed = honest.declare_parameter("speed", 1.0)
    witness = Witness(bus)
    leg = bus.raw(bus.path("leg"))
    meets(leg, witness)
    eventually(lambda: honest.session.id in map(str, leg.info.peers_zid()))
    new = msgpack.packb({"value": 9.0})

    def answers(key: str, payload: bytes | None) -> list[zenoh.Reply]:
        return [*leg.get(key, payload=payload, timeout=1.0)]

    eventually(lambda: [r for r in answers("robot7/@tfbus/param/arm/speed", None) if r.ok])
    assert not [r for r in answers("robot7/@tfbus/param/arm/speed", new) if r.ok]
    assert not answers("robot7/@tfbus/set/arm/speed", new)
    assert speed.value == 1.0


Open = Callable[[ClosedBus, Path], zenoh.Session]


def of_another_authority(bus: ClosedBus, folder: Path) -> zenoh.Session:
    other = ClosedBus(folder, Identity("arm", "publisher", "robot7"), name="others")
    (other.path("arm") / "authority.pem").write_bytes(
        (bus.path("arm") / "authority.pem").read_bytes()
    )
    return bus.raw(other.path("arm"))


def expired(bus: ClosedBus, folder: Path) -> zenoh.Session:
    bus.keystore.renew("leg", days=-0.001)
    return bus.raw(bus.path("leg"))


def revoked(bus: ClosedBus, folder: Path) -> zenoh.Session:
    return bus.raw(bus.path("gone"))


def without_certificate(bus: ClosedBus, folder: Path) -> zenoh.Session:
    tls = {
        "root_ca_certificate": str(bus.path("arm") / "authority.pem"),
        "verify_name_on_connect": False,
    }
    return bus.open_raw(**{"transport/link/tls": tls, "listen/endpoints": []})


def over_tcp(bus: ClosedBus, folder: Path) -> zenoh.Session:
    endpoint = bus.endpoint.replace("tls/", "tcp/")
    return bus.open_raw(**{"connect/endpoints": [endpoint], "listen/endpoints": []})


@pytest.mark.parametrize(
    "opens", [of_another_authority, expired, revoked, without_certificate, over_tcp]
)
def test_who_is_no_member_neither_reads_nor_writes(
    bus: ClosedBus, tmp_path: Path, opens: Open
) -> None:
    """No certificate, one of another authority, an expired or a revoked one: nothing goes in or
    out, and the others are undisturbed.
    """
    witness, honest = Witness(bus), bus.node("arm")
    keep_sending(honest, "base", "arm/hand")
    stranger = opens(bus, tmp_path)
    heard: list[str] = []

    def note(sample: zenoh.Sample) -> None:
        if sample.payload.to_bytes() != b"forged":  # which it hears from itself
            heard.append(str(sample.key_expr))

    for expression in ("**", "**/@tfbus/**"):
        stranger.declare_subscriber(expression, note)
    buffer = Buffer()
    with TransformListener(buffer, bus.node("witness", "listener", namespace="robot7")):
        buffer.lookup_transform("base", "arm/hand", timeout_s=DEADLINE_S)
        for _ in range(5):
            stranger.put("robot7/tf/gone", b"forged")
            stranger.put("robot7/tf/leg", b"forged")
            latest_ns = buffer.lookup_transform("base", "arm/hand").stamp_ns
            buffer.lookup_transform("base", "arm/hand", latest_ns + 10**8, timeout_s=DEADLINE_S)
        assert not [*stranger.get("robot7/@tfbus/node/*", timeout=0.3)]
    assert heard == []
    assert witness.keys == []


def test_frames_that_a_stream_may_not_have_are_refused(bus: ClosedBus) -> None:
    """A publisher whose program obeys no rights cannot publish frames beyond them."""
    honest = bus.node("arm")
    with pytest.raises(RightsError, match=r"frame 'base_link'.*arm/\*"):
        send_static(honest, "base_link")
    # An attacker's own program: the check of its own rights is left out.
    object.__setattr__(honest.session.settings.closed, "identity", Identity("arm", "admin"))
    buffer = Buffer()
    with TransformListener(buffer, bus.node("witness", namespace="robot7")) as listener:
        send_static(honest, "base_link")
        send_static(honest, "arm/hand")
        eventually(lambda: buffer.frames() and "arm/hand" in buffer.frames())
        assert "base_link" not in buffer.frames()
        (stream,) = eventually(lambda: [s for s in listener.streams() if s.frames])
        assert stream.frames == (("world", "arm/hand", True),)
        assert stream.forbidden >= 1


def send_static(node: Node, child: str) -> None:
    transform = TransformStamped(0, "world", child, Transform.identity())
    StaticTransformBroadcaster(node).send_transform(transform)


# Key expressions that reach the keys of others.
OF_MANY = ["robot7/*/arm", "robot7/*", "robot7/**", "robot7/$*f/arm", "robot7/$*k"]


def test_a_message_to_many_keys_is_refused(bus: ClosedBus) -> None:
    """Who may publish any topic does not reach the streams of others, or the clock, by `*`."""
    node = bus.node("witness", namespace="robot7")
    heard: list[str] = []
    for key in ("clock", "tf/**", "scan"):
        node.session.subscriber(key, lambda key, _: heard.append(key))
    declare_retained_subscriber(node.session, "tf_static/**", lambda key, _: heard.append(key))
    leg = bus.raw(bus.path("leg"))
    eventually(lambda: node.session.id in map(str, leg.info.peers_zid()))
    for key in OF_MANY:
        leg.put(key, b"forged")
    eventually(lambda: leg.put("robot7/scan", b"end") or heard)
    assert set(heard) == {"scan"}


def test_answers_at_other_keys_are_refused(bus: ClosedBus) -> None:
    """Who may serve any service does not answer for another's stream, by `*` or by a stray key."""
    node = bus.node("witness", namespace="robot7")
    leg = bus.raw(bus.path("leg"))
    asked: list[str] = []

    def forge(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        own = "robot7/tf_static/leg"
        for key in (*OF_MANY, "robot7/arm", "robot7/tf_static/arm", own):
            with suppress(zenoh.ZError):  # a key that is not within the query
                query.reply(key, b"own" if key == own else b"forged")
        query.drop()

    leg.declare_queryable("robot7/tf_static/leg/@adv/pub/1", forge)
    leg.declare_queryable("robot7/*/arm", forge)
    eventually(lambda: node.session.id in map(str, leg.info.peers_zid()))

    def answers() -> set[tuple[str, bytes]]:
        retained = ask_retained(node.session, "tf_static/**", timeout_s=5.0)
        return {(answer.key, answer.payload) for answer in retained}

    assert eventually(answers) == {("tf_static/leg", b"own")}
    eventually(lambda: [*node.session.ask("tf/arm", timeout_s=0.5)] or "robot7/tf/arm" in asked)
    assert [*node.session.ask("tf/arm", timeout_s=0.5)] == []


def test_a_namespace_is_closed_to_those_of_another(bus: ClosedBus) -> None:
    """An identity of a namespace reads nothing of another, and gets none of its tokens."""
    honest = bus.node("arm")
    keep_sending(honest, "base", "arm/hand")
    send_static(honest, "arm/tool")
    honest.declare_parameter("speed", 1.0)
    beside = bus.raw(bus.path("beside"))
    read: set[str] = set()
    tokens: set[str] = set()
    everything = ("**", "**/@tfbus/**", "**/@adv/**", "**/@tfbus/**/@adv/**", "robot7/tf/arm")
    for expression in (*everything, "robot8/**", "robot8/**/@tfbus/**"):
        beside.declare_subscriber(expression, lambda sample: read.add(str(sample.key_expr)))
        beside.liveliness().declare_subscriber(
            expression, lambda sample: tokens.add(str(sample.key_expr)), history=True
        )
    eventually(lambda: honest.session.id in map(str, beside.info.peers_zid()))
    other = bus.node("leg8", namespace="robot8")
    keep_sending(other, "base", "leg")
    eventually(lambda: "robot8/tf/leg8" in read and "robot8/@tfbus/node/leg8" in tokens)
    for key in ("**", "robot7/@tfbus/node/*", "robot7/@tfbus/param/**", "robot7/tf/**", "@/**"):
        replies = beside.get(key, timeout=0.5)
        assert not [r for r in replies if r.ok and "robot7" in str(r.ok.key_expr)]
    assert {key.split("/")[0] for key in read | tokens} == {"robot8"}


def test_a_reader_that_says_that_it_is_a_router_gets_nothing(bus: ClosedBus) -> None:
    """A client sends all to its router: to one of another namespace it sends nothing."""
    port = free_port()
    fake = bus.raw(
        bus.path("beside"),
        mode="router",
        **{"listen/endpoints": [f"tls/127.0.0.1:{port}"], "connect/endpoints": []},
    )
    got: set[str] = set()
    for expression in ("**", "**/@tfbus/**"):
        fake.declare_subscriber(expression, lambda sample: got.add(str(sample.key_expr)))
        fake.declare_queryable(
            expression, lambda query: query.payload and got.add(str(query.key_expr))
        )
        fake.liveliness().declare_subscriber(
            expression, lambda sample: got.add(str(sample.key_expr)), history=True
        )
    client = bus.node("arm", mode="client", connect=(f"tls/127.0.0.1:{port}",), listen=())
    send_static(client, "arm/tool")
    for _ in range(5):
        client.session.zenoh.put("scan", b"secret")
        assert [*client.session.ask("grip", b"secret", timeout_s=0.2)] == []
    # One that may pass follows on the same link.
    client.session.living("**/@tfbus/node/*")
    assert got == set()


def test_a_robot_s_own_router_carries_what_others_ask(tmp_path: Path) -> None:
    """A robot's router has the robot's identity: a base behind another router finds the robot's
    nodes by one question to all, and sets their parameters.
    """
    bus = ClosedBus(
        tmp_path,
        Identity("hub", "router"),
        Identity("arm", "publisher", "robot7"),
        Identity("ben", "operator"),
    )
    hub, own = (f"tls/127.0.0.1:{free_port()}" for _ in range(2))
    bus.node("hub", mode="router", connect=(), listen=(hub,))
    bus.node("arm", "arm_router", mode="router", connect=(hub,), listen=(own,))
    through = {"mode": "client", "listen": ()}
    arm = bus.node("arm", namespace="robot7", connect=(own,), **through)
    speed = arm.declare_parameter("speed", 1.0)
    ben = bus.node("ben", connect=(hub,), **through)
    try:
        eventually(lambda: "/robot7/arm" in {each.name for each in ask_nodes(ben.session).nodes})
        set_parameter(ben.session, "/robot7/arm", "speed", 9.0, print)
        assert speed.value == 9.0
    finally:
        bus.close()


def test_the_router_of_a_site_serves_it_before_its_hub_is_there(tmp_path: Path) -> None:
    """It joins the hub, by their certificates as ever, once that is there."""
    bus = ClosedBus(tmp_path, Identity("hub", "router"), Identity("ben", "operator"))
    hub, own = (f"tls/127.0.0.1:{free_port()}" for _ in range(2))
    try:
        site = bus.session("hub", "site", opens_alone=True, mode="client", connect=hub, listen=own)
        assert site.routers() == []
        through = {"mode": "client", "listen": (), "connect": own}
        names = {"ben_1", "ben_2"}
        for name in names:
            bus.node("ben", name, **through)
        eventually(lambda: names == {each.name[1:] for each in ask_nodes(site).nodes})
        bus.node("hub", mode="router", connect=(), listen=hub)
        eventually(site.routers)
        assert {*site.identities().values()} == {"ben", "hub"}
    finally:
        bus.close()


def test_a_topic_of_an_operator_is_retained(bus: ClosedBus) -> None:
    """Who may publish a topic, and serve nothing, may answer with its last message."""
    publisher = bus.node("ben").create_publisher(Pose, "goal", retained=True)
    publisher.publish(Pose(0, 3.0, 4.0, 0.0, 0.0, 0.0))
    heard: list[Pose] = []
    bus.node("laptop").create_subscription(Pose, "goal", heard.append, retained=True)
    assert eventually(lambda: heard)[0].x == 3.0


def test_recorded_bytes_sent_again_open_no_link(bus: ClosedBus) -> None:
    """What was caught on the network between two members does nothing when it is sent again."""
    witness = Witness(bus)
    links = eventually(lambda: sorted(witness.node.session.identities()))
    with Tap(int(bus.endpoint.rpartition(":")[2])) as tap:
        leg = bus.raw(
            bus.path("leg"),
            **{"connect/endpoints": [f"tls/127.0.0.1:{tap.port}"], "listen/endpoints": []},
        )
        eventually(lambda: [*leg.info.peers_zid()])
        eventually(lambda: leg.put("robot7/scan", b"forged") or witness.keys)
        leg.close()
        # Then all that it sent has come.
        eventually(lambda: sorted(witness.node.session.identities()) == links)
        witness.keys.clear()
        with socket.create_connection(("127.0.0.1", tap.to)) as again:
            again.settimeout(DEADLINE_S)
            again.sendall(bytes(tap.caught))
            with suppress(ConnectionError):
                while again.recv(65536):
                    pass  # its hello, and why it ends
    assert tap.caught
    assert witness.keys == []
    assert sorted(witness.node.session.identities()) == links


class Tap:
    """Passes the bytes of connections on to a port of this host, and keeps those of callers."""

    def __init__(self, to: int) -> None:
        self.to = to
        self.caught = bytearray()
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._ends: list[socket.socket] = [self._server]
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> "Tap":
        return self

    def __exit__(self, *_: object) -> None:
        for end in self._ends:
            end.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                caller, _ = self._server.accept()
                called = socket.create_connection(("127.0.0.1", self.to))
                self._ends += [caller, called]
                for pair in ((caller, called, self.caught), (called, caller, bytearray())):
                    threading.Thread(target=self._pass, args=pair, daemon=True).start()

    @staticmethod
    def _pass(source: socket.socket, target: socket.socket, caught: bytearray) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                caught += data
                target.sendall(data)
        with suppress(OSError):
            target.shutdown(socket.SHUT_WR)
