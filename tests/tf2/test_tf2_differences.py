"""Deliberate differences from tf2: one test for each.

All other answers are the same: test_against_tf2.py.
"""

from math import cos, inf, nan, sin, sqrt

import pytest

from tests.tf2.steps import (
    CanTransform,
    Clear,
    Frames,
    Insert,
    LatestCommonTime,
    Lookup,
    LookupFull,
    Pose,
)
from tests.tf2.versus import Oracle, last_answers

pytestmark = pytest.mark.real

S = 1_000_000_000
HERE: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def at(x: float) -> Pose:
    """A metre after another along x."""
    return (x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def chain(length: int, parent: str = "root") -> list[Insert]:
    """A chain of static frames, each a metre from the last, under a parent."""
    names = [parent, *(f"{parent}_{i}" for i in range(1, length + 1))]
    return [Insert(names[i], names[i + 1], S, at(1.0), static=True) for i in range(length)]


def test_a_leading_slash_is_refused_on_insert_as_it_is_on_lookup(tf2: Oracle) -> None:
    """tf2 strips a leading slash when it stores and refuses it when asked; tfbus refuses both."""
    ours, theirs = last_answers(tf2, Insert("/map", "base", S, HERE))
    assert (ours.word, theirs.word) == ("InvalidArgumentException", "accepted")
    ours, theirs = last_answers(tf2, Insert("map", "base", S, HERE), Lookup("/map", "base", S))
    assert ours.word == theirs.word == "InvalidArgumentException"


def test_a_name_that_cannot_be_comes_before_one_that_is_unknown(tf2: Oracle) -> None:
    """tf2 checks one name whole, then the next; tfbus waits for no frame beside such a name."""
    ours, theirs = last_answers(tf2, Insert("map", "base", S, HERE), Lookup("nowhere", "/map", S))
    assert (ours.word, theirs.word) == ("InvalidArgumentException", "LookupException")


@pytest.mark.parametrize(
    ("question", "word"),
    [
        (Lookup("nowhere", "nowhere", S), "LookupException"),
        (LatestCommonTime("nowhere", "nowhere"), "LookupException"),
        (CanTransform("nowhere", "nowhere", S), "no"),
    ],
)
def test_an_unknown_frame_is_unknown_from_itself_too(
    tf2: Oracle, question: Lookup | LatestCommonTime | CanTransform, word: str
) -> None:
    """tf2 sees an unknown frame from itself; tfbus checks every name."""
    ours, theirs = last_answers(tf2, question)
    assert ours.word == word
    if not isinstance(question, LatestCommonTime):
        assert theirs.word in ("transform", "yes")


def test_a_sample_that_is_too_old_makes_no_frame_known(tf2: Oracle) -> None:
    """Both refuse it; tf2 knows its parent from then on, tfbus changes nothing."""
    inserts = Insert("map", "base", 60 * S, HERE), Insert("nowhere", "base", S, HERE)
    ours, theirs = last_answers(tf2, *inserts)
    assert ours.word == theirs.word == "rejected"
    ours, theirs = last_answers(tf2, *inserts, Frames())
    assert (ours.names, theirs.names) == (("base", "map"), ("base", "map", "nowhere"))


@pytest.mark.parametrize("number", [inf, -inf])
def test_infinity_is_refused_as_nan_is(tf2: Oracle, number: float) -> None:
    """tf2 refuses what is not a number; tfbus refuses what is not finite."""
    ours, theirs = last_answers(tf2, Insert("map", "base", S, at(number)))
    assert (ours.word, theirs.word) == ("InvalidArgumentException", "accepted")
    ours, theirs = last_answers(tf2, Insert("map", "base", S, at(nan)))
    assert (ours.word, theirs.word) == ("InvalidArgumentException", "rejected")


def test_a_quaternion_within_tolerance_is_made_a_unit(tf2: Oracle) -> None:
    """Both accept a squared norm within 0.01 of one; tf2 keeps it so, tfbus normalises."""
    norm = sqrt(1.009)
    askew: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.6 * norm, 0.8 * norm)
    ours, theirs = last_answers(tf2, Insert("map", "base", S, askew), Lookup("map", "base", S))
    assert ours.pose == pytest.approx((0, 0, 0, 0, 0, 0.6, 0.8))
    assert theirs.pose == pytest.approx(askew)
    for squared_norm in (0.98, 1.02, 0.0):
        off: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, sqrt(squared_norm))
        ours, theirs = last_answers(tf2, Insert("map", "base", S, off))
        assert (ours.word, theirs.word) == ("InvalidArgumentException", "rejected")


def test_the_smallest_rotations_are_interpolated_too(tf2: Oracle) -> None:
    """Below some 2e-8 rad tf2's arc cosine is 0, and it answers the older rotation unblended."""
    angle = 2e-8
    turned: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, sin(angle / 2), cos(angle / 2))
    inserts = Insert("map", "base", 1 * S, HERE), Insert("map", "base", 3 * S, turned)
    ours, theirs = last_answers(tf2, *inserts, Lookup("map", "base", 2 * S))
    assert ours.pose and ours.pose[5] == pytest.approx(sin(angle / 4))
    assert theirs.pose == HERE


def test_of_equal_stamps_the_latest_arrival_counts(tf2: Oracle) -> None:
    """Noetic's tf2 keeps the first and warns of the others; tfbus takes the last, as ROS 2 does."""
    inserts = Insert("map", "base", S, at(1.0)), Insert("map", "base", S, at(2.0))
    ours, theirs = last_answers(tf2, *inserts, Lookup("map", "base", S))
    assert ours.pose == at(2.0)
    assert theirs.pose == at(1.0)


def test_stamp_zero_is_a_time_like_any_other(tf2: Oracle) -> None:
    """tf2 takes time 0 for the latest; tfbus says None for that, and means 0 by 0."""
    insert = Insert("map", "base", S, HERE)
    ours, theirs = last_answers(tf2, insert, Lookup("map", "base", 0))
    assert (ours.word, theirs.word) == ("ExtrapolationException", "transform")
    ours, theirs = last_answers(tf2, insert, Lookup("map", "base", None))
    assert ours.stamp_ns == theirs.stamp_ns == S


def test_a_tree_may_be_deeper_than_a_thousand_edges(tf2: Oracle) -> None:
    """tf2 takes a walk of more than 1,000 edges for a loop; tfbus knows that there is none."""
    deep = chain(1_100)
    ours, theirs = last_answers(tf2, *deep, Lookup("root", deep[-1].child, S))
    assert ours.pose == at(1_100.0)
    assert theirs.word == "LookupException"


def test_a_walk_stops_at_the_lowest_common_ancestor(tf2: Oracle) -> None:
    """tf2 walks to the root, however far, for two neighbours; tfbus looks at their edges only."""
    deep = chain(1_100)
    bottom = deep[-1].child
    left, right = Insert(bottom, "left", S, at(1.0)), Insert(bottom, "right", S, at(-1.0))
    ours, theirs = last_answers(tf2, *deep, left, right, Lookup("left", "right", S))
    assert ours.pose == at(-2.0)
    assert theirs.word == "LookupException"


def test_an_edge_that_would_close_a_loop_is_refused(tf2: Oracle) -> None:
    """tf2 takes it, and fails when it is asked; tfbus refuses it, and answers as before."""
    inserts = Insert("a", "b", S, at(1.0)), Insert("b", "c", S, at(1.0))
    closing = Insert("c", "a", S, at(1.0))
    ours, theirs = last_answers(tf2, *inserts, closing)
    assert (ours.word, theirs.word) == ("LoopException", "accepted")
    ours, theirs = last_answers(
        tf2, *inserts, closing, Insert("x", "y", S, HERE), Lookup("a", "c", S)
    )
    assert ours.pose == at(2.0)
    ours, theirs = last_answers(
        tf2, *inserts, closing, Insert("x", "y", S, HERE), Lookup("x", "c", S)
    )
    assert (ours.word, theirs.word) == ("ConnectivityException", "LookupException")


def test_parents_of_different_times_may_make_a_loop_that_no_lookup_meets(tf2: Oracle) -> None:
    """Frames that changed places make a loop at the times in between; tf2 fails for all frames
    below it, tfbus only where the way leads through it.
    """
    changed_places = (
        Insert("a", "b", 1 * S, at(1.0)),
        Insert("root", "b", 4 * S, at(1.0)),
        Insert("b", "a", 2 * S, at(1.0)),
        Insert("b", "a", 3 * S, at(1.0)),
    )
    left, right = Insert("b", "left", 2 * S, at(1.0)), Insert("b", "right", 2 * S, at(-1.0))
    ours, theirs = last_answers(tf2, *changed_places, left, right, Lookup("left", "right", 2 * S))
    assert ours.pose == at(-2.0)
    assert theirs.word == "LookupException"
    ours, theirs = last_answers(tf2, *changed_places, Lookup("root", "a", 2 * S))
    assert (ours.word, theirs.word) == ("ConnectivityException", "LookupException")


def test_two_frames_of_a_loop_have_one_transform_or_none(tf2: Oracle) -> None:
    """tf2 walks from the source up to the target, so that each is ahead of the other; tfbus answers
    where the frames are parent and child now, and otherwise says which frames make the loop.
    """
    changed_places = (
        Insert("a", "b", 1 * S, at(1.0)),
        Insert("root", "b", 4 * S, at(1.0)),
        Insert("b", "a", 2 * S, at(1.0)),
        Insert("b", "a", 3 * S, at(1.0)),
    )
    for target, source, x in (("a", "b", -1.0), ("b", "a", 1.0)):
        question = Lookup(target, source, 2 * S)
        ours, theirs = last_answers(tf2, *changed_places, question)
        assert (ours.pose, theirs.pose) == (at(x), at(1.0))
        apart = Insert("root", "a", 5 * S, at(1.0))
        ours, theirs = last_answers(tf2, *changed_places, apart, question)
        assert ours.word == "ConnectivityException" and "was a loop then" in ours.text
        assert theirs.pose == at(1.0)


def test_a_child_that_turns_static_holds_at_all_times(tf2: Oracle) -> None:
    """For tf2 a child stays what it was first; in tfbus it is what it was sent as last."""
    turned = Insert("map", "base", S, at(1.0)), Insert("map", "base", 2 * S, at(2.0), static=True)
    ours, theirs = last_answers(tf2, *turned, Lookup("map", "base", 9 * S))
    assert ours.pose == at(2.0)
    assert theirs.word == "ExtrapolationException"


def test_a_child_that_turns_dynamic_again_keeps_its_history(tf2: Oracle) -> None:
    """For tf2 a child that was static first has no history; tfbus keeps it across both turns."""
    first = Insert("map", "base", S, at(0.0), static=True)
    moving = Insert("map", "base", 2 * S, at(2.0)), Insert("map", "base", 4 * S, at(4.0))
    ours, theirs = last_answers(tf2, first, *moving, Lookup("map", "base", 3 * S))
    assert ours.pose == at(3.0)
    assert theirs.pose == at(4.0)
    ours, _ = last_answers(tf2, moving[0], first, moving[1], Lookup("map", "base", 3 * S))
    assert ours.pose == at(3.0)


def test_frames_of_two_trees_are_unconnected_whatever_the_time(tf2: Oracle) -> None:
    """tf2 may complain about the time of an edge that leads nowhere; tfbus names no edge that is
    not on a path.
    """
    apart = Insert("a", "b", S, HERE), Insert("x", "y", S, HERE)
    ours, theirs = last_answers(tf2, *apart, Lookup("b", "y", 2 * S))
    assert (ours.word, theirs.word) == ("ConnectivityException", "ExtrapolationException")
    ours, theirs = last_answers(tf2, *apart, LookupFull("b", S, "y", 2 * S, "a"))
    assert (ours.word, theirs.word) == ("ConnectivityException", "ExtrapolationException")


def test_an_edge_that_was_cleared_gives_way(tf2: Oracle) -> None:
    """To one that would close a loop; for tf2 its child has no data, for tfbus it is a root."""
    given_way = (
        Insert("map", "base", 1 * S, HERE),
        Clear(),
        Insert("other", "map", 2 * S, HERE),
        Insert("base", "map", 4 * S, HERE),
    )
    ours, theirs = last_answers(tf2, *given_way, Lookup("map", "base", 3 * S))
    assert (ours.word, theirs.word) == ("ConnectivityException", "ExtrapolationException")


def test_after_clear_the_latest_has_no_data(tf2: Oracle) -> None:
    """Of an edge whose samples were cleared tf2 says for the latest that it is unconnected, and at
    a time that it has no data; tfbus says that it has no data both times.
    """
    cleared = Insert("map", "base", S, HERE), Clear()
    ours, theirs = last_answers(tf2, *cleared, Lookup("map", "base", None))
    assert (ours.word, theirs.word) == ("ExtrapolationException", "ConnectivityException")
    ours, theirs = last_answers(tf2, *cleared, Lookup("map", "base", S))
    assert ours.word == theirs.word == "ExtrapolationException"
