"""Imports point one way: a lower module never knows of a higher one."""

import ast
import importlib
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

# Lowest first; the modules of a line may import those of lower lines, and each other.
LAYERS = [
    {
        "errors",
        "version",
        "signals",
        "clock",
        "log",
        "frame",
        "rejections",
        "change",
        "outcome",
        "octets",
        "sampling",
        "uncompiled",
        "words",
    },
    {"values", "numbers"},
    {"kernel", "time_order"},
    {"sweep"},
    {"transform"},
    {"rotation_arrays"},
    {"batch", "transform_array", "twist", "describe"},
    {"columns", "one_message"},
    {"tree"},
    {"intake"},
    {"explain", "waiting", "freshness", "shortfall"},
    {"store"},
    {"answering"},
    {"filling"},
    {"buffer"},
    {"codec", "keys", "messages", "description"},
    {"fleet", "described_tree"},
    {"wire", "newest_stamps", "stream_options", "stragglers"},
    {"kept_messages", "transform_reader"},
    {"settings", "executor", "interface", "workers"},
    {"options"},
    {"scouting"},
    {"kept_thread", "own_connections"},
    {"zenoh_errors", "zenoh_config", "zenoh_scout", "declaration", "bytes_publisher", "query"},
    {"lost_links"},
    {"session"},
    {"retained"},
    {"stream_frames", "stream_keys"},
    {"transform_sender"},
    {"claims", "conflicts", "stream_info", "stream_watch", "reception", "static_recovery"},
    {"asked_history"},
    {"reading", "stream_names"},
    {"interest"},
    {"clock_topic", "topic", "service", "goal", "parameters", "stream", "namesake"},
    {"node"},
    {"clock_offset"},
    {"presence"},
    {"elsewhere"},
    {"broadcaster", "listener", "graph", "live_names", "name_types"},
    {"frames"},
    {"why"},
    {"doctor"},
    {"launch"},
    {"nodes", "cli", "top", "__main__"},
]
RANK = {module: rank for rank, layer in enumerate(LAYERS) for module in layer}

# Imported where they are used, inside a function, as the loading of a command line is by a node.
LATE = {("node", "options")}


def sources(folder: str) -> list[Path]:
    """The source files below a folder, templates left out."""
    return [path for path in sorted((ROOT / folder).rglob("*.py")) if "template" not in path.parts]


def imports(path: Path) -> set[str]:
    """All names of modules that a file imports, anywhere in it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            assert node.module is not None
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def module_of(path: Path) -> str:
    """The module, or subpackage, of tfbus that a file is or belongs to."""
    return path.relative_to(ROOT / "tfbus").parts[0].removesuffix(".py")


def libraries(path: Path) -> set[str]:
    """The top-level packages that a file imports."""
    return {name.partition(".")[0] for name in imports(path)}


LIBRARY = [path for path in sources("tfbus") if module_of(path) not in ("__init__",)]


def test_every_module_has_its_layer() -> None:
    """A new module of the library is given a layer here."""
    assert {module_of(path) for path in LIBRARY} <= set(RANK)


@pytest.mark.parametrize("path", LIBRARY, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_one_way(path: Path) -> None:
    """A module imports modules of its own layer and of lower ones."""
    module = module_of(path)
    used = {
        parts[1] for name in imports(path) if (parts := name.split("."))[0] == "tfbus" and parts[1:]
    }
    higher = {other for other in used & set(RANK) if RANK[other] > RANK[module]}
    assert higher == set()


def test_only_the_session_and_its_parts_import_zenoh() -> None:
    """Zenoh is spoken to by the session and its parts; the rest of tfbus uses their words."""
    first = RANK["zenoh_errors"]
    users = {module_of(path) for path in LIBRARY if "zenoh" in libraries(path)}
    assert users <= {module for module, rank in RANK.items() if first <= rank <= RANK["retained"]}
    assert [path for path in sources("nodes") if "zenoh" in libraries(path)] == []


def test_zenohs_unstable_parts_are_in_one_module() -> None:
    """When Zenoh changes its extensions, one file of tfbus changes."""
    users = {
        module_of(path)
        for path in LIBRARY
        if any(name.startswith("zenoh.ext") for name in imports(path))
    }
    assert users == {"retained"}


@pytest.mark.parametrize("name", ["pose", "transform", "batch", "history", "buffer"])
def test_transforms_and_the_buffer_know_nothing_of_the_bus(name: str) -> None:
    """Transforms and the buffer are usable without Zenoh and msgpack."""
    path = ROOT / "tfbus" / f"{name}.py"
    if path.exists():
        assert libraries(path).isdisjoint({"zenoh", "msgpack", "click"})


@pytest.mark.parametrize("path", sources("nodes"), ids=lambda path: str(path.relative_to(ROOT)))
def test_nodes_use_public_names_only(path: Path) -> None:
    """A node uses what any other package could: the public names, the messages, its neighbours."""
    public = {f"tfbus.{name}" for name in importlib.import_module("tfbus").__all__}
    allowed = {"tfbus", "tfbus.messages", *public}
    used = {name for name in imports(path) if name.partition(".")[0] == "tfbus"}
    neighbours = {n for n in used if n.startswith(("tfbus.nodes", "tfbus.messages."))}
    assert used - allowed - neighbours == set()


def test_every_public_name_is_there() -> None:
    """Each name in the list of public names can be imported, and is what it says."""
    tfbus = importlib.import_module("tfbus")
    for name in tfbus.__all__:
        assert getattr(tfbus, name).__name__ == name
    with pytest.raises(AttributeError, match="module 'tfbus' has no attribute 'nonsense'"):
        tfbus.nonsense  # noqa: B018  # the access is the test


def test_every_package_is_installed() -> None:
    """Each package of the repository is in the list of those that are installed."""
    listed = set(
        tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    )
    places = {path.parent for path in sources("tfbus") + sources("nodes")}
    packages = {
        ".".join(("tfbus", *place.relative_to(ROOT).parts[place.is_relative_to(ROOT / "tfbus") :]))
        for place in places
    }
    assert packages | {"tfbus.configs"} == listed
