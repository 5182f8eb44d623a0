"""The pages about speed, made from what was measured last: python -m benchmarks.pages."""

from pathlib import Path

from benchmarks import page, tables_page

DOCS = Path(__file__).parent.parent / "docs" / "reference"


def made() -> dict[str, str]:
    """The pages by their file names."""
    return {"performance.md": page.made(), "performance-tables.md": tables_page.made()}


def write() -> None:
    """Write them."""
    for name, text in made().items():
        (DOCS / name).write_text(text)


if __name__ == "__main__":
    write()
