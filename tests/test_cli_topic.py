"""`tfbus topic`: what there is, what goes over it, how often, and publishing by hand."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from conftest import Bus, Process, eventually, free_port

from tfbus import (
    Node,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformStamped,
)
from tfbus.codec import encode_map, encode_message
from tfbus.messages import Color, Pose, Twist, Vector3

USAGE = """Usage: python -m tfbus topic echo [OPTIONS] TOPIC
Try 'python -m tfbus topic echo --help' for help.

"""
POSE = Pose(1_000_000_005, 5.5, 2.0, 0.25, 1.0, 0.0)


@dataclass(frozen=True)
class Battery:
    """A message that tfbus does not supply."""

    stamp_ns: int
    cells: list[float]
    name: str
    key: bytes = b""


def run(bus: Bus, *arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of `tfbus topic ARGUMENTS`."""
    done = bus.run("topic", *arguments)
    assert "Traceback" not in done.stdout + done.stderr
    return done.returncode, done.stdout, done.stderr


def sim(bus: Bus, namespace: str = "") -> Node:
    """A node that says and hears as the simulator does: a pose fifty times a second."""
    node = bus.node("sim", namespace=namespace)
    poses = node.create_publisher(Pose, "turtle1/pose")
    node.create_subscription(Twist, "turtle1/cmd_vel", lambda twist: None)
    node.create_timer(0.02, lambda: poses.publish(POSE))
    return node


class TestList:
    def test_topics_are_listed_one_a_line(self, bus: Bus) -> None:
        """Topics are listed by name, with their types, counted, or by their ends."""
        sim(bus)
        bus.node("other").create_subscription(Pose, "turtle1/pose", lambda pose: None)
        assert run(bus, "list") == (0, "turtle1/cmd_vel\nturtle1/pose\n", "")
        assert run(bus, "list", "-t")[1] == "turtle1/cmd_vel [Twist]\nturtle1/pose [Pose]\n"
        assert run(bus, "list", "-c")[1] == "2\n"
        assert run(bus, "list", "-v")[1].splitlines() == [
            "Published topics:",
            " * turtle1/pose [Pose] 1 publisher",
            "",
            "Subscribed topics:",
            " * turtle1/cmd_vel [Twist] 1 subscriber",
            " * turtle1/pose [Pose] 1 subscriber",
        ]

    def test_a_machine_reads_the_list_as_json(self, bus: Bus) -> None:
        """The list as JSON has each topic with its types and the nodes at both ends."""
        sim(bus)
        topics = json.loads(run(bus, "list", "--json")[1])
        ends = {topic["name"]: (topic["types"], topic["publishers"]) for topic in topics}
        assert ends["turtle1/cmd_vel"] == (["Twist"], [])
        assert ends["turtle1/pose"][1][0]["node"] == "/sim"

    def test_transforms_are_topics_too(self, bus: Bus) -> None:
        """What a stream sends, moving or static, is listed under its key."""
        node = bus.node("camera")
        pose = TransformStamped(1, "world", "camera", Transform.identity())
        StaticTransformBroadcaster(node).send_transform(pose)
        eventually(lambda: run(bus, "list", "-t")[1] == "tf_static/camera [TransformMessage]\n")
        _, out, _ = run(bus, "info", "tf_static")
        assert out.splitlines() == [
            "Type: TransformMessage",
            "Publisher count: 1",
            "Subscription count: not known, listeners do not tell",
        ]

    def test_nothing_is_an_empty_list(self, bus: Bus) -> None:
        """Where there is no topic, nothing is printed, and that is no failure."""
        assert run(bus, "list") == (0, "", "")

    def test_names_are_relative_to_the_namespace(self, bus: Bus) -> None:
        """From within a namespace its topics have no prefix, and those outside are not there."""
        sim(bus, "robot7")
        bus.node("other").create_publisher(Pose, "pose")
        assert run(bus, "list", "--namespace", "robot7")[1] == "turtle1/cmd_vel\nturtle1/pose\n"
        assert "robot7/turtle1/pose\n" in run(bus, "list")[1]

    def test_info_shows_both_ends(self, bus: Bus) -> None:
        """A topic is shown with its type and counts, and with -v the nodes of each end."""
        sim(bus)
        code, out, err = run(bus, "info", "turtle1/pose")
        assert (code, err) == (0, "")
        assert out == "Type: Pose\nPublisher count: 1\nSubscription count: 0\n"
        _, out, _ = run(bus, "info", "turtle1/pose", "-v")
        assert out.splitlines()[2:4] == ["  Node name: /sim", "    Type: Pose"]
        assert json.loads(run(bus, "info", "turtle1/pose", "--json")[1])["types"] == ["Pose"]

    def test_a_topic_that_is_not_there_is_told_with_the_nearest(self, bus: Bus) -> None:
        """A misspelt topic fails with the one that is meant."""
        assert run(bus, "info", "x")[2] == (
            "Error: there is no topic 'x', nor any other: is a node running?\n"
        )
        sim(bus)
        assert run(bus, "info", "turtle1/poze") == (
            1,
            "",
            "Error: there is no topic 'turtle1/poze'; did you mean 'turtle1/pose'?\n",
        )


class TestEcho:
    def test_a_message_is_printed_as_yaml(self, bus: Bus) -> None:
        """Each message is a map of YAML, and a line of dashes after it."""
        sim(bus)
        code, out, err = run(bus, "echo", "turtle1/pose", "--once")
        assert (code, err) == (0, "")
        assert out.splitlines() == [
            "stamp_ns: 1000000005",
            "x: 5.5",
            "y: 2.0",
            "theta: 0.25",
            "linear_velocity: 1.0",
            "angular_velocity: 0.0",
            "---",
        ]

    @pytest.mark.parametrize(
        ("options", "printed"),
        [
            (("--csv",), "1000000005,5.5,2.0,0.25,1.0,0.0\n"),
            (("--json", "--field", "y", "--filter", "m.x > 5 and m.theta < 1"), "2.0\n"),
            (("--raw",), f"{encode_message(POSE).hex()}\n"),
        ],
    )
    def test_a_message_in_another_form(
        self, bus: Bus, options: tuple[str, ...], printed: str
    ) -> None:
        """As CSV, one field as JSON where a filter takes it, or the bytes as they came."""
        sim(bus)
        assert run(bus, "echo", "turtle1/pose", "--once", *options) == (0, printed, "")

    def test_messages_of_any_type_are_printed(self, bus: Bus) -> None:
        """What tfbus has no type for is printed as it comes; long values are cut unless told."""
        node = bus.node("robot")
        publisher = node.create_publisher(Battery, "battery")
        battery = Battery(1, [3.5, 3.25, 3.0], "left and right", b"\x01\xff\x02")
        node.create_timer(0.02, lambda: publisher.publish(battery))
        echo = ("echo", "battery", "--once")
        _, out, _ = run(bus, *echo, "-l", "2")
        assert out.splitlines() == [
            *("stamp_ns: 1", "cells:", "- 3.5", "- 3.25", "- '...'"),
            *("name: le...", "key: 01ff...", "---"),
        ]
        _, out, _ = run(bus, *echo, "--no-arr", "--no-str")
        assert "cells: <list of 3>\nname: <text of 14>\nkey: <3 bytes>\n" in out
        assert json.loads(run(bus, *echo, "--json")[1])["cells"] == [3.5, 3.25, 3.0]

    def test_transforms_are_printed(self, bus: Bus) -> None:
        """The transforms of a stream, or of all, are printed row by row; static ones at once."""
        node = bus.node("camera")
        pose = TransformStamped(7, "world", "camera", Transform((1.0, 2.0, 3.0)))
        StaticTransformBroadcaster(node).send_transform(pose)
        moving = TransformBroadcaster(node)
        node.create_timer(0.02, lambda: moving.send_transform(pose))
        for topic in ("tf_static/camera", "tf_static", "tf/camera", "tf"):
            _, out, _ = run(bus, "echo", topic, "--once", "--json", "--field", "transforms[0]")
            assert json.loads(out) == {
                "stamp_ns": 7,
                "frame_id": "world",
                "child_frame_id": "camera",
                "transform": {
                    "translation": {"x": 1.0, "y": 2.0, "z": 3.0},
                    "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
                },
            }, topic

    def test_what_is_waited_for_is_said(self, bus: Bus) -> None:
        """Where nobody publishes, it is said, with the nearest topic; and given up in time."""
        sim(bus)
        code, out, err = run(bus, "echo", "turtle1/pse", "--timeout", "0.5")
        assert (code, out) == (1, "")
        assert err.splitlines() == [
            "Waiting for a message on 'turtle1/pse': nobody publishes it; "
            "did you mean 'turtle1/pose'?",
            "Error: no message came on 'turtle1/pse' in 0.5 s",
        ]

    def test_a_publisher_that_comes_later_is_heard(self, bus: Bus) -> None:
        """Echo waits for a topic that does not exist yet, and knows its type when it does."""
        echo = bus.start("topic", "echo", "color", "--field", "g")
        echo.wait_for_line("Waiting for a message on 'color': nobody publishes it")
        node = bus.node("painter")
        colors = node.create_publisher(Color, "color")
        node.create_timer(0.05, lambda: colors.publish(Color(1, 2, 3)))
        eventually(lambda: echo.out[:2] == ["2", "---"])
        assert echo.stop() == 0
        assert len(echo.err) == 1

    def test_a_bad_message_is_told_once_and_left_out(self, bus: Bus) -> None:
        """What is no message of the topic's type is told once; the others are printed."""
        node = bus.node("painter")
        colors = node.create_publisher(Color, "color")

        def publish() -> None:
            node.session.zenoh.put("color", b"\xff")
            node.session.zenoh.put("color", encode_map({"r": 1}))
            colors.publish(Color(1, 2, 3))

        node.create_timer(0.05, publish)
        echo = bus.start("topic", "echo", "color", "--csv")
        eventually(lambda: len(echo.out) > 5)
        assert echo.stop() == 0
        assert set(echo.out) == {"1,2,3"}
        assert len(echo.err) == 1
        assert echo.err[0].startswith("Warning: left out a message of 'color': ")

    def test_a_mistake_is_one_sentence(self, bus: Bus) -> None:
        """Options that do not go together, or a field that is not there, are usage errors."""
        assert run(bus, "echo", "turtle1/pose", "--csv", "--json")[::2] == (
            2,
            f"{USAGE}Error: --csv, --json and --raw are three forms: give one of them\n",
        )
        sim(bus)
        code, out, err = run(bus, "echo", "turtle1/pose", "--field", "thta")
        assert (code, out) == (2, "")
        assert err.endswith("no 'thta' there; did you mean 'theta'?\n")


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
        """Bandwidth tells sizes; a delay is the time since the stamp, here of a second of 1970."""
        node = sim(bus)
        _, out, _ = run(bus, "bw", "turtle1/pose", "--once")
        assert re.fullmatch(
            r"\d\.\d\d KB/s from \d+ messages\n"
            r"\tMessage size mean: (\d+) B min: \1 B max: \1 B\n",
            out,
        )
        _, out, _ = run(bus, "delay", "turtle1/pose", "--once", "--json")
        told = json.loads(out)
        assert told["mean_s"] == pytest.approx(node.now_ns() / 1e9 - 1.0, abs=60.0)
        assert (told["topic"], told["window"] > 1) == ("turtle1/pose", True)

    def test_several_topics_are_a_table(self, bus: Bus) -> None:
        """Several topics are measured together, a line each, transforms too."""
        node = sim(bus)
        moving = TransformBroadcaster(node)
        pose = TransformStamped(7, "world", "turtle1", Transform.identity())
        node.create_timer(0.02, lambda: moving.send_transform(pose))
        _, out, _ = run(bus, "hz", "turtle1/pose", "tf/sim", "--once", "--window", "5")
        headings, *rows = [line.split() for line in out.splitlines() if line]
        assert headings == ["topic", "rate", "min_delta", "max_delta", "std_dev", "window"]
        assert [(row[0], row[-1]) for row in rows] == [("turtle1/pose", "5"), ("tf/sim", "5")]
        assert run(bus, "delay", "tf", "--once")[1].startswith("average delay: ")

    def test_only_messages_that_pass_the_filter_are_counted(self, bus: Bus) -> None:
        """With a filter that nothing passes there is nothing to tell, and that is a failure."""
        sim(bus)
        code, out, err = run(bus, "hz", "turtle1/pose", "--filter", "m.x < 5", "--timeout", "0.5")
        assert (code, out) == (1, "")
        assert err == "Error: too few messages came on 'turtle1/pose' in 0.5 s\n"

    def test_silence_is_said(self, bus: Bus) -> None:
        """Where no message comes, or none any more, it is said and not printed as a rate."""
        hz = bus.start("topic", "hz", "turtle1/pose")
        hz.wait_for_line(r"nobody publishes it")
        node = sim(bus)
        hz.wait_for_line("average rate")
        node.close()
        hz.wait_for_line("No new messages on 'turtle1/pose'")
        assert hz.stop() == 0

    def test_messages_without_a_stamp_have_no_delay(self, bus: Bus) -> None:
        """A message without stamp_ns fails, saying which field is wanted."""
        node = bus.node("painter")
        colors = node.create_publisher(Color, "color")
        node.create_timer(0.05, lambda: colors.publish(Color(1, 2, 3)))
        code, _, err = run(bus, "delay", "color")
        assert (code, err) == (
            1,
            "Error: messages on 'color' have no field stamp_ns, so how old they are is unknown\n",
        )


class TestPub:
    @pytest.fixture
    def heard(self, bus: Bus) -> Iterator[list[Twist]]:
        """What a node hears on cmd_vel."""
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
        """One message is published when somebody subscribes; the type may be left out."""
        code, out, err = run(bus, "pub", "--once", "cmd_vel", *message)
        assert (code, err) == (0, "")
        assert out == (
            'publishing #1: Twist {"linear": {"x": 2.0, "y": 0.0, "z": 0.0}, '
            '"angular": {"x": 0.0, "y": 0.0, "z": 0.0}}\n'
        )
        eventually(lambda: heard == [Twist(Vector3(x=2.0))])

    def test_so_many_at_a_rate(self, bus: Bus, heard: list[Twist]) -> None:
        """Messages are published so many times, and told now and then."""
        code, out, _ = run(bus, "pub", "-t", "5", "-r", "50", "-p", "2", "cmd_vel", "Twist")
        assert code == 0
        assert [line.split(":")[0] for line in out.splitlines()] == [
            "publishing #1",
            "publishing #3",
            "publishing #5",
        ]
        eventually(lambda: heard == [Twist()] * 5)

    def test_it_goes_on_until_it_is_stopped(self, bus: Bus) -> None:
        """Without a count it publishes to whoever is there, and is a topic of its own."""
        pub: Process = bus.start(
            "topic", "pub", "-q", "-r", "50", "color", "Color", "{r: 1, g: 2, b: 3}"
        )
        eventually(lambda: run(bus, "list", "-t")[1] == "color [Color]\n")
        assert run(bus, "echo", "color", "--once", "--csv")[1] == "1,2,3\n"
        assert bus.run("node", "list").stdout == ""
        assert pub.stop() == 0
        assert (pub.out, pub.err) == ([], [])

    def test_a_type_of_ones_own(self, bus: Bus) -> None:
        """A message of a type that is not supplied goes as it is typed in."""
        heard: list[Battery] = []
        bus.node("robot").create_subscription(Battery, "battery", heard.append)
        values = "{stamp_ns: 1, cells: [3.5], name: left}"
        assert run(bus, "pub", "--once", "battery", values)[0] == 0
        eventually(lambda: heard == [Battery(1, [3.5], "left")])

    def test_subscribers_are_waited_for(self, bus: Bus, heard: list[Twist]) -> None:
        """It says what it waits for; so many subscribers have to be there, or come in time."""
        code, out, err = run(bus, "pub", "--once", "nobody", "Twist", "--max-wait-time", "0.3")
        assert (code, out) == (1, "")
        assert err == "Error: 'nobody' has fewer than 1 subscribers (waited 0.3 s)\n"
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
            (("Twist", "5"), "Invalid value for VALUES: a map of fields in YAML is wanted"),
            (("Twist", "{linear:", "{x: 1}}"), "3 words are more than a type and a map of fields"),
        ],
    )
    def test_a_mistake_is_one_sentence(
        self, bus: Bus, heard: list[Twist], message: tuple[str, ...], sentence: str
    ) -> None:
        """A field, value or type that cannot be is a usage error, and nothing is published."""
        code, out, err = run(bus, "pub", "--once", "cmd_vel", *message)
        assert (code, out) == (2, "")
        assert err.splitlines()[-1].startswith(f"Error: {sentence}")
        assert heard == []

    def test_transforms_are_not_published_by_hand(self, bus: Bus) -> None:
        """A topic of transforms is refused, with what does publish them."""
        code, _, err = run(bus, "pub", "tf/sim", "{}")
        assert code == 2
        assert "'tf/sim' is of transforms: publish one with `tfbus static`" in err


def test_a_client_works_through_a_router(bus: Bus) -> None:
    """All of it works for a client that knows only a router."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = bus.start("router", "--listen", endpoint)
    router.wait_for_line("Routing on")
    at_router = ("--mode", "client", "--connect", endpoint)
    pub = bus.start(
        "topic", "pub", "-q", "-r", "20", "color", "Color", "{r: 1, g: 2, b: 3}", *at_router
    )
    eventually(lambda: run(bus, "list", *at_router)[1] == "color\n")
    assert run(bus, "echo", "color", "--once", "--csv", *at_router)[1] == "1,2,3\n"
    assert run(bus, "hz", "color", "--once", *at_router)[0] == 0
    assert pub.stop() == 0
