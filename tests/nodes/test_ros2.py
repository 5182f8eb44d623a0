"""`tfbus ros2` as a command: what it says of mistakes."""

import pytest

from tests.live_bus import Bus


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--only-to-ros", "--only-from-ros"], "are mutually exclusive: give one"),
        (["--only-to-ros", "--clock", "from-ros"], "are mutually exclusive"),
        (["--ros-namespace", "robot 1"], "is none that ROS can have"),
        (["--frame-prefix", "/robot 1/"], "'/robot 1/' begins with a slash"),
        (["--rate-limit", "0"], "must be at least 0.01"),
        (["--domain", "300"], "300 is not in the range 0<=x<=232"),
    ],
)
def test_mistakes_are_said_in_a_sentence(bus: Bus, arguments: list[str], said: str) -> None:
    """With exit code 2."""
    ended = bus.run("ros2", *arguments)
    assert ended.returncode == 2 and said in " ".join(ended.stderr.split())


def test_the_domain_of_the_environment_is_checked(bus: Bus) -> None:
    """As ROS's own tools do."""
    ended = bus.run("ros2", "--via", "zenoh", env={"ROS_DOMAIN_ID": "many"})
    assert ended.returncode == 2 and "ROS_DOMAIN_ID is 'many'" in ended.stderr
