"""`--bag`, and the moments and spans of a recording."""

from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from tests.recordings import at, publisher, steadily, write
from tfbus.base.errors import TfbusError
from tfbus.base.wording import wall
from tfbus.command.recordings import BagChoice, bag_options, open_recording
from tfbus.command.types import parse_moment


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A recording of 10 s; its last message is stamped 9.9 s after its beginning."""
    return write(tmp_path / "run.mcap", steadily(publisher("sim"), 0.0, 10.0, ("world", "base")))


def choice(path: Path, **moments: str) -> BagChoice:
    return BagChoice((path,), **{name: parse_moment(text) for name, text in moments.items()})


def test_without_a_moment_it_is_the_end_and_the_whole(path: Path) -> None:
    """The moment is that of the last item, the span all of it."""
    with choice(path).opened() as bag:
        start_ns, end_ns = bag.reader.start_ns, bag.reader.end_ns
        assert bag.at_ns == end_ns
        assert bag.span == (start_ns, end_ns)


def test_a_span_ends_with_the_recording(path: Path) -> None:
    """A span that goes beyond the recording is cut to it."""
    with choice(path, begin="-1h", end="+5s").opened() as bag:
        assert bag.span == (bag.reader.start_ns, bag.reader.start_ns + 5_000_000_000)


@pytest.mark.parametrize(
    ("moments", "text"),
    [
        ({"at": "+11s"}, "--at: \\+11s is outside of the recording, which is from"),
        ({"at": "11"}, "--at: 11s is outside of .*: 3 is 3 s after its beginning, -3 is 3 s"),
        ({"at": "1670400305.7"}, r"--at: 2022-12-\d\d .*\.700 is outside"),
        ({"at": "2020-01-01"}, "2020-01-01 00:00:00.000 is outside of the recording"),
        ({"begin": "11"}, "--from: 11s is outside"),
        ({"begin": "2030-01-01"}, "--from: 2030-01-01"),
        ({"end": "2020-01-01"}, "--to: 2020-01-01"),
        ({"begin": "-1s", "end": "+1s"}, "must be before --to"),
    ],
)
def test_what_is_outside_is_an_error_that_says_what_is_inside(
    path: Path, moments: dict[str, str], text: str
) -> None:
    """It names the span of the recording, and the form that was meant."""
    with choice(path, **moments).opened() as bag, pytest.raises(click.UsageError, match=text):
        assert (bag.at_ns, bag.span) == ()


def test_a_number_is_seconds_of_the_recording(path: Path) -> None:
    """For --at, --from and --to: 3 is 3 s after its beginning, -3 is 3 s before its end."""
    with choice(path, at="3", begin="2.5", end="-3").opened() as bag:
        start_ns, end_ns = bag.reader.start_ns, bag.reader.end_ns
        assert bag.at_ns == start_ns + 3_000_000_000
        assert bag.span == (start_ns + 2_500_000_000, end_ns - 3_000_000_000)


def test_a_file_that_is_none_is_an_error_in_one_sentence(tmp_path: Path) -> None:
    """What is no recording, or an empty one, is named."""
    other = tmp_path / "run.csv"
    other.write_text("a,b\n" * 100)
    with pytest.raises(TfbusError, match=r"run\.csv"), open_recording(other):
        pass
    empty = write(tmp_path / "empty.mcap")
    with pytest.raises(TfbusError, match="empty"), open_recording(empty):
        pass


def test_a_moment_needs_a_recording() -> None:
    """Without --bag, --at, --from and --to are usage errors that say so."""

    @click.command()
    @bag_options("at", "begin", "end")
    def command(bag: BagChoice | None) -> None:
        raise AssertionError

    for option in ("--at", "--from", "--to"):
        done = CliRunner().invoke(command, [option, "+1s"])
        assert done.exit_code == 2
        assert f"{option} is a moment" in done.output and "give --bag" in done.output


def test_files_follow_an_option_as_a_shell_puts_them(path: Path) -> None:
    """`--bag run*.mcap frame`: files that are there, up to the first argument that is none."""
    more = [path, write(path.with_name("run2.mcap"), steadily(publisher("b"), 0.0, 1.0))]

    @click.command()
    @click.argument("frame")
    @bag_options()
    def command(frame: str, bag: BagChoice | None) -> None:
        assert bag is not None
        click.echo([frame, *(each.name for each in bag.paths)])

    (path.parent / "base").mkdir()
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(path.parent)
        done = CliRunner().invoke(command, ["--bag", *map(str, more), "base"])
    assert done.output == "['base', 'run.mcap', 'run2.mcap']\n"


def test_a_time_is_that_of_the_wall() -> None:
    """Local time, with milliseconds; a stamp beyond the calendar in seconds."""
    assert wall(at(1.5)).endswith(".500") and len(wall(at(1.5))) == 23
    assert wall(2**63 - 1) != ""
