"""YAML files: a mistake has its line, and a sentence in plain words."""

from pathlib import Path

import pytest

from tfbus.base.yaml_file import YamlFileError, read_yaml_file


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("a: 1\n  b: 2\n", 2, "a ':' stands where no key can be; check the indentation"),
        ("- a\nb: 1\n", 2, "this does not fit the lines above it; check the indentation"),
        ("x: 1\na: [1, 2\nb: 3\n", 2, "a list that begins here has no end; write ',' or ']'"),
        ("{a: 1\n", 1, "a mapping that begins here has no end; write ',' or '}'"),
        ("a: 1\nb: 'x\nc: 2\n", 2, "a quote that begins here has no end"),
        ("a:\n\t- 1\n", 2, "a tab stands here; indent with spaces"),
        ("a: @foo\n", 1, "a text cannot begin with '@'; put it in quotes"),
        ("a: 1\nfoo\n", 2, "a key that begins here has no ':' after it"),
        ("a: *x\n", 1, "'*x' refers to '&x', which is not there; put it in quotes"),
        ('a: "\\q"\n', 1, r"'\q' means nothing between double quotes; use single quotes"),
    ],
)
def test_a_mistake_in_yaml_is_plain(tmp_path: Path, text: str, line: int, reason: str) -> None:
    """What the parser calls a block end or a token is said as people see it in the file."""
    file = tmp_path / "robot.yaml"
    file.write_text(text)
    with pytest.raises(YamlFileError) as caught:
        read_yaml_file(file, "a list")
    assert str(caught.value).startswith(f"{file}:{line}: is not YAML: {reason}")
