"""The table of the buffer beside its peers, in words."""

from collections.abc import Sequence

from benchmarks.measure import Result

HEADINGS = ("measure", "peer", "peer takes", "tfbus takes", "at least", "reached", "ratio")


def rows(results: Sequence[Result]) -> list[tuple[str, ...]]:
    """The cells, in words."""
    return [_row(result) for result in results]


def as_text(results: Sequence[Result]) -> str:
    """Columns, the numbers flush right."""
    table = [HEADINGS, *rows(results)]
    widths = [max(len(row[column]) for row in table) for column in range(len(HEADINGS))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if column < 2 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in table
    )


def markdown_table(
    headings: Sequence[str], table: Sequence[Sequence[str]], *, words: int = 0
) -> str:
    """Any table; all but the first columns, of `words`, flush right."""
    rule = ["---" if column < words else "---:" for column in range(len(headings))]
    rows = [f"| {' | '.join(row)} |" for row in (headings, *table)]
    return "\n".join([rows[0], f"|{'|'.join(rule)}|", *rows[1:]])


def left_out(results: Sequence[Result]) -> list[str]:
    """What could not be measured, and why, each once."""
    return list(
        dict.fromkeys(
            f"{result.comparison.peer}, {result.comparison.what}: {result.missing}"
            for result in results
            if result.missing
        )
    )


def amount(number: float | None, unit: str = "ns") -> str:
    """A time in the unit that suits it, or bytes."""
    if number is None:
        return "-"
    if unit == "bytes":
        return f"{number:.0f} B"
    for scale, name in ((1e9, "s"), (1e6, "ms"), (1e3, "us")):
        if number >= scale:
            return f"{number / scale:.2f} {name}"
    return f"{number:.0f} ns"


def _row(result: Result) -> tuple[str, ...]:
    comparison = result.comparison
    ratio = result.ratio
    return (
        comparison.what,
        comparison.peer,
        amount(result.theirs, comparison.unit),
        amount(result.ours, comparison.unit),
        f"{comparison.at_least:.3g} x",
        "-" if ratio is None else "yes" if ratio >= comparison.at_least else "NO",
        "-" if ratio is None else f"{ratio:.2f} x",
    )
