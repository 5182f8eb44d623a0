"""A robot behind a bad link, with its own router: the frames of its listener while the link is
away, loses its connection, or has another address.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from signal import SIGUSR1

import numpy as np
import pytest

from tests import needs
from tests.buses import eventually
from tests.hosts.lossy_link import Conditions, LossyLink
from tests.hosts.network import ROUTER_HOST, Network, frames
from tests.live_bus import Bus

REASON = needs.why_no_hosts()
pytestmark = [pytest.mark.real, pytest.mark.skipif(bool(REASON), reason=REASON or "-")]

HERE = "tcp/127.0.0.1:7447"
# Reports of the witness, five a second: longer than a lost link takes to be found and opened again.
REPORTS = 50


class Robot:
    """A robot whose router is linked to that of the base by a bad link alone, and a listener."""

    def __init__(self, bus: Bus, network: str, conditions: Conditions) -> None:
        self.network = Network(bus, "robot", "desk", offline=("robot",))
        self.conditions = conditions
        self.link: LossyLink = self.network.hosts.join_by_link("robot", ROUTER_HOST, conditions)
        env = {"TFBUS_NETWORK": network}
        self.base = self.network.start_router(env=env)
        base = f"tcp/{self.network.hosts.link_address[ROUTER_HOST]}:7447"
        routing = env | {"TFBUS_CONNECT": base, "TFBUS_LISTEN": HERE}
        self.router = self.network.start("robot", "-m", "tfbus", "router", env=routing)
        self.router.wait_for_line("Routing on")
        local = env | {"TFBUS_MODE": "client", "TFBUS_CONNECT": HERE}
        arguments = ["arm", "--moving=arm", "--static=camera", "--correct=camera"]
        self.arm = self.network.start("robot", "stream_publisher.py", *arguments, env=local)
        self.witness = self.network.start("desk", "fault_witness.py", "w", client=True, env=env)

    def is_known(self, camera_x: float) -> bool:
        """Whether the listener has fresh frames of it, and the camera where it should be."""
        known = frames(self.witness)
        return (
            known.keys() >= {"arm", "camera"}
            and not any(each["gone"] for each in known.values())
            and known["arm"]["age_s"] < 1.0
            and known["camera"].get("x") == camera_x
        )

    def wait_until_known(self, camera_x: float) -> None:
        """Wait until it is known; an AssertionError says what the listener knew at last."""
        try:
            eventually(lambda: self.is_known(camera_x))
        except AssertionError as error:
            ends = (self.witness, self.arm, self.router, self.base)
            told = [line for end in ends for line in (*end.out[-2:], *end.err[-20:])]
            raise AssertionError("\n".join([str(error), *told])) from None

    def wait_for_reports(self, count: int) -> None:
        """Let the listener report so often."""
        before = len(self.witness.out)
        eventually(lambda: len(self.witness.out) >= before + count)


@pytest.fixture
def robot(bus: Bus, request: pytest.FixtureRequest) -> Iterator[Robot]:
    robot = Robot(bus, *request.param)
    yield robot
    robot.network.close()


def go_away(robot: Robot) -> None:
    """The link carries nothing for two seconds, as while a robot roams."""
    robot.link.set(Conditions(is_up=False))
    robot.wait_for_reports(10)
    robot.arm.signal(SIGUSR1)
    robot.link.set(robot.conditions)


def lose_connections(robot: Robot) -> None:
    """The base's connections of TCP end; those of UDP stay."""
    robot.network.hosts.end_connections(ROUTER_HOST)
    robot.arm.signal(SIGUSR1)


def renumber(robot: Robot) -> None:
    """The robot has another address."""
    robot.network.hosts.renumber_link("robot", "10.98.0.77")
    robot.arm.signal(SIGUSR1)


LOSSY = Conditions(0.02, 0.005, 0.05)
# A try to link again fails if its first packet is lost, and several may be: then it is gone.
GOOD_ENOUGH = Conditions(0.02, 0.005, 0.01)


@pytest.mark.parametrize(
    ("robot", "change"),
    [
        (("wifi", LOSSY), go_away),
        (("wifi", GOOD_ENOUGH), lose_connections),
        (("wifi", GOOD_ENOUGH), renumber),
        (("mobile", Conditions(0.06, 0.03, 0.01)), go_away),
        (("satellite", Conditions(0.3, 0.0, 0.02)), go_away),
    ],
    indirect=["robot"],
    ids=["Wi-Fi-away", "Wi-Fi-half lost", "Wi-Fi-another address", "mobile-away", "satellite-away"],
)
def test_a_robot_behind_a_bad_link_is_not_gone(
    robot: Robot, change: Callable[[Robot], None]
) -> None:
    """Its frames are fresh again, and what it corrected meanwhile is known; it never was gone."""
    robot.wait_until_known(0.0)
    robot.wait_for_reports(REPORTS)
    change(robot)
    robot.wait_until_known(1.0)
    robot.wait_for_reports(REPORTS)
    robot.wait_until_known(1.0)
    assert not [line for line in robot.witness.err if "is gone;" in line]


@pytest.mark.parametrize("robot", [("wifi", LOSSY)], indirect=True)
def test_a_robot_out_of_reach_is_gone_until_it_is_back(robot: Robot) -> None:
    """A link that stays away makes a stream silent, then gone; it is back with the link."""
    robot.wait_until_known(0.0)
    robot.link.set(Conditions(is_up=False))
    robot.witness.wait_for_line("is silent")
    eventually(lambda: frames(robot.witness)["arm"]["gone"])
    robot.arm.signal(SIGUSR1)
    robot.link.set(robot.conditions)
    robot.wait_until_known(1.0)


@pytest.mark.parametrize("robot", [("mobile", Conditions(0.06, 0.03, 0.01))], indirect=True)
def test_small_messages_arrive_beside_images_that_the_link_cannot_carry(
    robot: Robot, tmp_path: Path
) -> None:
    """Of ten topics with 50 messages of 100 B a second, two of three arrive at least, also
    beside a camera that sends five times as much as there is room for.
    """
    robot.wait_until_known(0.0)
    start, env = robot.network.start, {"TFBUS_NETWORK": "mobile"}
    local = env | {"TFBUS_MODE": "client", "TFBUS_CONNECT": HERE}
    np.save(tmp_path / "image.npy", np.zeros((250, 400), np.uint8))
    image = ["--file", str(tmp_path / "image.npy"), "--quiet", "--rate", "5"]
    start("robot", "-m", "tfbus", "topic", "pub", "camera", "Image", *image, env=local)
    start("desk", "-m", "tfbus", "topic", "hz", "camera", client=True, env=env)
    counter = start("desk", "numbered_topics.py", "count", client=True, env=env)
    start("robot", "numbered_topics.py", "send", env=local)
    told = json.loads(counter.wait_for_line("lost"))
    assert told["lost"] < 0.35, told
