"""The house: imports point downwards, one package knows Zenoh, nodes stand on few rooms."""

import ast
import importlib
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.sources import ROOT, source_of

# Lowest first. A package imports packages of lower storeys, and none of its own storey. A
# folder of a package that is listed here is a room of its own.
STOREYS = [
    {"base"},
    {"geometry", "messages"},
    {"buffer", "robot", "sensor_files", "wire"},
    {"ros"},
    {"recording"},
    {"bus"},
    {"command", "testing"},
    {"node"},
    {"streams"},
    {"bag", "frames"},
    {"compat", "doctor", "foxglove", "inspect", "launch", "ros.bridge", "top", "view"},
    {"cli"},
]
RANK = {package: rank for rank, storey in enumerate(STOREYS) for package in storey}


def sources(folder: str) -> list[Path]:
    """The source files below a folder of the repository, templates left out."""
    found = [path for path in sorted((ROOT / folder).rglob("*.py")) if "template" not in path.parts]
    assert found, f"no source files below {folder}/"
    return found


def room_of(name: str) -> str:
    """What of the storeys a dotted name below `tfbus` belongs to; else its first part."""
    above = name.split(".")
    rooms = (".".join(above[:depth]) for depth in range(len(above), 0, -1))
    return next((room for room in rooms if room in RANK), above[0])


def package_of(path: Path) -> str:
    """The package, or file, below tfbus/ that a source file belongs to."""
    return room_of(".".join(path.relative_to(ROOT / "tfbus").with_suffix("").parts))


def imports(path: Path) -> frozenset[str]:
    """Every dotted name that a file imports absolutely, anywhere in it."""
    return source_of(path).imports


def packages_used(path: Path) -> set[str]:
    """The packages below tfbus/ of all that a source file, or a .pxd file, imports."""
    if path.suffix == ".pxd":
        return set(re.findall(r"^\s*(?:from|cimport) tfbus\.(\w+)", path.read_text(), re.M))
    return {room_of(name.removeprefix("tfbus.")) for name in imports(path) if is_of_tfbus(name)}


def is_of_tfbus(name: str) -> bool:
    """Whether a dotted name is one below `tfbus`."""
    return name.partition(".")[0] == "tfbus"


def libraries(path: Path) -> set[str]:
    """The top-level packages that a file imports."""
    return {name.partition(".")[0] for name in imports(path)}


LIBRARY = [path for path in sources("tfbus") if path.parent.name != "tfbus" or path.stem in RANK]


def test_every_package_has_a_storey_and_says_its_job() -> None:
    """Each package stands on one storey; its __init__.py says its job in one sentence."""
    assert {package_of(path) for path in sources("tfbus")} == {*RANK, "__init__", "__main__"}
    for folder in {path.parent for path in LIBRARY} - {ROOT / "tfbus"}:
        said = source_of(folder / "__init__.py").docstrings[0]
        assert said and len(said.split("\n\n")[0].splitlines()) <= 2, folder


COMPILED = sorted((ROOT / "tfbus").rglob("*.pxd"))
assert COMPILED


def test_imports_point_downwards() -> None:
    """A file imports its own package and packages of lower storeys, by their full names."""
    own_names, upward, relative = set(), set(), set()
    for path in LIBRARY + COMPILED:
        own, used = package_of(path), packages_used(path)
        upward |= {(path, other) for other in used - {own} if RANK.get(other, 99) >= RANK[own]}
        own_names |= {(path, other) for other in used - {*RANK, "nodes"}}
        if path.suffix == ".py" and source_of(path).is_relative:
            relative.add(path)
    assert own_names == set(), "the library does not import tfbus's own public names"
    assert upward == set()
    assert relative == set()


# Each star stands on public names, on `frames`, and on the ground; besides, on no
# package that is not listed here. `cli` opens the doors of the others.
GROUND = {"base", "frames", "inspect", "messages"}
STARS: dict[str, set[str]] = {
    "view": {
        *("bus", "command", "geometry", "node", "recording", "robot", "streams", "wire"),
    },
    "foxglove": {
        *("bag", "bus", "command", "geometry", "node", "recording", "robot", "ros", "streams"),
        "wire",
    },
    "ros.bridge": {"bus", "command", "geometry", "node", "ros", "streams", "wire"},
    "compat": {"buffer", "bus", "geometry", "node", "ros", "wire"},
    "top": set(),
    "doctor": {"buffer", "bus", "geometry", "ros", "wire"},
    "bag": {"bus", "geometry", "node", "recording", "ros", "streams", "wire"},
    "launch": {"bus", "wire"},
    "cli": {
        *("bag", "buffer", "bus", "command", "compat", "doctor", "geometry", "launch", "node"),
        *("recording", "ros", "sensor_files", "top", "wire"),
    },
}


@cache
def public_names() -> frozenset[str]:
    """The dotted names, as they are defined, that are public in `tfbus` or `tfbus.inspect`."""
    doors = [importlib.import_module(door) for door in ("tfbus", "tfbus.inspect")]
    values = [(name, getattr(door, name)) for door in doors for name in door.__all__]
    return frozenset(f"{value.__module__}.{name}" for name, value in values)


@pytest.mark.parametrize("star", STARS)
def test_a_star_stands_on_public_names_and_on_frames(star: str) -> None:
    """It imports nothing else but what the table grants it."""
    used = {
        (room_of(name.removeprefix("tfbus.")), name)
        for path in LIBRARY
        if package_of(path) == star
        for name in imports(path)
        if name.startswith("tfbus.") and name not in public_names()
    }
    assert {pair for pair in used if pair[0] not in STARS[star] | GROUND | {star}} == set()


def test_no_star_imports_another_star() -> None:
    """But for the command line and the player of recordings."""
    leaning = {(star, other) for star, granted in STARS.items() for other in granted & STARS.keys()}
    leaning = {pair for pair in leaning if pair[0] != "cli"}
    assert leaning <= {("foxglove", "bag")}


@pytest.mark.parametrize(
    "halves",
    [
        (
            ["launch/arguments", "launch/description", "launch/find", "launch/reader"],
            ["launch.child", "launch.console", "launch.guard", "launch.run", "launch.supervisor"],
        ),
        (
            ["launch/child", "launch/console", "launch/guard", "launch/run", "launch/supervisor"],
            ["launch.arguments", "launch.find", "launch.reader"],
        ),
        (
            ["view/frames", "view/replay", "view/robots", "view/settings", "view/timeline"],
            ["view.page", "view.panels", "view.scene"],
        ),
    ],
)
def test_halves_do_not_know_each_other(halves: tuple[list[str], list[str]]) -> None:
    """Reading and running launch files are apart, and the view's model knows no page."""
    lower, upper = halves
    files = [
        path
        for path in sources("tfbus")
        if any(f"{path.relative_to(ROOT / 'tfbus')}".startswith(half) for half in lower)
    ]
    assert files
    used = {f"{name}." for path in files for name in imports(path)}
    assert not [name for name in used if any(f"tfbus.{half}." in name for half in upper)]


def test_a_bridge_and_its_legs_share_the_contract_of_a_leg_only() -> None:
    """A leg imports nothing of the bridge, and the bridge nothing of a leg."""
    for path in sources("tfbus/ros/bridge"):
        is_leg = path.parent.name == "legs"
        for name in imports(path):
            if name.startswith("tfbus.ros.bridge."):
                is_of_legs = name.startswith("tfbus.ros.bridge.legs.")
                is_of_one = is_of_legs and name.count(".") > 4
                assert is_of_legs if is_leg else not is_of_one, (path, name)


def test_the_architecture_page_has_these_storeys() -> None:
    """The table of docs/internals/architecture.md is that of this file."""
    page = (ROOT / "docs" / "internals" / "architecture.md").read_text()
    rows = re.findall(r"^\| (\d*) ?\| `([\w.]+)` \|", page, re.M)
    told: dict[str, int] = {}
    storey = 0
    for number, package in rows:
        storey = int(number) if number else storey
        told[package] = storey
    assert told == {package: rank + 1 for package, rank in RANK.items()}


def test_only_the_bus_imports_zenoh() -> None:
    """Zenoh is spoken to by tfbus/bus alone, its unstable extensions by one file of it, and its
    model has its values.
    """
    users = {path for path in LIBRARY + sources("nodes") if "zenoh" in libraries(path)}
    assert {path.parent.name for path in users} == {"bus", "testing"}
    unstable = {
        path.name for path in users if any(n.startswith("zenoh.ext") for n in imports(path))
    }
    assert unstable == {"retained.py"}


# Python's own of these are in base/scheduler.py alone. Programs, bridges and windows have them,
# too, for which a simulation has stand-ins (testing/of_python.py), and files that have to do with
# the real machine.
WAITING = {"_thread", "queue", "sched", "select", "selectors", "threading", "time"}
PROGRAMS = {
    *("cli", "command", "compat", "doctor", "foxglove", "launch", "ros", "ros.bridge"),
    *("testing", "top", "view"),
}
REAL = {
    "base/scheduler.py": "it is the one place",
    "base/signals.py": "signals come to the main thread of a real process",
    "base/callbacks.py": "what belongs to a thread of Python's",
    "buffer/lock.py": "C's own, or a lock that a signal handler may enter",
    "bus/callbacks.py": "the state that Python keeps of Zenoh's threads",
    "bus/neighbours.py": "the sockets of the real network",
    "bus/network_session.py": "the end of a process",
}


def test_time_threads_and_waiting_come_from_the_scheduler() -> None:
    """The core takes time, threads and queues from base/scheduler.py."""
    core = [path for path in LIBRARY if package_of(path) not in PROGRAMS]
    users = {str(path.relative_to(ROOT / "tfbus")) for path in core if libraries(path) & WAITING}
    assert users == REAL.keys()


def _at_import(tree: ast.AST) -> Iterator[ast.AST]:
    """The parts of a file that run at its import: not bodies of functions, nor annotations."""
    for name, value in ast.iter_fields(tree):
        is_body = name == "body" and isinstance(tree, FUNCTIONS)
        if not is_body and name not in ("annotation", "returns"):
            for each in value if isinstance(value, list) else [value]:
                if isinstance(each, ast.AST):
                    yield each
                    yield from _at_import(each)


FUNCTIONS = ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda


def test_names_of_the_scheduler_are_looked_up_when_they_are_used() -> None:
    """A simulation replaces them: no file binds one at its import, as a default of an argument."""
    for path in LIBRARY:
        assert not [name for name in imports(path) if name.startswith(f"{SCHEDULER}.")], path
        if SCHEDULER in imports(path):
            tree = ast.parse(path.read_text())
            bound = [
                ast.unparse(each) for each in _at_import(tree) if isinstance(each, ast.Attribute)
            ]
            assert not [text for text in bound if text.startswith("scheduler.")], path


SCHEDULER = "tfbus.base.scheduler"


@pytest.mark.parametrize("package", ["geometry", "buffer", "robot"])
def test_transforms_and_the_buffer_know_nothing_of_the_bus(package: str) -> None:
    """Transforms and the buffer are usable without Zenoh, msgpack and click."""
    used = {name for path in sources(f"tfbus/{package}") for name in libraries(path)}
    assert used - {"tfbus", "numpy", "cython", *sys.stdlib_module_names} <= {"scipy", "xacro"}


def test_the_library_knows_no_node() -> None:
    """Nodes use the library, never the other way round."""
    used = {(path, name) for path in LIBRARY for name in imports(path)}
    assert not {pair for pair in used if pair[1].startswith("tfbus.nodes")}


# Besides public names nodes use these rooms, as the commands of `cli` do, and import each name
# from the file that has it.
ROOMS_OF_NODES = {"base", "command", "foxglove", "frames", "messages", "ros", "ros.bridge", "view"}


def test_nodes_use_public_names_and_the_rooms_of_command_lines() -> None:
    """A node imports nothing else of tfbus, and its neighbours relatively."""
    public = set(importlib.import_module("tfbus").__all__)
    for path, name in sorted((node, name) for node in sources("nodes") for name in imports(node)):
        if is_of_tfbus(name):
            within = name.removeprefix("tfbus.")
            assert within in public or room_of(within) in ROOMS_OF_NODES, (path, name)
            assert not name.rpartition(".")[2].startswith("_"), (path, name)


# All import statements, and lines of texts that look like one.
_IMPORT = re.compile(r"^\s*(?:from|import)\s[^\n(]*(?:\([^)]*)?", re.M)


def test_no_test_imports_another() -> None:
    """What several tests share stands in a module of its own, such as tests/builders.py."""
    # To parse them all takes seconds.
    paths = [
        path
        for path in sources("tests")
        if any("test_" in found for found in _IMPORT.findall(path.read_text()))
    ]
    used = {(path.name, name) for path in paths for name in imports(path)}
    assert not {pair for pair in used if pair[1].startswith("tests.") and ".test_" in pair[1]}
