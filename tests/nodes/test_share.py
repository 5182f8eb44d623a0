"""`tfbus share`: frames of one robot, shown to others."""

from collections.abc import Iterator
from contextlib import ExitStack
from signal import SIGINT, SIGKILL

import pytest
from click.testing import CliRunner

from tests.builders import x_of
from tests.buses import eventually
from tests.processes.publishers import launch
from tests.simulated_bus import Bus
from tfbus import Buffer, BusError, NodeSettings, TransformListener
from tfbus.nodes import share
from tfbus.testing.programs import Program


def robot(bus: Bus, number: int, *arguments: str) -> Program:
    """A robot in the map that all share, as many metres ahead as its number says."""
    where = ("--namespace", f"robot{number}", "--x", str(number))
    return launch(bus, "wheels", *where, "--moving", "map:base_link", *arguments)


class Eyes:
    """What each robot sees."""

    def __init__(self, bus: Bus, stack: ExitStack) -> None:
        self._bus = bus
        self._stack = stack
        self._buffers: dict[int, Buffer] = {}

    def of(self, number: int) -> Buffer:
        """The buffer of a robot, with all that is sent in its namespace."""
        if number not in self._buffers:
            node = self._bus.node("eyes", namespace=f"robot{number}")
            buffer = self._buffers[number] = Buffer()
            self._stack.enter_context(TransformListener(buffer, node))
        return self._buffers[number]


@pytest.fixture
def eyes(bus: Bus) -> Iterator[Eyes]:
    with ExitStack() as stack:
        yield Eyes(bus, stack)


def test_a_robot_sees_the_frames_that_are_shown_to_it_and_no_others(bus: Bus, eyes: Eyes) -> None:
    """robot1 sees where robot7's base_link is in the map, at the time of its own samples, and
    nothing else of robot7; others see nothing.
    """
    for number in (1, 2, 7):
        robot(bus, number, "--static", "base_link:camera")
    bus.start("share", "robot7", "base_link", "--to", "robot1", "--rate", "50")
    eventually(lambda: x_of(eyes.of(1), "base_link", "robot7/base_link") == 6)
    stamp_ns = eyes.of(1).lookup_transform("map", "robot7/base_link").stamp_ns
    eventually(lambda: eyes.of(1).lookup_transform("map", "robot7/base_link").stamp_ns > stamp_ns)
    assert eyes.of(1).frames() == ["base_link", "camera", "map", "robot7/base_link"]
    eventually(lambda: x_of(eyes.of(2), "map", "camera") == 4)
    assert eyes.of(2).frames() == ["base_link", "camera", "map"]


def test_several_frames_may_be_shown_to_several_robots(bus: Bus, eyes: Eyes) -> None:
    """Frames and robots are lists; the path to each frame may lead over any streams."""
    robot(bus, 7, "--static", "base_link:arm", "--moving", "arm:gripper")
    shown = ("base_link", "gripper")
    bus.start("share", "robot7", *shown, "--to", "robot1", "--to", "robot2", "--rate", "50")
    for number in (1, 2):
        eventually(lambda number=number: x_of(eyes.of(number), "map", "robot7/gripper") == 21)
        # The frames of one robot come one after the other.
        eventually(
            lambda number=number: x_of(eyes.of(number), "robot7/base_link", "robot7/gripper") == 14
        )


def test_what_does_not_move_is_static_for_others_too(bus: Bus, eyes: Eyes) -> None:
    """A static transform is shown as one: it holds at all times, and comes to late joiners."""
    bus.start("static", "world", "dock", "--x", "5", "--namespace", "robot7")
    process = bus.start("share", "robot7", "dock", "--to", "robot1", "--relative-to", "world")
    process.wait_for_line("'robot7/dock' is visible in 'world'")
    eventually(lambda: x_of(eyes.of(1), "world", "robot7/dock") == 5)
    assert eyes.of(1).frame("robot7/dock").static


def test_frames_of_a_robot_that_is_gone_are_taken_back(bus: Bus, eyes: Eyes) -> None:
    """Where the robot is gone its frames are removed for the others, and shown again when it is
    back.
    """
    first = robot(bus, 7, "--static", "map:dock")
    process = bus.start("share", "robot7", "base_link", "dock", "--to", "robot1", "--rate", "50")
    eventually(lambda: {"robot7/base_link", "robot7/dock"} <= {*eyes.of(1).frames()})
    first.signal(SIGKILL)
    eventually(lambda: eyes.of(1).frames() == ["map"])
    process.wait_for_line("'robot7/base_link' is not visible: .*gone")
    robot(bus, 7)
    eventually(lambda: x_of(eyes.of(1), "map", "robot7/base_link") == 7)


def test_the_end_of_share_is_noticed(bus: Bus, eyes: Eyes) -> None:
    """The frames are gone for the robots that saw them."""
    robot(bus, 7)
    process = bus.start("share", "robot7", "base_link", "--to", "robot1", "--rate", "50")
    eventually(lambda: x_of(eyes.of(1), "map", "robot7/base_link") == 7)
    assert process.stop(SIGINT) == 0
    eventually(lambda: eyes.of(1).frame("robot7/base_link").gone)


def test_frames_may_be_shown_to_all(bus: Bus, eyes: Eyes) -> None:
    """With `--to all` every other robot sees them, also one that comes later."""
    robot(bus, 7)
    robot(bus, 1)
    bus.start("share", "robot7", "base_link", "--to", "all", "--rate", "50")
    eventually(lambda: x_of(eyes.of(1), "base_link", "robot7/base_link") == 6)
    robot(bus, 2)
    eventually(lambda: x_of(eyes.of(2), "base_link", "robot7/base_link") == 5)
    assert "robot7/base_link" not in eyes.of(7).frames()


def test_what_is_shown_to_a_robot_is_not_the_robot(bus: Bus, eyes: Eyes) -> None:
    """If several share with all, none of them keeps showing frames to a robot that is gone."""
    robots = {number: robot(bus, number) for number in (1, 7, 8)}
    for number in (7, 8):
        bus.start("share", f"robot{number}", "base_link", "--to", "all", "--rate", "50")
        frame = f"robot{number}/base_link"
        eventually(lambda frame=frame: x_of(eyes.of(1), "base_link", frame))
    robots[1].signal(SIGKILL)
    session = bus.node("watch").session
    eventually(lambda: session.living("robot7/@tfbus/node/*"))
    eventually(lambda: session.living("robot1/@tfbus/node/*") == ["robot1/@tfbus/node/eyes"])


def test_one_robot_that_cannot_be_reached_does_not_hold_up_the_others(
    bus: Bus, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A robot whose bus cannot be joined is logged once, and retried."""
    node = bus.node("share_1")
    unreachable = {"robot2"}
    joined: list[str] = []

    class Reached:
        def __init__(self, settings: NodeSettings, robot: str) -> None:
            if robot in unreachable:
                raise BusError("cannot join the bus")
            joined.append(robot)

        def show(self, views: object) -> None:
            if len(joined) == 2:
                node.close()
            unreachable.clear()

        def close(self) -> None:
            pass

    monkeypatch.setattr(share, "Recipient", Reached)
    with TransformListener(Buffer(), node, reads="needed") as listener:
        share.Sharing(node, listener, ["robot7/base"], "map", 50.0).go_on(
            ["robot1", "robot2"], None
        )
    assert joined == ["robot1", "robot2"]
    report = capsys.readouterr().err
    assert report.count("frames to robot2 yet; retrying: ") == 1


def test_a_fleet_within_a_namespace_shares_there(bus: Bus, eyes: Eyes) -> None:
    """With a namespace the robots are those within it."""
    bus.start("static", "map", "dock", "--x", "5", "--namespace", "lab/robot7")
    bus.start("share", "robot7", "dock", "--to", "robot1", "--namespace", "lab")
    buffer = Buffer()
    with TransformListener(buffer, bus.node("eyes", namespace="lab/robot1")):
        eventually(lambda: x_of(buffer, "map", "robot7/dock") == 5)


def test_a_missing_frame_is_logged(bus: Bus) -> None:
    """A frame without a transform is logged after 2 s, with the reason; share goes on."""
    process = bus.start("share", "robot7", "base_link", "--to", "robot1", "--rate", "50")
    line = process.wait_for_line("is not visible")
    assert "'robot7/base_link' is not visible: " in line and "no frame 'map'" in line


@pytest.mark.parametrize(
    ("arguments", "mistake"),
    [
        (["robot7", "--to", "robot1"], "Missing argument 'FRAMES...'"),
        (["robot7", "base_link"], "Missing option '--to'"),
        (["robot7", "base_link", "--to", "robot7"], "--to: 'robot7' already sees its own frames;"),
        (["robot7", "map", "--to", "robot1"], "--relative-to: 'map' is one of the shown frames"),
        (["robot7", "/base", "--to", "robot1"], "begins with a slash"),
        (["robot 7", "base", "--to", "robot1"], "ROBOT: 'robot 7' cannot be the name of"),
        (["robot7", "base", "--to", "a*"], "--to: 'a*' cannot be the name of a namespace"),
        (["/", "base", "--to", "a"], "ROBOT: the name of a robot must not be empty"),
        (["robot7", "base", "--to", "a", "--rate", "0"], "must be at least 0.01, not 0"),
    ],
)
def test_mistakes_are_one_sentence(arguments: list[str], mistake: str) -> None:
    """A mistake is an error at once, with what is allowed, and exit code 2."""
    refused = CliRunner().invoke(share.main, arguments)
    assert refused.exit_code == 2
    assert mistake in " ".join(refused.output.split())
