"""docs/reference/performance.md and performance-tables.md, made from benchmarks/measured."""

from pathlib import Path

import pytest

from benchmarks import fleet, pages, parts
from benchmarks.parts import Part, Table


@pytest.mark.parametrize("name", ["performance.md", "performance-tables.md"])
def test_the_pages_are_made_from_what_was_measured(name: str) -> None:
    """`python -m benchmarks.pages` writes the pages as they are."""
    assert (pages.DOCS / name).read_text() == pages.made()[name]


def test_a_part_is_kept_as_it_was_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kept and read again it is the same, and the pages are made anew."""
    written: list[bool] = []
    monkeypatch.setattr(parts, "FOLDER", tmp_path)
    monkeypatch.setattr(pages, "write", lambda: written.append(True))
    table = Table(["process", "CPU"], [["node [1]", "2 %"], ["", "-"]])
    Part("here", {"all": table}, {"tfbus": "0.1.0"}, {"seconds": "20"}).keep("rest")
    assert parts.kept("rest") == Part("here", {"all": table}, {"tfbus": "0.1.0"}, {"seconds": "20"})
    assert written == [True]


def test_a_row_is_found_by_its_words() -> None:
    """With its cells by heading; an unknown one is a mistake."""
    table = Table(["robot", "what", "tfbus"], [["arm", "read", "1 ms"], ["arm", "fk", "2 us"]], 2)
    assert table.row("arm", "fk")["tfbus"] == "2 us"
    with pytest.raises(KeyError, match="no row"):
        table.row("leg")


def test_a_fleet_is_written_among_others() -> None:
    """In place of a row of the same number of robots, else in the order of these numbers."""
    page = "# Fleets\n\n| robots | MB |\n|---|---:|\n| 20 (1) | 5 |\n| 1,000 (1) | 7 |\n\nEnd.\n"
    for row in (["100 (10)", "6"], ["20 (10)", "4"]):
        page = fleet.write(page, Table(["robots", "MB"], [row]))
    rows = [line for line in page.splitlines() if line[:2] == "| "]
    assert rows == ["| robots | MB |", "| 20 (10) | 4 |", "| 100 (10) | 6 |", "| 1,000 (1) | 7 |"]
    assert page.endswith("| 1,000 (1) | 7 |\n\nEnd.\n")
