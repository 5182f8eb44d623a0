"""The tools that listen to transforms, looking at robots with equal frame names, all together."""

import json
import re

import pytest

from tests.buses import send_static
from tests.simulated_bus import Bus
from tfbus import Transform, TransformBroadcaster, TransformStamped

SHARED = ("--fleet", "--shared", "map")


@pytest.fixture
def robots(bus: Bus) -> Bus:
    """A bus on which base_link moves in the map, in robot3 and in robot7."""
    for number in (3, 7):
        node = bus.node("wheels", namespace=f"robot{number}")
        broadcaster = TransformBroadcaster(node)
        pose = Transform((number, 0, 0))

        def send(broadcaster=broadcaster, node=node, pose=pose) -> None:  # by their values
            broadcaster.send_transform(TransformStamped(node.now_ns(), "map", "base_link", pose))

        node.create_timer(0.02, send)
    return bus


def test_frames_of_all_robots_hang_below_what_they_share(robots: Bus) -> None:
    """`tfbus frames --fleet` shows each frame with its robot's name, and shared ones without."""
    done = robots.run("frames", *SHARED, "--json", "--check")
    assert (done.returncode, done.stderr) == (0, "")
    tree = json.loads(done.stdout)
    assert tree["roots"] == ["map"]
    assert [frame["name"] for frame in tree["frames"]] == [
        "map",
        "robot3/base_link",
        "robot7/base_link",
    ]


def test_robots_that_share_nothing_are_trees_apart(robots: Bus) -> None:
    """Without --shared each robot has a map of its own."""
    done = robots.run("frames", "--fleet", "--json", "--check")
    assert done.returncode == 1
    assert json.loads(done.stdout)["roots"] == ["robot3/map", "robot7/map"]


def test_one_robot_is_seen_from_another(robots: Bus) -> None:
    """`echo`, `monitor`, `why` and `plot` take frames as the fleet calls them."""
    pair = ("robot3/base_link", "robot7/base_link", *SHARED)
    pose = robots.run("echo", *pair, "--once", "--format", "json").stdout
    assert json.loads(pose)["xyz"] == pytest.approx([4.0, 0.0, 0.0])
    report = json.loads(robots.run("monitor", *pair, "--once", "--json").stdout)
    assert report["pair"]["chain"] == ["robot3/base_link", "map", "robot7/base_link"]
    assert all(edge["rate_hz"] > 1.0 for edge in report["edges"])
    assert json.loads(robots.run("why", *pair, "--json").stdout)["failure"] == ""


def test_the_doctor_measures_every_robot(robots: Bus) -> None:
    """`tfbus doctor --fleet` checks how the frames of all robots come."""
    found = json.loads(robots.run("doctor", *SHARED, "--only", "order", "--json").stdout)
    assert found["order"]["evidence"] == ["2 dynamic frames in 3.0 s"]


@pytest.mark.parametrize(
    ("frame", "roster", "advice"),
    [
        ("robot5/base_link", (), "start robot 'robot5', or check its link: no node of it is here"),
        ("robot5/base_link", ("--expect", "robot[1-9]"), "its link: it is missing"),
        ("robto3/base_link", ("--expect", "robot[1-9]"), "not in the roster; did you mean"),
        ("robot3/base_lnk", ("--expect", "robot[1-9]"), "use 'robot3/base_link'"),
    ],
)
def test_why_says_which_robot_is_not_there(
    robots: Bus, frame: str, roster: tuple[str, ...], advice: str
) -> None:
    """An unknown frame of a robot that is not there is no unknown name; a roster says that the
    robot is missing, or is called otherwise.
    """
    done = robots.run("why", "map", frame, *SHARED, *roster)
    assert done.returncode == 1
    assert advice in " ".join(done.stdout.split())


def test_why_says_where_a_frame_of_the_fleet_is(robots: Bus) -> None:
    """For a frame that only --fleet shows, the hint names --fleet and --namespace."""
    done = robots.run("why", "map", "base_link", "--json")
    assert done.returncode == 1
    within, together, *_ = json.loads(done.stdout)["remedies"]
    assert "'map'" in within and within.endswith("--namespace robot3 or robot7")
    assert "'robot3/map'" in together and together.endswith("--fleet")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--shared", "map"), "--shared needs --fleet"),
        (("--fleet", "--shared", "/map"), "--shared: frame id '/map' begins with a slash"),
    ],
)
def test_what_is_shared_is_a_frame_of_a_fleet(
    bus: Bus, options: tuple[str, ...], message: str
) -> None:
    """A mistake in --shared is a usage error."""
    done = bus.run("frames", *options)
    assert done.returncode == 2
    assert message in done.stderr


@pytest.mark.parametrize(
    ("line", "known"),
    [
        ("frames", "frames are"),
        ("echo map base_link --timeout 2", "'map' is"),
        ("monitor map base_link --once", "'base_link' is"),
        ("monitor --once", "frames are"),
        ("plot map base_link -o robot.png", "'map' is"),
    ],
)
def test_an_unknown_frame_gets_a_hint_about_namespaces(robots: Bus, line: str, known: str) -> None:
    """A tool without a namespace says in which ones there is what it does not find."""
    done = robots.run(*line.split())
    assert done.returncode == 1
    hint = "known in other namespaces: .* --namespace robot3 or robot7, .* --fleet"
    assert re.search(f"{known} {hint}", done.stderr)


@pytest.mark.parametrize("tool", [("frames", "--watch"), ("monitor",)])
def test_a_screen_without_frames_says_where_they_are(robots: Bus, tool: tuple[str, ...]) -> None:
    """What goes on while nothing comes names the robots, too."""
    screen = robots.start(*tool)
    screen.wait_for_line("yet: frames are known in other namespaces: look with --namespace robot3")
    assert screen.stop() == 0


def test_the_doctor_names_the_robots(robots: Bus) -> None:
    """Where only namespaces have nodes, it says which, and how to look there."""
    done = robots.run("doctor", "--only", "nodes", "--for", "0.5")
    headline, verdict, evidence, remedy, *_ = done.stdout.splitlines()
    assert verdict == "warn    nodes"
    assert "namespace /; 2 nodes below" in headline and headline.endswith("--fleet")
    assert "namespace /; " in evidence and evidence.endswith(" robot3, robot7")
    assert "--namespace robot3" in remedy and remedy.endswith("--fleet")


@pytest.mark.parametrize(
    ("options", "nodes", "frames"),
    [((), 1, 2), (("--fleet",), 5, 8), (("--namespace", "robot3", "--fleet"), 2, 3)],
)
def test_each_check_of_the_doctor_has_the_same_scope(
    robots: Bus, options: tuple[str, ...], nodes: int, frames: int
) -> None:
    """Checks of nodes and of frames look at the namespace alone, or with --fleet at all below it;
    neither at less than the other.
    """
    send_static(robots.node("tower"), "map", "gate")
    for number in (3, 7):
        send_static(robots.node("mount", namespace=f"robot{number}"), "base_link", "camera")
    checks = ("nodes", "node-names", "callbacks", "conflicts", "gone")
    only = [f"--only={name}" for name in checks]
    found = json.loads(robots.run("doctor", *options, *only, "--json").stdout)
    counts = [int(found[name]["evidence"][0].split()[0]) for name in checks]
    assert counts == [nodes, nodes, nodes, frames, frames]


def test_the_doctor_misses_robots_of_the_roster(robots: Bus) -> None:
    """A robot of the roster that is not there is a failure, one outside of it a warning; both are
    in one sentence for all robots alike.
    """
    doctor = ("doctor", *SHARED, "--only", "robots", "--for", "0.5", "--expect")
    done = robots.run(*doctor, "robot[3-7]")
    assert done.returncode == 1
    verdict, evidence, remedy = done.stdout.splitlines()[1:4]
    assert verdict == "fail    robots"
    assert "robot4: missing; " in evidence and evidence.endswith(" 2 other robots: robot5, robot6")
    assert "start it" in remedy and remedy.endswith("(tfbus fleet")
    done = robots.run(*doctor, "robot3")
    assert (done.returncode, "- robot7 " in done.stdout) == (0, True)
    done = robots.run(*doctor, "robot[3,7]")
    verdict, total = done.stdout.splitlines()[1:]
    assert re.fullmatch("ok +robots +2 of 2 .*", verdict) and total == "1 ok"


def test_to_the_doctor_a_robot_that_boots_is_not_missing(robots: Bus) -> None:
    """While it watches, a robot that never came is a failure only after the time of --grace."""
    watch = ("--watch", "--only", "robots", "--for", "0.5", "--grace", "10")
    clock = robots.node("clock")
    began_ns = clock.now_ns()
    doctor = robots.start("doctor", "--fleet", "--expect", "robot[3,7,9]", *watch)
    doctor.wait_for_line("1 ok: nothing is wrong")
    doctor.wait_for_line("fail +robots")
    doctor.wait_for_line("- robot9: missing")
    assert clock.now_ns() - began_ns >= 10 * 10**9
    assert doctor.stop() == 0


@pytest.mark.parametrize(
    "command",
    [
        "doctor",
        "doctor --watch",
        "doctor --fleet --expect robot1",
        "fleet",
        "fleet --expect robot1",
        "fleet --watch --expect robot1",
        "fleet --watch --on-gone true",
    ],
)
def test_a_grace_that_would_do_nothing_is_refused(bus: Bus, command: str) -> None:
    """--grace is for robots of a roster that something would happen without: else a usage error."""
    done = bus.run(*command.split(), "--grace", "20")
    assert done.returncode == 2
    assert "--grace is for" in done.stderr and "--expect" in done.stderr


def test_the_doctor_notices_a_robot_that_goes(robots: Bus) -> None:
    """While it watches, a robot of the roster that is gone is a failure until it is back."""
    with robots.network.process("outside", "robot9"):
        robots.node("wheels", namespace="robot9")
    watch = ("--watch", "--only", "robots", "--for", "0.5")
    doctor = robots.start("doctor", "--fleet", "--expect", "robot[3,7,9]", *watch)
    doctor.wait_for_line("watching namespace / and all below it: robots, first findings")
    doctor.wait_for_line("1 ok: nothing is wrong")
    robots.network.kill("outside/robot9")
    doctor.wait_for_line("fail +robots")
    doctor.wait_for_line("- robot9: gone")
    robots.node("wheels", namespace="robot9")
    doctor.wait_for_line("ended +robots")
    assert doctor.stop() == 0


@pytest.mark.parametrize("tool", ["doctor", "why map base_link", "view"])
def test_a_roster_is_of_a_fleet(bus: Bus, tool: str) -> None:
    """--expect without --fleet is the same usage error of each tool."""
    done = bus.run(*tool.split(), "--expect", "robot[1-3]")
    assert done.returncode == 2
    assert "--expect " in done.stderr and "give --fleet" in done.stderr


def test_robots_with_equal_roots_may_share_them(robots: Bus) -> None:
    """`why` and `frames` suggest --shared if the trees of two robots have roots of one name."""
    why = robots.run("why", "robot3/base_link", "robot7/base_link", "--fleet", "--json")
    assert json.loads(why.stdout)["remedies"][0].endswith("pass --shared map")
    frames = " ".join(robots.run("frames", "--fleet").stdout.split())
    assert "pass --shared map" in frames


def test_why_never_advises_a_frame_of_another_robot(robots: Bus) -> None:
    """For a robot that is off, no remedy and no suggestion names a frame of one that is there."""
    done = robots.run("why", "map", "robot37/base_link", *SHARED, "--json")
    assert done.returncode == 1
    explained = json.loads(done.stdout)
    said = " ".join([explained["failure"], *explained["remedies"]])
    assert "robot37/base_link" in said
    assert "robot3/" not in said and "robot7/" not in said.replace("robot37/", "")


def test_the_doctor_says_once_what_is_wrong_with_many_robots(bus: Bus) -> None:
    """A trouble that robots have alike is one sentence, which names them; JSON has each. The remedy
    is that for robots with equal frames.
    """
    for number in range(14):
        node = bus.node("mount", namespace=f"robot{number}")
        send_static(node, "map", "dock")
    options = ("doctor", "--fleet", "--only", "disconnected", "--for", "0.5")
    text = " ".join(bus.run(*options).stdout.split())
    assert robot_trees(text) == 1
    assert "12 other robots: robot2" in text and "robot6 and 7" in text
    assert "pass --shared map" in text and "between the trees" not in text
    assert robot_trees(bus.run(*options, "--json").stdout) == 13


def robot_trees(text: str) -> int:
    """How many trees of robots a text says are separate."""
    return " ".join(text.split()).count("a separate tree")
