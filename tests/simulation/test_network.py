"""The simulated network as users have it: hosts, processes, paths, and words for its faults."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import tfbus
from tfbus.bus.keystore import Keystore
from tfbus.bus.rights import Identity
from tfbus.inspect import Watch
from tfbus.messages import Vector3
from tfbus.nodes import carrot
from tfbus.testing import Network, Process, SimulationError


def _tree(network: Network, host: str, frame: str) -> Process:
    """A process that publishes one frame of the world, ten times a second."""

    def publish() -> None:
        with tfbus.Node(frame) as node:
            broadcaster = tfbus.TransformBroadcaster(node)
            pose = tfbus.Transform((1.0, 0.0, 0.0))

            def send() -> None:
                broadcaster.send_transform(
                    tfbus.TransformStamped(node.now_ns(), "world", frame, pose)
                )

            node.create_timer(0.1, send)
            node.spin()

    network.host(host)
    return network.start(host, frame, publish)


class _Eye:
    """A listener on a host."""

    def __init__(self, network: Network, host: str) -> None:
        network.host(host)
        with network.process(host, "eye") as self.process:
            self.buffer = tfbus.Buffer()
            tfbus.TransformListener(self.buffer, tfbus.Node(f"eye_{host}"))

    def sees(self, frame: str) -> bool:
        """Whether the publisher of a frame is there."""
        try:
            return not self.buffer.frame(frame).gone
        except tfbus.LookupException:
            return False


def test_a_partition_of_two_names_separates_them(network: Network) -> None:
    """Nothing passes between robot and base; a third host still reaches both."""
    for host in ("robot", "base", "desk"):
        _tree(network, host, f"of_{host}")
    eyes = {host: _Eye(network, host) for host in ("robot", "base", "desk")}
    frames = [f"of_{host}" for host in eyes]
    network.run(until=lambda: all(eye.sees(f) for eye in eyes.values() for f in frames))
    network.partition("robot", "base")
    network.run(until=lambda: not eyes["base"].sees("of_robot"))
    network.run(until=lambda: not eyes["robot"].sees("of_base"))
    network.run(5.0)
    assert all(eyes["desk"].sees(frame) for frame in frames)
    assert eyes["robot"].sees("of_desk") and eyes["base"].sees("of_desk")
    network.heal()
    network.run(until=lambda: all(eye.sees(f) for eye in eyes.values() for f in frames))


def test_a_partition_of_one_host_cuts_it_off(network: Network) -> None:
    """A single group is apart from all other hosts."""
    _tree(network, "robot", "arm")
    eyes = [_Eye(network, host) for host in ("base", "desk")]
    network.run(until=lambda: all(eye.sees("arm") for eye in eyes))
    network.partition("robot")
    network.run(until=lambda: not any(eye.sees("arm") for eye in eyes))


def test_a_killed_process_is_gone_and_back_when_restarted(network: Network) -> None:
    """`kill` and `restart` take a process by its name."""
    _tree(network, "robot", "arm")
    eye = _Eye(network, "base")
    network.run(until=lambda: eye.sees("arm"))
    network.kill("robot/arm")
    network.run(until=lambda: not eye.sees("arm"))
    network.restart("robot/arm")
    network.run(until=lambda: eye.sees("arm"))


def test_a_program_has_output_and_exit_code_and_is_restarted(network: Network) -> None:
    """A command of tfbus runs as in a terminal, under the name of its module."""
    network.host("robot")
    program = network.program("robot", carrot.main, "--param", "radius=1.0")
    program.wait_for_line("ready")
    network.restart("robot/carrot")
    assert program.exit_code == -signal.SIGKILL
    eye = _Eye(network, "base")
    network.run(until=lambda: eye.sees("carrot1"))
    mistaken = network.program("robot", carrot.main, "--rate", "5", name="mistaken")
    assert mistaken.wait() == 2
    assert "No such option" in mistaken.stderr


def test_a_stopped_process_is_gone_until_it_goes_on(network: Network) -> None:
    """A process that stops for seconds is gone after the lease, and comes back."""
    arm = _tree(network, "robot", "arm")
    eye = _Eye(network, "base")
    network.run(until=lambda: eye.sees("arm"))
    network.stop(arm)
    assert 1.0 < network.run(until=lambda: not eye.sees("arm")) < 3.0
    network.go_on(arm)
    network.run(until=lambda: eye.sees("arm"))


@pytest.mark.parametrize("is_suspended", [False, True])
def test_a_listener_that_did_not_run_gives_others_time(
    network: Network, is_suspended: bool
) -> None:
    """A process that was stopped for a while, or whose laptop was suspended, takes no publisher for
    gone or stale: neither at once nor later, but the publisher and the node that left meanwhile,
    and them soon.
    """
    _tree(network, "robot", "arm")
    left = _tree(network, "robot", "left")
    network.host("base")
    told: list[tuple[str, str]] = []

    def watch() -> None:
        with tfbus.Node("eye") as node, Watch(node) as bus:
            told.extend((each.kind, each.name) for each in bus.changes())

    eye = network.start("base", "eye", watch)
    network.run(until=lambda: {("node came", "/arm"), ("frame appeared", "left")} <= {*told})
    network.run(3.0)
    told.clear()
    network.stop(eye)
    network.run(1.0)
    network.kill(left)
    network.run(9.0)
    if is_suspended:
        eye.host.suspended_ns += 10 * 10**9
    network.go_on(eye)
    network.run(until=lambda: ("frame gone", "left") in told and ("node left", "/left") in told)
    network.run(10.0)
    assert [each for each in told if each[1] in ("arm", "/arm")] == []


def test_a_host_whose_power_fails_is_gone_after_the_lease(network: Network) -> None:
    """Nobody hears a word of its end, so its frames outlive it."""
    _tree(network, "robot", "arm")
    eye = _Eye(network, "base")
    network.run(until=lambda: eye.sees("arm"))
    network.power_off("robot")
    assert 1.0 < network.run(until=lambda: not eye.sees("arm")) < 3.0


def test_a_process_whose_farewell_is_lost_is_gone_after_the_lease(network: Network) -> None:
    """It closes its session, and its path fails before the news of that have arrived."""
    arm = _tree(network, "robot", "arm")
    eye = _Eye(network, "base")
    network.run(until=lambda: eye.sees("arm"))
    network.run(5.0)
    network.path("robot", "base", delay_s=3.0)
    network.signal(arm, signal.SIGINT)
    network.run(until=lambda: arm.is_dead)
    network.cut("robot", "base", both_ways=False)
    network.run(until=lambda: not eye.sees("arm"), timeout_s=5.0)


def test_a_host_that_roams_is_back(network: Network) -> None:
    """Its links are lost, and it is met again at its new address, with all its frames."""
    _tree(network, "robot", "arm")
    eye = _Eye(network, "base")
    network.run(until=lambda: eye.sees("arm"))
    network.roam("robot", "10.0.1.7")
    roamed_ns = network.now_ns
    network.run(until=lambda: eye.buffer.lookup_transform("world", "arm").stamp_ns > roamed_ns)
    network.run(until=lambda: eye.sees("arm"))


def test_processes_have_ids_and_names_of_their_own(network: Network) -> None:
    """Each process has its own id, and the name of its host, by Python's functions too."""
    found = set()
    for host in ("robot", "base"):
        with network.process(network.host(host), "node") as process:
            found.add((socket.gethostname(), os.getpid()))
        assert (host, process.pid) in found
    assert len(found) == 2


def test_clocks_of_hosts_differ_drift_and_step(network: Network) -> None:
    """Each host tells its own time, by the node's clock and by Python's."""
    late = network.host("late", offset_s=-5.0, drift_ppm=100.0)
    with network.process(late, "node"):
        node = tfbus.Node("node")
        assert network.now_ns - node.now_ns() == pytest.approx(5e9, abs=1e6)
        network.run(100.0)
        assert network.now_ns - node.now_ns() == pytest.approx(5e9 - 1e7, abs=1e6)
        late.step_clock(5.0)
        assert network.now_ns - time.time_ns() == pytest.approx(-1e7, abs=1e6)


def test_messages_that_a_congested_link_drops_are_counted(network: Network) -> None:
    """A narrow path drops messages of a flood, and the network says how many."""
    robot, base = network.host("robot"), network.host("base")
    network.path(robot, base, bytes_a_second=3_000)
    got: list[object] = []
    with network.process(base, "reader"):
        tfbus.Node("reader").create_subscription(Vector3, "pose", got.append)
    with network.process(robot, "writer"):
        node = tfbus.Node("writer")
        publisher = node.create_publisher(Vector3, "pose")
        network.run(2.0)
        for _ in range(1500):
            publisher.publish(Vector3())
    network.run(60.0)
    assert network.dropped and 0 < len(got) < 1500


def _arrived(network: Network, protocol: str, **path: float) -> int:
    """How many of 100 messages reach a router over such a path."""
    robot, base = network.host(f"robot_{protocol}"), network.host(f"base_{protocol}")
    got: list[object] = []
    with network.process(base, "router"):
        here = f"{protocol}/[::]:7447"
        router = tfbus.Node(settings=tfbus.NodeSettings("hub", mode="router", listen=here))
        router.create_subscription(Vector3, "pose", got.append)
    with network.process(robot, "writer") as writer:
        there = f"{protocol}/{base.name}:7447"
        node = tfbus.Node(settings=tfbus.NodeSettings("writer", mode="client", connect=there))
        publisher = node.create_publisher(Vector3, "pose")
    network.run(2.0)
    network.path(robot, base, **path)
    for _ in range(100):
        with network.within(writer):
            publisher.publish(Vector3())
        network.run(0.01)
    network.run(20.0)
    return len(got)


@pytest.mark.parametrize("path", [{"loss": 0.3}, {"delay_s": 0.05, "reordering": 0.3}], ids=str)
def test_udp_loses_messages_where_tcp_delays_them(network: Network, path: dict[str, float]) -> None:
    """A lost packet, or one that others overtake, is lost over UDP alone."""
    assert _arrived(network, "tcp", **path) == 100
    assert 40 < _arrived(network, "udp", **path) < 90


def test_a_session_listens_at_its_own_host_alone(network: Network) -> None:
    """An address of another host cannot be taken, as on a real one."""
    network.host("base")
    with network.process(network.host("robot"), "router"):
        for own in ("robot", "[::]", "127.0.0.1"):
            tfbus.Node(settings=tfbus.NodeSettings("hub", listen=f"tcp/{own}:7447")).close()
        with pytest.raises(tfbus.BusError, match="could not join"):
            tfbus.Node(settings=tfbus.NodeSettings("hub", listen="tcp/base:7447"))


async def _do_nothing() -> None:
    """A coroutine, whose call alone does nothing."""


@pytest.mark.parametrize(
    ("mistake", "sentence"),
    [
        (
            lambda network: network.partition("robto"),
            "no host 'robto': .*network.host.*mean 'robot'",
        ),
        (lambda network: network.kill("robot/arn"), "no process 'robot/arn'; .*'robot/arm'"),
        (lambda network: network.partition("robot", ["robot"]), "'robot' is in two groups"),
        (lambda network: network.kill("arm"), "no process 'arm'; did you mean 'robot/arm'"),
        (lambda network: network.run(until=lambda: False, timeout_s=1.0), "not hold after 1 s"),
        (lambda network: network.run(), "for how long"),
        (lambda network: network.run(-1.0), "seconds must be a number from 0 on, not -1.0"),
        (lambda network: network.run(lambda: True), "seconds must be a number"),
        (lambda network: network.run(until=_do_nothing), "until must be .* without `async`"),
        (lambda network: network.start("robot", "n", _do_nothing), "main must .* asyncio.run"),
        (lambda network: network.start("robot", "n", "arm"), "main must be a function .*not 'arm'"),
        (lambda network: network.program("robot", "tfbuss"), "no command 'tfbuss'.* mean 'tfbus'"),
        (lambda network: network.program("robot", carrot.main, "--rate", 5), "are texts, not 5"),
        (
            lambda network: network.path("robot", "robot", loss=1.0),
            "loss is a share .* network.cut",
        ),
        (lambda network: network.path("robot", "robot", reordering=30), "reordering is a share"),
        (lambda network: network.path("robot", "robot", delay_s=-1.0), "delay_s must be a number"),
        (lambda network: network.host("robot", offset_s=1.0), "another clock: .*step_clock"),
        (lambda network: network.host("robot/arm"), "a text without a slash, not 'robot/arm'"),
        (lambda network: network.host(network.host("robot")), "a text .*, not <Host robot>"),
        (lambda network: network.signal("robot/arm", 999), "no signal 999: .* signal.SIGTERM"),
        (lambda network: network.power_off("outside"), "test itself are in process 'outside/main'"),
        (lambda network: network.kill("outside/main"), "test itself are in process 'outside/main'"),
        (lambda network: network.stop("outside/main"), "test itself are in process 'outside/main'"),
        (lambda _: Network().__enter__(), "one simulated network at a time"),
        (lambda _: Network().host("robot"), "in force within its `with`"),
    ],
)
def test_a_mistake_is_explained(network: Network, mistake: object, sentence: str) -> None:
    """A wrong name or use gives a sentence with what there is."""
    _tree(network, "robot", "arm")
    with pytest.raises(SimulationError, match=sentence):
        mistake(network)  # type: ignore[operator]


@pytest.mark.parametrize(
    ("call", "right"),
    [
        (lambda network: network.path("robot", "robot", delay=0.1), "delay_s=0.02"),
        (lambda network: network.host("robot", offset=0.1), "offset_s=0.3"),
        (lambda network: network.run(until=lambda: True, timeout=1.0), "timeout_s=60.0"),
    ],
)
def test_another_name_of_an_argument_is_answered_with_the_right_one(
    network: Network, call: Callable[[Network], object], right: str
) -> None:
    """As a call that has it."""
    network.host("robot")
    with pytest.raises(TypeError, match=f"call it as in network.*{right}"):
        call(network)


def test_a_fault_that_there_is_not_is_refused(network: Network) -> None:
    """A wrong name does not set nothing."""
    with pytest.raises(AttributeError, match="lost_declaration"):
        network.faults.lost_declaration = 1.0  # type: ignore[attr-defined]


def test_a_process_that_has_ended_is_not_entered(network: Network) -> None:
    """Its calls would never happen."""
    arm = _tree(network, "robot", "arm")
    network.kill(arm)
    with pytest.raises(SimulationError, match="'robot/arm' does not run"), network.within(arm):
        pass


def test_a_network_that_is_over_leaves_no_thread() -> None:
    """Also of a process that had no turn."""
    before = threading.enumerate()
    with Network() as network:
        network.start(network.host("robot"), "node", lambda: None)
    assert threading.enumerate() == before


def test_a_network_that_is_over_says_so() -> None:
    """It runs no more after its `with`."""
    with Network() as network:
        network.run(1.0)
    with pytest.raises(SimulationError, match="within its `with`"):
        network.run(1.0)


def test_an_error_of_a_process_fails_the_test(network: Network) -> None:
    """An error of the main function of a process is raised by `run`."""

    def fail() -> None:
        raise ValueError("a mistake of the node")

    network.start(network.host("robot"), "node", fail)
    with pytest.raises(ValueError, match="a mistake of the node"):
        network.run(1.0)


def test_a_closed_bus_is_refused(network: Network, tmp_path: Path) -> None:
    """A node with an identity is not simulated as if it had none."""
    keystore = Keystore.init(tmp_path / "keys", days=10)
    keystore.add(Identity("robot", "reader"), days=5)
    settings = tfbus.NodeSettings("robot", secure=str(keystore.path / "robot"))
    with pytest.raises(SimulationError, match=r"closed bus .*'robot'"):
        tfbus.Node(settings=settings)


def test_a_configuration_file_is_refused(network: Network, tmp_path: Path) -> None:
    """A node is not simulated as if its file were empty."""
    path = tmp_path / "zenoh.json5"
    path.write_text("{}")
    with pytest.raises(SimulationError, match=r"files of Zenoh .*'node'"):
        tfbus.Node(settings=tfbus.NodeSettings("node", config=str(path)))


def test_settings_of_the_environment_have_no_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """A network hides the settings of the machine's own bus."""
    monkeypatch.setenv("TFBUS_MODE", "client")
    monkeypatch.setenv("TFBUS_CONNECT", "tcp/127.0.0.1:1")
    with Network():
        assert tfbus.Node("node").settings.connect == ()
    assert os.environ["TFBUS_MODE"] == "client"


def test_a_client_without_a_router_says_so(network: Network) -> None:
    """It opens no real connection to find out why."""
    network.host("robot")
    with network.process("robot", "node"), pytest.raises(tfbus.BusError, match="no router answers"):
        settings = tfbus.NodeSettings("node", mode="client", connect="tcp/base:7447")
        tfbus.Node(settings=settings, patience_s=3.0)


def test_a_message_that_must_arrive_waits_five_seconds_for_a_link(network: Network) -> None:
    """Then Zenoh closes the link, and the publisher goes on."""
    robot, base = network.host("robot"), network.host("base")
    with network.process(base, "reader"):
        tfbus.Node("reader").create_subscription(Vector3, "pose", print, retained=True)
    with network.process(robot, "writer"):
        publisher = tfbus.Node("writer").create_publisher(Vector3, "pose", retained=True)
        network.run(2.0)
        network.path(robot, base, bytes_a_second=1.0)
        begun_ns = network.now_ns
        for _ in range(3_000):
            publisher.publish(Vector3())
    assert network.now_ns - begun_ns == pytest.approx(5e9, rel=0.1)


def test_a_process_is_in_its_main_thread_from_its_first_turn_on() -> None:
    """Whichever turns the seed gives: where it was not, signals ended it without its handlers."""
    found: list[bool] = []
    for seed in range(20):
        with Network(seed, interleaving=1) as network:
            process = network.start(
                network.host("robot"),
                "node",
                lambda: found.append(threading.current_thread() is threading.main_thread()),
            )
            network.run(until=lambda process=process: process.is_dead)
    assert found == [True] * 20


def test_an_alarm_after_the_end_of_the_only_task_reads_virtual_time(network: Network) -> None:
    """Calls of the network are in virtual time on whichever thread they come, also on one whose
    task has just ended.
    """
    network.start(network.host("robot"), "short", lambda: None)
    called: list[tuple[float, float]] = []
    begun_s = time.monotonic()
    network.tasks.call_after(
        1.0, lambda: called.append((time.monotonic() - begun_s, time.perf_counter() - begun_s))
    )
    network.run(2.0)
    assert called == [pytest.approx((1.0, 1.0))]


@pytest.mark.real
def test_a_seed_that_is_none_is_a_mistake_of_usage(tmp_path: Path) -> None:
    """Pytest says what may be given."""
    command = [sys.executable, "-m", "pytest", "--tfbus-seed", "seven", str(tmp_path)]
    said = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert said.returncode == pytest.ExitCode.USAGE_ERROR
    assert "'seven' is no seed: " in said.stderr and "from 0 on, or random" in said.stderr
