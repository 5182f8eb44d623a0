"""What a user has chosen to see, as one frozen value, and as a YAML file."""

from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from tfbus import SettingsError
from tfbus.view.model.filter import NameFilter


@dataclass(frozen=True)
class ViewSettings:
    """The choices of the page.

    An empty `fixed_frame` leaves it to the frames that there are. `only` and `never` are regular
    expressions on names, `hidden` are frames whose box is not ticked, `trails` those that draw
    where they were in the last `trail_s` seconds. `scale` multiplies the size of the axes, which
    fits what is shown; `opacity` is that of axes and arrows, 0 to 1.
    """

    fixed_frame: str = ""
    selected: str = ""
    axes: bool = True
    names: bool = True
    arrows: bool = True
    grid: bool = True
    dark: bool = False
    scale: float = 1.0
    opacity: float = 1.0
    only: str = ""
    never: str = ""
    hidden: tuple[str, ...] = ()
    trails: tuple[str, ...] = ()
    trail_s: float = 5.0
    measure_from: str = ""
    measure_to: str = ""

    @cached_property
    def filter(self) -> NameFilter:
        """Which names are shown."""
        return NameFilter(self.only, self.never)

    def shows(self, name: str) -> bool:
        """Whether a frame of this name is to be drawn."""
        return name not in self.hidden and self.filter.takes(name)


# What a number may be; others would be taken by no control of the page.
RANGES = {"scale": (0.1, 10.0), "opacity": (0.05, 1.0), "trail_s": (0.5, 60.0)}

_FIELDS: dict[str, type] = {field.name: type(field.default) for field in fields(ViewSettings)}


def load(path: Path) -> ViewSettings:
    """The settings that a file says; what it does not say is as it is without one.

    Raises SettingsError for a file that cannot be read, or says what cannot be.
    """
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"the settings {path} cannot be read: {error}") from error
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise SettingsError(f"{path} is not YAML: {' '.join(str(error).split())}") from error
    values = {} if values is None else values
    if not isinstance(values, dict):
        raise SettingsError(f"{path} is not a map of settings; they are: {', '.join(_FIELDS)}")
    try:
        return ViewSettings(**{name: _read(name, value) for name, value in values.items()})
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from error


def holds_settings(path: Path) -> bool:
    """Whether a file is evidently one that the page saved: a map of settings and nothing else."""
    try:
        values = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        return False
    return isinstance(values, dict) and bool(values) and values.keys() <= _FIELDS.keys()


def save(settings: ViewSettings, path: Path) -> None:
    """Write the settings to a file. Raises SettingsError where it cannot be written."""
    values = {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in asdict(settings).items()
    }
    try:
        path.write_text(yaml.safe_dump(values, sort_keys=False, allow_unicode=True))
    except OSError as error:
        raise SettingsError(f"the settings {path} cannot be written: {error}") from error


def _read(name: object, value: Any) -> Any:
    """The value as the field of this name has it. Raises SettingsError where it cannot."""
    if not isinstance(name, str) or name not in _FIELDS:
        raise SettingsError(f"there is no setting {name!r}; there are: {', '.join(_FIELDS)}")
    wanted = _FIELDS[name]
    if wanted is tuple:
        if isinstance(value, list) and all(isinstance(item, str) for item in value):
            return tuple(value)
        raise SettingsError(f"{name} is {value!r}; a list of names of frames is wanted")
    if wanted is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    kind: type = type(value)
    if kind is not wanted:
        raise SettingsError(f"{name} is {value!r}; {_KINDS[wanted]} is wanted")
    if name in RANGES:
        least, most = RANGES[name]
        if not least <= value <= most:
            raise SettingsError(
                f"{name} is {value:g}; a number from {least:g} to {most:g} is wanted"
            )
    if name in ("only", "never"):
        NameFilter(value)
    return value


_KINDS = {bool: "true or false", float: "a number", str: "a text"}
