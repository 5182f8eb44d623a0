"""The leg by rmw_zenoh's wire: two of ours, their router, and strangers' messages."""

import json
import logging
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
import zenoh

from tests.buses import DEADLINE_S, eventually, send_until
from tests.ros.bridge.ros_router import RosRouter
from tfbus import BusError, InvalidNameError, SettingsError
from tfbus.ros.bridge.legs import LegSettings, RosPublisher, RosTopic, open_leg
from tfbus.ros.bridge.legs.zenoh import ZenohLeg
from tfbus.ros.definitions import STRING, TF_MESSAGE
from tfbus.ros.rmw_zenoh import Attachment, attachment_bytes, gid_of

pytestmark = pytest.mark.real

TF = RosTopic("/tf", TF_MESSAGE, depth=100)
TF_STATIC = RosTopic("/tf_static", TF_MESSAGE, retained=True, depth=1)
HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
TF_KEY = f"0/tf/tf2_msgs::msg::dds_::TFMessage_/{HASH}"


class Heard(list[tuple[bytes, str]]):
    """The messages that a leg heard, with the gids of their publishers."""

    def add(self, payload: bytes, gid: str) -> None:
        """Take a message."""
        self.append((payload, gid))

    @property
    def payloads(self) -> list[bytes]:
        """What they are, without who sent them."""
        return [payload for payload, _ in self]


class Ros:
    """A router and legs beside it."""

    def __init__(self) -> None:
        self.router = RosRouter()
        self._ending: list[Any] = []

    def leg(self, node: str = "tfbus_ros2", *, peer: bool = False, **given: Any) -> ZenohLeg:
        """A leg; what is given are fields of its settings."""
        endpoint = f"peer:{self.router.endpoint}" if peer else self.router.endpoint
        settings = LegSettings(node, connect=(endpoint,), **{"domain": 0, **given})
        leg = ZenohLeg(settings, logging.getLogger("test"))
        self._ending.append(leg)
        return leg

    def stranger(self) -> zenoh.Session:
        """A session of another program."""
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([self.router.endpoint]))
        config.insert_json5("timestamping/enabled", "true")
        session = zenoh.open(config)
        self._ending.append(session)
        return session

    def close(self) -> None:
        """End all."""
        for each in reversed(self._ending):
            each.close()
        self.router.stop()


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> Iterator[Ros]:
    """A ROS network to be, in an environment that says nothing of one."""
    for name in ("ROS_DOMAIN_ID", "ZENOH_SESSION_CONFIG_URI", "ZENOH_CONFIG_OVERRIDE"):
        monkeypatch.delenv(name, raising=False)
    ros = Ros()
    yield ros
    ros.close()


def test_a_peer_without_a_router_says_so(ros: Ros) -> None:
    """It opens at once, and finds the router when it comes."""
    leg = ros.leg(peer=True)
    eventually(lambda: "No Zenoh router" in "".join(leg.warnings()))
    ros.router.start()
    eventually(lambda: not leg.warnings())


def test_a_router_that_neither_answers_nor_refuses_is_named(
    ros: Ros, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a host that is unplugged, while Zenoh still waits for it; it is joined in the end."""
    is_there = threading.Event()
    opening = zenoh.open

    def open_at_last(config: zenoh.Config) -> zenoh.Session:
        assert is_there.wait(DEADLINE_S)
        return opening(config)

    monkeypatch.setattr("tfbus.bus.ros_session.zenoh.open", open_at_last)
    leg = ros.leg()
    [said] = eventually(leg.warnings)
    assert f"answers at {ros.router.endpoint}, " in said
    assert leg.warnings() == [said]
    is_there.set()
    ros.router.start()
    eventually(lambda: not leg.warnings())


@pytest.mark.parametrize("peer", [False, True])
def test_messages_come_with_the_gid_of_their_publisher(ros: Ros, peer: bool) -> None:
    """In order, and its node is known; as a client of the router and as a peer."""
    ros.router.start()
    sending, hearing = ros.leg("sender", namespace="robot1"), ros.leg("hearer", peer=peer)
    heard = Heard()
    hearing.subscribe(TF, heard.add)
    sender = sending.publisher(TF)
    eventually(lambda: sender.heard)
    send_until(lambda: sender.send(b"first"), lambda: bool(heard))
    heard.clear()
    for number in range(20):
        sender.send(b"%d" % number)
    eventually(lambda: b"19" in heard.payloads)
    assert [each for each in heard.payloads if each != b"first"] == [
        b"%d" % number for number in range(20)
    ]
    assert {gid for _, gid in heard} == {sender.gid}
    eventually(lambda: hearing.publishers("/tf"))
    assert hearing.publishers("/tf") == [RosPublisher(sender.gid, "/robot1/sender")]
    eventually(lambda: not hearing.warnings())


def test_late_joiners_have_the_retained_messages_of_all_publishers(ros: Ros) -> None:
    """Of many publishers in one process: the last one of each; and of whom, once their tokens have
    come, which a message may precede.
    """
    ros.router.start()
    sending = ros.leg("sender")
    senders = [sending.publisher(TF_STATIC) for _ in range(20)]
    for number, sender in enumerate(senders):
        sender.send(b"old %d" % number)
        sender.send(b"%d" % number)
    heard = Heard()
    ros.leg("hearer").subscribe(TF_STATIC, heard.add)
    eventually(lambda: len(set(heard.payloads)) >= 20)
    assert set(heard.payloads) == {b"%d" % number for number in range(20)}
    heard.clear()
    for number, sender in enumerate(senders):
        sender.send(b"%d" % number)
    eventually(lambda: len(set(heard)) >= 20)
    assert set(heard) == {(b"%d" % number, each.gid) for number, each in enumerate(senders)}


def test_its_own_messages_do_not_come_back(ros: Ros) -> None:
    """Neither dynamic nor retained; nor is it among the publishers."""
    ros.router.start()
    leg, other = ros.leg(), ros.leg("other")
    heard = Heard()
    leg.subscribe(TF, heard.add)
    leg.subscribe(TF_STATIC, heard.add)
    senders = [leg.publisher(TF), leg.publisher(TF_STATIC)]
    for sender in senders:
        sender.send(b"own")
    theirs = other.publisher(TF)
    send_until(lambda: theirs.send(b"theirs"), lambda: bool(heard))
    assert set(heard.payloads) == {b"theirs"}
    eventually(lambda: len(leg.publishers("/tf")) == 1)
    assert leg.publishers("/tf_static") == []


def test_either_side_may_start_again(ros: Ros) -> None:
    """A publisher of the same name has another gid, and its retained message is heard; a
    subscriber that starts again has it too.
    """
    ros.router.start()
    heard = Heard()
    hearing = ros.leg("hearer")
    hearing.subscribe(TF_STATIC, heard.add)
    gids = []
    for payload in (b"first", b"second"):
        sending = ros.leg("sender")
        sender = sending.publisher(TF_STATIC)
        sender.send(payload)
        eventually(lambda payload=payload, gid=sender.gid: (payload, gid) in heard)
        eventually(
            lambda gid=sender.gid: (
                hearing.publishers("/tf_static") == [RosPublisher(gid, "/sender")]
            )
        )
        gids.append(sender.gid)
        if payload == b"first":
            sending.close()
    assert gids[0] != gids[1]
    hearing.close()
    again = Heard()
    ros.leg("hearer").subscribe(TF_STATIC, again.add)
    eventually(lambda: again)
    assert set(again) == {(b"second", gids[1])}


def test_what_is_closed_neither_sends_nor_hears(ros: Ros) -> None:
    """And is no longer told; twice is fine."""
    ros.router.start()
    leg, other = ros.leg(), ros.leg("other")
    heard, still = Heard(), Heard()
    closing = leg.subscribe(TF, heard.add)
    leg.subscribe(TF, still.add)
    sender, lasting = other.publisher(TF), other.publisher(TF)
    send_until(lambda: sender.send(b"1"), lambda: bool(heard))
    eventually(lambda: len(leg.publishers("/tf")) == 2)
    for _ in range(2):
        closing.close()
        sender.close()
    heard.clear()
    send_until(lambda: lasting.send(b"2"), lambda: b"2" in still.payloads)
    assert heard == []
    eventually(lambda: [each.gid for each in leg.publishers("/tf")] == [lasting.gid])
    with pytest.raises(BusError, match="it is closed"):
        sender.send(b"3")
    for _ in range(2):
        other.close()
    eventually(lambda: leg.publishers("/tf") == [])
    with pytest.raises(BusError, match="closed"):
        other.publisher(TF)


def test_it_waits_for_the_router_and_for_its_return(
    ros: Ros, caplog: pytest.LogCaptureFixture
) -> None:
    """What was retained before there was a router, and while it was gone, arrives."""
    caplog.set_level(logging.INFO)
    sending, hearing = ros.leg("sender"), ros.leg("hearer")
    heard = Heard()
    hearing.subscribe(TF_STATIC, heard.add)
    sender = sending.publisher(TF_STATIC)
    sender.send(b"early")
    endpoint = ros.router.endpoint
    missing = (
        f"No Zenoh router of ROS answers at {endpoint}, tried until one does: start one with: "
        "ros2 run rmw_zenoh_cpp rmw_zenohd; ROS with Fast DDS (its default) or Cyclone DDS is "
        "reached by --via dds"
    )
    eventually(lambda: hearing.warnings() == [missing])
    eventually(lambda: sending.warnings() == [missing])
    ros.router.start()
    eventually(lambda: (b"early", sender.gid) in heard)
    eventually(lambda: hearing.publishers("/tf_static"))
    eventually(lambda: not hearing.warnings())
    ros.router.stop()
    eventually(lambda: hearing.warnings() == [missing])
    eventually(lambda: sending.warnings() == [missing])
    eventually(lambda: hearing.publishers("/tf_static") == [])
    sender.send(b"while it was gone")
    ros.router.start()
    eventually(lambda: (b"while it was gone", sender.gid) in heard)
    eventually(lambda: hearing.publishers("/tf_static"))
    eventually(lambda: caplog.messages.count(f"Joined ROS at {endpoint}") == 4)
    lost = f"Lost the Zenoh router of ROS at {endpoint}. Trying on"
    assert caplog.messages.count(lost) == 2


def test_a_message_without_an_attachment_is_dropped_and_counted(
    ros: Ros, caplog: pytest.LogCaptureFixture
) -> None:
    """As rmw_zenoh drops it; the log says so once."""
    ros.router.start()
    leg, stranger = ros.leg(), ros.stranger()
    heard = Heard()
    leg.subscribe(TF, heard.add)
    good = attachment_bytes(Attachment(1, time.time_ns(), bytes(range(16))))
    send_until(lambda: stranger.put(TF_KEY, b"good", attachment=good), lambda: bool(heard))
    stranger.put(TF_KEY, b"bad")
    stranger.put(TF_KEY, b"bad", attachment=b"short")
    eventually(lambda: leg.dropped == 2)
    assert set(heard) == {(b"good", bytes(range(16)).hex())}
    [dropped] = [each for each in caplog.messages if each.startswith("Dropped")]
    assert " on /tf " in dropped and "no attachment" in dropped


def test_publishers_with_another_gid_are_known_by_their_session(ros: Ros) -> None:
    """zenoh-ros2-sdk makes gids up: where its session has no other publisher, it is that one."""
    ros.router.start()
    leg, stranger = ros.leg(), ros.stranger()
    heard = Heard()
    leg.subscribe(TF, heard.add)
    place = TF_KEY.removeprefix("0/tf/")
    token = f"@ros2_lv/0/{stranger.zid()}/0/1/MP/%/%/arm/%tf/{place}/::,100:,:,:,,"
    held = stranger.liveliness().declare_token(token)
    eventually(lambda: leg.publishers("/tf"))
    attachment = attachment_bytes(Attachment(1, time.time_ns(), bytes(16)))
    send_until(lambda: stranger.put(TF_KEY, b"x", attachment=attachment), lambda: bool(heard))
    made_up = RosPublisher(bytes(16).hex(), "/arm")
    assert heard[0] == (b"x", made_up.gid)
    eventually(lambda: made_up in leg.publishers("/tf"))
    held.undeclare()
    eventually(lambda: not leg.publishers("/tf"))


def test_a_message_that_is_faster_than_its_publishers_token_is_of_no_other(ros: Ros) -> None:
    """Of a session that has another publisher of the topic, whose token was there before."""
    ros.router.start()
    leg, stranger = ros.leg(), ros.stranger()
    heard = Heard()
    leg.subscribe(TF, heard.add)
    place = TF_KEY.removeprefix("0/tf/")
    tokens = [
        f"@ros2_lv/0/{stranger.zid()}/0/{number}/MP/%/%/{node}/%tf/{place}/::,100:,:,:,,"
        for number, node in enumerate(("early", "late"))
    ]
    held = [stranger.liveliness().declare_token(tokens[0])]
    eventually(lambda: [each.node for each in leg.publishers("/tf")] == ["/early"])
    gid = gid_of(tokens[1])
    attachment = attachment_bytes(Attachment(1, time.time_ns(), gid))
    send_until(lambda: stranger.put(TF_KEY, b"x", attachment=attachment), lambda: bool(heard))
    held.append(stranger.liveliness().declare_token(tokens[1]))
    eventually(lambda: RosPublisher(gid.hex(), "/late") in leg.publishers("/tf"))
    assert {each for _, each in heard} == {gid.hex()}


def test_an_exception_of_the_callback_is_logged_once(
    ros: Ros, caplog: pytest.LogCaptureFixture
) -> None:
    """And the next message comes all the same."""
    ros.router.start()
    calls = []

    def fail(payload: bytes, gid: str) -> None:
        calls.append(payload)
        raise ValueError("not that")

    ros.leg().subscribe(TF, fail)
    sender = ros.leg("other").publisher(TF)
    send_until(lambda: sender.send(b"x"), lambda: len(calls) > 2)
    [failed] = [each.message for each in caplog.records if each.exc_info]
    assert f"message of {TF_KEY}" in failed


def test_before_rmw_zenoh_0_2_4_attachments_have_names(ros: Ros) -> None:
    """Both are read; which one is written is by the distribution, and a warning says so."""
    ros.router.start()
    old, new = ros.leg("old", distro="jazzy-0.2.3"), ros.leg("new")
    heard = Heard()
    new.subscribe(TF, heard.add)
    attachments = []
    watch = ros.stranger().declare_subscriber(
        TF_KEY, lambda sample: attachments.append(sample.attachment.to_bytes())
    )
    sender = old.publisher(TF)
    send_until(lambda: sender.send(b"x"), lambda: bool(heard and attachments))
    assert heard[0] == (b"x", sender.gid)
    assert attachments[0].startswith(b"\x0fsequence_number")
    eventually(new.warnings)
    [warning] = new.warnings()
    assert "rmw_zenoh before 0.2.4" in warning and warning.endswith("--distro jazzy-0.2.3")
    watch.undeclare()


def test_humble_has_no_hashes_of_types(ros: Ros) -> None:
    """Legs of Humble hear each other; one of a later ROS says what to do."""
    ros.router.start()
    one, other = ros.leg("one", distro="humble"), ros.leg("other", distro="humble")
    later = ros.leg("later")
    heard, unheard = Heard(), Heard()
    other.subscribe(TF, heard.add)
    later.subscribe(TF, unheard.add)
    sender = one.publisher(TF)
    send_until(lambda: sender.send(b"x"), lambda: bool(heard))
    eventually(later.warnings)
    eventually(lambda: "/one, /other" in later.warnings()[0])
    [warning] = later.warnings()
    assert warning.startswith("/tf ") and warning.endswith("--distro humble")
    assert unheard == []


def test_domains_are_apart(ros: Ros, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the settings, else by ROS_DOMAIN_ID; a warning names the domain that has nodes."""
    ros.router.start()
    far = ros.leg("far", domain=7)
    far.publisher(TF)
    near = ros.leg("near")
    eventually(near.warnings)
    [warning] = near.warnings()
    assert "domain 0" in warning and "--domain 7" in warning
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    by_environment = ros.leg("there", domain=None)
    eventually(lambda: [each.node for each in by_environment.publishers("/tf")] == ["/far"])
    for text in ("seven", "233", "-1"):
        monkeypatch.setenv("ROS_DOMAIN_ID", text)
        with pytest.raises(SettingsError, match=f"ROS_DOMAIN_ID is '{text}'"):
            ros.leg(domain=None)


def test_settings_that_are_wrong_are_errors(ros: Ros) -> None:
    """Before anything is opened."""
    with pytest.raises(SettingsError, match="unknown distribution"):
        ros.leg(distro="noetic")
    with pytest.raises(InvalidNameError, match="'my-robot'"):
        ros.leg(namespace="my-robot")
    with pytest.raises(SettingsError, match=r"'nonsense' .*endpoint"):
        open_leg("zenoh", LegSettings(connect=("nonsense",)), logging.getLogger("test"))
    leg = ros.leg()
    with pytest.raises(InvalidNameError, match="full name"):
        leg.publisher(RosTopic("chatter", STRING))
    with pytest.raises(InvalidNameError, match="full name"):
        leg.subscribe(RosTopic("/**", STRING), lambda payload, gid: None)


def test_it_is_configured_as_ros_where_no_endpoint_is_given(
    ros: Ros, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    """By ZENOH_SESSION_CONFIG_URI, and ZENOH_CONFIG_OVERRIDE over it, as for ROS's own nodes."""
    ros.router.start()
    file = tmp_path / "session.json5"
    file.write_text("{mode: 'client', connect: {endpoints: ['tcp/127.0.0.1:1']}}")
    monkeypatch.setenv("ZENOH_SESSION_CONFIG_URI", str(file))
    override = f'connect/endpoints=["{ros.router.endpoint}"];transport/link/tx/lease=60000'
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", override)
    leg = ZenohLeg(LegSettings(domain=0), logging.getLogger("test"))
    eventually(lambda: not leg.warnings())
    leg.close()
    file.write_text("{mode: 'client', connect: 7}")
    with pytest.raises(SettingsError, match=r"session\.json5: "):
        ZenohLeg(LegSettings(domain=0), logging.getLogger("test"))
    file.write_text("{mode: 'client'}")
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", "nonsense")
    with pytest.raises(SettingsError, match=r"ZENOH_CONFIG_OVERRIDE .*'nonsense'"):
        ZenohLeg(LegSettings(domain=0), logging.getLogger("test"))
