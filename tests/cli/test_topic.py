"""`tfbus topic`: topics, their publishers and subscribers, and their messages."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from tests.buses import eventually
from tests.cli.topic_talker import POSE, Battery, run, sim
from tests.simulated_bus import Bus
from tfbus import (
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformStamped,
)
from tfbus.messages import Color, Image, LaserScan, OccupancyGrid, PointCloud, Pose, PoseStamped
from tfbus.wire.codec import encode_map, encode_message

USAGE = """Usage: python -m tfbus topic echo [OPTIONS] TOPIC [TYPE]
Try 'python -m tfbus topic echo --help' for help.

"""


class TestList:
    def test_topics_are_listed_one_a_line(self, bus: Bus) -> None:
        """Topics are listed by name, with their types, counted, or by their ends."""
        sim(bus)
        bus.node("other").create_subscription(Pose, "turtle1/pose", lambda pose: None)
        assert run(bus, "list") == (0, "turtle1/cmd_vel\nturtle1/pose\n", "")
        typed = run(bus, "list", "-t")[1].splitlines()
        assert typed == ["turtle1/cmd_vel [Twist]", "turtle1/pose [Pose]"]
        assert run(bus, "list", "-c")[1] == "2\n"
        assert run(bus, "list", "-v")[1].splitlines() == [
            "Published topics:",
            " * turtle1/pose [Pose] 1 publisher",
            "",
            "Subscribed topics:",
            " * turtle1/cmd_vel [Twist] 1 subscriber",
            " * turtle1/pose [Pose] 1 subscriber",
        ]

    def test_all_types_have_the_names_of_their_classes(self, bus: Bus) -> None:
        """Also those that have ROS's full names on the bus, which JSON has; others have those."""
        node = bus.node("robot")
        for type_ in (PointCloud, PoseStamped):
            node.create_publisher(type_, type_.__name__.lower())
        node.create_raw_publisher("battery", type_name="my_msgs/msg/Battery")
        wanted = [
            "battery [my_msgs/msg/Battery]",
            "pointcloud [PointCloud]",
            "posestamped [PoseStamped]",
        ]
        eventually(lambda: run(bus, "list", "-t")[1].splitlines() == wanted)
        assert run(bus, "type", "pointcloud")[1] == "PointCloud\n"
        assert run(bus, "info", "pointcloud")[1].startswith("Type: PointCloud\n")
        told = {each["name"]: each["types"] for each in json.loads(run(bus, "list", "--json")[1])}
        assert told["pointcloud"] == ["sensor_msgs/msg/PointCloud2"]
        assert "pointcloud: PointCloud" in bus.run("node", "info", "/robot").stdout

    def test_a_machine_reads_the_list_as_json(self, bus: Bus) -> None:
        """The list as JSON has each topic with its types and the nodes at both ends."""
        sim(bus)
        topics = json.loads(run(bus, "list", "--json")[1])
        ends = {topic["name"]: (topic["types"], topic["publishers"]) for topic in topics}
        assert ends["turtle1/cmd_vel"] == (["Twist"], [])
        assert ends["turtle1/pose"][1][0]["node"] == "/sim"

    def test_transforms_are_topics_too(self, bus: Bus) -> None:
        """A stream's transforms, dynamic and static, are listed under their keys."""
        node = bus.node("camera")
        pose = TransformStamped(1, "world", "camera", Transform.identity())
        StaticTransformBroadcaster(node).send_transform(pose)
        eventually(lambda: run(bus, "list", "-t")[1] == "tf_static/camera [TransformMessage]\n")
        _, out, _ = run(bus, "info", "tf_static")
        kind, publishers, subscriptions = out.splitlines()
        assert (kind, publishers) == ("Type: TransformMessage", "Publisher count: 1")
        assert subscriptions.startswith("Subscription count: unknown")

    def test_nothing_is_an_empty_list(self, bus: Bus) -> None:
        """Without topics nothing is printed, with exit code 0."""
        assert run(bus, "list") == (0, "", "")

    def test_names_are_relative_to_the_namespace(self, bus: Bus) -> None:
        """In a namespace its topics have no prefix, and topics outside are hidden."""
        sim(bus, "robot7")
        bus.node("other").create_publisher(Pose, "pose")
        inside = run(bus, "list", "--namespace", "robot7")[1].splitlines()
        assert inside == ["turtle1/cmd_vel", "turtle1/pose"]
        assert "robot7/turtle1/pose\n" in run(bus, "list")[1]

    def test_info_shows_both_ends(self, bus: Bus) -> None:
        """A topic is shown with its type and counts, and with -v the nodes of each end."""
        sim(bus)
        code, out, err = run(bus, "info", "turtle1/pose")
        assert (code, err) == (0, "")
        assert out.splitlines() == ["Type: Pose", "Publisher count: 1", "Subscription count: 0"]
        _, out, _ = run(bus, "info", "turtle1/pose", "-v")
        assert out.splitlines()[2:4] == ["  Node name: /sim", "    Type: Pose"]
        assert json.loads(run(bus, "info", "turtle1/pose", "--json")[1])["types"] == ["Pose"]

    def test_a_topic_has_a_type_and_is_found_by_it(self, bus: Bus) -> None:
        """`type` is the way from the name to the type, `find` the way back, also by ROS's names."""
        sim(bus)
        assert run(bus, "type", "turtle1/pose") == (0, "Pose\n", "")
        assert run(bus, "find", "Pose") == (0, "turtle1/pose\n", "")
        assert run(bus, "find", "turtlesim/msg/Pose", "--count") == (0, "1\n", "")
        code, out, err = run(bus, "find", "Poes")
        assert (code, out) == (1, "")
        assert "of type 'Poes'" in err and "mean 'Pose'" in err
        # One that has another name on the bus, by the name that `list` prints.
        bus.node("lidar").create_publisher(LaserScan, "scan")
        assert "mean 'LaserScan'" in run(bus, "find", "LazerScan")[2]

    def test_an_unknown_topic_is_an_error_with_a_near_name(self, bus: Bus) -> None:
        """A misspelt topic fails with the one that is meant."""
        assert "'x', nor any other" in run(bus, "info", "x")[2]
        sim(bus)
        code, out, err = run(bus, "info", "turtle1/poze")
        assert (code, out) == (1, "")
        assert "no topic 'turtle1/poze'" in err and "mean 'turtle1/pose'" in err


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
        """As CSV, one field as JSON behind a filter, or the bytes."""
        sim(bus)
        assert run(bus, "echo", "turtle1/pose", "--once", *options) == (0, printed, "")

    def test_when_it_came_is_a_comment_before_it(self, bus: Bus) -> None:
        """With -i a comment says when a message came, and its size."""
        sim(bus)
        code, out, err = run(bus, "echo", "turtle1/pose", "--once", "-i", "--field", "x")
        assert (code, err) == (0, "")
        assert re.fullmatch(r"# arrived at \d{10}\.\d{9}, \d+ bytes\n.*\n---\n", out)

    def test_messages_of_any_type_are_printed(self, bus: Bus) -> None:
        """Messages of unknown types are printed as they are; long values are cut by default."""
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
        assert out.splitlines()[1:4] == [
            "cells: <list of 3>",
            "name: <text of 14>",
            "key: <3 bytes>",
        ]
        assert json.loads(run(bus, *echo, "--json")[1])["cells"] == [3.5, 3.25, 3.0]

    def test_an_array_is_one_line(self, bus: Bus) -> None:
        """Cut as lists are, its numbers with the digits of their type, or only its type and shape;
        JSON has all of it.
        """
        node = bus.node("laser")
        publisher = node.create_publisher(LaserScan, "scan")
        ranges = np.arange(200, dtype=np.float32) / np.float32(10)
        node.create_timer(0.02, lambda: publisher.publish(LaserScan(1, "laser", ranges=ranges)))
        echo = ("echo", "scan", "--once")
        _, out, _ = run(bus, *echo, "-l", "3")
        assert out.splitlines()[-3:-1] == ["ranges: [0.0, 0.1, 0.2, '...']", "intensities: []"]
        _, out, _ = run(bus, *echo, "--no-arr")
        assert "ranges: <float32 array of 200>" in out.splitlines()
        assert json.loads(run(bus, *echo, "--json")[1])["ranges"] == ranges.tolist()
        assert run(bus, *echo, "--field", "ranges[7]")[1] == "0.7\n---\n"

    def test_a_cloud_an_image_and_a_map_are_summaries(self, bus: Bus) -> None:
        """A person sees what is in them; with --field, -f or in JSON all of it."""
        node = bus.node("robot")
        xyz = np.array([(0, 1, 2), (3, 4, 5), (np.nan, 7, 8)])
        messages = {
            "points": PointCloud.from_xyz(1, "lidar", xyz),
            "image": Image.from_pixels(1, "camera", np.full((2, 3), 7, np.uint8)),
            "map": OccupancyGrid.from_cells(1, "map", np.array([[0, -1], [100, 0]]), 0.5),
        }
        for topic, message in messages.items():
            node.create_publisher(type(message), topic, retained=True).publish(message)
        shown = {each: run(bus, "echo", each, "--once")[1] for each in messages}
        for line in (
            "  points: 3",
            "    x: float32, 0 to 3, 1 NaN",
            "    z: float32, 2 to 8",
            "  - [0.0, 1.0, 2.0]",
        ):
            assert line in shown["points"].splitlines()
        assert "data: 3 by 2, mono8, 6 B, uint8, 7 to 7" in shown["image"].splitlines()
        said = "2 by 2 cells of 0.5 m: 50.0% free, 25.0% unknown, 25.0% occupied"
        assert f"data: '{said}'" in shown["map"].splitlines()
        assert "data: [7, 7, 7, 7, 7, 7]" in run(bus, "echo", "image", "--once", "-f")[1]
        assert json.loads(run(bus, "echo", "map", "--once", "--json")[1])["data"] == [0, -1, 100, 0]
        assert run(bus, "echo", "map", "--once", "--field", "data[2]")[1] == "100\n---\n"

    def test_transforms_are_printed(self, bus: Bus) -> None:
        """The transforms of a stream, or of all, are printed row by row; static ones at once."""
        node = bus.node("camera")
        pose = Transform((1.0, 2.0, 3.0))
        fixed, moving = (TransformStamped(7, "world", child, pose) for child in ("lens", "head"))
        StaticTransformBroadcaster(node).send_transform(fixed)
        broadcaster = TransformBroadcaster(node)
        node.create_timer(0.02, lambda: broadcaster.send_transform(moving))
        for topic, child in (
            ("tf_static/camera", "lens"),
            ("tf_static", "lens"),
            ("tf/camera", "head"),
            ("tf", "head"),
        ):
            _, out, _ = run(bus, "echo", topic, "--once", "--json", "--field", "transforms[0]")
            assert json.loads(out) == {
                "stamp_ns": 7,
                "frame_id": "world",
                "child_frame_id": child,
                "transform": {
                    "translation": {"x": 1.0, "y": 2.0, "z": 3.0},
                    "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
                },
            }, topic

    def test_it_prints_what_it_waits_for(self, bus: Bus) -> None:
        """Without a publisher it prints so, with a near topic, and fails after the timeout."""
        sim(bus)
        code, out, err = run(bus, "echo", "turtle1/pse", "--timeout", "0.5")
        waiting, error = err.splitlines()
        assert (code, out) == (1, "")
        assert waiting.startswith("Waiting for a message ") and "no publisher" in waiting
        assert "'turtle1/pse'" in waiting and "mean 'turtle1/pose'" in waiting
        assert error.startswith("Error: ") and "'turtle1/pse' after 0.5 s" in error

    def test_a_publisher_that_comes_later_is_heard(self, bus: Bus) -> None:
        """Echo waits for a topic that does not exist yet, and knows its type when it does."""
        echo = bus.start("topic", "echo", "color", "--field", "g")
        echo.wait_for_line("Waiting for a message on 'color': it has no publisher")
        node = bus.node("painter")
        colors = node.create_publisher(Color, "color")
        node.create_timer(0.05, lambda: colors.publish(Color(1, 2, 3)))
        eventually(lambda: echo.out[:2] == ["2", "---"])
        assert echo.stop() == 0
        assert len(echo.err) == 1

    def test_a_bad_message_is_skipped_with_one_warning(self, bus: Bus) -> None:
        """Messages of another type are skipped with one warning; the others are printed."""
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
        [warning] = echo.err
        assert warning.startswith("Warning: skipped ") and "'color'" in warning

    def test_a_message_that_is_nested_too_deeply_is_told(self, bus: Bus) -> None:
        """A stranger's message of 900 lists in each other ends nothing."""
        node = bus.node("stranger")
        publisher = node.create_raw_publisher("deep", type_name="Deep")
        deep = b"\x81\xa1a" + b"\x91" * 900 + b"\xc0"
        node.create_timer(0.05, lambda: publisher.publish(deep))
        for form in ("--yaml", "--csv", "--json"):
            options = () if form == "--yaml" else (form,)
            done = bus.run("topic", "echo", "deep", "--once", *options)
            assert (done.returncode, done.stderr) == (0, "")
            assert "nested too deeply" in done.stdout or form == "--json"

    def test_a_mistake_is_one_sentence(self, bus: Bus) -> None:
        """Options that are mutually exclusive, and unknown fields, are usage errors."""
        for arguments, sentence in (
            (("x", "--csv", "--json"), "--csv, --json and --raw are mutually exclusive: give one"),
            (
                ("x", "--raw", "--filter", "m.x > 5"),
                "--raw has bytes, without fields: omit --field and --filter",
            ),
            (
                ("~/x",),
                "Invalid value for 'TOPIC': topic '~/x' is private to a node: write the node's "
                "name instead of '~'",
            ),
        ):
            assert run(bus, "echo", *arguments)[::2] == (2, f"{USAGE}Error: {sentence}\n")
        sim(bus)
        code, out, err = run(bus, "echo", "turtle1/pose", "--field", "thta")
        assert (code, out) == (2, "")
        assert "no field 'thta'" in err and "mean 'theta'" in err


def test_a_client_works_through_a_router(bus: Bus) -> None:
    """All of it works for a client that knows only a router."""
    endpoint = "tcp/127.0.0.1:7447"
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


def test_a_file_is_published(bus: Bus, tmp_path: Path) -> None:
    """`topic pub --file` sends the cloud of a file with a frame and the time; large arrays are
    printed short; another type, other values and a bad file are refused in a sentence.
    """
    points = tmp_path / "points.npy"
    np.save(points, np.arange(3000.0).reshape(1000, 3))
    clouds: list[PointCloud] = []
    bus.node("sink").create_subscription(PointCloud, "points", clouds.append)
    typed = ("pub", "points", "PointCloud", "{frame_id: lidar}", "--file", str(points))
    pub = bus.start("topic", *typed, "-r", "20")
    eventually(lambda: len(clouds) > 1)
    assert np.array_equal(clouds[0].xyz()[:, 1], np.arange(1.0, 3000.0, 3.0))
    assert clouds[0].frame_id == "lidar" and 0 < clouds[0].stamp_ns < clouds[1].stamp_ns
    assert len(run(bus, "echo", "points", "--once")[1]) < 2000
    assert "<uint8 array of 12000>" in run(bus, "echo", "points", "--once", "--no-arr")[1]
    assert run(bus, "delay", "points", "--once")[0] == 0
    assert pub.stop() == 0
    code, _, err = run(bus, "pub", "--once", "p", "Pose", "--file", str(points))
    assert (code, "PointCloud or Image" in err) == (2, True)
    code, _, err = run(bus, "pub", "--once", "p", "PointCloud", "{width: 3}", "--file", str(points))
    assert (code, "frame_id and stamp_ns" in err) == (2, True)
    points.write_bytes(b"nothing")
    code, _, err = run(bus, *typed, "--once")
    assert (code, "--file: " in err, "has no cloud" in err) == (2, True, True)
    assert "VALUES" not in err.partition("Error:")[2] and "Traceback" not in err


def test_the_type_may_be_named_as_in_ros(bus: Bus) -> None:
    """`topic echo` takes the type behind the topic, and refuses another than the announced one."""
    sim(bus)
    code, out, _ = run(bus, "echo", "turtle1/pose", "turtlesim/msg/Pose", "--once", "--field", "x")
    assert (code, out) == (0, "5.5\n---\n")
    code, _, err = run(bus, "echo", "turtle1/pose", "Twist", "--once")
    assert (code, "type Pose, not Twist" in err) == (2, True)


def test_the_fields_of_transforms_are_shown(bus: Bus) -> None:
    """`tf`, a stream on it, and the names of the type in tfbus and in ROS show the same."""
    shown = {
        run(bus, "show", name)[1] for name in ("tf", "tf/sim", "TransformMessage", "TFMessage")
    }
    (text,) = shown
    assert text.startswith("TransformMessage: ")
    assert "  transforms: list[" in text
