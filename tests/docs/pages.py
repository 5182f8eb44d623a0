"""The pages, their sections and the fenced blocks in them.

The HTML comment above a block, its rule, says how a reader uses it:

    <!-- goes on -->      the last command of the block runs until the section ends, in a terminal
                          of its own, and prints the lines shown, in any order
    <!-- typed: up q -->  the command has a terminal, and these keys are typed once it has printed
                          its lines
    <!-- numbers differ --> numbers in the output are not compared
    <!-- exits with 1 --> the last command of the block ends with that code; 0 otherwise
    <!-- file: x.py -->   the block is written to that file, whatever its language
    <!-- not run: why --> a python block is compiled only; of commands only names and options are
                          checked
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
CONFIGURATIONS = sorted((ROOT / "configs").glob("*.json5"))

FENCE = re.compile(
    r"(?:^<!--\s*(?P<rule>.*?)\s*-->\n)?^```(?P<language>\w*)\n(?P<text>.*?)^```$", re.M | re.S
)
_RULE = re.compile(r"(goes on|typed:|numbers differ|exits with|file:|not run:)\s*(.*)", re.S)


@dataclass(frozen=True)
class Block:
    """One fenced block of a page."""

    page: Path
    line: int
    language: str
    text: str
    rule: str
    rule_value: str

    @property
    def is_run(self) -> bool:
        return self.rule != "not run:"

    def __str__(self) -> str:
        return f"{name_of(self.page)}:{self.line}"


@dataclass(frozen=True)
class Section:
    """A heading of a page, and the blocks below it."""

    page: Path
    title: str
    blocks: tuple[Block, ...]

    def __str__(self) -> str:
        return f"{name_of(self.page)}: {self.title}"


@dataclass
class Command:
    """A command line, and the lines that the page says it prints."""

    line: str
    numbers_differ: bool
    output: list[str] = field(default_factory=list)
    interrupted: bool = False


def name_of(page: Path) -> str:
    """A page's path within the repository."""
    return str(page.relative_to(ROOT))


def sections(page: Path) -> Iterator[Section]:
    """The parts of a page that are run on their own."""
    at = 0
    text = page.read_text()
    for part in re.split(r"^(?=## )", text, flags=re.M):
        title = part.partition("\n")[0].strip("# ")
        blocks = tuple(_blocks(page, part, text.count("\n", 0, at) + 1))
        at += len(part)
        if blocks:
            yield Section(page, title, blocks)


def _blocks(page: Path, part: str, first_line: int) -> Iterator[Block]:
    for found in FENCE.finditer(part):
        line = first_line + part.count("\n", 0, found.start("text")) - 1
        rule = _RULE.fullmatch(found["rule"] or "")
        yield Block(
            page, line, found["language"], found["text"], *(rule.groups() if rule else ("", ""))
        )


def commands(block: Block) -> list[Command]:
    """The commands of a console block, lines that end in a backslash joined."""
    found: list[Command] = []
    for line in block.text.replace("\\\n", "").splitlines():
        if line.startswith("$ "):
            found.append(Command(line[2:], block.rule == "numbers differ"))
        elif line == "^C":
            found[-1].interrupted = True
        else:
            assert found, f"{block}: a console block begins with '$ '"
            found[-1].output.append(line)
    return found
