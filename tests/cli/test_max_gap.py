"""`--max-gap` of the tools that interpolate: no pose comes from samples that are far apart."""

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from nodes.echo import main as echo
from tests.recordings import at, described, publisher, steadily, write
from tfbus.cli import main

BASE, ARM = publisher("base"), publisher("arm")
PAIR = ("world", "tool")


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """10 s at 10 Hz: world -> arm -> tool; arm has nothing from 4 s to 7 s."""
    return write(
        tmp_path / "run.mcap",
        described(BASE, 0.0, ("world", "arm", False)),
        steadily(BASE, 0.0, 4.0, ("world", "arm")),
        steadily(BASE, 7.0, 10.0, ("world", "arm")),
        described(ARM, 0.0, ("arm", "tool", False)),
        steadily(ARM, 0.0, 10.0, ("arm", "tool")),
    )


def run(command: object, *args: object) -> Result:
    return CliRunner().invoke(command, [str(each) for each in args])  # type: ignore[arg-type]


def seconds(rows: str) -> list[float]:
    """The times of rows of CSV, from the beginning of the recording."""
    stamps = [int(line.split(",")[0]) for line in rows.splitlines()[1:]]
    return [round((stamp_ns - at(0.0)) / 1e9, 1) for stamp_ns in stamps]


@pytest.mark.parametrize("options", [(), ("--rate", 5)], ids=["samples", "rate"])
def test_echo_and_export_leave_out_the_hole(
    bag: Path, tmp_path: Path, options: tuple[object, ...]
) -> None:
    """And have it without the option."""
    for limit, holds in (((), True), (("--max-gap", 0.5), False)):
        printed = run(echo, *PAIR, "--bag", bag, "--format", "csv", *options, *limit)
        output = tmp_path / "poses.csv"
        wrote = run(main, "bag", "export", bag, *PAIR, "-o", output, "--force", *options, *limit)
        assert (printed.exit_code, wrote.exit_code) == (0, 0), wrote.output
        for rows in (printed.stdout, output.read_text()):
            found = seconds(rows)
            assert any(4.2 < each < 6.8 for each in found) is holds
            assert min(found) < 1.0 and max(found) > 9.0


def test_a_moment_in_the_hole_says_why_there_is_no_pose(bag: Path) -> None:
    """With the edge and the limit, and exit code 1."""
    moment = (*PAIR, "--bag", bag, "--at", "5")
    assert run(echo, *moment).exit_code == 0
    refused = run(echo, *moment, "--max-gap", "0.5")
    assert refused.exit_code == 1
    assert "'world' -> 'arm'" in refused.stderr
    assert "max_gap_s allows 0.5 s" in refused.stderr


def test_plot_has_no_pose_in_the_hole(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says how many there are."""
    figure = pytest.importorskip("matplotlib.figure")
    monkeypatch.setattr(figure.Figure, "savefig", lambda *_, **__: None)  # which takes a second
    counts = []
    for limit in ((), ("--max-gap", 0.5)):
        done = run(main, "plot", *PAIR, "--bag", bag, "-o", tmp_path / "path.svg", *limit)
        assert done.exit_code == 0, done.output
        counts.append(int(done.stdout.split(": ")[1].split()[0]))
    assert counts[0] - counts[1] == 30


def test_without_a_pair_there_is_nothing_to_interpolate(bag: Path, tmp_path: Path) -> None:
    """The option is refused there."""
    refused = run(main, "bag", "export", bag, "-o", tmp_path / "all.csv", "--max-gap", 1)
    assert refused.exit_code == 2
    assert "--max-gap is for" in refused.stderr
