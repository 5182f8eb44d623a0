"""Finding a launch file: by path, or by the name of one that comes with tfbus."""

from importlib.resources import files
from pathlib import Path

from tfbus.launch.place import LaunchError, nearest

_SUFFIXES = (".launch.yaml", ".yaml")


def find_launch_file(name: str, beside: Path = Path()) -> Path:
    """The file meant by `name`.

    With a slash or a `.yaml` or `.yml` at the end it is a path, relative to the folder `beside`;
    else the name of an installed launch file. Raises LaunchError if there is none.
    """
    if "/" in name or name.endswith((".yaml", ".yml")):
        path = beside / name
        if not path.is_file():
            raise LaunchError(f"there is no launch file {str(path)!r}")
        return path
    installed = installed_launch_files()
    if name in installed:
        return installed[name]
    here = next((name + end for end in _SUFFIXES if (beside / (name + end)).is_file()), "")
    hint = (
        f"; did you mean './{here}', a file in this folder?" if here else nearest(name, installed)
    )
    raise LaunchError(
        f"no launch file called {name!r} comes with tfbus{hint} "
        f"There are: {', '.join(installed)}; a file of your own is given by its path"
    )


def installed_launch_files() -> dict[str, Path]:
    """The launch files that come with tfbus, by name."""
    found = {}
    for entry in files("tfbus.configs").iterdir():
        for suffix in _SUFFIXES:
            if entry.name.endswith(suffix):
                found[entry.name.removesuffix(suffix)] = Path(str(entry))
                break
    return dict(sorted(found.items()))
