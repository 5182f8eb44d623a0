"""Finds a launch file by its path, or by its name in tfbus or an installed package."""

from importlib import metadata
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import yaml

from tfbus.base.wording import did_you_mean
from tfbus.launch.description import LaunchError

# Where a package may have them, besides its own folder.
_FOLDERS = ("", "launch", "configs", "config")
_FILE_SUFFIXES = (".launch.yaml", ".yaml", ".launch.yml", ".yml")
_KEYS = {"nodes", "includes"}
# Packages of ROS whose launch files are tfbus's own.
_CALLED_IN_ROS = {
    "turtle_tf2_cpp": "; use: tfbus launch follow",
    "turtle_tf2_py": "; use: tfbus launch follow",
    "turtlesim": "; use: tfbus launch turtle",
}


def find_in_package(package: str, name: str) -> Path:
    """The launch file of this name, with or without its ending, of an installed package.

    It is in the package's folder, or in `launch`, `configs` or `config` below. Raises LaunchError.
    """
    files = launch_files_of(package)
    for end in ("", *_FILE_SUFFIXES):
        if f"{name}{end}" in files:
            return files[f"{name}{end}"]
    hint = did_you_mean(name, files, none="; it has none")
    raise LaunchError(f"package {package!r} has no launch file {name!r}{hint}")


def launch_files_of(package: str) -> dict[str, Path]:
    """The launch files of an installed package by their names; the package is not imported.

    Raises LaunchError if there is no such package.
    """
    folders = _folders_of(package)
    if not folders:
        known = packages_with_nodes()
        hint = _CALLED_IN_ROS.get(package) or did_you_mean(package, known)
        raise LaunchError(f"there is no Python package {package!r}{hint}")
    found: dict[str, Path] = {}
    for folder in folders:
        for below in _FOLDERS:
            for path in sorted((folder / below).glob("*")):
                if path.name.endswith(_FILE_SUFFIXES) and _is_launch_file(path):
                    found.setdefault(path.name, path)
    return dict(sorted(found.items()))


def packages_with_nodes() -> list[str]:
    """The packages other than tfbus that add nodes to it, sorted."""
    points = metadata.entry_points(group="tfbus.nodes")
    return sorted({point.module.partition(".")[0] for point in points} - {"tfbus"})


def _folders_of(package: str) -> list[Path]:
    if not package.isidentifier():
        return []
    try:
        spec = find_spec(package)
    except (ImportError, ValueError):
        return []
    return [Path(folder) for folder in (spec and spec.submodule_search_locations) or ()]


def _is_launch_file(path: Path) -> bool:
    """Whether it lists nodes: a package may have YAML files of parameters, too."""
    try:
        document = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError):
        return True  # its mistake is said when it is launched
    entries = document.value if isinstance(document, yaml.MappingNode) else ()
    return any(isinstance(key, yaml.ScalarNode) and key.value in _KEYS for key, _ in entries)


_SUFFIXES = (".launch.yaml", ".yaml")


def find_launch_file(name: str, beside: Path = Path()) -> Path:
    """The file meant by `name`.

    A name with a slash, or that ends with `.yaml` or `.yml`, is a path relative to the folder
    `beside`, or if there is none the file name of an installed launch file; any other is the name
    of an installed one. Raises LaunchError if there is none.
    """
    if "/" in name or name.endswith((".yaml", ".yml")):
        path = beside / name
        if path.is_file():
            return path
        if found := _supplied(name):
            return found
        hint = did_you_mean(name, installed_launch_files()) if "/" not in name else ""
        raise LaunchError(f"there is no launch file {str(path)!r}{hint}")
    installed = installed_launch_files()
    if found := _supplied(name):
        return found
    here = next((name + end for end in _SUFFIXES if (beside / (name + end)).is_file()), "")
    hint = f"; did you mean './{here}'?" if here else did_you_mean(name, installed)
    if not here and (own := _files_of(name)):
        hint = f"; package {name!r} has some: tfbus launch {name} {' or '.join(own)}"
    raise LaunchError(
        f"tfbus has no launch file {name!r} (give a file of your own by its path){hint}"
    )


def find_in(package: str, name: str) -> Path:
    """The launch file of this name in an installed package, tfbus or another.

    Raises LaunchError.
    """
    if package != "tfbus":
        return find_in_package(package, name)
    return _supplied(name) or find_launch_file(name)


def _supplied(name: str) -> Path | None:
    """The installed launch file of this name, with or without its ending."""
    for end in ("", *_SUFFIXES):
        if name.endswith(end) and (path := installed_launch_files().get(name.removesuffix(end))):
            return path
    return None


def _files_of(package: str) -> list[str]:
    try:
        return list(launch_files_of(package))
    except LaunchError:
        return []


def installed_launch_files() -> dict[str, Path]:
    """The launch files that come with tfbus, by name."""
    found = {}
    for entry in files("tfbus.configs").iterdir():
        for suffix in _SUFFIXES:
            if entry.name.endswith(suffix):
                found[entry.name.removesuffix(suffix)] = Path(str(entry))
                break
    return dict(sorted(found.items()))
