"""The checks of the doctor: each finds its trouble, and nothing on a healthy bus."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from tfbus import Buffer, NodeSettings, Transform, TransformStamped
from tfbus.base.addresses import Interface
from tfbus.bus.identity_folder import SecureFolder
from tfbus.bus.rights import Identity, Rights
from tfbus.doctor.examination import CHECKS, Examination, ExaminedHost
from tfbus.doctor.examine import is_stopped
from tfbus.frames.fleet import RobotStatus
from tfbus.frames.moment import BusMoment
from tfbus.frames.report import EdgeFlow, StreamFlow
from tfbus.frames.snapshot import frame_tree
from tfbus.frames.windows import spread_of
from tfbus.streams.info import StreamInfo
from tfbus.wire.descriptions import (
    BufferDescription,
    DelayDescription,
    FailureDescription,
    FilterDescription,
    NodeDescription,
)

NS = 1_000_000_000
NOW_NS = 1_670_400_300 * NS

VERSIONS = {
    "Python": "3.11.7",
    "tfbus": "0.1.0",
    "eclipse-zenoh": "1.10.2",
    "numpy": "2.0",
    "msgpack": "1.1",
    "click": "8.2",
    "PyYAML": "6.0",
}
ETH0 = Interface("eth0", is_up=True, has_multicast=True, is_loopback=False)
DOWN = Interface("eth0", is_up=False, has_multicast=True, is_loopback=False)
HOST = ExaminedHost(VERSIONS, is_compiled=True, interfaces=(ETH0,), scouted=True, routers=1)
SIM = NodeDescription(
    "/sim",
    "robot",
    7,
    "0.1.0",
    "session",
    0,
    ("sim",),
    (),
    {},
    {},
    {},
    {},
    buffers=(BufferDescription(10.0),),
    filters=(FilterDescription("scan", "odom", passed=7),),
)
CLOCK = replace(SIM, name="/clock", pid=9, streams=(), publishes={"clock": "Clock"})
FOLLOWER = replace(SIM, subscribes={"clock": "Clock"})
STREAM = StreamInfo(
    "sim",
    node="/sim",
    host="robot",
    pid=7,
    alive=True,
    frames=(("world", "base", False), ("base", "camera", True)),
    clock_offset_s=0.001,
)
OTHER = replace(STREAM, name="other", node="/other", pid=8, frames=())
FLOW = EdgeFlow(
    *("sim", "world", "base"),
    rate_hz=10.0,
    period_s=0.1,
    jitter_s=0.002,
    delays_s=spread_of([0.001, 0.003]),
    longest_gap_s=0.11,
)
LOAD = StreamFlow(messages_hz=10.0, bytes_per_s=3_000.0, largest_bytes=300)


def filled() -> Buffer:
    """world -> base at 10 Hz for 2 s, base -> camera static."""
    buffer = Buffer()
    for back in range(21):
        stamp_ns = NOW_NS - back * NS // 10
        moving = TransformStamped(stamp_ns, "world", "base", Transform.identity())
        buffer.set_transform(moving, authority="sim")
    fixed = TransformStamped(NOW_NS, "base", "camera", Transform.identity())
    buffer.set_transform(fixed, static=True, authority="sim")
    return buffer


def at_moment(seen: Examination, **changes: Any) -> Examination:
    """The same with other contents of its moment."""
    return replace(seen, moment=replace(seen.moment, **changes))


def with_tree(buffer: Buffer, *streams: StreamInfo) -> Callable[[Examination], Examination]:
    return lambda seen: at_moment(seen, tree=frame_tree(buffer, streams, NOW_NS))


def with_streams(*streams: StreamInfo) -> Callable[[Examination], Examination]:
    return with_tree(filled(), *streams)


def with_host(**changes: object) -> Callable[[Examination], Examination]:
    return lambda seen: replace(seen, host=replace(HOST, **changes))


def with_flow(**changes: object) -> Callable[[Examination], Examination]:
    return lambda seen: replace(seen, flows=(replace(FLOW, **changes),))


def with_load(**changes: object) -> Callable[[Examination], Examination]:
    return lambda seen: replace(seen, loads={"sim": replace(LOAD, **changes)})


def with_nodes(*nodes: NodeDescription) -> Callable[[Examination], Examination]:
    return lambda seen: at_moment(seen, nodes=nodes)


def of_identity(*, days: float = 300.0, **given: Any) -> NodeSettings:
    """The settings of a process on a closed bus, with a certificate that is valid for a while."""
    arm = Identity("arm", "publisher")
    ends = datetime.now(UTC) + timedelta(days=days)
    settings = NodeSettings("doctor", **given)
    folder = SecureFolder(Path("keys/arm"), arm, Rights({"arm": arm}), ends, "these")
    object.__setattr__(settings, "closed", folder)
    return settings


@pytest.fixture
def healthy() -> Examination:
    """A bus on which nothing is wrong."""
    return Examination(
        of_identity(),
        BusMoment(at_ns=NOW_NS, tree=frame_tree(filled(), (STREAM,), NOW_NS), nodes=(SIM,)),
        (FLOW,),
        {"sim": LOAD},
        listened_s=3.0,
        host=HOST,
        robots=(RobotStatus("robot7", "there"),),
        roster=("robot7",),
    )


def apart() -> Buffer:
    buffer = filled()
    buffer.set_transform(TransformStamped(NOW_NS, "map", "dock", Transform.identity()))
    return buffer


def alone() -> Buffer:
    buffer = apart()
    buffer.remove("dock")
    return buffer


def gone() -> Buffer:
    buffer = filled()
    buffer.mark_gone(["base"], True, "sim")
    return buffer


# The trouble of each check: how to cause it, the verdict, and part of the evidence.
def with_settings(settings: NodeSettings, **host: object) -> Callable[[Examination], Examination]:
    return lambda seen: replace(seen, settings=settings, host=replace(HOST, **host))


TROUBLES = {
    "encryption": (
        with_settings(NodeSettings("doctor"), listens_beyond=("tcp/[::]:0",), routers=1),
        "warn",
        "any process that reaches tcp/[::]:0 can read everything, send any frame, call any service "
        "and set any parameter",
    ),
    "certificate": (
        with_settings(of_identity(days=3.5)),
        "warn",
        f"that of 'arm' expires on {datetime.now(UTC) + timedelta(days=3.5):%Y-%m-%d}, in 3 days",
    ),
    "rights": (
        with_nodes(SIM, replace(SIM, name="/arm", rights="others")),
        "fail",
        "1 node with other rights than these: /arm",
    ),
    "install": (
        with_host(versions=VERSIONS | {"msgpack": ""}),
        "fail",
        "msgpack is not installed",
    ),
    "kernel": (with_host(is_compiled=False), "warn", "the buffer is interpreted"),
    "zenoh": (
        with_host(versions=VERSIONS | {"eclipse-zenoh": "2.0.0"}),
        "warn",
        "eclipse-zenoh 2.0.0; tfbus is tested with 1.10",
    ),
    "alone": (
        with_host(scouts={42: "python"}),
        "warn",
        "programs of this host scout, and none of them is on this bus: python (pid 42)",
    ),
    "scouting": (
        with_host(scouted=False, interfaces=(DOWN,)),
        "fail",
        "no interface is up and carries multicast",
    ),
    "routers": (
        lambda seen: replace(
            seen,
            settings=NodeSettings("doctor", connect=("tcp/hub:7447",)),
            host=replace(HOST, unreachable={"tcp/hub:7447": "Connection refused"}),
        ),
        "fail",
        "tcp/hub:7447: Connection refused",
    ),
    "nodes": (
        lambda seen: at_moment(
            seen,
            nodes=(replace(SIM, name="/robot7/sim"), replace(SIM, name="/a/b/sim")),
            tree=frame_tree(Buffer(), (), NOW_NS),
        ),
        "warn",
        "no node in namespace /; robots are in namespaces a/b, robot7",
    ),
    "robots": (
        lambda seen: replace(
            seen,
            roster=("robot3", "robot7"),
            robots=(
                RobotStatus("robot7", "gone", gone_ns=NOW_NS - 90 * NS),
                RobotStatus("robot3", "missing"),
            ),
        ),
        "fail",
        "robot7: gone 90.0 s\nrobot3: missing",
    ),
    "node-names": (
        with_nodes(SIM, replace(SIM, host="desk", pid=8)),
        "fail",
        "2 nodes are called /sim: on robot, pid 7; on desk, pid 8",
    ),
    "conflicts": (
        with_streams(STREAM, replace(OTHER, frames=(("world", "base", False),))),
        "fail",
        "'base' is published by several at once: /sim on robot, pid 7 under 'world'; /other on",
    ),
    "loops": (
        with_streams(STREAM, replace(OTHER, frames=(("base", "world", False),))),
        "fail",
        "is a loop, made by",
    ),
    "orphans": (
        with_tree(alone(), replace(STREAM, frames=(*STREAM.frames, ("map", "dock", False)))),
        "warn",
        "'map' is alone",
    ),
    "disconnected": (
        with_tree(apart(), STREAM),
        "warn",
        "'map' and 1 frame below it are a separate tree",
    ),
    "static-dynamic": (
        with_streams(STREAM, replace(OTHER, frames=(("base", "camera", False),))),
        "fail",
        "'camera' is static by /sim on robot, pid 7 and dynamic by /other on robot, pid 8",
    ),
    "gone": (with_tree(gone(), STREAM), "warn", "the publisher of 'base' is gone: /sim on robot"),
    "stale": (
        lambda seen: at_moment(seen, tree=replace(seen.tree, recorded_ns=NOW_NS + 5 * NS)),
        "warn",
        "no sample of 'base' for 5.0 s: /sim on robot, pid 7",
    ),
    "silent": (
        with_streams(replace(STREAM, frames=(*STREAM.frames, ("base", "arm", False)))),
        "warn",
        "no transform of 'arm' has come, though /sim on robot, pid 7 lists it",
    ),
    "clock": (
        with_nodes(CLOCK, FOLLOWER),
        "warn",
        "/clock publishes a simulated time; the stamps of 1 of 1 publisher follow it",
    ),
    "clock-skew": (
        with_streams(replace(STREAM, clock_offset_s=-2.5)),
        "fail",
        "the clock of /sim on robot, pid 7 is 2.5 s behind ours",
    ),
    "rates": (
        with_flow(rate_hz=3.0),
        "warn",
        "'base' arrives at 3.0 Hz; by its stamps it is sent at 10.0 Hz",
    ),
    "jitter": (
        with_flow(jitter_s=0.08),
        "warn",
        "but with a jitter of 80 ms: its stamps are as irregular",
    ),
    "gaps": (with_flow(longest_gap_s=1.5), "warn", "'base' paused for 1.5 s"),
    "order": (with_flow(out_of_order=4), "warn", "4 samples of 'base' arrived after"),
    "stamps": (
        with_flow(delays_s=spread_of([-0.5])),
        "fail",
        "samples of 'base' are 500 ms in the future",
    ),
    "refused": (
        lambda seen: at_moment(seen, rejected={"not finite": 3}),
        "fail",
        "3 times: not finite",
    ),
    "messages": (
        with_load(largest_bytes=900_000),
        "warn",
        "messages of stream 'sim' have up to 900 kB",
    ),
    "unread": (
        with_nodes(replace(SIM, unread=tuple(f"s{number}" for number in range(12)))),
        "warn",
        "no node reads the dynamic frames of stream 's0' of /sim",
    ),
    "callbacks": (
        with_nodes(replace(SIM, delays=(DelayDescription("topic a", 12, "topic scan", 0.201),))),
        "warn",
        "/sim: topic a lost 12 messages: the callback of topic scan took up to 201 ms",
    ),
    "buffers": (
        with_nodes(replace(SIM, buffers=(BufferDescription(2.0, 12, 0.75),))),
        "warn",
        "/sim keeps 2.0 s, but 12 lookups asked for older data, by up to 750 ms",
    ),
    "filters": (
        with_nodes(
            replace(
                SIM,
                filters=(
                    FilterDescription("scan", "odom", 1, 7, {"too old": 3}, sources=("laser",)),
                ),
            )
        ),
        "warn",
        "/sim: topic scan into 'odom': 7 passed, 1 waiting, 3 dropped (3 too old)",
    ),
    "dropped": (
        with_nodes(replace(SIM, buffers=(BufferDescription(10.0, dropped=3),))),
        "fail",
        "/sim dropped 3 messages: transforms come on more keys than it accepts",
    ),
}


LIVE = [name for name, check in CHECKS.items() if check.applies(to_recording=False)]

# These find no trouble.
INFORMING = {"ros"}


def test_every_check_is_tried() -> None:
    """There is a trouble for each check of a bus; `test_recorded_checks` has the others."""
    assert TROUBLES.keys() | INFORMING == set(LIVE)


@pytest.mark.parametrize("name", LIVE)
def test_nothing_is_found_where_nothing_is_wrong(name: str, healthy: Examination) -> None:
    """On a healthy bus each check is ok, or says why it was skipped."""
    settings = of_identity(connect=("tls/hub:7447",))
    finding = CHECKS[name](replace(healthy, settings=settings))
    assert (finding.verdict, finding.remedy) == ("ok", "")


@pytest.mark.parametrize("name", TROUBLES)
def test_each_trouble_is_found(name: str, healthy: Examination) -> None:
    """Each check names its trouble in its evidence, and has a remedy."""
    injure, verdict, evidence = TROUBLES[name]
    finding = CHECKS[name](injure(healthy))
    assert finding.verdict == verdict
    assert evidence in "\n".join(finding.evidence)
    assert finding.remedy


@pytest.mark.parametrize(
    ("others", "verdict"), [((), "ok"), (("robot8",), "ok"), (("robot7/arm",), "warn")]
)
def test_a_robot_alone_in_its_namespace_may_be_any_node(
    others: tuple[str, ...], verdict: str, healthy: Examination
) -> None:
    """As `tfbus keys add --nodes '*'` makes it; beside another publisher that is too wide."""
    settings = of_identity(days=30)
    robot = Identity("robot7", "publisher", "robot7", nodes=("*",))
    beside = [Identity(f"other{at}", "publisher", each) for at, each in enumerate(others)]
    rights = Rights({each.name: each for each in (robot, *beside)})
    object.__setattr__(settings, "closed", replace(settings.closed, rights=rights))
    finding = CHECKS["rights"](with_settings(settings)(healthy))
    assert finding.verdict == verdict


def test_a_closed_bus_says_what_it_has_not_on_a_bad_network(healthy: Examination) -> None:
    """It is well, and its links are of TCP alone."""
    why = "a closed bus has links of TCP alone"
    finding = CHECKS["encryption"](with_host(without_datagrams=why)(healthy))
    assert (finding.verdict, finding.evidence[1:]) == ("ok", (why,))
    assert len(CHECKS["encryption"](healthy).evidence) == 1


def test_a_bus_that_keeps_this_process_out_is_named(healthy: Examination) -> None:
    """Where no node is found, since the bus is closed, the remedy is how to join it."""
    empty = at_moment(healthy, nodes=(), tree=frame_tree(Buffer(), (), NOW_NS))
    hint = "a closed bus is here (tls/10.0.0.1:4711): join it by --secure DIR"
    finding = CHECKS["nodes"](replace(empty, out_of_reach=hint))
    (evidence,) = finding.evidence
    assert evidence.startswith("no node ") and evidence.endswith(hint.rpartition(": ")[0])
    assert finding.remedy == hint.rpartition(": ")[2]


def test_stamps_of_zero_are_found(healthy: Examination) -> None:
    """A stamp of 0, as of a clock that does not run yet, is named."""
    finding = CHECKS["stamps"](with_flow(at_zero=2)(healthy))
    (evidence,) = finding.evidence
    assert evidence.startswith("2 samples of 'base'") and evidence.endswith("stamp 0")


def test_a_gap_is_judged_by_the_median_period(healthy: Examination) -> None:
    """A frame that mostly comes every 0.1 s had a gap of 1.5 s, even if gaps halve its rate."""
    often = with_flow(rate_hz=2.5, period_s=0.1, longest_gap_s=1.5)(healthy)
    assert CHECKS["gaps"](often).verdict == "warn"
    seldom = with_flow(rate_hz=10.0, period_s=0.4, longest_gap_s=1.5)(healthy)
    assert CHECKS["gaps"](seldom).verdict == "ok"


def test_messages_that_were_missed_are_gaps(healthy: Examination) -> None:
    """Missed messages count as gaps."""
    finding = CHECKS["gaps"](with_streams(replace(STREAM, missed=7))(healthy))
    (evidence,) = finding.evidence
    assert evidence.startswith("7 messages of stream 'sim'")


@pytest.mark.parametrize(
    ("name", "injure", "reason"),
    [
        ("scouting", with_host(scouted=None), "scouting is off, by the mode or the configuration"),
        ("routers", with_host(routers=0), "no --connect was given, and scouting found no router"),
        ("certificate", with_settings(NodeSettings("doctor")), "it is an open bus"),
        ("rights", with_settings(NodeSettings("doctor")), "it is an open bus"),
        (
            "rates",
            lambda seen: replace(seen, flows=()),
            "no dynamic transform came in 3.0 s",
        ),
        ("callbacks", with_nodes(), "no node was found"),
        ("buffers", with_nodes(), "no node has a buffer"),
        ("dropped", with_nodes(), "no node has a buffer"),
        ("filters", with_nodes(), "no subscription waits for transforms"),
    ],
)
def test_what_cannot_be_seen_is_skipped(
    name: str, injure: Callable[[Examination], Examination], reason: str, healthy: Examination
) -> None:
    """A check with nothing to look at is skipped, with a reason."""
    finding = CHECKS[name](injure(healthy))
    assert (finding.verdict, finding.evidence) == ("skipped", (reason,))


def test_on_an_empty_bus_nothing_is_well(healthy: Examination) -> None:
    """With no node but tools, checks of nodes and frames have nothing to look at."""
    tool = replace(SIM, name="/_view_1", streams=(), buffers=(), filters=())
    nothing = frame_tree(Buffer(), (), NOW_NS)
    empty = replace(at_moment(healthy, nodes=(tool,), tree=nothing), flows=(), loads={}, roster=())
    verdicts = {name: check(empty).verdict for name, check in CHECKS.items()}
    well = {name for name, verdict in verdicts.items() if verdict == "ok"}
    of_the_host = {"install", "kernel", "zenoh", "scouting", "alone", "routers"}
    expected = of_the_host | {"encryption", "certificate", "rights", "clock", "ros"}
    assert well == expected, "a check that has nothing to look at is skipped"


def test_a_check_of_recordings_is_skipped_on_a_bus(healthy: Examination) -> None:
    """With a word on what it needs."""
    skipped = {name: CHECKS[name](healthy) for name in CHECKS.keys() - set(LIVE)}
    assert skipped.keys() == {"complete", "restarts", "clock-jumps"}
    assert all(each.verdict == "skipped" for each in skipped.values())
    assert all("--bag" in each.evidence[0] for each in skipped.values())


def test_tools_are_not_counted(healthy: Examination) -> None:
    """The nodes of tools, such as the doctor itself, are in no count."""
    seen = with_nodes(SIM, replace(SIM, name="/_doctor_1"))(healthy)
    assert CHECKS["nodes"](seen).evidence == ("1 node in namespace /",)
    assert CHECKS["node-names"](seen).evidence == ("1 node",)


def test_a_callback_that_fails_is_named_for_a_minute(healthy: Examination) -> None:
    """With its last exception; one that failed longer ago is no trouble any more."""
    failure = FailureDescription("topic scan", 12, "ValueError: no scan", NOW_NS - 59 * NS)
    finding = CHECKS["callbacks"](with_nodes(replace(SIM, failures=(failure,)))(healthy))
    assert finding.verdict == "warn" and "log of the node" in finding.remedy
    [evidence] = finding.evidence
    assert evidence.startswith("/sim: the callback of topic scan failed 12 times, at last at 2022-")
    assert evidence.endswith(": ValueError: no scan")
    old = replace(failure, last_ns=NOW_NS - 61 * NS)
    finding = CHECKS["callbacks"](with_nodes(replace(SIM, failures=(old,)))(healthy))
    assert finding.verdict == "ok"


def test_drops_of_a_filter_are_a_trouble_for_a_minute(healthy: Examination) -> None:
    """Also the reason of the last is old news then."""
    drops = FilterDescription("scan", "odom", 1, 7, {"too old": 3}, "frame 'laser', too old: x")

    def verdict(last_ns: int) -> str:
        node = replace(SIM, filters=(replace(drops, last_ns=last_ns),))
        return CHECKS["filters"](with_nodes(node)(healthy)).verdict

    assert verdict(NOW_NS - 59 * NS) == "warn"
    assert verdict(NOW_NS - 61 * NS) == "ok"


def test_lookups_in_another_unit_are_not_for_a_longer_cache(healthy: Examination) -> None:
    """The evidence has the stamp and its unit."""
    mistake = "the stamp 1670400300000 looks like milliseconds, but stamps are nanoseconds"
    buffer = BufferDescription(10.0, mistaken=25, mistake=mistake)
    finding = CHECKS["buffers"](with_nodes(replace(SIM, buffers=(buffer,)))(healthy))
    assert finding.verdict == "warn" and "cache" not in finding.remedy
    assert finding.evidence == (f"/sim: 25 lookups asked for a time that has no answer: {mistake}",)


def test_a_stopped_program_of_this_host_is_named(healthy: Examination) -> None:
    """It scouts as far as the system knows, and no link to it opens."""
    seen = with_host(scouts={SIM.pid: "sim", 42: "python"}, stopped=frozenset({42}))(healthy)
    finding = CHECKS["alone"](seen)
    assert finding.verdict == "warn"
    (evidence,) = finding.evidence
    assert evidence.endswith("are stopped: python (pid 42)")


def test_a_program_of_this_host_without_a_node_is_named(healthy: Examination) -> None:
    """Some programs have a session and no node, such as a launch."""
    finding = CHECKS["alone"](with_host(scouts={SIM.pid: "sim", 42: "tfbus"})(healthy))
    assert finding.evidence == (
        "scouting programs of this host with a node on this bus: 1 of 2",
        "without one, as a launch: tfbus (pid 42)",
    )
    finding = CHECKS["alone"](with_host(scouts={SIM.pid: "sim"})(healthy))
    assert finding.evidence == ("scouting programs of this host with a node on this bus: 1 of 1",)


@pytest.mark.real
def test_a_process_is_stopped_until_it_goes_on() -> None:
    """As SIGSTOP and SIGCONT say; one that has ended is not."""
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    with process:
        assert not is_stopped(process.pid)
        process.send_signal(signal.SIGSTOP)
        os.waitpid(process.pid, os.WUNTRACED)  # until it has stopped
        assert is_stopped(process.pid)
        process.send_signal(signal.SIGCONT)
        os.waitpid(process.pid, os.WCONTINUED)
        assert not is_stopped(process.pid)
        process.kill()
    assert not is_stopped(process.pid)


def test_a_simulated_time_explains_rates_and_stamps(healthy: Examination) -> None:
    """The stamps of a publisher with simulated time are not compared with our clock."""
    names = ("rates", "stamps", "gaps", "jitter")
    odd = with_flow(rate_hz=3.0, delays_s=spread_of([-40.0]), longest_gap_s=3.0, jitter_s=0.5)(
        healthy
    )
    assert [CHECKS[name](odd).verdict for name in names] == ["warn", "fail", "warn", "warn"]
    report = with_nodes(CLOCK, FOLLOWER)(odd)
    assert {CHECKS[name](report).verdict for name in names} == {"ok"}
    ours = replace(report, settings=NodeSettings("doctor", sim_time=True))
    assert CHECKS["clock"](ours).verdict == "ok"
    assert CHECKS["rates"](ours).verdict == "warn"


@pytest.mark.parametrize(
    ("nodes", "changes", "verdict"),
    [
        ((SIM,), {"rate_hz": 50.0}, "warn"),
        ((SIM,), {"rate_hz": 0.5}, "ok"),  # a slow computation, such as a loop closure
        ((CLOCK, SIM), {"rate_hz": 50.0}, "ok"),  # a recording with its old stamps and its clock
        ((SIM,), {"rate_hz": 50.0, "delays_s": spread_of([0.2, 5.0])}, "ok"),
    ],
)
def test_samples_that_come_long_after_their_stamps_are_found(
    nodes: tuple[NodeDescription, ...], changes: dict[str, Any], verdict: str, healthy: Examination
) -> None:
    """Samples count as late if they come often, never sooner, and by no simulated time."""
    flow = {"delays_s": spread_of([5.0, 5.1])} | changes
    finding = CHECKS["stamps"](with_nodes(*nodes)(with_flow(**flow)(healthy)))
    assert finding.verdict == verdict
    assert ("come 5.0 s after their stamps" in "".join(finding.evidence)) == (verdict == "warn")


def test_a_clock_that_no_publisher_follows_is_fine(healthy: Examination) -> None:
    """Doctor and publishers all use the system's time."""
    assert CHECKS["clock"](with_nodes(CLOCK, SIM)(healthy)).verdict == "ok"


@pytest.mark.parametrize(
    ("sim_time", "delay_s", "evidence"),
    [
        (False, 1.7e9, "samples of 'base' are 19676 days old: is its time simulated? try --sim"),
        (True, -1.7e9, "'base' are 19676 days in the future: is its node without --sim-time?"),
    ],
)
def test_stamps_of_other_years_are_of_another_clock(
    sim_time: bool, delay_s: float, evidence: str, healthy: Examination
) -> None:
    """They are reported once, and other checks ignore them."""
    seen = with_flow(rate_hz=100.0, delays_s=spread_of([delay_s]))(healthy)
    seen = replace(seen, settings=NodeSettings("doctor", sim_time=sim_time))
    finding = CHECKS["stamps"](seen)
    assert len(finding.evidence) == 1
    assert evidence in finding.evidence[0]
    assert CHECKS["rates"](seen).verdict == "ok"


def test_stamps_in_seconds_are_named(healthy: Examination) -> None:
    """Where they are seconds of this day, no simulated time is suspected."""
    buffer = Buffer()
    seconds = TransformStamped(NOW_NS // NS, "world", "base", Transform.identity())
    buffer.set_transform(seconds, authority="sim")
    seen = with_flow(delays_s=spread_of([1.67e9]))(with_tree(buffer, STREAM)(healthy))
    (evidence,) = CHECKS["stamps"](seen).evidence
    assert "old: its stamps" in evidence and "like seconds: " in evidence


def test_a_frame_of_two_publishers_is_one_frame(healthy: Examination) -> None:
    """Two publishers of a frame are a conflict, not a trouble with its rate."""
    flows = (replace(FLOW, rate_hz=5.0), replace(FLOW, stream="other", rate_hz=5.0))
    finding = CHECKS["rates"](replace(healthy, flows=flows))
    assert (finding.verdict, finding.evidence) == ("ok", ("1 dynamic frame in 3.0 s",))


def test_a_stream_that_no_node_reads_yet_is_ok(healthy: Examination) -> None:
    """An unread stream is evidence, but no trouble."""
    finding = CHECKS["unread"](with_nodes(replace(SIM, unread=("sim",)))(healthy))
    assert finding.verdict == "ok"
    (evidence,) = finding.evidence
    assert evidence.startswith("no node reads ") and evidence.endswith("'sim' of /sim")


def test_more_than_before_is_no_loss(healthy: Examination) -> None:
    """What was held up comes at once, and a publisher may send more often."""
    assert CHECKS["rates"](with_flow(rate_hz=25.0)(healthy)).verdict == "ok"


@pytest.mark.parametrize(
    ("delays", "known", "remedy"),
    [
        ([0.01, 0.012, 0.011], "its stamps are as irregular", "its timer or loop"),
        ([0.01, 0.2, 0.01, 0.3], "its stamps are regular, its delays are not", "the network"),
    ],
    ids=["sent so", "delayed"],
)
def test_jitter_is_of_the_publisher_or_of_the_way(
    healthy: Examination, delays: list[float], known: str, remedy: str
) -> None:
    """As the delays tell: what to do differs."""
    finding = CHECKS["jitter"](with_flow(jitter_s=0.08, delays_s=spread_of(delays))(healthy))
    assert known in finding.evidence[0]
    assert remedy in finding.remedy


def test_a_silent_robot_is_no_misspelled_parent(healthy: Examination) -> None:
    """Its publisher lists the transform that would join the trees."""
    listing = replace(OTHER, frames=(("world", "map", False),))
    seen = with_tree(apart(), STREAM, listing)(healthy)
    finding = CHECKS["disconnected"](seen)
    assert finding.verdict == "warn"
    assert "see silent" in finding.remedy and "misspelled" not in finding.remedy
    assert CHECKS["silent"](seen).verdict == "warn"
    assert "misspelled" in CHECKS["disconnected"](with_tree(apart(), STREAM)(healthy)).remedy
