"""Pages that promise to be complete are complete."""

import re
import tomllib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from itertools import chain
from typing import Any

import pytest

import tfbus
import tfbus.messages
import tfbus.testing
from docs import api, commands
from tests.builders import SAMPLE
from tests.docs.pages import ROOT

ARCHITECTURE = ROOT / "docs" / "internals" / "architecture.md"
REFERENCE = ROOT / "docs" / "reference"


def test_the_api_page_is_up_to_date() -> None:
    """docs/reference/api.md is what `make docs-api` writes."""
    assert (REFERENCE / "api.md").read_text() == api.page(), "run `make docs-api`"


def test_the_page_of_commands_is_up_to_date() -> None:
    """docs/reference/commands.md is what `make docs-api` writes."""
    assert (REFERENCE / "commands.md").read_text() == commands.page(), "run `make docs-api`"


def test_the_api_page_has_every_public_name() -> None:
    """Each name of tfbus and of tfbus.testing has a heading."""
    page = (REFERENCE / "api.md").read_text()
    names = [*tfbus.__all__, *tfbus.testing.__all__]
    assert [name for name in names if f"\n### {name}\n" not in page] == []


def message_types() -> Iterator[tuple[str, Any]]:
    """The dataclasses of tfbus.messages, those of services and actions by their outer name."""
    for name, value in vars(tfbus.messages).items():
        if isinstance(value, type) and value.__module__.startswith("tfbus.messages"):
            for message_type in filter(is_dataclass, (value, *vars(value).values())):
                yield name, message_type


@pytest.mark.parametrize(("name", "message_type"), list(message_types()), ids=str)
def test_the_pages_know_every_message_and_field(name: str, message_type: Any) -> None:
    """The API page has each message, and docs/reference/messages.md its fields, but for types that
    are on the bus as in ROS.
    """
    assert f"\n### {name}\n" in (REFERENCE / "api.md").read_text()
    text = (REFERENCE / "messages.md").read_text()
    if not hasattr(message_type, "__msgtype__"):
        assert f"`{name}`" in text
        assert [entry.name for entry in fields(message_type) if f"`{entry.name}`" not in text] == []


def test_the_sample_in_the_docs_is_the_frozen_one() -> None:
    """docs/reference/wire.md takes the frozen sample apart, byte by byte."""
    (shown,) = re.findall(
        r"<!-- sample -->\n```text\n(.*?)```", (REFERENCE / "wire.md").read_text(), re.S
    )
    assert bytes.fromhex("".join(re.split("  +", line)[0] for line in shown.splitlines())) == SAMPLE


def test_the_architecture_page_knows_every_package() -> None:
    """docs/internals/architecture.md says of every package of the library what its job is."""
    text = ARCHITECTURE.read_text()
    names = {path.parent.name for path in (ROOT / "tfbus").glob("*/__init__.py")}
    names |= {path.stem for path in (ROOT / "tfbus").glob("[a-z]*.py")}
    assert {name for name in names if f"`{name}`" not in text} == set()


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/internals/architecture.md"])
def test_the_pages_for_contributors_name_files_that_are_there(page: str) -> None:
    """Each path of Python is that of a file or folder, from the clone or from tfbus/."""
    paths = set(re.findall(r"`([\w*]+/[\w*/]+\.py|tfbus/[\w/]+/)`", (ROOT / page).read_text()))
    assert paths != set()
    missing = {path for path in paths if not [*ROOT.glob(path), *ROOT.glob(f"tfbus/{path}")]}
    assert missing - {"tfbus/cli/NAME.py"} == set()


def test_the_architecture_page_knows_every_dependency() -> None:
    """docs/internals/architecture.md says of every package that tfbus depends on why."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = chain(project["dependencies"], *project["optional-dependencies"].values())
    names = {re.split(r"[^\w-]", entry)[0] for entry in needed} - {"tfbus"}
    text = ARCHITECTURE.read_text()
    assert {name for name in names if name not in text} == set()
