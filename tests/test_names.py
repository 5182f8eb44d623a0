"""Names of frames: valid ones, and the sentences on invalid ones."""

import pytest

from tfbus.base.wording import MOST_LETTERS, mistake_in


@pytest.mark.parametrize("name", ["base_link", "robot7/arm 2", "grün", "世界", "a" * MOST_LETTERS])
def test_what_can_be_printed_can_be_a_name(name: str) -> None:
    """Letters of any script, signs and spaces are allowed."""
    assert mistake_in(name) == ""


@pytest.mark.parametrize(
    ("name", "mistake"),
    [
        (7, "must be a str such as 'base_link', not int"),
        ("", "must not be empty"),
        ("/map", "'/map' begins with a slash; write 'map'"),
        ("a\x1b[2J", r"'a\x1b[2J' contains U+001B, which cannot be printed"),
        ("caf\udce9", r"'caf\udce9' contains U+DCE9, which cannot be printed"),
        ("a\u202eb", r"'a\u202eb' contains U+202E, which cannot be printed"),
        ("a" * 300, f"'{'a' * 59}…' has 300 letters; at most 255 are allowed"),
    ],
)
def test_a_mistake_is_said_with_its_remedy(name: object, mistake: str) -> None:
    """What is wrong comes first; nothing that a terminal would obey is repeated."""
    assert mistake_in(name).startswith(mistake)
