"""Parts of what is measured: tables kept in benchmarks/measured, from which pages are made."""

import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from benchmarks.report import markdown_table

FOLDER = Path(__file__).parent / "measured"

_ROW = re.compile(r"\[[^][{}]+\]")


@dataclass(frozen=True)
class Table:
    """Headings, and rows of cells; the first `words` columns are words, the others numbers."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1

    def row(self, *words: str) -> dict[str, str]:
        """The row that begins with these words, by heading."""
        for row in self.rows:
            if tuple(row[: len(words)]) == words:
                return dict(zip(self.headings, row, strict=True))
        raise KeyError(f"no row {words} among {[row[0] for row in self.rows]}")

    def as_markdown(self) -> str:
        """The table as Markdown has it."""
        return markdown_table(self.headings, self.rows, words=self.words)


@dataclass(frozen=True)
class Part:
    """One part: the machine it was measured on, the versions of the programs, tables by name, and
    what else its text says.
    """

    place: str
    tables: Mapping[str, Table]
    versions: Mapping[str, str] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)

    def keep(self, name: str) -> None:
        """Keep it in place of the former part of this name, and make the pages anew."""
        text = json.dumps(asdict(self), indent=1, ensure_ascii=False)
        # A row is a line.
        text = _ROW.sub(lambda row: re.sub(r"\n *", " ", row[0]), text)
        (FOLDER / f"{name}.json").write_text(f"{text}\n")
        from benchmarks import pages

        pages.write()

    def show(self) -> None:
        """Print it, for people at a terminal."""
        print(self.place, *(f"{who}: {what}" for who, what in self.versions.items()), sep="\n")
        for table in self.tables.values():
            print(f"\n{table.as_markdown()}")
        sys.stdout.flush()


def kept(name: str) -> Part:
    """The part of this name as it was measured last."""
    found = json.loads((FOLDER / f"{name}.json").read_text())
    tables = {key: Table(**table) for key, table in found.pop("tables").items()}
    return Part(tables=tables, **found)
