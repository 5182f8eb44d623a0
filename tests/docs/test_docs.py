"""README.md and docs/ keep their word: the shown commands run, and print the shown output.

A section (a `##` heading and its text) is run from top to bottom as a reader would, in one
folder and on a bus of its own. The language of a fenced block decides what happens to it:

    ```console            each `$ ` line is run; its output follows it, `...` for any
                          lines, `^C` for the Ctrl-C that ends it
    ```python             is run to its end, as a program
    ```yaml               is a launch file, and read as one
    ```text               is no program

The comment above a block changes that; tests/docs/pages.py lists the comments. Parts that
differ between two runs (stamps, process ids, ports) are not compared.

Sections run on a simulated bus if they can (tests/docs/simulated_shell.py), and in real shells
otherwise: sections of windows, browsers, routers, pipes, typed keys, and of README.md.
"""

import re
import shlex
from pathlib import Path
from urllib.parse import unquote

import click
import pytest

from tests import live_bus, simulated_bus
from tests.docs.pages import CONFIGURATIONS, FENCE, PAGES, ROOT, Section, name_of, sections
from tests.docs.reader import Reader
from tests.docs.real_shell import PATH, RealShell
from tests.docs.simulated_shell import SimulatedShell, can_follow
from tfbus.cli import main

SECTIONS = [section for page in PAGES for section in sections(page)]


RUN = [section for section in SECTIONS if any(block.is_run for block in section.blocks)]
REAL = [each for each in RUN if name_of(each.page) == "README.md" or not can_follow(each)]
SIMULATED = [each for each in RUN if each not in REAL]


@pytest.mark.real
@pytest.mark.parametrize("section", REAL, ids=str)
def test_what_a_page_shows_works(section: Section, bus: live_bus.Bus, tmp_path: Path) -> None:
    """Every command and program of the docs runs, and prints what the page says."""
    folder = tmp_path / "reader"
    folder.mkdir()
    follow(section, RealShell(bus, folder))


@pytest.mark.parametrize("section", SIMULATED, ids=str)
def test_what_a_page_shows_works_on_a_simulated_bus(
    section: Section, bus: simulated_bus.Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So it does where time is virtual."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    shell = SimulatedShell(bus, tmp_path)
    try:
        follow(section, shell)
    finally:
        shell.forget_modules()


def follow(section: Section, shell: RealShell | SimulatedShell) -> None:
    """Do what a section says, from top to bottom."""
    reader = Reader(shell)
    for block in section.blocks:
        if block.is_run:
            reader.follow(block)
    reader.end()


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_block_says_what_it_is(page: Path) -> None:
    """A block has a language; one that is not run gives its reason, and compiles all the same."""
    for block in (block for section in sections(page) for block in section.blocks):
        assert block.language, f"{block}: write ```text where it is no program"
        if block.rule == "not run:":
            assert block.rule_value, f"{block}: say why it is not run"
        if block.language == "python":
            compile(block.text, str(block), "exec")


@pytest.mark.parametrize("page", [*PAGES, *CONFIGURATIONS], ids=name_of)
def test_every_command_and_option_on_a_page_exists(page: Path) -> None:
    """tfbus knows `tfbus NAME --option` wherever a page writes it, run or not."""
    text = page.read_text().replace("\\\n", "")
    fenced = "\n".join(block["text"] for block in FENCE.finditer(text))
    mentioned = [
        *re.findall(r"^(?:\w*\$ +)?(tfbus [a-z].*)$", fenced, re.M),
        *re.findall(r"^(?: {4,}|// +)(tfbus [a-z].*)$", text, re.M),
        *re.findall(r"`(tfbus [a-z][^`]*)`", FENCE.sub("", text)),
    ]
    for line in mentioned:
        check_command_line(shlex.split(line.split(" | ")[0], comments=True)[1:])


def check_command_line(words: list[str]) -> None:
    """Fail where tfbus has no such command, or the command no such option."""
    if words[:1] == ["my_node"]:
        return  # of the package that `tfbus create` writes; tests/installed.py runs it
    command: click.Command = main
    context = click.Context(command)
    while isinstance(command, click.Group) and words and words[0] != "[OPTIONS]":
        known = command.get_command(context, words[0])
        assert known is not None, f"there is no command {words[0]!r}"
        command, words = known, words[1:]
    options = {option for parameter in command.params for option in parameter.opts}
    for word in words:
        if word.startswith("--"):
            assert word.partition("=")[0] in {*options, "--help"}, f"{word} of {command.name}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page: Path) -> None:
    """Every link between the pages leads to a file, and to a heading of it where it names one."""
    for link in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", page.read_text())):
        if "://" in link:
            continue
        path, _, heading = unquote(link).partition("#")
        target = (page.parent / path) if path else page
        assert target.exists(), f"{name_of(page)} links to {link}"
        if heading:
            assert heading in headings(target), f"{name_of(page)} links to {link}"


def headings(page: Path) -> set[str]:
    """The headings of a page as links name them."""
    titles = re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text()), re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_every_page_and_example_is_in_the_index() -> None:
    """docs/README.md links to every page of docs/ and every program of examples/."""
    index = (ROOT / "docs" / "README.md").read_text()
    paths = {str(page.relative_to(ROOT / "docs")) for page in (ROOT / "docs").rglob("*.md")}
    paths |= {f"../examples/{path.name}" for path in (ROOT / "examples").glob("*.*")}
    assert {path for path in paths - {"README.md"} if f"({path})" not in index} == set()


def test_the_launch_file_of_the_picture_has_no_mistakes(bus: simulated_bus.Bus) -> None:
    """docs/images/picture.yaml, which makes turtle.png, can be started."""
    images = ROOT / "docs" / "images"
    dry = bus.run("launch", str(images / "picture.yaml"), "--dry-run", env={"PATH": PATH})
    assert dry.returncode == 0, dry.stderr
    assert f"--screenshot {images}/turtle.png" in dry.stdout
