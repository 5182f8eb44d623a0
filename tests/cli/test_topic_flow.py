"""`tfbus topic`: how often messages come, how large and how late, and publishing by hand."""

import json
import re
from collections.abc import Iterator

import numpy as np
import pytest

from tests.buses import eventually
from tests.cli.topic_talker import Battery, run, sim
from tests.simulated_bus import Bus
from tfbus import (
    Transform,
    TransformBroadcaster,
    TransformStamped,
)
from tfbus.messages import Color, PointCloud, Twist, Vector3
from tfbus.testing.programs import Program


class TestMeasure:
    def test_the_rate_is_printed_as_ros2_does(self, bus: Bus) -> None:
        """A rate is two lines: the average, and how the intervals are spread."""
        sim(bus)
        code, out, err = run(bus, "hz", "turtle1/pose", "--once")
        assert (code, err) == (0, "")
        assert re.fullmatch(
            r"average rate: \d+\.\d{3}\n"
            r"\tmin: \d\.\d{3}s max: \d\.\d{3}s std dev: \d\.\d{5}s window: \d+\n",
            out,
        )

    def test_bandwidth_and_delay(self, bus: Bus) -> None:
        """Bandwidth has sizes; a delay is the time since the stamp, here of 1970."""
        node = sim(bus)
        _, out, _ = run(bus, "bw", "turtle1/pose", "--once")
        assert re.fullmatch(
            r"[\d.]+ K?B/s from \d+ messages\n"
            r"\tMessage size mean: (\d+) B min: \1 B max: \1 B\n",
            out,
        )
        _, out, _ = run(bus, "delay", "turtle1/pose", "--once", "--json")
        report = json.loads(out)
        assert report["mean_s"] == pytest.approx(node.now_ns() / 1e9 - 1.0, abs=60.0)
        assert (report["topic"], report["window"] > 1) == ("turtle1/pose", True)

    def test_messages_with_a_header_of_ros_have_a_delay(self, bus: Bus) -> None:
        """By its stamp; what they carry is not read."""
        node = bus.node("lidar")
        clouds = node.create_publisher(PointCloud, "points")
        xyz = np.zeros((9_000, 3))
        node.create_timer(
            0.1, lambda: clouds.publish(PointCloud.from_xyz(node.now_ns() - 10**9, "lidar", xyz))
        )
        _, out, _ = run(bus, "delay", "points", "--once", "--json")
        assert json.loads(out)["mean_s"] == pytest.approx(1.0, abs=0.1)

    def test_several_topics_are_a_table(self, bus: Bus) -> None:
        """Several topics are measured together, a line each, transforms too."""
        node = sim(bus)
        moving = TransformBroadcaster(node)
        pose = TransformStamped(7, "world", "turtle1", Transform.identity())
        node.create_timer(0.02, lambda: moving.send_transform(pose))
        _, out, _ = run(bus, "hz", "turtle1/pose", "tf/sim", "--once", "--window", "5")
        headings, *rows = [line.split() for line in out.splitlines() if line]
        assert headings == ["topic", "rate", "min_delta", "max_delta", "std_dev", "window"]
        assert [row[0] for row in rows] == ["turtle1/pose", "tf/sim"]
        assert all(2 <= int(row[-1]) <= 5 for row in rows)
        assert run(bus, "delay", "tf", "--once")[1].startswith("average delay: ")

    def test_only_messages_that_pass_the_filter_are_counted(self, bus: Bus) -> None:
        """With a filter that nothing passes there is nothing to tell, and that is a failure."""
        sim(bus)
        code, out, err = run(bus, "hz", "turtle1/pose", "--filter", "m.x < 5", "--timeout", "0.5")
        assert (code, out) == (1, "")
        assert "too few messages" in err and "'turtle1/pose'" in err

    def test_silence_is_reported(self, bus: Bus) -> None:
        """If no messages come, or they stop, it prints so instead of a rate."""
        hz = bus.start("topic", "hz", "turtle1/pose")
        hz.wait_for_line(r"it has no publisher")
        node = sim(bus)
        hz.wait_for_line("average rate")
        node.close()
        hz.wait_for_line("No new messages on 'turtle1/pose'")
        assert hz.stop() == 0

    def test_messages_without_a_stamp_have_no_delay(self, bus: Bus) -> None:
        """A message without stamp_ns is an error that names the field."""
        node = bus.node("painter")
        colors = node.create_publisher(Color, "color")
        node.create_timer(0.05, lambda: colors.publish(Color(1, 2, 3)))
        code, _, err = run(bus, "delay", "color")
        assert code == 1 and "'color'" in err and "no field stamp_ns" in err


class TestPub:
    @pytest.fixture
    def heard(self, bus: Bus) -> Iterator[list[Twist]]:
        """The messages that a node receives on cmd_vel."""
        heard: list[Twist] = []
        bus.node("sim").create_subscription(Twist, "cmd_vel", heard.append)
        yield heard

    @pytest.mark.parametrize(
        "message",
        [("Twist", "{linear: {x: 2}}"), ("{linear: {x: 2}}",), ("linear: {x: 2.0}",)],
    )
    def test_one_message_reaches_its_subscriber(
        self, bus: Bus, heard: list[Twist], message: tuple[str, ...]
    ) -> None:
        """One message is published once there is a subscriber; the type is optional."""
        code, out, err = run(bus, "pub", "--once", "cmd_vel", *message)
        assert (code, err) == (0, "")
        assert out == (
            'publishing #1: Twist {"linear": {"x": 2.0, "y": 0.0, "z": 0.0}, '
            '"angular": {"x": 0.0, "y": 0.0, "z": 0.0}}\n'
        )
        eventually(lambda: heard == [Twist(Vector3(x=2.0))])

    def test_so_many_at_a_rate(self, bus: Bus, heard: list[Twist]) -> None:
        """It publishes N messages, and prints every second one."""
        code, out, _ = run(bus, "pub", "-t", "5", "-r", "50", "-p", "2", "cmd_vel", "Twist")
        assert code == 0
        assert [line.split(":")[0] for line in out.splitlines()] == [
            "publishing #1",
            "publishing #3",
            "publishing #5",
        ]
        eventually(lambda: heard == [Twist()] * 5)

    def test_it_goes_on_until_it_is_stopped(self, bus: Bus) -> None:
        """Without a count it does not wait for subscribers, and its topic is listed."""
        pub: Program = bus.start(
            "topic", "pub", "-q", "-r", "50", "color", "Color", "{r: 1, g: 2, b: 3}"
        )
        eventually(lambda: run(bus, "list", "-t")[1] == "color [Color]\n")
        assert run(bus, "echo", "color", "--once", "--csv")[1] == "1,2,3\n"
        assert bus.run("node", "list").stdout == ""
        assert pub.stop() == 0
        assert (pub.out, pub.err) == ([], [])

    def test_a_type_may_be_called_as_in_ros(self, bus: Bus, heard: list[Twist]) -> None:
        """A command line for ROS publishes the same message."""
        twist = ("geometry_msgs/msg/Twist", "{linear: {x: 2.0}}")
        assert run(bus, "pub", "--once", "cmd_vel", *twist)[0] == 0
        eventually(lambda: [message.linear.x for message in heard] == [2.0])

    def test_a_type_of_ones_own(self, bus: Bus) -> None:
        """A message of a type that is not supplied goes as it is typed in."""
        heard: list[Battery] = []
        bus.node("robot").create_subscription(Battery, "battery", heard.append)
        values = "{stamp_ns: 1, cells: [3.5], name: left}"
        assert run(bus, "pub", "--once", "battery", values)[0] == 0
        eventually(lambda: heard == [Battery(1, [3.5], "left")])

    def test_subscribers_are_waited_for(self, bus: Bus, heard: list[Twist]) -> None:
        """It prints what it waits for, and fails if N subscribers do not come in time."""
        code, out, err = run(bus, "pub", "--once", "nobody", "Twist", "--max-wait-time", "0.3")
        assert (code, out) == (1, "")
        assert "'nobody' has fewer than" in err
        pub = bus.start("topic", "pub", "--once", "-w", "2", "cmd_vel", "Twist")
        pub.wait_for_line("Waiting for 2 subscribers of 'cmd_vel'")
        assert heard == []
        bus.node("second").create_subscription(Twist, "cmd_vel", lambda twist: None)
        assert pub.wait() == 0
        eventually(lambda: heard == [Twist()])

    @pytest.mark.parametrize(
        ("message", "sentence"),
        [
            (("{linaer: {x: 2}}",), "Twist has no field 'linaer'; did you mean 'linear'?"),
            (("Twist", "5"), "Invalid value for VALUES: expected a YAML map of fields"),
            (("Twist", "{linear:", "{x: 1}}"), "expected a type and a map of fields, got 3 words"),
        ],
    )
    def test_a_mistake_is_one_sentence(
        self, bus: Bus, heard: list[Twist], message: tuple[str, ...], sentence: str
    ) -> None:
        """An invalid field, value or type is a usage error; nothing is published."""
        code, out, err = run(bus, "pub", "--once", "cmd_vel", *message)
        assert (code, out) == (2, "")
        assert err.splitlines()[-1].startswith(f"Error: {sentence}")
        assert heard == []

    def test_transforms_are_not_published_by_hand(self, bus: Bus) -> None:
        """A topic of transforms is refused; the error names `tfbus static`."""
        code, _, err = run(bus, "pub", "tf/sim", "{}")
        assert code == 2
        assert "'tf/sim' carries transforms" in err and "`tfbus static`" in err
