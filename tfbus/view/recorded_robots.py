"""The robots in a recording, as they were described at its cursor."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tfbus.errors import DecodeError, UrdfError
from tfbus.recording.items import TopicItem
from tfbus.recording.selection import Selection
from tfbus.robot.robot import read_described
from tfbus.view.meshes.guard import MeshError
from tfbus.view.model.shown_robot import ShownRobot
from tfbus.view.robot_source import GivenRobots, Joints
from tfbus.wording import printable

if TYPE_CHECKING:
    from tfbus.recording.reader import RecordingReader
    from tfbus.view.replay import Replay

_TOPIC = "robot_description"

# As many descriptions are remembered.
_MOST = 1000


@dataclass(frozen=True)
class _Described:
    """A description from a log time on: of ours, or a string as ROS has it."""

    log_ns: int
    topic: str
    text: str
    prefix: str = ""
    source: str = ""


class RecordedRobots:
    """The robots of the namespace that a replay shows, and with a fleet of those below, at its
    cursor.

    Before its first description a robot is shown by that one.
    """

    def __init__(
        self, reader: "RecordingReader", replay: "Replay", package_path: Sequence[Path] = ()
    ) -> None:
        self._replay = replay
        self._package_path = tuple(package_path)
        self._mistakes: dict[str, None] = {}
        self._described: dict[tuple[str, str], list[_Described]] = {}
        try:
            for each in self._descriptions(reader):
                same = self._described.setdefault((each.topic, each.prefix), [])
                if not same or same[-1].text != each.text:
                    same.append(each)
                if sum(map(len, self._described.values())) >= _MOST:
                    break
        except DecodeError as error:
            self._mistakes[f"The robot_description cannot be read: {printable(str(error))}"] = None
        self._read: dict[_Described, ShownRobot | None] = {}
        self._given = GivenRobots()

    def robots(self) -> Sequence[ShownRobot]:
        """The robots as they were described at the cursor."""
        log_ns = self._replay.playhead.progress.log_ns
        found = [self._shown(_at(same, log_ns)) for same in self._described.values()]
        return [*(robot for robot in found if robot is not None), *self._given.robots()]

    def add(self, robot: ShownRobot) -> None:
        """Add a robot of the program; it replaces one of the same title."""
        self._given.add(robot)

    def mistakes(self) -> Sequence[str]:
        """Which descriptions are none."""
        return list(self._mistakes)

    def joints(self, robot: ShownRobot) -> Joints | None:
        """None: they were where they were."""
        return None

    def fetch(self, origin: str, mesh: str, within_s: float) -> bytes:
        """Meshes are not recorded."""
        raise MeshError("it is not on this machine")

    def close(self) -> None:
        """Nothing to end."""

    def _shown(self, described: _Described) -> ShownRobot | None:
        if described not in self._read:
            try:
                self._read[described] = self._make(described)
            except UrdfError as error:
                text = f"The robot_description is not shown: {printable(str(error), 400)}"
                self._mistakes[text] = None
                self._read[described] = None
        return self._read[described]

    def _make(self, described: _Described) -> ShownRobot:
        robot = read_described(
            described.text, described.source, self._package_path, "the recorded description"
        )
        names = None
        if self._replay.fleet is not None:
            own = self._replay.namespace
            namespace = _namespace(described.topic)
            names = self._replay.fleet.names(namespace.removeprefix(own).strip("/"))
        return ShownRobot(robot, described.prefix, names, is_described=True)

    def _is_seen(self, topic: str) -> bool:
        namespace, own = _namespace(topic), self._replay.namespace
        if topic.rpartition("/")[2] != _TOPIC:
            return False
        is_below = not own or namespace.startswith(f"{own}/")
        return namespace == own or (self._replay.fleet is not None and is_below)

    def _descriptions(self, reader: "RecordingReader") -> Iterator[_Described]:
        names = tuple(each.name for each in reader.topics if self._is_seen(each.name))
        for item in reader.items(selection=Selection(topics=names)) if names else ():
            if not isinstance(item, TopicItem):
                continue
            values = item.values
            text = values.get("urdf", values.get("data"))
            if isinstance(text, str):
                prefix, source = values.get("prefix", ""), values.get("source", "")
                is_plain = isinstance(prefix, str) and isinstance(source, str)
                given = (prefix, source) if is_plain else ()
                yield _Described(item.log_ns, item.topic, text, *given)


def _namespace(topic: str) -> str:
    return topic.strip("/").rpartition("/")[0]


def _at(same: Sequence[_Described], log_ns: int) -> _Described:
    until = [each for each in same if each.log_ns <= log_ns]
    return until[-1] if until else same[0]
