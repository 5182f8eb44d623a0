"""docs/reference/performance.md has parts that are measured on their own."""

from pathlib import Path

from benchmarks.parts import former, put_in


def test_each_part_of_the_page_is_written_without_the_others(tmp_path: Path) -> None:
    """A part goes in its place where there is one, else to the end; the others stay."""
    page = tmp_path / "performance.md"
    page.write_text("# Fast\n")
    assert former(page) == ""
    put_in(page, "<!-- the bus -->", "<!-- the bus -->\n\n1 us\n")
    put_in(page, "<!-- the view -->", "<!-- the view -->\n\n3 cores\n")
    put_in(page, "<!-- the bus -->", "<!-- the bus -->\n\n2 us\n")
    put_in(page, "<!-- the view -->", "<!-- the view -->\n\n1 core\n")
    parts = "\n<!-- the bus -->\n\n2 us\n\n<!-- the view -->\n\n1 core\n"
    assert page.read_text() == f"# Fast\n{parts}"
    assert former(page) == parts
