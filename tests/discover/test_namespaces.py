"""Hints where frames of other namespaces are to be found."""

import re

from tfbus.discover.namespaces import where_to_look


def test_namespaces_that_have_a_frame_are_named() -> None:
    """At most three, and only those that have it."""
    frames = {("robot7", "base"), ("robot8", "base"), ("robot9", "arm")}
    hint = where_to_look(frames, "base")
    assert hint.startswith("'base' is known")
    assert re.findall(r"--\w+|robot\d", hint) == ["--namespace", "robot7", "robot8", "--fleet"]
    assert where_to_look(frames, "wheel") == ""


def test_what_is_in_no_namespace_is_seen_without_one() -> None:
    """The hint has no empty name in it."""
    hint = where_to_look({("", "map"), ("robot7", "map")}, "map")
    assert hint.startswith("'map' is known outside") and hint.endswith("without --namespace")
