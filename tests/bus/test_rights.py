"""The rights of identities, and the sentences that say why not."""

import logging

import pytest

from tests.builders import at
from tfbus import Buffer, SettingsError
from tfbus.base.log import LogOnce
from tfbus.bus.rights import RIGHTS, ROLES, Identity, Rights
from tfbus.geometry.columns import Columns
from tfbus.streams.frame_names import StreamRights
from tfbus.streams.stream_facts import ReceptionHooks, StreamFacts
from tfbus.streams.stream_states import StreamStates
from tfbus.wire.codec import encode_message
from tfbus.wire.descriptions import StreamDescription


@pytest.mark.parametrize(
    ("role", "allowed"),
    [
        ("reader", set()),
        ("publisher", {"frames", "topics", "serves", "calls"}),
        ("operator", {"topics", "calls", "sets"}),
        ("router", set()),
        ("admin", {"nodes", "frames", "topics", "serves", "calls", "sets"}),
    ],
)
def test_a_role_has_these_rights(role: str, allowed: set[str]) -> None:
    """Without more in its file, an identity has the rights of its role."""
    identity = Identity("it", role)
    assert {right for right in RIGHTS if identity.allows(right, "a/b")} == allowed


def test_the_table_names_every_role() -> None:
    """The five roles are those of the test above."""
    assert ROLES == ("reader", "publisher", "operator", "router", "admin")


def test_nodes_have_the_identity_s_name_or_begin_with_it() -> None:
    """Nodes and streams of other names need a right."""
    arm = Identity("arm", "publisher", nodes=("gripper",))
    named = ("arm", "arm_camera", "_arm_frames_1", "robot7/arm", "gripper")
    assert all(arm.allows("nodes", name) for name in named)
    assert not any(arm.allows("nodes", name) for name in ("leg", "army", "robot7/gripper"))


def test_the_clock_has_to_be_named() -> None:
    """Who may publish all topics may not publish the time of all."""
    assert not Identity("arm", "publisher").allows("topics", "clock")
    assert Identity("sim", "publisher", topics=("**", "clock")).allows("topics", "clock")


@pytest.mark.parametrize(
    ("identity", "right", "name", "namespace", "mistake"),
    [
        (Identity("arm", "publisher"), "frames", "hand", "", ""),
        (
            Identity("laptop", "reader"),
            "frames",
            "hand",
            "",
            "this identity, 'laptop', may not publish frame 'hand': its role is reader; give it "
            "`frames: [hand]` in rights.yaml, beside the authority",
        ),
        (
            Identity("arm", "publisher", frames=("arm/*",)),
            "frames",
            "hand",
            "",
            "this identity, 'arm', may not publish frame 'hand': it may publish arm/*; add it to "
            "its 'frames' in rights.yaml, beside the authority",
        ),
        (
            Identity("arm", "publisher"),
            "nodes",
            "base",
            "",
            "this identity, 'arm', may not run node 'base': its nodes are 'arm' and 'arm_*'; "
            "rename the node, or give it `nodes: [base]` in rights.yaml, beside the authority",
        ),
        (
            Identity("arm", "publisher", "robot7", nodes=("gripper",)),
            "nodes",
            "/robot7/base",
            "",
            "this identity, 'arm', may not run node '/robot7/base': its nodes are 'arm', "
            "'arm_*' and 'gripper'; rename the node, or add it to its 'nodes' in rights.yaml, "
            "beside the authority",
        ),
        (
            Identity("sim", "publisher"),
            "topics",
            "clock",
            "",
            "this identity, 'sim', may not publish topic 'clock': its role is publisher; give it "
            "`topics: ['**', clock]` in rights.yaml, beside the authority",
        ),
        (
            Identity("arm", "publisher", "robot7"),
            "topics",
            "/robot8/scan",
            "robot7",
            "this identity, 'arm', may not publish topic '/robot8/scan': its namespace is 'robot7'",
        ),
        (Identity("arm", "publisher", "robot7"), "topics", "scan", "robot7/arm", ""),
        (
            Identity("arm", "publisher", revoked="2026-11-22"),
            "calls",
            "spawn",
            "",
            "this identity, 'arm', may not call service 'spawn': it was revoked on 2026-11-22",
        ),
    ],
)
def test_a_refusal_says_who_what_and_why(
    identity: Identity, right: str, name: str, namespace: str, mistake: str
) -> None:
    """A right that is missing is named in one sentence."""
    assert identity.mistake_in(right, name, namespace) == mistake


def test_the_frames_of_a_stream_are_those_of_its_publisher() -> None:
    """An admin may publish any stream, and widens no other identity's."""
    arm = Identity("arm", "publisher", frames=("arm/*",))
    rights = Rights({"arm": arm, "boss": Identity("boss", "admin")})
    assert rights.frames_of_stream("arm", "robot7") == ("arm/*",)
    assert rights.frames_of_stream("boss", "") is None
    assert rights.frames_of_stream("unknown", "") is None  # as the admin's


def test_a_stream_of_later_rights_comes_through_and_a_revoked_one_does_not() -> None:
    """What is not in these rights was let in by a router with later ones; the stream of a reader,
    or of an identity that was revoked, may have no frame.
    """
    gone = Identity("gone", "publisher", revoked="2026-11-22")
    laptop = Identity("laptop", "reader")
    rights = Rights({each.name: each for each in (gone, laptop)})
    assert rights.frames_of_stream("later", "robot7") is None
    assert rights.may_be_of("/robot7/later", "later", "robot7")
    for stream in ("gone", "laptop"):
        assert rights.frames_of_stream(stream, "robot7") == ()
        assert not rights.may_be_of(f"/robot7/{stream}", stream, "robot7")


def test_an_identity_that_is_not_there_is_named_with_the_nearest() -> None:
    """A name that was misspelt is answered with those there are."""
    with pytest.raises(SettingsError, match=r"identity 'amr'; .*'arm'"):
        Rights({"arm": Identity("arm", "reader")}).identity("amr")


def test_no_identity_has_the_name_of_another_s_node() -> None:
    """Who is `arm` runs the nodes arm_*: an identity `arm_left` would be one of them."""
    arm, left = Identity("arm", "publisher", "robot7"), Identity("arm_left", "publisher", "robot7")
    with pytest.raises(SettingsError, match=r"'arm' .*'arm-left'"):
        Rights({"arm": arm, "arm_left": left})
    elsewhere = Identity("arm_left", "publisher", "robot8")
    assert Rights({"arm": arm, "arm_left": elsewhere}).identity("arm_left") == elsewhere


def test_an_identity_needs_the_rights_of_few() -> None:
    """Robots of other namespaces can send it nothing, so it needs no rules for them."""
    fleet = [Identity(f"robot{number}", "publisher", f"robot{number}") for number in range(1, 4)]
    rights = Rights(
        {each.name: each for each in (*fleet, Identity("hub", "router"), Identity("ben", "reader"))}
    )
    assert list(rights.seen_by(fleet[0]).identities) == ["robot1", "hub", "ben"]
    assert (
        rights.seen_by(rights.identity("hub")) == rights.seen_by(rights.identity("ben")) == rights
    )


@pytest.mark.parametrize(
    ("key", "is_fleet", "allowed"),
    [
        ("tf/arm", False, {"arm/left"}),
        # Shared frames have none in front.
        ("robot7/tf/arm", True, {"arm/left", "robot7/arm/left"}),
        # Without a fleet frames have no namespace in front.
        ("robot7/tf/arm/arm%2Fleft", False, {"arm/left"}),
        ("tf/unknown", False, {"arm/left", "leg", "robot7/arm/left", "robot7/leg"}),
    ],
)
def test_a_listener_takes_the_frames_that_a_stream_may_have(
    key: str, is_fleet: bool, allowed: set[str]
) -> None:
    """By its key, and by the names of its frames as they are called here; others are counted."""
    rights = Rights({"arm": Identity("arm", "publisher", frames=("arm/*",))})
    log = logging.getLogger("test")
    facts = StreamFacts("arm", Buffer(), log, ReceptionHooks(log))
    of_stream = StreamRights(rights, "").frames(key, facts, is_fleet=is_fleet)
    children = {"arm/left", "leg", "robot7/arm/left", "robot7/leg"}
    rows = Columns.of_transforms(at(child=child) for child in sorted(children))
    for turn in (1, 2):
        kept = rows if of_stream is None else of_stream.allowed_of(rows)
        assert set(kept.children()) == allowed
        assert facts.counts.forbidden == turn * len(children - allowed)


def test_a_description_is_judged_by_its_child_frames() -> None:
    """Whatever their parents are called."""
    rights = Rights({"arm": Identity("arm", "publisher", frames=("arm/*",))})
    rows = (("leg", "arm/left", False), ("arm/left", "leg", False))
    key, described = "@tfbus/stream/arm", StreamDescription(1, "/arm", 1, rows)
    kept, mistake = StreamRights(rights, "").checked(key, described)
    assert kept is not None and kept.frames == rows[:1]
    assert mistake.endswith("publish 'leg', only arm/*")
    # The listener takes it so.
    log = LogOnce(logging.getLogger("test"))
    states = StreamStates(log, StreamRights(rights, ""), lambda state: None, lambda state: None)
    assert states.read(key, encode_message(described)) == kept


class Counted(str):
    """A name that counts how often it is looked up."""

    __slots__ = ()
    hashes = 0

    def __hash__(self) -> int:
        Counted.hashes += 1
        return super().__hash__()


def test_a_description_of_many_refused_frames_is_judged_name_by_name() -> None:
    """It is not gone through again for each of them: a member could hold up all listeners."""
    rights = Rights({"arm": Identity("arm", "publisher", frames=("arm/*",))})
    rows = tuple(("w", Counted(f"{at}{n}"), False) for n in range(500) for at in ("arm/", "leg/"))
    description = StreamDescription(1, "/arm", 1, rows)
    Counted.hashes = 0
    kept, mistake = StreamRights(rights, "").checked("@tfbus/stream/arm", description)
    assert kept is not None and len(kept.frames) == 500
    assert "may not publish 'leg/0'" in mistake
    assert Counted.hashes < 10 * len(rows)
