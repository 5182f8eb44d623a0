"""Rosters of robots, their order, and the robots of a moment."""

import gc
import tracemalloc

import pytest

from tests.builders import S, moved
from tfbus import Buffer
from tfbus.base.errors import InvalidArgumentException, LookupException
from tfbus.base.structs import replace
from tfbus.base.wording import natural_order
from tfbus.frames.fleet import FleetWatch, RobotStatus, worst_first
from tfbus.frames.moment import BusMoment
from tfbus.frames.snapshot import Problem, frame_tree
from tfbus.streams.info import MOST_GONE, StreamInfo
from tfbus.wire.fleet import roster_of


def test_numbers_in_names_count_as_numbers() -> None:
    """robot2 is before robot10, and names without numbers are as ever."""
    names = ["robot2", "robot2/arm1", "robot2/arm12", "robot10", "robot", "2", "10", "tower"]
    expected = ["2", "10", "robot", "robot2", "robot2/arm1", "robot2/arm12", "robot10", "tower"]
    assert sorted(names, key=natural_order) == expected
    assert natural_order("1" * 10_000) != natural_order("01")


@pytest.mark.parametrize(
    ("texts", "names"),
    [
        (["robot[1-3]"], ["robot1", "robot2", "robot3"]),
        (["robot[08-10]"], ["robot08", "robot09", "robot10"]),
        (["robot[1,4-5,x]"], ["robot1", "robot4", "robot5", "robotx"]),
        (["hall[1-2]/r[1-2]"], ["hall1/r1", "hall1/r2", "hall2/r1", "hall2/r2"]),
        (["tower", "/tower/"], ["tower"]),
    ],
)
def test_a_roster_has_ranges(texts: list[str], names: list[str]) -> None:
    """A range stands for all its numbers, and its zeros stay; each robot is there once."""
    assert list(roster_of(texts)) == names


@pytest.mark.parametrize(
    "text",
    [
        "robot[1-",
        "robot1-3]",
        "robot[]",
        "robot[3-1]",
        "robot[1-]",
        "robot[1-99999]",
        "a[1-200][1-200]",
        "a*",
        "a//b",
    ],
)
def test_a_roster_refuses_mistakes(text: str) -> None:
    """A range that is none, too many robots, and names that cannot be namespaces are errors."""
    with pytest.raises(InvalidArgumentException):
        roster_of([text])


def test_the_worst_come_first() -> None:
    """Gone, missing, in trouble, well: each in the order of names."""
    problem = Problem("gone", ("robot10/arm",), "its publisher is gone")
    robots = [
        RobotStatus("robot10", "there"),
        RobotStatus("robot2", "there"),
        RobotStatus("robot30", "there", problems=(problem,)),
        RobotStatus("robot4", "missing"),
        RobotStatus("robot5", "gone"),
        RobotStatus("robot1", "there", stale=1),
    ]
    names = [robot.name for robot in worst_first(robots)]
    assert names == ["robot5", "robot4", "robot1", "robot30", "robot2", "robot10"]


@pytest.mark.parametrize(
    ("frame", "nearest"),
    [
        ("robot7/base_link", ()),
        ("robot27/base_lnk", ("robot27/base_link",)),
        ("base_link", ()),
        ("mapp", ("map",)),
    ],
)
def test_similar_names_are_of_the_same_robot(frame: str, nearest: tuple[str, ...]) -> None:
    """An unknown frame is never answered with a frame of another robot."""
    error = LookupException("", frame=frame, known=["map", "robot27/base_link", "robot27/arm"])
    assert error.nearest[:1] == nearest[:1]
    assert nearest or "robot27" not in error.advice


def moment(at_s: float, *streams: StreamInfo, buffer: Buffer | None = None) -> BusMoment:
    """The bus at this second, with these streams, and the frames of a buffer if there is one."""
    at_ns = round(at_s * S)
    return BusMoment(at_ns=at_ns, tree=frame_tree(buffer or Buffer(), streams, at_ns))


def wheels(heard_s: float, messages: int, size: int, *, alive: bool = True) -> StreamInfo:
    """The stream of robot7, whose last message came at this second, 20 ms old."""
    return StreamInfo(
        "robot7/wheels",
        node="/robot7/wheels",
        alive=alive,
        frames=(("map", "robot7/base", False),),
        messages=messages,
        bytes=size,
        last_heard_ns=round(heard_s * S),
        last_delay_s=0.02,
    )


def test_between_looks_at_all_frames_a_robot_has_the_problems_of_the_last() -> None:
    """Of a moment without frames the age is that of the stream's last message, and the problems
    are those that were there; one that is gone is gone at once.
    """
    buffer = Buffer()
    buffer.set_transform(moved(round(999.0 * S), "map", "robot7/base"), authority="robot7/wheels")
    watch = FleetWatch()
    (robot,) = watch.robots(moment(1010.0, wheels(999.0, 10, 1000), buffer=buffer))
    assert (robot.age_s, robot.frames, robot.stale) == (11.0, 1, 1)
    (robot,) = watch.robots(moment(1011.0, wheels(1010.9, 20, 2000)), has_frames=False)
    assert (robot.age_s, robot.frames, robot.stale) == (pytest.approx(0.12), 1, 1)
    (robot,) = watch.robots(moment(1012.0, wheels(1010.9, 20, 2000, alive=False)), has_frames=False)
    assert robot.state == "gone"


def test_a_robot_that_returns_has_its_rate_at_once() -> None:
    """Of one that came just now the rate is not known yet; then it is that since it came, not that
    of all messages that were counted before it left.
    """
    watch = FleetWatch()
    for at_s, messages, alive in (
        (1000.0, 0, True),
        (1001.0, 500, False),
        (1010.0, 500, False),
        (1011.0, 510, True),
    ):
        stream = wheels(at_s, messages, 100 * messages, alive=alive)
        (robot,) = watch.robots(moment(at_s, stream))
    assert (robot.state, robot.messages_hz, robot.bytes_per_s) == ("there", None, None)
    for second in range(1, 10):
        count = 510 + 10 * second
        (robot,) = watch.robots(moment(1011.0 + second, wheels(1011.0, count, 100 * count)))
        assert robot.messages_hz == 10.0
    # A listener that has forgotten the stream counts from 0 again.
    (robot,) = watch.robots(moment(1022.0, wheels(1022.0, 3, 300)))
    assert robot.messages_hz is None
    (robot,) = watch.robots(moment(1023.0, wheels(1023.0, 13, 1300)))
    assert robot.messages_hz == 10.0


def test_a_moment_may_be_looked_at_twice() -> None:
    """A robot that comes between two looks at one moment, as of a clock that stands still, has its
    rate from then on; one that restarts between them too.
    """
    for before in ((), (wheels(1000.0, 500, 50_000),)):
        watch = FleetWatch()
        watch.robots(moment(999.0, *before))
        watch.robots(moment(1000.0, *before))
        (robot,) = watch.robots(moment(1000.0, wheels(1000.0, 0, 0)))
        assert (robot.state, robot.messages_hz) == ("there", None)
        (robot,) = watch.robots(moment(1001.0, wheels(1001.0, 10, 1000)))
        assert robot.messages_hz == 10.0


def test_robots_that_come_and_go_fill_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of many that came, each with another name, and left, a watch keeps the thousand, here a
    hundred, that left last, in at most 1 kB each beside 100 kB; the roster is never forgotten.
    """
    assert MOST_GONE == 1000
    monkeypatch.setattr("tfbus.frames.fleet.MOST_GONE", 100)
    watch = FleetWatch(("robot0",))
    watch.robots(moment(0.0, wheels(0, 7, 700)))  # whatever the first one imports
    gc.collect()  # what other tests left, whose ends take memory, too
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for first in range(0, 300, 50):
        here = [
            replace(wheels(first, 7, 700), name=f"robot{number}/wheels", node="")
            for number in range(first, first + 50)
        ]
        watch.robots(moment(float(first), *here))
    del here
    watch.robots(moment(300.0))
    gc.collect()
    used = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    robots = watch.robots(moment(301.0))
    assert {robot.state for robot in robots} == {"gone"}
    assert [each.name for each in robots][:2] == ["robot0", "robot200"]
    assert len(robots) == 101
    assert used < (100 + 100) * 2**10


def test_a_load_is_that_on_the_air() -> None:
    """The network adds to each message, and to each packet of a large one."""
    watch = FleetWatch()
    watch.robots(moment(1000.0, wheels(1000.0, 0, 0)))
    (robot,) = watch.robots(moment(1002.0, wheels(1002.0, 20, 20 * 228)))
    assert robot.messages_hz == 10.0
    # 6.8 kB/s at 20 Hz, as benchmarks.bus.air counts them.
    assert robot.bytes_per_s == pytest.approx(3340, rel=0.02)


def test_a_robot_that_is_expected_is_one_also_below_a_namespace_with_nodes() -> None:
    """As of a server of maps for all robots of a site; what is not expected is a part of it."""
    names = ("site", "site/robot1", "site/robot1/arm", "site/door")
    streams = [StreamInfo(f"{name}/sim", node=f"/{name}/sim", alive=True) for name in names]
    watch = FleetWatch(["site/robot1", "site/robot2"])
    robots = {robot.name: robot for robot in watch.robots(moment(1.0, *streams))}
    assert {name: robot.state for name, robot in robots.items()} == {
        "site": "there",
        "site/robot1": "there",
        "site/robot2": "missing",
    }
