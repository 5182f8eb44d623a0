"""README.md and docs/ keep their word: what they show is run, and gives what they say.

A section (a `##` heading and what follows) is run from top to bottom as a reader would, in one
folder and on one bus of its own. What happens to a fenced block is decided by its language and
the HTML comment above it:

    ```console            each `$ ` line is run; what follows it is what it prints, `...` for any
                          lines, `^C` for the Ctrl-C that ends it
    <!-- goes on -->      the last command of the block goes on until the end of the section, in
                          a terminal of its own, and prints the lines shown, in any order
    <!-- typed: up q -->  is given a terminal, and these keys once it has printed its lines
    <!-- numbers differ --> numbers in the output are not compared
    <!-- exits with 1 --> the last command of the block ends with that code; 0 otherwise
    ```python             is run to its end, as a program
    <!-- file: x.py -->   is written to that file instead, whatever its language
    ```yaml               is a launch file, and read as one
    <!-- not run: why --> a python block is only compiled, of commands only names and options are
                          checked
    ```text               is no program

What differs between two runs (stamps, process ids, ports) is not compared.
"""

import json
import os
import pty
import re
import shlex
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import click
import pytest
import zenoh

import tfbus.messages
from tests.live_bus import DEADLINE_S, Bus, Process, eventually, free_port
from tests.wire.test_transforms import SAMPLE
from tfbus.cli import main

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
CONFIGURATIONS = sorted((ROOT / "configs").glob("*.json5"))

# With the command `tfbus` of this environment, activated or not.
PATH = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

# The port of the router in the docs; here another one that is free.
ROUTER_PORT = "7447"

_FENCE = re.compile(
    r"(?:^<!--\s*(?P<rule>.*?)\s*-->\n)?^```(?P<language>\w*)\n(?P<text>.*?)^```$", re.M | re.S
)
_RULE = re.compile(r"(goes on|typed:|numbers differ|exits with|file:|not run:)\s*(.*)", re.S)

_DIFFERS = [
    (re.compile(r"\b\d{10}\.\d{9}\b|\b\d{19}\b"), "STAMP"),
    (re.compile(r"\b([Pp]id:? \[?)\d+"), r"\1PID"),
    (re.compile(r"(Host: ).+"), r"\1HOST"),
    (re.compile(r"(Up: )\d+ s"), r"\1TIME"),
    (re.compile(r"\b[0-9a-f]{32}\b|(?<=_)[0-9a-f]{8}\b"), "ID"),
]

_KEYS = {"up": b"\x1b[A", "down": b"\x1b[B", "right": b"\x1b[C", "left": b"\x1b[D"}
_NUMBER = re.compile(r"-?\d+\.\d+")


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


@dataclass(frozen=True)
class Section:
    """A heading of a page, and the blocks below it."""

    page: Path
    title: str
    blocks: tuple[Block, ...]

    def __str__(self) -> str:
        return f"{self.page.name}: {self.title}"


@dataclass
class Command:
    """A command line, and the lines that it prints by what the page says."""

    line: str
    numbers_differ: bool
    output: list[str] = field(default_factory=list)
    interrupted: bool = False


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
    for found in _FENCE.finditer(part):
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
            assert found, f"{block.page.name}:{block.line}: a console block begins with '$ '"
            found[-1].output.append(line)
    return found


def same(line: str, numbers_differ: bool = False) -> str:
    """The line without what differs between two runs."""
    if numbers_differ:
        line = _NUMBER.sub("0", line)
    for pattern, stands_for in _DIFFERS:
        line = pattern.sub(stands_for, line)
    return line.rstrip()


SECTIONS = [section for page in PAGES for section in sections(page)]
BLOCKS = [block for section in SECTIONS for block in section.blocks]


class Reader:
    """Does what a section says, in a folder and on a bus."""

    def __init__(self, bus: Bus, folder: Path):
        self._bus = bus
        self._folder = folder
        self._port = str(free_port())
        self._env = bus.env | {
            "PATH": PATH,
            "ZENOH_CONFIG": str(_for_plain_zenoh(bus, folder / "zenoh.json5")),
        }
        self._going_on: list[Process] = []
        _copy_configurations(folder / "configs")

    def follow(self, block: Block) -> None:
        """Do what one block says."""
        text = block.text.replace(ROUTER_PORT, self._port)
        if block.rule == "file:":
            (self._folder / block.rule_value).write_text(text)
        elif block.language == "python":
            self._run([sys.executable, "-c", text])
        elif block.language == "yaml":
            (self._folder / "block.yaml").write_text(text)
            self._run([sys.executable, "-m", "tfbus", "launch", "./block.yaml", "--dry-run"])
        elif block.language == "console":
            *others, last = commands(block)
            for command in others:
                self._do(command)
            if block.rule == "goes on":
                self._going_on.append(self._start(last))
            elif block.rule == "typed:":
                self._type(last, block.rule_value.split())
            else:
                self._do(last, exit_code=int(block.rule_value or 0))

    def end(self) -> None:
        """Press Ctrl-C in every terminal where something goes on, the last one first."""
        for process in reversed(self._going_on):
            assert process.stop() == 0, f"{process.command}: {process.err}"

    def _do(self, command: Command, exit_code: int = 0) -> None:
        if command.interrupted:
            assert self._start(command).stop() == exit_code
            return
        printed = self._run(["bash", "-c", self._here(command.line)], exit_code)
        assert _matches(
            [same(line, command.numbers_differ) for line in printed.splitlines()],
            [same(self._here(line), command.numbers_differ) for line in command.output],
        ), f"$ {command.line}\nprinted:\n{printed}"

    def _type(self, command: Command, keys: list[str]) -> None:
        keyboard, terminal = pty.openpty()
        at_terminal = f"exec {command.line} <{os.ttyname(terminal)}"
        process = self._start(replace(command, line=at_terminal))
        for key in keys:
            os.write(keyboard, _KEYS.get(key, key.encode()))
        assert process.wait() == 0
        os.close(keyboard)
        os.close(terminal)

    def _start(self, command: Command) -> Process:
        process = self._bus.start_command(
            ["bash", "-c", self._here(command.line)], env=self._env, cwd=self._folder
        )
        wanted = {same(self._here(line)) for line in command.output} - {"..."}

        def missing() -> set[str]:
            return wanted - {same(line) for line in [*process.out, *process.err]}

        try:
            eventually(lambda: not missing())
        except AssertionError:
            raise AssertionError(
                f"$ {command.line}\ndid not print: {sorted(missing())}\n"
                f"but: {process.out}\n{process.err}"
            ) from None
        return process

    def _run(self, command: list[str], exit_code: int = 0) -> str:
        done = subprocess.run(
            command,
            env=self._env,
            cwd=self._folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=3 * DEADLINE_S,
        )
        assert done.returncode == exit_code, (
            f"{command} ended with {done.returncode}: {done.stdout}"
        )
        return done.stdout

    def _here(self, line: str) -> str:
        return line.replace(ROUTER_PORT, self._port)


def _copy_configurations(folder: Path) -> None:
    """configs/*.json5 without multicast, which would reach other buses than the test's."""
    folder.mkdir()
    for path in CONFIGURATIONS:
        (folder / path.name).write_text(str(quiet(path)))


def _for_plain_zenoh(bus: Bus, path: Path) -> Path:
    """A configuration for programs that know nothing of tfbus's own settings."""
    config = zenoh.Config.from_file(bus.config)
    config.insert_json5("connect/endpoints", json.dumps([bus.endpoint]))
    path.write_text(str(config))
    return path


def quiet(path: Path) -> zenoh.Config:
    """A configuration file, with multicast off."""
    config = zenoh.Config.from_file(path)
    config.insert_json5("scouting/multicast/enabled", "false")
    return config


def _matches(printed: list[str], shown: list[str]) -> bool:
    """Whether the lines are those shown, where `...` stands for any number of lines."""
    if not shown:
        return not printed
    if shown[0] == "...":
        return any(_matches(printed[at:], shown[1:]) for at in range(len(printed) + 1))
    return bool(printed) and printed[0] == shown[0] and _matches(printed[1:], shown[1:])


@pytest.mark.parametrize(
    "section", [section for section in SECTIONS if any(b.is_run for b in section.blocks)], ids=str
)
def test_what_a_page_shows_works(section: Section, bus: Bus, tmp_path: Path) -> None:
    """Every command and program of the docs runs, and prints what the page says."""
    folder = tmp_path / "reader"
    folder.mkdir()
    reader = Reader(bus, folder)
    for block in section.blocks:
        if block.is_run:
            reader.follow(block)
    reader.end()


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: f"{block.page.name}:{block.line}")
def test_every_block_says_what_it_is(block: Block) -> None:
    """A block has a language; one that is not run has its reason, and is sound all the same."""
    assert block.language, "write ```text where it is no program"
    if block.rule == "not run:":
        assert block.rule_value, "say why it is not run"
    if block.language == "python":
        compile(block.text, f"{block.page.name}:{block.line}", "exec")


@pytest.mark.parametrize("page", [*PAGES, *CONFIGURATIONS], ids=lambda page: page.name)
def test_every_command_and_option_that_is_mentioned_exists(page: Path) -> None:
    """`tfbus NAME --option` is known to tfbus wherever a page writes it, run or not."""
    text = page.read_text().replace("\\\n", "")
    mentioned = re.findall(
        r"^(?:\w*\$ | {4,}|// +)?(tfbus [a-z].*)$|`(tfbus [a-z][^`]*)`", text, re.M
    )
    for line in filter(None, (block or inline for block, inline in mentioned)):
        check_command_line(shlex.split(line.split(" | ")[0], comments=True)[1:])


def check_command_line(words: list[str]) -> None:
    """Fail where tfbus has no such command, or the command no such option."""
    if words[:1] == ["my_node"]:
        return  # of the package that `tfbus create` writes; tests/installed.py runs it
    command: click.Command = main
    context = click.Context(command)
    while isinstance(command, click.Group) and words:
        known = command.get_command(context, words[0])
        assert known is not None, f"there is no command {words[0]!r}"
        command, words = known, words[1:]
    options = {option for parameter in command.params for option in parameter.opts}
    for word in words:
        if word.startswith("--"):
            assert word.partition("=")[0] in {*options, "--help"}, f"{word} of {command.name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    """Every link between the pages leads to a file, and to a heading of it where it names one."""
    for link in re.findall(r"\]\(([^)\s]+)\)", _FENCE.sub("", page.read_text())):
        if "://" in link:
            continue
        path, _, heading = unquote(link).partition("#")
        target = (page.parent / path) if path else page
        assert target.exists(), f"{page.name} links to {link}"
        if heading:
            assert heading in headings(target), f"{page.name} links to {link}"


def headings(page: Path) -> set[str]:
    """The headings of a page as links name them."""
    titles = re.findall(r"^#+ (.*)$", _FENCE.sub("", page.read_text()), re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("name", ["peer", "client", "router"])
def test_a_supplied_configuration_says_what_it_is_for(name: str) -> None:
    """configs/NAME.json5 is a file that Zenoh reads, for that mode, with timestamps on."""
    config = zenoh.Config.from_file(ROOT / "configs" / f"{name}.json5")
    assert config.get_json("mode") == f'"{name}"'
    assert config.get_json("timestamping/enabled") == "true"


def test_the_supplied_configurations_work_together(bus: Bus, tmp_path: Path) -> None:
    """A client and a peer, each with its supplied configuration, meet at a router with its own."""
    _copy_configurations(tmp_path / "configs")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = bus.start(
        *("router", "--config", f"{tmp_path}/configs/router.json5", "--listen", endpoint)
    )
    router.wait_for_line("Routing on")
    at_router = ("--connect", endpoint)
    static = bus.start(
        *("static", "world", "camera", "--x", "1", *at_router),
        *("--config", f"{tmp_path}/configs/peer.json5", "--listen", "tcp/127.0.0.1:0"),
    )
    echo = bus.run(
        *("echo", "world", "camera", "--once", "--timeout", "10", *at_router),
        *("--config", f"{tmp_path}/configs/client.json5"),
    )
    assert "- Translation: [1.000, 0.000, 0.000]" in echo.stdout
    for process in (static, router):
        assert process.stop(signal.SIGTERM) == 0


def test_the_sample_in_the_docs_is_the_frozen_one() -> None:
    """docs/wire.md takes the frozen sample apart, byte by byte."""
    (shown,) = re.findall(
        r"<!-- sample -->\n```text\n(.*?)```", (ROOT / "docs" / "wire.md").read_text(), re.S
    )
    assert bytes.fromhex("".join(re.split("  +", line)[0] for line in shown.splitlines())) == SAMPLE


@pytest.mark.parametrize(
    "path",
    [*(ROOT / "tfbus").glob("*.py"), *(ROOT / "tfbus").glob("*/")],
    ids=lambda path: path.name,
)
def test_the_architecture_page_knows_every_file(path: Path) -> None:
    """docs/architecture.md says of every file and folder of the library what it is for."""
    name = f"`{path.name}/`" if path.is_dir() else f"`{path.name}`"
    if path.name != "__pycache__":
        assert name in (ROOT / "docs" / "architecture.md").read_text()


def test_the_architecture_page_knows_every_dependency() -> None:
    """docs/architecture.md says of every package that tfbus depends on why."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = chain(project["dependencies"], *project["optional-dependencies"].values())
    names = {re.split(r"[^\w-]", entry)[0] for entry in needed} - {"tfbus"}
    text = (ROOT / "docs" / "architecture.md").read_text()
    assert {name for name in names if name not in text} == set()


def message_types() -> Iterator[tuple[str, Any]]:
    """The dataclasses of tfbus.messages, those of services and goals by their outer name."""
    for name, value in vars(tfbus.messages).items():
        if isinstance(value, type) and value.__module__ == "tfbus.messages":
            for message_type in filter(is_dataclass, (value, *vars(value).values())):
                yield name, message_type


@pytest.mark.parametrize(("name", "message_type"), list(message_types()), ids=str)
def test_the_messages_page_knows_every_field(name: str, message_type: Any) -> None:
    """docs/messages.md names every message of tfbus.messages, with all its fields."""
    text = (ROOT / "docs" / "messages.md").read_text()
    assert f"`{name}`" in text
    assert [entry.name for entry in fields(message_type) if f"`{entry.name}`" not in text] == []


def test_the_picture_in_the_readme_can_be_made_again(bus: Bus) -> None:
    """docs/picture.yaml, which makes docs/turtle.png, is a launch file without mistakes."""
    dry = bus.run("launch", str(ROOT / "docs" / "picture.yaml"), "--dry-run", env={"PATH": PATH})
    assert dry.returncode == 0, dry.stderr
    assert f"--screenshot {ROOT}/docs/turtle.png" in dry.stdout
