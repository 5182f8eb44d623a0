"""Hints where frames of other namespaces are to be found."""

from tfbus.discover.out_of_reach import where_to_look


def test_namespaces_that_have_a_frame_are_named() -> None:
    """At most three, and only those that have it."""
    frames = {("robot7", "base"), ("robot8", "base"), ("robot9", "arm")}
    assert where_to_look(frames, "base") == (
        "'base' is known in other namespaces: look with --namespace robot7 or robot8, or with "
        "--fleet"
    )
    assert where_to_look(frames, "wheel") == ""


def test_what_is_in_no_namespace_is_seen_without_one() -> None:
    """The hint has no empty name in it."""
    assert where_to_look({("", "map"), ("robot7", "map")}, "map") == (
        "'map' is known outside of this namespace: look without --namespace"
    )
