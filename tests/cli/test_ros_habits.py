"""Commands and nodes as a user of ROS types them, in any terminal."""

import re

import pytest
from click.testing import CliRunner

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus.cli import CALLED_IN_ROS, NODES, NOT_NEEDED_FROM_ROS, TOOLS, main
from tfbus.compat.std_srvs.srv import Trigger
from tfbus.messages import Spawn


def test_a_node_starts_with_the_arguments_of_ros(bus: Bus) -> None:
    """Name and namespace come from remappings."""
    node = bus.start(
        *("static", "world", "cam", "--ros-args", "-r", "__node:=camera_tf", "-r", "__ns:=/robot7")
    )
    node.wait_for_line(r"\[camera_tf\]: ready")
    eventually(lambda: "/robot7/camera_tf" in bus.run("node", "list").stdout.splitlines())


def test_a_parameter_of_a_node_in_another_namespace_is_read_by_its_full_name(bus: Bus) -> None:
    """From within a namespace a full name reaches any node."""
    node = bus.node("sim", namespace="robot7")
    node.declare_parameter("rate", 2.5)
    done = eventually(
        lambda: (
            found
            if (found := bus.run("param", "get", "--namespace", "robot8", "/robot7/sim", "rate"))
            and found.returncode == 0
            else None
        )
    )
    assert "2.5" in done.stdout


def test_what_a_terminal_cannot_show_is_escaped(bus: Bus) -> None:
    """A name in letters that the encoding lacks is no error."""
    bus.node("talker").create_raw_publisher("高さ")
    env = {"PYTHONIOENCODING": "latin-1"}
    eventually(lambda: "\\u9ad8" in bus.run("topic", "list", env=env).stdout)


def test_a_name_in_another_encoding_is_refused_in_one_sentence(bus: Bus) -> None:
    """A terminal in Latin-1 sends bytes that are no UTF-8."""
    for arguments in (("node", "info", "caf\udce9"), ("param", "get", "sim", "caf\udce9")):
        done = bus.run(*arguments)
        assert (done.returncode, done.stdout) == (2, "")
        assert r"'caf\udce9' cannot be" in done.stderr
        assert "Traceback" not in done.stderr


def test_a_goal_is_called_with_its_type(bus: Bus) -> None:
    """`tfbus call` takes the type between the name and the goal, and checks it."""
    node = bus.node("sim")
    node.create_service(Spawn, "spawn", lambda request: Spawn.Response(request.name))
    done = bus.run("call", "spawn", "turtlesim/srv/Spawn", "{name: leo}")
    assert (done.returncode, done.stdout) == (0, '{"name": "leo"}\n')
    done = bus.run("call", "spawn", "Kill", "{name: leo}")
    assert (done.returncode, "type Spawn, not Kill" in done.stderr) == (2, True)


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ("record -o run", "'record'; use: tfbus bag record"),
        ("play run.mcap", "'play'; use: tfbus bag play"),
    ],
)
def test_a_command_that_is_part_of_another_is_named(command: str, answer: str) -> None:
    """Jobs of `tfbus bag` are looked for as commands, too."""
    assert answer in usage_error(*command.split())


def usage_error(*arguments: str) -> str:
    """The last line of a command line that is refused before it joins the bus."""
    done = CliRunner().invoke(main, arguments)
    assert (done.exit_code, done.stdout) == (2, "")
    return done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ("action list", "'action'; use: tfbus service list"),
        ("component list", "'component'; tfbus has none, since each node is a process"),
        ("daemon stop", "'daemon'; tfbus has none, since each command asks the nodes itself"),
        ("lifecycle set sim configure", "'lifecycle'; tfbus has none, since a node is active"),
        ("msg show String", "'msg'; use: tfbus topic show"),
        ("multicast receive", "'multicast'; tfbus has no test of its own for it: tfbus doctor"),
        ("rosrun turtlesim turtlesim_node", "'rosrun'; use: tfbus simulator"),
        ("rostopic list", "'rostopic'; use: tfbus topic"),
        ("rqt", "'rqt'; use: tfbus top, tfbus plot, tfbus view or tfbus foxglove"),
        ("security create_key", "'security'; use: tfbus keys"),
    ],
)
def test_a_command_of_ros_names_what_does_the_same_or_why_there_is_none(
    command: str, answer: str
) -> None:
    """Also a command that tfbus cannot have says what to do."""
    assert f"there is no command {answer}" in usage_error(*command.split())


@pytest.mark.parametrize("word", sorted({**CALLED_IN_ROS, **NOT_NEEDED_FROM_ROS}))
def test_no_answer_is_given_of_a_command_that_is_there(word: str) -> None:
    """The words that are answered are not commands, and the commands that they name are."""
    answer = usage_error(*word.split())
    named = re.findall(r"tfbus ([a-z]\w+)", answer.partition(";")[2])
    assert "there is no command" in answer
    assert set(named) - {"has"} <= {*TOOLS, *NODES}


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ("service call -r 1 /spawn", "-r: tfbus calls once; repeat it in the shell"),
        ("service call -f /spawn", "-f: not needed: the feedback of an action is printed"),
        ("call --feedback /rotate", "--feedback: not needed: the feedback"),
        ("topic pub --qos-reliability best_effort /x", "--qos-reliability: not needed"),
        ("topic pub --yaml-file twist.yaml /x", "--yaml-file: leave it out, and take the values"),
        ("topic echo --qos-durability transient_local /x", "--qos-durability: not needed"),
        ("topic echo --flow-style /x", "--flow-style: use --json"),
        ("topic hz --wall-time /x", "--wall-time: not needed"),
        ("topic list --include-hidden-topics", "--include-hidden-topics: not needed"),
        ("node list --no-daemon", "--no-daemon: not needed: there is no daemon"),
        ("param list --include-hidden-nodes", "--include-hidden-nodes: use tfbus node list"),
    ],
)
def test_an_option_of_ros_is_answered(command: str, answer: str) -> None:
    """An option that tfbus does not have says what to write, or why it is not needed."""
    assert f"no option {answer}" in usage_error(*command.split())


@pytest.mark.parametrize(
    ("option", "answer"),
    [
        ("--max-bag-size", "must be at least 100 kB, not 0: omit the option for no limit"),
        ("--max-bag-duration", "must be at least 1, not 0: omit the option for no limit"),
        (
            "--max-cache-size",
            "must be at least 1 MB, not 0: messages are always written from memory",
        ),
    ],
)
def test_a_zero_that_switches_a_limit_off_in_ros_is_answered(option: str, answer: str) -> None:
    """`bag record` says what to write in place of ROS's 0."""
    assert answer in usage_error("bag", "record", option, "0")


def test_topics_and_services_of_ros_types_are_used_with_their_full_names(bus: Bus) -> None:
    """`topic pub`, `topic echo`, `topic find` and `service call` take them as `ros2` does."""
    node = bus.node("lamp")
    node.create_service(Trigger, "blink", lambda request: Trigger.Response(success=True))
    given = "topic", "pub", "-q", "lit", "std_msgs/msg/Bool", "data: true"
    published = bus.start(*given, "--rate", "20")
    done = bus.run("topic", "echo", "lit", "std_msgs/msg/Bool", "--once", "--json")
    assert (done.returncode, done.stdout) == (0, '{"data": true}\n')
    for typed in ("std_msgs/msg/Bool", "Bool"):
        assert bus.run("topic", "find", typed).stdout == "lit\n"
    for named in ("lit", "std_msgs/msg/Bool"):
        assert bus.run("topic", "show", named).stdout.splitlines()[1:] == ["  data: boolean"]
    assert published.stop() == 0
    eventually(
        lambda: bus.run("service", "find", "std_srvs/srv/Trigger").stdout == "blink\n",
    )
    for named in ("blink", "std_srvs/srv/Trigger"):
        assert "  success: boolean\n" in bus.run("service", "show", named).stdout
    done = bus.run("call", "blink", "std_srvs/srv/Trigger", "{}")
    assert (done.returncode, done.stdout) == (0, '{"success": true, "message": ""}\n')


@pytest.mark.parametrize(
    ("values", "answer"),
    [("dat: true", "there is no field 'dat'"), ("data: hi", "field 'data' must be a boolean")],
)
def test_fields_of_a_ros_type_are_checked(bus: Bus, values: str, answer: str) -> None:
    """`topic pub` names the field that is wrong."""
    done = bus.run("topic", "pub", "-w", "0", "-t", "1", "x", "std_msgs/msg/Bool", values)
    assert (done.returncode, done.stdout) == (2, "")
    assert answer in done.stderr.splitlines()[-1]


def test_a_message_type_of_ros_that_tfbus_lacks_names_those_it_has() -> None:
    """It says that the type may be omitted, too, and what publishes transforms."""
    answer = usage_error("topic", "pub", "--once", "/x", "my_msgs/msg/Weight", "data: hi")
    assert "leave the type out" in answer
    assert "available: CameraInfo, Clock, Color" in answer
    answer = usage_error("topic", "pub", "--once", "/tf", "tf2_msgs/msg/TFMessage", "{}")
    assert "`tfbus static`" in answer


def test_the_parameter_use_sim_time_says_how_simulated_time_is_set(bus: Bus) -> None:
    """`param get`, `set` and `describe` name the option --sim-time."""
    bus.node("sim")
    for verb, *value in (("get",), ("set", "true"), ("describe",)):
        arguments = ("param", verb, "sim", "use_sim_time", *value)
        eventually(lambda given=arguments: bus.run(*given).returncode == 2)
        assert "tfbus simulator --sim-time" in bus.run(*arguments).stderr


def test_a_node_that_has_a_parameter_of_that_name_answers_it(bus: Bus) -> None:
    """use_sim_time may be a program's own parameter."""
    bus.node("sim").declare_parameter("use_sim_time", False)
    arguments = ("param", "get", "sim", "use_sim_time")
    eventually(lambda: bus.run(*arguments).stdout == "Boolean value is: false\n")


def test_echo_of_tf_without_transforms_names_what_shows_frames(bus: Bus) -> None:
    """Where a bus has no transforms, other topics are not offered in their place."""
    bus.node("sim").create_raw_publisher("pose", type_name="Pose")
    for topic, command in (("/tf", "tfbus echo TARGET SOURCE"), ("/tf_static", "tfbus static")):
        done = bus.run("topic", "echo", "--timeout", "0.1", topic)
        assert command in done.stderr
        assert "available" not in done.stderr
