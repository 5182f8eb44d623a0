"""Finds a launch file by its path, or by the name of one that comes with tfbus."""

from importlib.resources import files
from pathlib import Path

from tfbus.launch.errors import LaunchError
from tfbus.launch.read.packages import find_in_package, launch_files_of
from tfbus.wording import did_you_mean

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
