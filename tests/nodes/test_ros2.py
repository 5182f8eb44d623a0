"""`tfbus ros2` as a command: its sentences on mistakes."""

from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest

from nodes import ros2
from tests.simulated_bus import Bus


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--only-to-ros", "--only-from-ros"], "are mutually exclusive: give one"),
        (["--only-to-ros", "--clock", "from-ros"], "are mutually exclusive"),
        (["--only-to-ros", "--odom-tf"], "the Odometry comes from ROS"),
        (["--frames", ""], "--frames '' fits no frame"),
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


@pytest.mark.real
@pytest.mark.parametrize(
    ("option", "direction"), [("--only-to-ros", "from-ros"), ("--only-from-ros", "to-ros")]
)
def test_a_topic_of_the_other_direction_is_a_mistake(
    bus: Bus, tmp_path: Path, option: str, direction: str
) -> None:
    """It could not cross."""
    file = tmp_path / "topics.yaml"
    file.write_text(f"turtle1/pose: {{direction: {direction}}}\n")
    ended = bus.run("ros2", option, "--topics", str(file))
    said = " ".join(ended.stderr.split())
    assert ended.returncode == 2 and f"{option} excludes topic 'turtle1/pose'" in said


@pytest.mark.real
def test_the_domain_of_the_environment_is_checked(bus: Bus) -> None:
    """As ROS's own tools do."""
    ended = bus.run("ros2", "--via", "zenoh", env={"ROS_DOMAIN_ID": "many"})
    assert ended.returncode == 2 and "DOMAIN_ID is 'many'" in ended.stderr


@pytest.mark.parametrize(
    ("modules", "connect", "has_router", "via", "said"),
    [
        (("rclpy", "cyclonedds"), (), True, "rclpy", "since it is there"),
        (("cyclonedds",), (), True, "zenoh", "--via dds is for Fast DDS and Cyclone DDS"),
        (("cyclonedds",), (), False, "dds", "--via zenoh is for rmw_zenoh"),
        ((), (), False, "zenoh", "--via dds is for Fast DDS and Cyclone DDS and needs "),
        (("cyclonedds",), ("tcp/robot:7447",), False, "zenoh", "an endpoint of Zenoh"),
        (("cyclonedds",), ("wlan0",), True, "dds", "a host or an interface"),
    ],
)
def test_auto_takes_what_is_there(
    monkeypatch: pytest.MonkeyPatch,
    modules: tuple[str, ...],
    connect: tuple[str, ...],
    has_router: bool,
    via: str,
    said: str,
) -> None:
    """And says why, and what the other way is."""
    monkeypatch.setattr(
        ros2, "find_spec", lambda name: ModuleSpec(name, None) if name in modules else None
    )
    monkeypatch.setattr(ros2, "has_router", lambda: has_router)
    chosen, note = ros2.choose_way(connect)
    assert chosen == via and said in note
