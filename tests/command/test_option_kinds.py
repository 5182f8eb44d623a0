"""Options with several values after one name, and sizes."""

import click
import pytest
from click.testing import CliRunner

from tfbus.command.options import Several
from tfbus.command.types import ByteSize


@click.command()
@click.argument("rest", nargs=-1)
@click.option("-t", "--topics", cls=Several, multiple=True)
@click.option("--size", type=ByteSize())
def command(rest: tuple[str, ...], topics: tuple[str, ...], size: int | None) -> None:
    """Print what was given."""
    click.echo(f"{rest} {topics} {size}")


@pytest.mark.parametrize(
    ("line", "printed"),
    [
        ("--topics a b c", "() ('a', 'b', 'c') None"),
        ("--topics a --topics b", "() ('a', 'b') None"),
        ("x -t a b --size 5", "('x',) ('a', 'b') 5"),
        ("--topics=a b -- c", "('c',) ('a', 'b') None"),
        ("a b", "('a', 'b') () None"),
    ],
)
def test_all_words_up_to_the_next_option_are_values(line: str, printed: str) -> None:
    """As those of ROS, and repeated as those of click."""
    assert CliRunner().invoke(command, line.split()).output.strip() == printed


@pytest.mark.parametrize("line", ["--topics -o x", "-t --size 5", "--topics"])
def test_an_option_is_no_value(line: str) -> None:
    """Otherwise the name of an option would be one of a topic, which never comes."""
    done = CliRunner().invoke(command, line.split())
    assert done.exit_code == 2 and "Error" in done.stderr


@pytest.mark.parametrize(
    ("text", "size"), [("500MB", 500_000_000), ("2 GB", 2_000_000_000), ("7", 7), ("1kB", 1000)]
)
def test_sizes_have_units(text: str, size: int) -> None:
    """The units are those of the limits of messages."""
    assert CliRunner().invoke(command, ["--size", text]).output.strip() == f"() () {size}"


@pytest.mark.parametrize("text", ["0", "-1", "5 apples", "1.5GB", "5mb", ""])
def test_other_sizes_are_refused(text: str) -> None:
    """The error says what to write."""
    done = CliRunner().invoke(command, ["--size", text])
    assert done.exit_code == 2 and "as in 500MB" in done.stderr
