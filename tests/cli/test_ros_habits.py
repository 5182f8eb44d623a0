"""Commands and nodes as a user of ROS types them, in any terminal."""

from tests.live_bus import Bus, eventually
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
    assert (done.returncode, "'spawn' is of type Spawn, not Kill" in done.stderr) == (2, True)
