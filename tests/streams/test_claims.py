"""Claims: two live streams that list one frame, and which of them has priority."""

from itertools import permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import S, description
from tests.fakes import Clock
from tfbus import InvalidArgumentException
from tfbus.base import scheduler
from tfbus.streams.conflicts import Claims, Conflict, Rule
from tfbus.wire.descriptions import StreamDescription


def described(
    *children: str, epoch: int = 1, priority: int = 0, started: int = 0
) -> StreamDescription:
    rows = [("world", child, False) for child in children]
    return description(
        rows, epoch=epoch, host="h", pid=epoch, priority=priority, started_ns=started
    )


def rejected(claims: Claims, *updates: tuple[str, StreamDescription | None]) -> dict[str, set[str]]:
    """The rejected frames of each stream that has some, after these updates."""
    excluded: dict[str, set[str]] = {}
    for stream, listed in updates:
        contested = claims.update(stream, listed)
        for name, resolution in claims.resolutions(stream, contested).items():
            assert resolution.accepted.isdisjoint(resolution.rejected)
            excluded[name] = (excluded.get(name, set()) - resolution.accepted) | resolution.rejected
    return {name: frames for name, frames in excluded.items() if frames}


def test_frames_of_one_stream_are_not_contested() -> None:
    """Streams of different frames are not in conflict."""
    claims = Claims("first")
    assert claims.update("a", described("robot")) == set()
    assert claims.update("b", described("arm")) == set()


def test_the_first_is_the_one_of_the_older_epoch() -> None:
    """With "first" the stream that was started first wins, in whatever order they are met."""
    for order in permutations("abc"):
        updates = [(name, described("robot", epoch="bca".index(name))) for name in order]
        assert rejected(Claims("first"), *updates) == {"a": {"robot"}, "c": {"robot"}}


@pytest.mark.parametrize("rule", ["first", "priority"])
def test_a_clock_that_goes_back_makes_no_publisher_younger(rule: Rule) -> None:
    """A publisher whose epoch has grown since it was started still wins over one started later."""
    updates = [
        ("a", described("robot", epoch=1, started=1)),
        ("b", described("robot", epoch=2, started=2)),
        ("a", described("robot", epoch=3, started=1)),
    ]
    assert rejected(Claims(rule), *updates) == {"b": {"robot"}}


def test_the_priority_comes_before_the_epoch() -> None:
    """With "priority" the higher one wins, and of equal ones the first started."""
    updates = [
        ("a", described("robot", epoch=1)),
        ("b", described("robot", epoch=3, priority=2)),
        ("c", described("robot", epoch=2, priority=2)),
    ]
    assert rejected(Claims("priority"), *updates) == {"a": {"robot"}, "b": {"robot"}}


def test_with_latest_no_stream_is_left_out() -> None:
    """As in tf2, all frames are accepted, and the last to send wins."""
    claims = Claims("latest")
    claims.update("a", described("robot", epoch=1))
    assert claims.update("b", described("robot", epoch=2)) == {"robot"}
    assert rejected(claims, ("b", described("robot", epoch=2))) == {}


def test_when_the_winner_is_gone_the_next_takes_over() -> None:
    """A stream that is gone, or no longer lists a frame, leaves it to the next."""
    claims = Claims("first")
    claims.update("a", described("robot", epoch=1))
    claims.update("b", described("robot", epoch=2))
    contested = claims.update("a", None)
    assert claims.resolutions("a", contested)["b"].accepted == {"robot"}
    again = described("robot", "arm", epoch=3)
    assert rejected(claims, ("a", again)) == {"a": {"robot"}}
    contested = claims.update("a", described("arm", epoch=3))
    assert claims.resolutions("a", contested)["a"].accepted == {"robot"}


def test_each_pair_is_reported_once() -> None:
    """A conflict is new once for each two streams, with the frames that they share."""
    claims = Claims("latest")
    claims.update("b", described("robot", "arm", "drone", epoch=1))
    contested = claims.update("a", described("robot", "arm", epoch=2))
    (conflict,) = claims.news("a", contested)
    assert isinstance(conflict, Conflict)
    assert (conflict.first.stream, conflict.other.stream) == ("b", "a")
    assert conflict.frames == ("arm", "robot")
    assert str(conflict.other) == "'a' of /node (host h, pid 2)"
    claims.update("a", None)
    assert claims.news("a", claims.update("a", described("robot", epoch=3))) == []


def test_which_frames_others_list_is_found_again_only_when_that_changes() -> None:
    """Not at each description of any stream, and not at one that repeats what was known."""
    claims = Claims("latest")
    claims.update("a", described("robot"))
    asked = frozenset({"robot", "lamp"})
    first = claims.of_others("b", asked)
    assert first == {"robot"}
    for stream, listed in (
        ("c", ["arm"]),
        ("a", ["robot"]),
        ("b", ["lamp"]),
        ("a", ["robot", "x"]),
    ):
        claims.update(stream, described(*listed, epoch=2))
        assert claims.outdated == set()
        assert claims.of_others("b", asked) is first
    claims.update("c", described("lamp"))
    assert claims.outdated == {"b"}
    assert claims.of_others("b", asked) == {"robot", "lamp"}
    claims.update("a", None)
    assert claims.of_others("b", asked) == {"lamp"}
    claims.update("b", None)
    assert claims.outdated == {"b"}


def test_an_unknown_rule_is_refused() -> None:
    """There are three rules."""
    with pytest.raises(InvalidArgumentException, match="latest, first, priority"):
        Claims("strongest")  # the mistake is the test


@given(
    st.lists(
        st.tuples(
            st.sampled_from("abcd"),
            st.none() | st.sets(st.sampled_from("xyz")),
            st.integers(1, 3),
            st.integers(0, 1),
        ),
        max_size=12,
    ),
    st.sampled_from(["first", "priority"]),
)
def test_after_any_events_the_rule_alone_decides(
    events: list[tuple[str, set[str] | None, int, int]], rule: Rule
) -> None:
    """Each frame is accepted from the one winner among the streams that list it now."""
    updates = [
        (
            stream,
            None if children is None else described(*children, epoch=epoch, priority=priority),
        )
        for stream, children, epoch, priority in events
    ]
    excluded = rejected(Claims(rule), *updates)
    now = {stream: listed for stream, listed in dict(updates).items() if listed is not None}
    for child in "xyz":
        claimants = [
            (-listed.priority if rule == "priority" else 0, listed.epoch, name)
            for name, listed in now.items()
            if any(child == frame for _, frame, _ in listed.frames)
        ]
        losers = {name for _, _, name in sorted(claimants)[1:]}
        assert {name for name, frames in excluded.items() if child in frames} == losers


def test_who_claims_late_to_have_been_there_first_was_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A stream that a listener meets after a minute, and that says it is an hour old, is new."""
    clock = Clock(3600 * S)
    monkeypatch.setattr(scheduler, "time_ns", clock)
    claims = Claims("first")
    old = described("robot", started=1800 * S)
    claims.update("honest", old)
    clock.now_ns += 60 * S
    liar = described("robot", started=1)
    assert rejected(claims, ("liar", liar), ("honest", old), ("liar", liar)) == {"liar": {"robot"}}
    # One that starts now is believed, and so is one that was there before and is back.
    claims.update("honest", None)
    new = described("robot", started=clock.now_ns)
    assert rejected(claims, ("new", new), ("honest", old)).keys() == {"new", "liar"}


def test_streams_that_are_met_together_late_are_ranked_by_their_word(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """After a cut link all are met at once: the first started wins, whichever is met first."""
    for order in permutations(("a", "b")):
        clock = Clock(3600 * S)
        monkeypatch.setattr(scheduler, "time_ns", clock)
        claims = Claims("first")
        clock.now_ns += 600 * S
        updates = [(name, described("robot", started=1 + "ab".index(name))) for name in order]
        assert rejected(claims, *updates) == {"b": {"robot"}}


def test_a_frame_that_hundreds_claim_costs_a_newcomer_no_more() -> None:
    """Of 300 streams that list the same 50 frames, each is compared with the first only."""
    claims = Claims("first")
    frames = [f"frame{number}" for number in range(50)]
    for number in range(300):
        updates = (f"stream{number}", described(*frames, epoch=number + 1))
        contested = claims.update(*updates)
        assert len(claims.resolutions(updates[0], contested)) <= 2
        assert len(claims.news(updates[0], contested)) == min(number, 1)
