"""`tfbus.inspect`: the bus at one moment and its changes, live and recorded alike."""

import math
from dataclasses import asdict
from pathlib import Path
from random import Random
from typing import Any

import pytest

from tests.builders import examples
from tests.buses import DEADLINE_S, eventually, keep_sending, send_static
from tests.needs import module
from tests.processes.sim_time import follower, start_clock
from tests.recordings import at, described, gone, node, publisher, statics, steadily, write
from tests.simulated_bus import Bus
from tfbus import FileError, InvalidArgumentException, MissingFileError, Node
from tfbus.base import scheduler
from tfbus.inspect import BusChange, BusMoment, Recorded, Watch
from tfbus.messages import Vector3

S = 1_000_000_000


def contents(moment: BusMoment) -> dict[str, Any]:
    """All of a moment that does not depend on when a message was on its way."""
    return {
        "frames": {
            name: (
                *(each.parent, each.state, each.faults, each.publishers, each.host),
                # Of publishers that are in conflict the last to send.
                "" if "conflict" in each.faults else each.node,
            )
            for name, each in moment.frames.items()
        },
        "streams": {name: each.frames for name, each in moment.streams.items() if each.alive},
        "conflicts": moment.conflicts,
        "problems": {(each.kind, each.frames, each.remedy) for each in moment.problems},
        "nodes": {
            name
            for name in moment.node_names
            if not name.startswith(("/_", "/watching", "/recorder"))
        },
        "topics": set(moment.topics),
        "lost": moment.lost,
        "refused": moment.refused,
    }


class Robots:
    """Nodes that come, send, fall silent and leave, as drawn."""

    def __init__(self, bus: Bus, seed: int) -> None:
        self._bus, self._random, self._nodes = bus, Random(seed), dict[str, list[Node]]()

    def step(self) -> None:
        """Something that may happen to a bus."""
        name, child = self._random.choice(["arm", "base", "cup"]), self._random.choice("abc")
        parent = self._random.choice(["map", "odom"])
        if name in self._nodes and self._random.random() < 0.5:
            for each in self._nodes.pop(name):
                each.close()
            return
        node = self._bus.node(name) if name not in self._nodes else self._nodes[name][0]
        self._nodes.setdefault(name, [node])
        if self._random.random() < 0.3:
            send_static(node, parent, f"{child}_fixed")
        else:
            keep_sending(node, parent, child)


@pytest.mark.parametrize("seed", range(examples(6)))
def test_a_moment_is_the_same_live_and_recorded(bus: Bus, tmp_path: Path, seed: int) -> None:
    """Whatever came and went: frames, states, publishers, conflicts, problems, nodes, topics."""
    module("mcap")
    path = tmp_path / "run.mcap"
    recorder = bus.start("bag", "record", "-o", str(path))
    recorder.wait_for_line("Recording")
    watching, robots = bus.node("watching"), Robots(bus, seed)
    keep_sending(bus.node("clock"), "map", "hand")  # the recording goes on to the end
    live = []
    with Watch(watching) as watch:
        for _ in range(min(8, examples(50))):
            robots.step()
            # Beyond all limits of time at which a state changes.
            scheduler.sleep(4.3)
            live.append(watch.now())
    scheduler.sleep(1.0)
    assert recorder.stop() == 0
    with Recorded(path) as recorded:
        for moment in live:
            assert contents(recorded.at(moment.at_ns)) == contents(moment)


def test_a_topic_is_in_the_moment_a_second_after_it_began(bus: Bus) -> None:
    """Also of a node that has been there for long, and of a namespace below; nothing waits."""
    robot = bus.node("sim", namespace="robot7")
    with Watch(bus.node("watching")) as watch:
        scheduler.sleep(33.3)
        robot.create_publisher(Vector3, "flag")
        keep_sending(robot, "map", "base")
        scheduler.sleep(1.3)
        before_s = scheduler.monotonic()
        assert {"robot7/flag", "robot7/tf/sim"} <= watch.now().topics.keys()
        assert scheduler.monotonic() == before_s


def kinds(changes: list[BusChange]) -> list[tuple[str, str]]:
    return [(each.kind, each.name) for each in changes]


def test_the_changes_of_a_recording_come_in_order(tmp_path: Path) -> None:
    """A frame appears, is disputed, stops, comes back, and loses its publisher."""
    sim, bad = publisher("sim"), publisher("bad")
    path = write(
        tmp_path / "run.mcap",
        node("/sim"),
        described(sim, 0.0, ("world", "base", False)),
        steadily(sim, 0.0, 20.0, ("world", "base"), pause=(8.0, 12.0)),
        described(bad, 4.0, ("world", "base", False)),
        gone(bad, 6.0),
        gone(sim, 20.0),
        statics(publisher("late"), 21.0, ("base", "laser", 0.1)),
    )
    with Recorded(path) as recorded:
        changes = list(recorded.changes())
        part = list(recorded.changes(at(5.0), at(7.0)))
    assert [each for each in kinds(changes) if each[1] == "base"] == [
        ("problem begun", "base"),
        ("frame appeared", "base"),
        ("problem ended", "base"),
        ("conflict begun", "base"),
        ("conflict ended", "base"),
        ("frame stale", "base"),
        ("frame back", "base"),
        ("frame gone", "base"),
        ("problem begun", "base"),
    ]
    assert ("conflict ended", "base") in kinds(part)
    assert [each.at_ns for each in changes] == sorted(each.at_ns for each in changes)
    (conflict,) = [each for each in changes if each.kind == "conflict begun"]
    assert 0 <= at(4.0) - conflict.at_ns <= S // 5
    assert conflict.problem and "rename" in conflict.problem.remedy


def test_a_moment_outside_of_a_recording_is_refused(tmp_path: Path) -> None:
    """The error names the log times that it has."""
    path = write(tmp_path / "run.mcap", steadily(publisher("sim"), 0.0, 2.0, ("world", "base")))
    with Recorded(path) as recorded:
        with pytest.raises(InvalidArgumentException, match=str(recorded.end_ns)):
            recorded.at(recorded.end_ns + 1)
        assert recorded.at(recorded.end_ns).frames["base"].rate_hz == pytest.approx(10.0)
    with pytest.raises(InvalidArgumentException, match="file"):
        Recorded()


@pytest.mark.parametrize(
    ("from_s", "to_s", "period_s", "word"),
    [
        (1.5, 0.5, 0.2, "ends before"),
        (0.5, 9.0, 0.2, "not in the recording"),
        *[(0.5, 1.5, period_s, "period_s") for period_s in (0.0, -1.0, math.nan, math.inf, "1")],
    ],
)
def test_a_span_that_is_none_is_refused_at_once(
    tmp_path: Path, from_s: float, to_s: float, period_s: Any, word: str
) -> None:
    """Before the first change is asked for; and a moment is a whole number of ns."""
    path = write(tmp_path / "run.mcap", steadily(publisher("sim"), 0.0, 2.0, ("world", "base")))
    with Recorded(path) as recorded:
        with pytest.raises(InvalidArgumentException, match=word):
            recorded.changes(at(from_s), at(to_s), period_s)
        not_whole: Any = at(1.0) + 0.5
        with pytest.raises(InvalidArgumentException, match="integer"):
            recorded.at(not_whole)


def test_a_missing_file_is_an_error_of_tfbus(tmp_path: Path) -> None:
    """It says which file, and programs catch it as any error of a file."""
    with pytest.raises(MissingFileError, match="cannot be read") as caught:
        Recorded(tmp_path / "gone.mcap")
    assert isinstance(caught.value, FileError)


def test_the_changes_of_a_bus_come_as_they_happen(bus: Bus) -> None:
    """First all that is there, then the frame and the node that leave."""
    sim, watching = bus.node("sim"), bus.node("watching")
    keep_sending(sim, "world", "base")
    seen: list[BusChange] = []
    with Watch(watching) as watch:
        for change in watch.changes():
            seen.append(change)
            if change.kind == "frame appeared" and change.name == "base":
                sim.close()
            if {("frame gone", "base"), ("node left", "/sim")} <= set(kinds(seen)):
                break
    assert kinds(seen)[0] == ("node came", "/sim")
    assert all(each.text for each in seen)


def test_a_watch_by_the_simulated_clock_finds_no_other_time(bus: Bus) -> None:
    """Its node follows the clock as the publishers do."""
    start_clock(bus)
    keep_sending(follower(bus, "odometry"), "world", "base")
    node = follower(bus, "watching")
    node.wait_for_clock(DEADLINE_S)
    with Watch(node) as watch:
        moment = eventually(lambda: "/clock" in (now := watch.now()).node_names and now)
    assert moment.problems == ()


def test_a_frame_has_its_rate_age_and_delay(bus: Bus) -> None:
    """In Hz and s, with its publisher; None for a root and for a static frame."""
    keep_sending(bus.node("sim"), "world", "base", rate_hz=20.0, late_ns=100_000_000)
    send_static(bus.node("mount"), "base", "laser")
    with Watch(bus.node("watching")) as watch:
        eventually(lambda: watch.now().streams["sim"].delay_s)
        moment = watch.now()
    base, laser, world = (moment.frames[name] for name in ("base", "laser", "world"))
    assert (base.parent, base.state, base.publisher, base.node) == (
        *("world", "dynamic", "sim"),
        "/sim",
    )
    assert base.rate_hz == pytest.approx(20.0, rel=0.1)
    assert base.delay_s == pytest.approx(0.1, abs=0.05)
    assert base.age_s is not None and 0.1 <= base.age_s < 0.3
    assert (laser.state, laser.age_s, laser.delay_s) == ("static", None, None)
    assert (world.state, world.publishers) == ("root", ())
    assert (moment.lost, moment.refused, moment.unanswered) == (0, 0, ())
    assert asdict(base)["rate_hz"] == base.rate_hz
