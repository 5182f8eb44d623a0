"""The output of all tools: plain in a pipe; coloured, and no wider than it, in a terminal.

`paint` is for a word, `table` for rows, `yaml_text` for values, `say` and `warn` for sentences on
stderr. click removes colours if stdout is not a terminal, `NO_COLOR` (https://no-color.org)
everywhere.
"""

import os
import re
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import click

from tfbus.base.json_text import json_text
from tfbus.base.standard_error import for_stderr
from tfbus.base.wording import columns, counted, cut, cut_apart, printable

F = TypeVar("F", bound=Callable[..., Any])

# The roles of words, and their styles.
_ROLES: dict[str, dict[str, Any]] = {
    "heading": {"bold": True},
    "name": {"fg": "cyan"},
    "type": {"fg": "green"},
    "faint": {"dim": True},
    "good": {"fg": "green"},
    "warning": {"fg": "yellow"},
    "bad": {"fg": "red"},
}

# The roles of the states of frames; the others are plain.
_STATE_ROLES = {
    "root": "heading",
    "static": "faint",
    "stale": "warning",
    "ahead": "warning",
    "gone": "bad",
    "conflict": "bad",
}

# Between two columns of a table.
_GAP = "  "

# These stay in a line besides printable characters: the styles of `paint`, tabs and line ends.
_KEPT = re.compile(r"(\x1b\[\d+m|[\t\n])")

# The longest sentence of an error or a warning.
_LONGEST_SENTENCE = 2000

# A page that is shown again and again has at most as many lines.
_MOST_LINES = 500

# Commands of a terminal: its alternate screen with the cursor hidden, and the way back; to the top
# left; to clear the rest of a line, and of the screen.
_ENTER_SCREEN, _LEAVE_SCREEN = "\x1b[?1049h\x1b[?25l", "\x1b[?25h\x1b[?1049l"
_TO_THE_TOP, _TO_REST_OF_LINE, _TO_REST_OF_SCREEN = "\x1b[H", "\x1b[K", "\x1b[K\x1b[J"

# Keeps a long text in YAML on its line.
_NEVER_FOLDED = 2**31 - 1

_YAML_KEY = re.compile(r"^(\s*(?:- )*)([^\s:'\"{\[-][^:]*)(:)(?=\s|$)")


def json_option(text: str) -> Callable[[F], F]:
    """The option `--json` of a tool, whose value is the argument `as_json`."""
    return click.option("--json", "as_json", is_flag=True, help=text)


def print_json(value: object) -> None:
    """Print one line of JSON."""
    click.echo(json_text(value))


def as_text(value: object) -> str:
    """A text as it can be printed, a number as Python has it, other values as JSON."""
    if isinstance(value, str):
        return printable(value, len(value))
    return repr(value) if isinstance(value, float) else json_text(value)


def print_lines(lines: Iterable[str]) -> None:
    """Print lines in one write; nothing for no lines."""
    if text := "\n".join(lines):
        print_text(text)


def print_text(text: str) -> None:
    """Print a text that may be painted, and have several lines."""
    click.echo(printable_text(text))


def printable_text(text: str) -> str:
    """The text without anything else that a terminal would obey; all from the bus goes this way."""
    parts = _KEPT.split(text)
    return "".join(part if at % 2 else printable(part, len(part)) for at, part in enumerate(parts))


def sentence(what: object) -> str:
    """An error or a warning in one line that can be printed, not too long."""
    return printable(str(what), _LONGEST_SENTENCE)


@contextmanager
def screen() -> Iterator[Callable[[Iterable[str]], None]]:
    """Inside the `with`, `show(lines)` shows a page in place of the one before.

    In a terminal that is its alternate screen, as of a pager: the scrollback stays as it was, pages
    are cut to its height, and the last one is printed at the end. Elsewhere each page is printed,
    with an empty line after it.
    """
    if not is_terminal():
        yield lambda lines: print_lines([*first_lines(list(lines)), ""])
        return
    pages: list[list[str]] = []

    def show(lines: Iterable[str]) -> None:
        pages[:] = [list(lines)]
        height = shutil.get_terminal_size((80, 24)).lines
        fitting = first_lines(pages[0], height - 1) if len(pages[0]) > height else pages[0]
        text = f"{_TO_REST_OF_LINE}\n".join(_clipped(printable_text(each)) for each in fitting)
        click.echo(f"{_TO_THE_TOP}{text}{_TO_REST_OF_SCREEN}", nl=False)

    click.echo(_ENTER_SCREEN, nl=False)
    try:
        yield show
    finally:
        click.echo(_LEAVE_SCREEN, nl=False)
        for page in pages:
            print_lines(first_lines(page))


def _clipped(line: str) -> str:
    """A painted line, as much of it as the terminal is wide: a second line would move the page."""
    room, shown = width(), []
    for part in _KEPT.split(line):
        if not _KEPT.fullmatch(part):
            part = cut(part, room) if room else ""
            room -= columns(part)
        shown.append(part)
    return "".join(shown)


def first_lines(lines: list[str], most: int = _MOST_LINES) -> list[str]:
    """At most `most` lines, and one that says how many more there are."""
    more = len(lines) - most
    return lines if more <= 0 else [*lines[:most], f"… {counted(more, 'more line')}"]


def warn(what: object) -> None:
    """Print to stderr a problem that does not stop the tool."""
    text = for_stderr(f"Warning: {sentence(what)}")
    click.echo(f"{paint('Warning:', 'warning')}{text.removeprefix('Warning:')}", err=True)


def say(what: object) -> None:
    """Print a sentence on the tool's work to stderr, as that it waits for a topic."""
    for line in for_stderr(sentence(what)).split("\n"):
        click.echo(paint(line, "faint"), err=True)


def run_in_shell(option: str, line: str, told: Mapping[str, str]) -> None:
    """Run the command of an option to its end, with `told` in its environment; its own failure is
    a warning, and no reason to stop.
    """
    import subprocess  # which few tools need

    code = subprocess.run(line, shell=True, env={**os.environ, **told}, check=False).returncode
    if code:
        warn(f"the command of {option} exited with {code}: {line}")


def paint(text: str, role: str) -> str:
    """The text in the style of its role: heading, name, type, faint, good, warning or bad."""
    text = printable(text, len(text))
    if not text or os.environ.get("NO_COLOR"):
        return text
    return click.style(text, **_ROLES[role])


def with_type(name: str, type_name: str) -> str:
    """`turtle1/pose [Pose]`."""
    return f"{name} {paint(f'[{type_name}]', 'type')}"


def paint_state(text: str, state: str) -> str:
    """The text in the style of a frame's state."""
    return paint(text, _STATE_ROLES[state]) if state in _STATE_ROLES else text


def is_terminal() -> bool:
    """Whether stdout is a terminal."""
    return sys.stdout.isatty()


def width() -> int:
    """The width of a line in characters: the terminal's, or COLUMNS, or 80."""
    return shutil.get_terminal_size((80, 24)).columns


def longest_line() -> int:
    """How long a line with names may be: as wide as a terminal; in a pipe, which has no width, of
    any length, since programs read the names there.
    """
    return width() if is_terminal() else sys.maxsize


def table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    right: Iterable[int] = (),
    names: Iterable[int] = (),
    longest: int | None = None,
) -> list[str]:
    """Lines of columns under headings; cells may be painted.

    The columns of index `right` are aligned to the right. If a line is longer than `longest` (None:
    `longest_line()`), the widest columns are cut; columns of index `names` so that different cells
    stay different, even if the line is longer then.
    """
    room = (longest_line() if longest is None else longest) - len(_GAP) * (len(headings) - 1)
    cells = [[paint(heading, "heading") for heading in headings], *map(list, rows)]
    widths = [max(map(_length, column)) for column in zip(*cells, strict=True)]
    _narrow(widths, room)
    for at in names:
        for row, cell in zip(
            cells, _cut_apart([row[at] for row in cells], widths[at]), strict=True
        ):
            row[at] = cell
        widths[at] = max(_length(row[at]) for row in cells)
    on_the_right = set(right)
    return [
        _GAP.join(
            _padded(cell, wide, at in on_the_right)
            for at, (cell, wide) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    ]


class OneLine(list[Any]):
    """A list that YAML has in one line: `[1, 2, 3]`."""


def yaml_text(value: object) -> str:
    """The value as YAML in block style, its keys painted; maps keep their order."""
    import yaml  # only if YAML is printed

    class dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
        pass

    def in_one_line(dumper: Any, items: OneLine) -> Any:
        return dumper.represent_sequence("tag:yaml.org,2002:seq", items, flow_style=True)

    dumper.add_representer(OneLine, in_one_line)

    def dumped(*, allow_unicode: bool) -> str:
        return str(
            yaml.dump(
                value,
                Dumper=dumper,
                sort_keys=False,
                allow_unicode=allow_unicode,
                default_flow_style=False,
                width=_NEVER_FOLDED,
            )
        )

    text = dumped(allow_unicode=True)
    if not text.replace("\n", "").isprintable():
        # YAML leaves marks of direction and others as they are, unless it escapes all but ASCII.
        text = dumped(allow_unicode=False)
    text = text.removesuffix("\n...\n").rstrip("\n")  # YAML ends a scalar document so
    return text if not is_terminal() else "\n".join(map(_painted_key, text.splitlines()))


def _painted_key(line: str) -> str:
    return _YAML_KEY.sub(lambda found: found[1] + paint(found[2], "name") + found[3], line)


def _length(cell: str) -> int:
    return columns(click.unstyle(cell))


def _narrow(widths: list[int], room: int) -> None:
    while sum(widths) > room and max(widths) > 1:
        widths[widths.index(max(widths))] -= 1


def _cut_apart(cells: list[str], wide: int) -> list[str]:
    bare = list(map(click.unstyle, cells))
    shown = cut_apart(bare, wide)
    return [cell.replace(text, shown[text]) for cell, text in zip(cells, bare, strict=True)]


def _padded(cell: str, wide: int, right: bool) -> str:
    bare = click.unstyle(cell)
    if columns(bare) > wide:
        cell = cell.replace(bare, cut(bare, wide))
    space = " " * (wide - _length(cell))
    return space + cell if right else cell + space


def counted_transforms(dynamic: int, static: int) -> str:
    """`9,000 dynamic and 2 static transforms`; each static frame of a stream counts once, however
    often its transform is repeated.
    """
    if not static:
        return many(dynamic, "dynamic transform")
    text = many(static, "static transform")
    return f"{dynamic:,} dynamic and {text}" if dynamic else text


def with_transforms(messages: str, dynamic: int, static: int) -> str:
    """`60 messages with 9,000 dynamic transforms, and 2 static transforms`: messages of static
    transforms, which repeat, are not among the 60.
    """
    said = f"{messages} with {many(dynamic, 'dynamic transform')}" if dynamic else messages
    return f"{said}, and {many(static, 'static transform')}" if static else said


def many(count: int, noun: str) -> str:
    """A number of things, with commas: `9,000,000 transforms`."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"
