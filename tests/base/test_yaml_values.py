"""Values as people type them."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus.base.yaml_file import read_strangers_value, read_value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("true", True),
        ("False", False),
        ("7", 7),
        ("+7", 7),
        ("010", 10),
        ("0x1F", 31),
        ("0o17", 15),
        ("-0.5", -0.5),
        (".5", 0.5),
        ("2.", 2.0),
        ("1e-3", 0.001),
        ("-.inf", -math.inf),
        ("null", None),
        ("~", None),
        ("", None),
        ("[3, x, {y: [1.5]}]", [3, "x", {"y": [1.5]}]),
        ("!!binary aGk=", b"hi"),
    ],
)
def test_words_are_what_they_look_like(text: str, value: object) -> None:
    """Numbers, true, false and nothing are read as such, alone and within lists and maps."""
    assert read_value(text) == value
    assert type(read_value(text)) is type(value)


@pytest.mark.parametrize(
    "text", ["no", "off", "y", "Yes", "1:30", "2022-12-07", "1_000", "nan", "inf", "e5", "7 m"]
)
def test_all_other_words_are_texts(text: str) -> None:
    """A robot called `no` keeps its name, and a date is a text."""
    assert read_value(text) == text
    assert read_value(f"{{name: {text}}}") == {"name": text}


def test_keys_are_texts() -> None:
    """`off` is a field like any other, and so is a number."""
    assert read_value("{r: 1, off: 1, 2: 3, true: 4}") == {"r": 1, "off": 1, "2": 3, "true": 4}


@pytest.mark.parametrize("text", ["{", "{[1]: 2}", "&a {x: *a}", "!!bool 5", "9" * 5000, "\0"])
def test_what_is_no_yaml_says_itself(text: str) -> None:
    """A text that is not YAML is its own value."""
    assert read_value(text) == text


@pytest.mark.parametrize("text", ["[&a 1, *a]", "&a 1", "{x: &a [1], y: *a}", "*a"])
def test_anchors_and_aliases_from_the_network_are_no_values(text: str) -> None:
    """In a text from the network, a few aliases of aliases could stand for billions of values."""
    assert read_strangers_value(text) == text


@pytest.mark.parametrize("text", ["[" * 101, "{" * 101, "7 " * 5001])
def test_a_text_from_the_network_that_is_slow_to_read_is_a_text(text: str) -> None:
    """PyYAML's time grows with the square of the nesting."""
    assert read_strangers_value(text) == text


def test_a_usual_text_from_the_network_is_read() -> None:
    """Lists and maps come as text too."""
    assert read_strangers_value("[[1, 2], {x: 1e-3}]") == [[1, 2], {"x": 0.001}]


@given(st.text(max_size=40))
def test_any_text_is_read(text: str) -> None:
    """No text is too strange to be read."""
    read_value(text)
