"""Patterns of names in rights, by themselves and as key expressions of Zenoh."""

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from tfbus import SettingsError
from tfbus.bus.patterns import as_keys, as_path, check_pattern, matches

PARTS = st.text("ab_", min_size=1, max_size=3)
NAMES = st.lists(PARTS, min_size=1, max_size=4).map("/".join)
PATTERNS = st.lists(
    st.one_of(PARTS, st.sampled_from(["*", "**", "a*", "*b", "a*b"])), min_size=1, max_size=4
).map("/".join)


@pytest.mark.parametrize(
    ("pattern", "name", "fits"),
    [
        ("arm", "arm", True),
        ("arm", "arm2", False),
        ("arm*", "arm2", True),
        ("arm*", "arm/hand", False),
        ("arm/*", "arm/hand", True),
        ("arm/*", "arm/hand/finger", False),
        ("arm/**", "arm/hand/finger", True),
        ("arm/**", "arm", True),
        ("**", "anything/at/all", True),
        ("*/pose", "turtle1/pose", True),
        ("**/pose", "pose", True),
    ],
)
def test_a_star_is_letters_of_a_part_and_two_are_any_parts(
    pattern: str, name: str, fits: bool
) -> None:
    """`*` stands for letters within a part, `**` for any number of parts."""
    assert matches(pattern, name) is fits


@given(PATTERNS, NAMES)
def test_a_pattern_of_topics_stands_for_the_same_in_zenoh(pattern: str, name: str) -> None:
    """The key expression of a pattern includes just the names that the pattern stands for."""
    expression = zenoh.KeyExpr.autocanonize(as_path(pattern))
    assert expression.includes(zenoh.KeyExpr(name)) == matches(pattern, name)


@given(PATTERNS, NAMES)
def test_a_pattern_of_nodes_stands_for_the_same_in_zenoh(pattern: str, name: str) -> None:
    """So do those of nodes and streams: the last part is the name, before it is a namespace."""
    *namespace, node = name.split("/")
    key = zenoh.KeyExpr("/".join([*namespace, "@tfbus/node", node]))
    found = [zenoh.KeyExpr.autocanonize(each) for each in as_keys(pattern, "@tfbus/node")]
    assert any(each.includes(key) for each in found) == matches(pattern, name)


@pytest.mark.parametrize(
    ("pattern", "mistake"),
    [
        ("", "not a pattern"),
        ("a//b", "not a pattern"),
        ("a b", "not a pattern"),
        ("tf$*", "not a pattern"),
        ("a**", "whole parts"),
        ("@tfbus/node", "tfbus's own"),
        ("a\x1bb", "not a pattern"),
    ],
)
def test_a_pattern_that_is_none_is_refused(pattern: str, mistake: str) -> None:
    """What is no pattern of names is refused with the reason."""
    with pytest.raises(SettingsError, match=mistake):
        check_pattern(pattern)
