"""All that is measured of recordings."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.bus.place import Place, Process, place
from benchmarks.recordings import bus
from benchmarks.recordings.bus import Flood, Timing
from benchmarks.recordings.robot import HOUR, MINUTE

TFBUS, MCAP, ROSBAGS = "tfbus", "mcap", "rosbags"
FROM_BEGINNING = "all from the beginning into a buffer"

# What one process of each does a second time, by its function: the file that it is given. These
# take turns.
_FILES: dict[str, list[tuple[str, str, dict[str, Any]]]] = {
    "write": [
        (who, "write", {"count": MINUTE, "compression": "zstd"}) for who in (TFBUS, MCAP, ROSBAGS)
    ],
    "write, not compressed": [
        (who, "write", {"count": MINUTE, "compression": "none"}) for who in (TFBUS, MCAP, ROSBAGS)
    ],
    "read": [(who, "read", {"path": "minute"}) for who in (TFBUS, MCAP, ROSBAGS)],
    "one frame": [(TFBUS, "samples", {"path": "minute"})],
    "open": [(who, "open_it", {"path": "hour"}) for who in (TFBUS, MCAP, ROSBAGS)],
    "frames": [(TFBUS, "frames", {"path": "hour"})],
    "seek": [(who, "seek", {"path": "hour"}) for who in (TFBUS, MCAP, ROSBAGS)],
    "first lookup": [(TFBUS, "first_lookup", {"path": "hour"})],
}

# Of what takes a while: filling a buffer from the beginning, recording the robot.
_SLOW_RUNS = 1


@dataclass(frozen=True)
class Measured:
    """The versions of the programs; CPU seconds by what is done and by whom, or why there are none;
    the cores for a robot, by its publishers; floods by the transforms of a message; the timing of a
    replay and of bare Zenoh; the size of the file of an hour.
    """

    versions: Mapping[str, str]
    cpu_s: Mapping[str, Mapping[str, float | str]]
    robot_cores: Mapping[int, float]
    floods: Mapping[int, Sequence[Flood]]
    timing: Mapping[str, Timing]
    hour_bytes: int


def measure(runs: int, tell: Callable[[str], None]) -> Measured:
    """Measure all of it, which takes some minutes."""
    with place() as at:
        versions = _ask(at, f"by_{TFBUS}:versions")
        files = {"minute": MINUTE, "hour": HOUR}
        for name, messages in files.items():
            tell(f"recordings: make the file of one {name}")
            path = str(at.folder / f"{name}.mcap")
            _ask(at, f"by_{TFBUS}:make", path=path, count=messages)
        cpu_s = {}
        for what, asked in _FILES.items():
            tell(f"recordings: {what}")
            cpu_s[what] = _in_turns(at, asked, runs)
        tell("recordings: lookups")
        hour = str(at.folder / "hour.mcap")
        found = [_ask(at, f"by_{TFBUS}:look_up", path=hour) for _ in range(runs)]
        for where in found[0]:
            cpu_s[f"lookup {where}"] = {TFBUS: median(one[where] for one in found)}
        played = [_ask(at, f"by_{TFBUS}:play_to_middle", path=hour) for _ in range(_SLOW_RUNS)]
        cpu_s["first lookup"] = {**cpu_s["first lookup"], FROM_BEGINNING: median(played)}
        hour_bytes = Path(hour).stat().st_size
    tell("recordings: record")
    robot_cores = {publishers: bus.record_robot(publishers, _SLOW_RUNS) for publishers in (1, 10)}
    tell("recordings: without loss")
    floods = {rows: bus.without_loss(rows) for rows in (50, 1)}
    tell("recordings: play")
    return Measured(versions, cpu_s, robot_cores, floods, bus.play(runs), hour_bytes)


_folders = count()


def _in_turns(
    at: Place, asked: Sequence[tuple[str, str, dict[str, Any]]], runs: int
) -> dict[str, float | str]:
    """The medians of what each says, or why it says nothing."""
    taken: dict[str, list[float]] = {who: [] for who, _, _ in asked}
    failed: dict[str, str] = {}
    for _ in range(runs):
        for who, function, arguments in asked:
            if who in failed:
                continue
            try:
                taken[who].append(_ask(at, f"by_{who}:{function}", **_places(at, arguments)))
            except RuntimeError as error:
                failed[who] = str(error).splitlines()[-1]
    return {who: failed[who] if who in failed else median(taken[who]) for who in taken}


def _places(at: Place, arguments: dict[str, Any]) -> dict[str, Any]:
    if "path" in arguments:
        return {**arguments, "path": str(at.folder / f"{arguments['path']}.mcap")}
    folder = at.folder / f"written-{next(_folders)}"
    folder.mkdir()
    return {**arguments, "folder": str(folder)}


def _ask(at: Place, function: str, **arguments: Any) -> Any:
    with Process(at, f"recordings.{function}", at.env, **arguments) as process:
        return process.hear()
