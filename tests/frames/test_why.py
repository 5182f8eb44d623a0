"""Why a lookup has no answer: each fault of a path at its edge, with a remedy."""

import json
import re
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import pytest

from tests.buses import eventually, keep_sending
from tests.recordings import at, described, gone, publisher, steadily, write
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformStamped,
)
from tfbus.frames.clocks import SimulatedTime
from tfbus.frames.moment import BusMoment
from tfbus.frames.recorded import RecordedFrames
from tfbus.frames.snapshot import frame_tree
from tfbus.frames.why import Explanation, Step, explain, explain_recorded
from tfbus.recording.reader import RecordingReader
from tfbus.streams.info import StreamInfo

NOW_NS = 100_000_000_000
S = 1_000_000_000
SIM = StreamInfo("sim", "/sim", "lab", 7, alive=True)


def dynamic(
    buffer: Buffer, parent: str, child: str, *, oldest_s: float = 2.0, newest_s: float = 0.0
) -> None:
    """Samples of an edge at 10 Hz, from `oldest_s` to `newest_s` ago."""
    for tenths in range(round(oldest_s * 10), round(newest_s * 10) - 1, -1):
        stamp_ns = NOW_NS - tenths * S // 10
        ts = TransformStamped(stamp_ns, parent, child, Transform.identity())
        buffer.set_transform(ts, authority="sim")


def static(buffer: Buffer, parent: str, child: str) -> None:
    """A static edge."""
    ts = TransformStamped(NOW_NS, parent, child, Transform.identity())
    buffer.set_transform(ts, static=True, authority="sim")


def ask(
    buffer: Buffer,
    target: str,
    source: str,
    at_s: float | None = None,
    *,
    stream: StreamInfo = SIM,
    frames_in_other_namespaces: Collection[tuple[str, str]] = (),
) -> Explanation:
    """The explained lookup, at `at_s` seconds from now."""
    tree = frame_tree(buffer, [stream], NOW_NS)
    stamp_ns = None if at_s is None else NOW_NS + round(at_s * S)
    return explain(
        BusMoment(at_ns=NOW_NS, tree=tree),
        buffer,
        target,
        source,
        stamp_ns,
        frames_in_other_namespaces=frames_in_other_namespaces,
    )


def verdicts(explanation: Explanation) -> list[tuple[str, str]]:
    """The verdict on each edge, by its child."""
    return [(step.child, step.verdict) for step in explanation.steps]


def fault(explanation: Explanation, child: str) -> Step:
    """The step of one edge."""
    (step,) = [step for step in explanation.steps if step.child == child]
    return step


@pytest.fixture
def buffer() -> Buffer:
    """world -> base -> arm, dynamic, and world -> camera, static."""
    buffer = Buffer(cache_time_s=1000.0)
    dynamic(buffer, "world", "base")
    dynamic(buffer, "base", "arm")
    static(buffer, "world", "camera")
    return buffer


class TestExplain:
    def test_on_a_good_path_each_edge_is_ok(self, buffer: Buffer) -> None:
        """A lookup with an answer has its path from target to source, and no remedies."""
        report = ask(buffer, "camera", "arm")
        assert report.answer is not None
        assert (report.failure, report.remedies) == ("", ())
        assert verdicts(report) == [("camera", "ok"), ("base", "ok"), ("arm", "ok")]
        assert report.steps[1].facts == ("0.0 ms old", "10.0 Hz over 2.0 s", "by sim")

    def test_an_edge_with_two_publishers_is_a_bad_sign(self, buffer: Buffer) -> None:
        """The answer is from one of them, and the explanation says so."""
        sim = replace(SIM, frames=(("base", "arm", False),))
        tree = frame_tree(buffer, [sim, replace(sim, name="rival")], NOW_NS)
        report = explain(BusMoment(at_ns=NOW_NS, tree=tree), buffer, "world", "arm")
        assert verdicts(report) == [("base", "ok"), ("arm", "warn")]
        assert fault(report, "arm").reason.endswith("one of its publishers")
        assert report.remedies[0].startswith("'arm' is published ")

    def test_a_frame_to_itself_has_no_edges(self, buffer: Buffer) -> None:
        """Between a frame and itself nothing can be wrong."""
        assert ask(buffer, "arm", "arm").steps == ()

    def test_a_misspelt_frame_is_named_with_the_nearest(self, buffer: Buffer) -> None:
        """An unknown name fails, with the nearest as a remedy."""
        report = ask(buffer, "wrld", "arm")
        assert re.search(r"'wrld'; .*'world'\?$", report.failure)
        (remedy,) = report.remedies
        assert remedy.startswith("use 'world'")

    def test_a_frame_of_another_namespace_is_found_there(self, buffer: Buffer) -> None:
        """The remedy for a frame that only another namespace has names that namespace."""
        report = ask(buffer, "world", "gripper", frames_in_other_namespaces={("robot7", "gripper")})
        within, together, start = report.remedies
        assert within.endswith("'gripper': --namespace robot7")
        assert together.endswith("'robot7/gripper': --fleet")
        assert start.startswith("start the node") and start.endswith("'gripper'")

    def test_a_frame_as_a_fleet_names_it_needs_the_fleet(self, buffer: Buffer) -> None:
        """The remedy for a frame with its robot's name in front is --fleet."""
        report = ask(
            buffer, "world", "robot7/gripper", frames_in_other_namespaces={("robot7", "gripper")}
        )
        assert report.remedies[0].endswith("all robots together: --fleet")

    def test_two_trees_are_named_by_their_roots(self, buffer: Buffer) -> None:
        """For unconnected frames the steps are all edges above both; the remedy joins the roots."""
        static(buffer, "isle", "palm")
        report = ask(buffer, "arm", "palm")
        assert verdicts(report) == [("arm", "ok"), ("base", "ok"), ("palm", "ok")]
        (remedy,) = report.remedies
        assert remedy.endswith("between 'world' and 'isle'")

    def test_a_misspelt_parent_is_named_with_the_frame_that_is_like_it(
        self, buffer: Buffer
    ) -> None:
        """Whichever of the two trees is asked from, before the advice to join them."""
        static(buffer, "bsae", "gripper")
        for asked in (("world", "gripper"), ("gripper", "world")):
            question, join = ask(buffer, *asked).remedies
            assert question == "did you mean 'base' by 'bsae'?"
            assert join.startswith("publish a transform between ")

    def test_the_edge_that_starts_too_late_fails(self, buffer: Buffer) -> None:
        """A time before the oldest sample fails at the edges that do not reach back to it."""
        dynamic(buffer, "world", "base", oldest_s=9.0, newest_s=2.1)
        report = ask(buffer, "world", "arm", -3.0)
        assert verdicts(report) == [("base", "ok"), ("arm", "fail")]
        assert fault(report, "arm").reason.endswith("1.0 s before its oldest sample")
        (remedy,) = report.remedies
        assert remedy.startswith("query a later time")

    def test_samples_in_the_future_are_a_bad_sign(self, buffer: Buffer) -> None:
        """The latest lookup has an answer, one at the present time does not: the stamps are why."""
        dynamic(buffer, "arm", "hand", oldest_s=-300.0, newest_s=-302.0)
        report = ask(buffer, "arm", "hand")
        assert verdicts(report) == [("hand", "warn")]
        assert "in the future: " in fault(report, "hand").reason
        (remedy,) = report.remedies
        assert "/sim on lab, pid 7 stamp 'hand' " in remedy and remedy.endswith(": node.now_ns()")
        report = ask(buffer, "arm", "hand", 0.0)
        assert verdicts(report) == [("hand", "fail")]
        assert " 5 min before its oldest" in fault(report, "hand").reason
        assert report.remedies == (remedy,)

    def test_samples_that_come_long_after_their_stamps_are_a_bad_sign(self, buffer: Buffer) -> None:
        """The latest lookup has an answer, and none at the present time ever has."""
        late = replace(SIM, delay_s=5.0, last_delay_s=5.0)
        report = ask(buffer, "world", "base", stream=late)
        assert verdicts(report) == [("base", "warn")]
        assert "5.0 s after their stamps" in fault(report, "base").reason
        (remedy,) = report.remedies
        assert "stamp 'base'" in remedy and remedy.endswith("node.now_ns()")

    def test_the_edge_that_is_late_fails(self, buffer: Buffer) -> None:
        """A time after the newest sample fails; waiting helps."""
        report = ask(buffer, "camera", "base", 0.5)
        assert verdicts(report) == [("camera", "ok"), ("base", "fail")]
        assert fault(report, "base").reason.endswith(" after its newest sample")
        (remedy,) = report.remedies
        assert "timeout_s" in remedy and remedy.endswith("query the latest")

    def test_an_edge_of_a_gone_publisher_is_a_bad_sign(self, buffer: Buffer) -> None:
        """The lookup still has an answer; the remedy is to start the publisher again."""
        buffer.mark_gone(["arm"], True, "sim")
        report = ask(buffer, "world", "arm")
        assert report.answer is not None
        assert verdicts(report) == [("base", "ok"), ("arm", "warn")]
        (restart,) = report.remedies
        assert restart.endswith("'arm' again: /sim on lab, pid 7")
        assert restart in ask(buffer, "world", "arm", 0.5).remedies

    @pytest.mark.parametrize(
        ("name", "bridge", "sender"),
        [
            ("ros2/lidar_driver", "/ros2", "ROS's node /lidar_driver"),
            ("r7/ros2/arm/driver", "/r7/ros2", "ROS's node /arm/driver"),
            ("ros2", "/ros2", "a node of ROS"),
        ],
    )
    def test_what_a_bridge_brings_is_sent_by_ros(
        self, buffer: Buffer, name: str, bridge: str, sender: str
    ) -> None:
        """The remedy names the node there; the bridge may be in order."""
        stream = StreamInfo(name, bridge, "lab", 7, alive=True, origin=("ab12",))
        ts = TransformStamped(NOW_NS - 9 * S, "base", "lidar", Transform.identity())
        buffer.set_transform(ts, authority=name)
        buffer.mark_gone(["lidar"], True, name)
        (remedy,) = ask(buffer, "base", "lidar", stream=stream).remedies
        assert f"of 'lidar' again: {sender} (" in remedy and f"by {bridge} on lab" in remedy

    def test_a_stale_edge_is_a_bad_sign(self, buffer: Buffer) -> None:
        """It has been silent for longer than its rate allows."""
        dynamic(buffer, "arm", "hand", oldest_s=9.0, newest_s=5.0)
        report = ask(buffer, "base", "hand")
        assert verdicts(report) == [("arm", "ok"), ("hand", "warn")]
        assert fault(report, "hand").reason == "no sample for 5.0 s"
        assert re.search("/sim on lab, .*'hand'", report.remedies[0])

    def test_a_skewed_clock_is_a_bad_sign(self, buffer: Buffer) -> None:
        """If the publisher's clock differs from ours, its stamps mislead."""
        stream = StreamInfo("sim", "/sim", "lab", 7, alive=True, clock_offset_s=-2.5)
        report = ask(buffer, "world", "base", stream=stream)
        assert re.search(r"clock .* 2\.5 s behind ours$", fault(report, "base").reason)
        (remedy,) = report.remedies
        assert "clocks of lab" in remedy and "NTP" in remedy

    def test_a_simulated_time_that_we_do_not_follow_is_a_bad_sign(self, buffer: Buffer) -> None:
        """A publisher that follows a clock is named, and --sim-time is the first remedy."""
        tree = frame_tree(buffer, [SIM], NOW_NS, SimulatedTime(("/clock",), frozenset({"/sim"}), 1))
        report = explain(BusMoment(at_ns=NOW_NS, tree=tree), buffer, "world", "base")
        assert verdicts(report) == [("base", "warn")]
        assert any("use --sim-time" in each for each in fault(report, "base").facts)
        (remedy,) = report.remedies
        assert remedy == ": ".join((tree.problems()[0].text, tree.problems()[0].remedy))
        assert "--sim-time" in tree.problems()[0].remedy

    def test_stamps_of_zero_are_a_bad_sign(self) -> None:
        """The edge and the remedy say that they are 0."""
        now_ns = 1_670_400_300 * S
        buffer = Buffer()
        ts = TransformStamped(0, "world", "base", Transform.identity())
        buffer.set_transform(ts, authority="sim")
        tree = frame_tree(buffer, [SIM], now_ns)
        report = explain(BusMoment(at_ns=now_ns, tree=tree), buffer, "world", "base")
        assert verdicts(report) == [("base", "warn")]
        assert any("its stamps are 0" in fact for fact in fault(report, "base").facts)
        assert "node.now_ns()" in report.remedies[-1]

    @pytest.mark.parametrize(("at_s", "verdict"), [(None, "warn"), (-1.0, "fail")])
    def test_stamps_in_seconds_are_a_bad_sign(self, at_s: float | None, verdict: str) -> None:
        """They keep a lookup at a time from an answer, and the remedy is how to stamp."""
        now_s = 1_670_400_300
        buffer = Buffer()
        for back_s in (2, 1, 0):
            ts = TransformStamped(now_s - back_s, "world", "base", Transform.identity())
            buffer.set_transform(ts, authority="sim")
        stamp_ns = None if at_s is None else now_s * S + round(at_s * S)
        report = explain(
            BusMoment(at_ns=now_s * S, tree=frame_tree(buffer, [SIM], now_s * S)),
            buffer,
            "world",
            "base",
            stamp_ns,
        )
        assert verdicts(report) == [("base", verdict)]
        step = fault(report, "base")
        assert step.reason.startswith("no lookup at ")
        assert "like seconds" in step.facts[-2] and step.facts[-1] == "by sim"
        assert "'base' by /sim" in report.remedies[-1]
        assert "look like seconds" in report.remedies[-1]
        assert report.remedies[-1].endswith("tfbus.stamp_ns(SECONDS)")

    def test_problems_of_the_tree_near_the_path_have_remedies(self, buffer: Buffer) -> None:
        """A loop, or a frame that is listed but not sent, can keep two frames unconnected."""
        static(buffer, "isle", "palm")
        frames = (("isle", "world", False), ("world", "base", False))
        report = ask(buffer, "world", "palm", stream=StreamInfo("sim", "/sim", frames=frames))
        (remedy,) = report.remedies
        assert remedy.endswith("between 'world' and 'isle'")
        alive = StreamInfo("sim", "/sim", "lab", 7, alive=True, frames=(("isle", "new", False),))
        report = ask(buffer, "world", "palm", stream=alive)
        assert "'new' has come" in report.remedies[-1] and "/sim on lab" in report.remedies[-1]
        assert "tfbus monitor" in report.remedies[-1]


class TestCommand:
    def run(self, bus: Bus, *arguments: str) -> tuple[int, list[str]]:
        """Exit code and lines of stdout."""
        done = bus.run("why", *arguments)
        assert "Traceback" not in done.stdout + done.stderr
        return done.returncode, done.stdout.splitlines()

    def test_a_lookup_is_walked_edge_by_edge(self, bus: Bus) -> None:
        """The exit code is 0 with an answer and 1 without; --at chooses a time."""
        node = bus.node("sim")
        send = TransformBroadcaster(node).send_transform
        node.create_timer(
            0.05,
            lambda: send(TransformStamped(node.now_ns(), "world", "turtle1", Transform.identity())),
        )
        pose = TransformStamped(1, "turtle1", "camera", Transform((1.0, 2.0, 3.0)))
        StaticTransformBroadcaster(node).send_transform(pose)

        def report() -> list[str]:
            code, lines = self.run(bus, "world", "camera")
            return lines if code == 0 else []

        lines = eventually(report)
        assert re.fullmatch(r"camera seen from world: .* \d.* old", lines[0])
        assert lines[1].startswith("  ok    world -> turtle1  ")
        assert re.fullmatch("  ok    turtle1 -> camera  static, .*", lines[2])
        code, lines = self.run(bus, "world", "camera", "--at", "+60s")
        assert code == 1
        assert lines[0].endswith(": no answer")
        assert re.fullmatch(r"  - wait for it \(timeout_s\), .*", lines[-1])
        assert max(map(len, lines)) <= 80
        done = bus.run("why", "world", "camera", "--at", "soon")
        assert done.returncode == 2

    def test_the_answer_is_as_old_as_its_edge(self, bus: Bus) -> None:
        """Both ages are of the same moment, however long the nodes take to answer."""
        bus.network.path(bus.network.host("robot"), "outside", delay_s=0.3)
        keep_sending(Bus(bus.network, "robot").node("sim"), "world", "base", rate_hz=1.0)
        eventually(lambda: self.run(bus, "world", "base")[0] == 0)
        _, (answer, edge, *_) = self.run(bus, "world", "base")
        assert re.findall(r"[0-9.]+ m?s old", answer) == re.findall(r"[0-9.]+ m?s old", edge) != []

    def test_the_past_may_be_a_date(self, bus: Bus) -> None:
        """A date is looked up in what publishers hold of then, as seconds before now are."""
        node = bus.node("sim")
        send = TransformBroadcaster(node, history_s=60.0).send_transform
        node.create_timer(
            0.1,
            lambda: send(TransformStamped(node.now_ns(), "world", "base", Transform.identity())),
        )
        bus.network.run(40.0)
        then_ns = node.now_ns() - 30 * S
        assert self.run(bus, "world", "base", "--at", str(then_ns))[0] == 0
        assert self.run(bus, "world", "base", "--at", "-30s")[0] == 0

    def test_a_machine_reads_it_as_json(self, bus: Bus) -> None:
        """JSON has the answer, each step and the remedies; all namespaces are searched."""
        node = bus.node("sim", namespace="robot7")
        pose = TransformStamped(1, "world", "camera", Transform((1.0, 2.0, 3.0)))
        StaticTransformBroadcaster(node).send_transform(pose)
        eventually(lambda: self.run(bus, "world", "camera", "--namespace", "robot7")[0] == 0)
        code, (line,) = self.run(bus, "world", "camera", "--json")
        report = json.loads(line)
        assert (code, report["answer"], report["steps"]) == (1, None, [])
        assert "--namespace robot7" in report["remedies"][0]
        _, (line,) = self.run(bus, "world", "camera", "--namespace", "robot7", "--json")
        assert json.loads(line)["answer"]["xyz"] == [1.0, 2.0, 3.0]


def test_the_answer_is_of_the_moment_of_the_steps() -> None:
    """A sample that comes after the tree was taken changes neither the answer nor its age."""
    buffer = Buffer()
    dynamic(buffer, "map", "base", newest_s=0.1)
    moment = BusMoment(at_ns=NOW_NS, tree=frame_tree(buffer, [SIM], NOW_NS))
    dynamic(buffer, "map", "base", oldest_s=0.0)
    found = explain(moment, buffer, "map", "base")
    assert found.answer is not None
    assert found.answer.stamp_ns == NOW_NS - S // 10
    assert found.age_s == 0.1
    assert found.steps[0].facts[0] == "100 ms old"


def test_no_line_ends_within_an_option() -> None:
    """A line of `tfbus why` breaks at blanks, and never at the hyphen of an option."""
    from tfbus.base.wording import wrapped

    for letters in range(50, 80):
        lines = wrapped(f"{'a' * letters} --sim-time and --namespace", 80, "  - ")
        assert not any(line.endswith("-") for line in lines)
        assert max(map(len, lines)) <= 80


def test_a_frame_of_a_recording_may_have_any_name(tmp_path: Path) -> None:
    """An unknown frame has its nearest in the message, also where that is called `query`."""
    sender = publisher("sim")
    path = write(
        tmp_path / "run.mcap",
        described(sender, 0.0, ("world", "query", False)),
        steadily(sender, 0.0, 2.0, ("world", "query")),
    )
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        frames.seek(at(1.0))
        report = explain_recorded(frames, "world", "qery", [str(path)])
    assert "'query'" in report.failure


def test_a_publisher_that_began_again_and_sends_nothing_was_last_heard(tmp_path: Path) -> None:
    """The advice on a recording says when a frame came last, before its publisher's restart."""
    arm, again, gripper = publisher("arm"), publisher("arm", 20.0), ("base", "gripper", False)
    path = write(
        tmp_path / "run.mcap",
        described(publisher("sim"), 0.0, ("world", "base", False)),
        steadily(publisher("sim"), 0.0, 40.0, ("world", "base")),
        described(arm, 0.0, gripper),
        steadily(arm, 0.0, 5.0, gripper[:2]),
        gone(arm, 5.0),
        described(again, 20.0, gripper),
        gone(again, 30.0),
    )
    with RecordingReader(path) as reader:
        frames = RecordedFrames(reader)
        for at_s, lost in ((21.0, ""), (35.0, ", and was lost at +30.000s")):
            frames.seek(at(at_s))
            report = explain_recorded(frames, "world", "gripper", [str(path)])
            assert report.remedies[0] == (
                f"/arm on robot, pid 7 began again and sent no 'gripper'{lost}: it was last heard "
                "at +4.905s, so look just before (--at +3.905s), and into the log of its node"
            )
