"""The choices of users: settings, also as a YAML file, the selected frames, and the time shown."""

import math
import re
import sys
import threading
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import yaml

from tfbus.base.errors import SettingsError
from tfbus.base.whole_file import replacing
from tfbus.base.wording import did_you_mean, printable
from tfbus.base.yaml_file import yaml_mistake
from tfbus.wire.keys import relative


class PatternError(SettingsError):
    """A malformed regular expression; the message names the mistake and its place."""


@dataclass(frozen=True)
class NameFilter:
    """Takes names that `only` matches and `never` does not, anywhere in the name.

    An empty `only` matches every name, an empty `never` none. Raises PatternError for a malformed
    regular expression.
    """

    only: str = ""
    never: str = ""

    def __post_init__(self) -> None:
        for pattern in (self.only, self.never):
            _compiled(pattern)

    def takes(self, name: str) -> bool:
        """Whether a frame of this name is shown."""
        if self.never and _compiled(self.never).search(name):
            return False
        return not self.only or bool(_compiled(self.only).search(name))


@lru_cache(maxsize=64)
def _compiled(pattern: str) -> re.Pattern[str]:
    try:
        return re.compile(pattern)
    except re.error as error:
        place = "" if error.pos is None else f" at character {error.pos + 1}"
        raise PatternError(
            f"{pattern!r} is not a regular expression: {error.msg}{place}; "
            r"escape a point as \. and a bracket as \("
        ) from error


@dataclass(frozen=True)
class TopicSettings:
    """How the messages of a topic are drawn, while it is `shown`.

    Points have the `color` of their "height" in the fixed frame, of a column, are all "flat", or by
    "auto" of rgb, else intensity, else height: from `color_min` to `color_max`, for None the bounds
    in the message. They are `size` cm wide, or `pixels` unless that is 0, and stay for `decay_s`
    seconds, or with 0 until the next message. With `locked` a message moves with its frame, instead
    of staying where that was at its stamp. At most `rate_hz` messages are drawn a second.

    Of points in one cube of `voxel` cm one is drawn, with 0 each, and at most `most_points` of a
    message. Images are JPEG of this `quality`. Markers of `hidden` namespaces are not drawn.

    Shapes of one colour have `rgb`, such as "#ff8800", or with "" that of their kind. Arrows, axes,
    balls and views of cameras are `scale` times as large. Maps, arrows, balls, cones and ellipsoids
    have the `opacity`. Lines of paths are `width` cm wide, with 0 some pixels. `poses` are drawn as
    "arrows", "axes" or "none", by "auto" as arrows unless they are of a path. Maps are coloured by
    "auto", or as a "costmap" of RViz, 1 cm above their plane.

    Topics of one `group` are drawn, or not, together; "" is none.

    A `topic` such as `points#2` is `points`, shown once more with settings of its own.
    """

    topic: str
    shown: bool = True
    color: str = "auto"
    color_min: float | None = None
    color_max: float | None = None
    size: float = 3.0
    pixels: float = 0.0
    decay_s: float = 0.0
    locked: bool = False
    rate_hz: float = 15.0
    voxel: float = 0.0
    most_points: float = 100_000.0
    quality: float = 75.0
    hidden: tuple[str, ...] = ()
    group: str = ""
    rgb: str = ""
    opacity: float = 1.0
    scale: float = 1.0
    width: float = 0.0
    poses: str = "auto"

    def painted(self, own: tuple[int, int, int]) -> tuple[int, int, int]:
        """The colour of a shape that has this one of its own: `rgb`, if that is given."""
        if not self.rgb:
            return own
        red, green, blue = bytes.fromhex(self.rgb.removeprefix("#"))
        return red, green, blue


# A topic is shown so often, each time by settings of its own.
MOST_TIMES = 10


def topic_of(name: str) -> str:
    """The topic of settings by their name: `points` of `points#2`. No topic of the bus has a # of
    its own; some of others' recordings do.
    """
    return name.partition("#")[0]


@dataclass(frozen=True)
class ViewSettings:
    """The choices of the page.

    An empty `fixed_frame` chooses one by itself. `only` and `never` are regular expressions on
    names, `hidden` the frames whose box is not ticked, `trails` the frames that draw where they
    were in the last `trail_s` seconds. `scale` multiplies the length of the axes, which fits the
    scene (with messages, unless it is scaled); axes and arrows have the `opacity`, 0 to 1.

    Cameras move along with the frame `follow`, and with `follow_yaw` turn with its heading.
    The tools publish on `goal_topic`, `initial_pose_topic` and `point_topic`.

    Messages of `topics` are drawn, each by its settings, but for topics of `hidden_groups`.
    `shapes` of robots are "visual", "collision" or "both", with `robot_opacity`; `hidden_robots`
    are not drawn. The links of drawn robots have axes, names and arrows with `link_axes`.
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
    shapes: str = "visual"
    robot_opacity: float = 1.0
    link_axes: bool = False
    hidden_robots: tuple[str, ...] = ()
    follow: str = ""
    follow_yaw: bool = False
    goal_topic: str = "goal_pose"
    initial_pose_topic: str = "initialpose"
    point_topic: str = "clicked_point"
    topics: tuple[TopicSettings, ...] = ()
    hidden_groups: tuple[str, ...] = ()

    @cached_property
    def drawn(self) -> Mapping[str, TopicSettings]:
        """The settings of each topic that is drawn: it is shown, and its group is not hidden."""
        return {
            each.topic: each
            for each in self.topics
            if each.shown and each.group not in self.hidden_groups
        }

    def of_topic(self, topic: str) -> TopicSettings:
        """The settings of a topic; one that has none is not shown."""
        chosen = (each for each in self.topics if each.topic == topic)
        return next(chosen, TopicSettings(topic, shown=False))

    @cached_property
    def filter(self) -> NameFilter:
        """The choice of names that are shown."""
        return NameFilter(self.only, self.never)

    def shows(self, name: str) -> bool:
        """Whether a frame of this name is drawn."""
        return name not in self.hidden and self.filter.takes(name)


# The least and the most of each number; the page's controls take no others.
RANGES = {
    "scale": (0.1, 10.0),
    "opacity": (0.05, 1.0),
    "trail_s": (0.5, 60.0),
    "robot_opacity": (0.05, 1.0),
    "size": (0.1, 100.0),
    "pixels": (0.0, 20.0),
    "decay_s": (0.0, 3600.0),
    "rate_hz": (0.1, 60.0),
    "voxel": (0.0, 100.0),
    "most_points": (1000.0, 500_000.0),
    "quality": (5.0, 95.0),
    "width": (0.0, 100.0),
}

_MOST_NUMBER = sys.float_info.max

# Of settings whose name does not say it.
_UNITS = {"size": "cm", "voxel": "cm", "width": "cm"}

# Smaller cubes than points are wide are metres, taken for centimetres.
_LEAST_VOXEL = 1.0

# The shapes of robots, and those of poses, to choose from.
SHAPES = ("visual", "collision", "both")
POSES = ("auto", "arrows", "axes", "none")

_FIELDS: dict[str, type] = {field.name: type(field.default) for field in fields(ViewSettings)}
_OF_TOPIC = {
    field.name: str if field.name == "topic" else type(field.default)
    for field in fields(TopicSettings)
}


def load_settings(path: Path) -> ViewSettings:
    """The settings in a file; others have their defaults.

    Raises SettingsError if the file cannot be read or has a wrong name or value.
    """
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"cannot read the settings {path}: {error}") from error
    return read_settings(text, str(path))


def read_settings(text: str, name: str) -> ViewSettings:
    """The settings in a text of YAML, of the file `name`; others have their defaults.

    Raises SettingsError if it is no map, or has a wrong name or value.
    """
    try:
        values = yaml.safe_load(text)
    except yaml.MarkedYAMLError as error:
        line, reason = yaml_mistake(error)
        raise SettingsError(f"{name}:{line}: is not YAML: {reason}") from error
    except RecursionError as error:
        raise SettingsError(f"{name} is not YAML: it is nested too deeply") from error
    except (yaml.YAMLError, ValueError) as error:  # the latter for a date such as 2001-13-45
        raise SettingsError(f"{name} is not YAML: {' '.join(str(error).split())}") from error
    values = {} if values is None else values
    if not isinstance(values, dict):
        raise SettingsError(f"{name} is not a map of settings; available: {', '.join(_FIELDS)}")
    try:
        return ViewSettings(**{key: _read(key, value) for key, value in values.items()})
    except SettingsError as error:
        raise SettingsError(f"{name}: {error}") from error


def holds_settings(path: Path) -> bool:
    """Whether a file is evidently one that the page saved: a map of settings only."""
    try:
        values = yaml.safe_load(path.read_text())
    except (OSError, RecursionError, ValueError, yaml.YAMLError):
        return False
    return isinstance(values, dict) and bool(values) and values.keys() <= _FIELDS.keys()


def save_settings(settings: ViewSettings, path: Path) -> None:
    """Write the settings to a file. Raises SettingsError if that fails."""
    try:
        with replacing(path) as file:
            file.write(written_settings(settings))
    except OSError as error:
        raise SettingsError(f"cannot write the settings {path}: {error}") from error


def written_settings(settings: ViewSettings) -> bytes:
    """The settings as the bytes of a file."""
    values = {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in asdict(settings).items()
    }
    text: str = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
    return text.encode()


def _read_topic(value: object) -> TopicSettings:
    if not isinstance(value, dict) or "topic" not in value:
        raise SettingsError(f"topics must be a list of maps with a topic, got {_shown(value)}")
    return TopicSettings(**{name: _read(name, each, _OF_TOPIC) for name, each in value.items()})


def topic_named(text: str, settings: ViewSettings, namespace: str = "") -> TopicSettings:
    """The settings of a topic that is to be shown, from a text such as `points` or
    `points:voxel=5,color=height`, over its former ones. `/points` is a topic of the `namespace`, or
    of another. Raises SettingsError.
    """
    topic, _, given = text.partition(":")
    topic = relative(topic, namespace)
    if not topic:
        raise SettingsError(f"{text!r} has no topic before its settings, as points:voxel=5 has")
    values: dict[str, Any] = {}
    for part in given.split(",") if given else ():
        name, equals, value = part.partition("=")
        if not equals or name == "topic":
            raise SettingsError(f"{text!r}: {part!r} is not a setting such as rate_hz=5")
        if not value.strip():
            raise SettingsError(f"{text!r}: {name} has no value after its '='")
        try:
            read = yaml.safe_load(value) if _OF_TOPIC.get(name) is not str else value
        except (yaml.YAMLError, ValueError):  # the latter for a date such as 2001-13-45
            read = value
        try:
            values[name] = _read(name, [read] if name == "hidden" else read, _OF_TOPIC)
        except SettingsError as error:
            raise SettingsError(f"{text!r}: {error}") from error
    return replace(settings.of_topic(topic), **({"shown": True} | values), topic=topic)


def _read(name: object, value: Any, known: Mapping[str, type] = _FIELDS) -> Any:
    """The value, as the type of this field. Raises SettingsError for a wrong name or value."""
    if not isinstance(name, str) or name not in known:
        raise SettingsError(f"no setting {name!r}{did_you_mean(str(name), known)}")
    wanted = known[name]
    if name == "topics":
        if not isinstance(value, list):
            raise SettingsError(f"topics must be a list of maps with a topic, got {_shown(value)}")
        return tuple(map(_read_topic, value))
    if wanted is tuple:
        if isinstance(value, list) and all(isinstance(item, str) for item in value):
            return tuple(value)
        raise SettingsError(f"{name} must be a list of names, got {_shown(value)}")
    if wanted is type(None) and value in (None, "auto"):
        return None
    if wanted in (float, type(None)) and isinstance(value, int) and not isinstance(value, bool):
        value = math.inf if abs(value) > _MOST_NUMBER else float(value)
    kind: type = type(value)
    if kind is not (float if wanted is type(None) else wanted):
        raise SettingsError(f"{name} must be {_KINDS[wanted]}, got {_shown(value)}")
    if name in RANGES:
        _check_range(name, value)
    if wanted is type(None) and not abs(value) <= _MOST_NUMBER:
        raise SettingsError(f"{name} must be a finite number or auto, got {value:g}")
    choices = {"shapes": SHAPES, "poses": POSES}.get(name)
    if choices is not None and value not in choices:
        raise SettingsError(f"{name} must be one of {', '.join(choices)}, got {value!r}")
    if name == "rgb" and not re.fullmatch("(#?[0-9a-fA-F]{6})?", value):
        raise SettingsError(f"rgb must be a colour such as '#ff8800', got {value!r}")
    if name in ("only", "never"):
        NameFilter(value)
    return value


def _shown(value: object) -> str:
    """A wrong value, as an error says it. A browser may have sent the file, in which a few letters
    can stand for billions of values.
    """
    if isinstance(value, str | bytes):
        return f"'{printable(str(value), 60)}'"
    kinds: dict[type, str] = {list: "a list", dict: "a map", set: "a set"}
    return kinds.get(type(value)) or f"{value!r}"


def _check_range(name: str, value: float) -> None:
    least, most = RANGES[name]
    is_voxel = name == "voxel" and value != 0.0
    least = _LEAST_VOXEL if is_voxel else least
    if least <= value <= most:
        return
    unit = _UNITS.get(name, "")
    allowed = f"{'0 or ' if is_voxel else ''}from {least:g} to {most:g} {unit}".rstrip()
    in_cm = value * 100.0
    meant = f" ({value:g} m is {name}={in_cm:g})" if unit and least <= in_cm <= most else ""
    raise SettingsError(f"{name} must be {allowed}, got {value:g}{meant}")


_KINDS = {
    bool: "true or false",
    float: "a number",
    str: "a string",
    type(None): "a number or auto",
}


@dataclass(frozen=True)
class Playback:
    """Shows the latest time while `held_ns` is None, else `ago_s` seconds before `held_ns`."""

    held_ns: int | None = None
    ago_s: float = 0.0

    @property
    def follows(self) -> bool:
        """Whether the latest time is shown."""
        return self.held_ns is None

    @property
    def stamp_ns(self) -> int | None:
        """The time shown; None is the latest of each frame."""
        return None if self.held_ns is None else self.held_ns - round(self.ago_s * 1e9)

    def pause(self, now_ns: int) -> "Playback":
        """Hold this time; a time already held stays."""
        return Playback(now_ns) if self.follows else self

    def scrub(self, now_ns: int, ago_s: float) -> "Playback":
        """Show the time `ago_s` before the held one; holds `now_ns` if none is held."""
        return Playback(now_ns if self.held_ns is None else self.held_ns, ago_s)


class Selections:
    """The selected frame of each browser, by the number of its client; safe from any thread.

    A browser starts with the frame that was selected last, so that a reload keeps it.
    """

    def __init__(self, first: str = "") -> None:
        self._lock = threading.Lock()
        self._last = first
        self._chosen: dict[int, str] = {}

    def of(self, client: int) -> str:
        """The frame that a browser has selected; "" for none."""
        with self._lock:
            return self._chosen.setdefault(client, self._last)

    @property
    def chosen(self) -> frozenset[str]:
        """The frames that any browser has selected."""
        with self._lock:
            return frozenset(name for name in self._chosen.values() if name)

    def select(self, client: int, frame: str) -> None:
        """Select a frame in one browser."""
        with self._lock:
            self._last = self._chosen[client] = frame

    def keep(self, clients: Collection[int]) -> None:
        """Forget the browsers that are not among these; note where new ones start."""
        with self._lock:
            self._chosen = {client: self._chosen.get(client, self._last) for client in clients}


class ViewState:
    """The settings and the playback; the controls change them, the page reads them."""

    def __init__(self, settings: ViewSettings) -> None:
        self._lock = threading.Lock()
        self.settings = settings
        self.playback = Playback()

    def change(self, **values: Any) -> None:
        """Set some of the fields of ViewSettings."""
        with self._lock:
            self.settings = replace(self.settings, **values)

    def load(self, settings: ViewSettings) -> None:
        """Replace all settings."""
        with self._lock:
            self.settings = settings

    def tick(self, field: str, name: str, is_in: bool) -> None:
        """Put a name into a list of names, such as `hidden` or `trails`, or take it out."""
        with self._lock:
            others = tuple(each for each in getattr(self.settings, field) if each != name)
            chosen: dict[str, Any] = {field: (*others, name) if is_in else others}
            self.settings = replace(self.settings, **chosen)

    def change_topic(self, topic: str, **values: Any) -> None:
        """Set some of the fields of the TopicSettings of a topic."""
        with self._lock:
            changed = replace(self.settings.of_topic(topic), **values)
            others = tuple(each for each in self.settings.topics if each.topic != topic)
            self.settings = replace(self.settings, topics=(*others, changed))

    def show_again(self, topic: str) -> None:
        """Show a topic once more, at first by the settings that it has here; at most ten times."""
        with self._lock:
            taken = {each.topic for each in self.settings.topics}
            names = (f"{topic_of(topic)}#{number}" for number in range(2, MOST_TIMES + 1))
            name = next((each for each in names if each not in taken), None)
            if name is None:
                return
            again = replace(self.settings.of_topic(topic), topic=name)
            self.settings = replace(self.settings, topics=(*self.settings.topics, again))

    def forget_topic(self, topic: str) -> None:
        """Remove the settings of a topic: it is not shown, or once less."""
        with self._lock:
            others = tuple(each for each in self.settings.topics if each.topic != topic)
            self.settings = replace(self.settings, topics=others)

    def play(self, step: Callable[[Playback], Playback]) -> None:
        """Replace the playback by `step(playback)`."""
        with self._lock:
            self.playback = step(self.playback)
