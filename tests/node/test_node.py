"""Nodes: topics, services, actions, parameters, their names and their end."""

import asyncio
import logging
import re
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import pytest

from tests.buses import DEADLINE_S, eventually
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    BusError,
    DecodeError,
    GoalHandle,
    InvalidNameError,
    Node,
    NodeSettings,
    ParameterError,
    ServiceError,
    SettingsError,
    TransformListener,
)
from tfbus.messages import Pose, RotateAbsolute, Spawn, Vector3
from tfbus.node.action import CancelGoal
from tfbus.wire.codec import decode_map, encode_map, encode_message
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import node_key, node_parameters_key, parameter_key


@dataclass(frozen=True)
class Number:
    value: int


# A few letters of YAML that stand for 9 to the power of nine values.
BOMB = "[&a [x,x,x,x,x,x,x,x,x]" + "".join(
    f",&{anchor} [{','.join([f'*{before}'] * 9)}]" for before, anchor in pairwise("abcdefghi")
)
BOMB += "]"


class Records(logging.Handler):
    """What a node's log says, line by line."""

    def __init__(self, node: Node) -> None:
        super().__init__()
        self.lines: list[str] = []
        node.log.addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(f"{record.levelname}: {record.getMessage()}")


@pytest.fixture
def node(bus: Bus) -> Node:
    """The node that offers something."""
    return bus.node("server")


@pytest.fixture
def other(bus: Bus) -> Node:
    """The node that uses it."""
    return bus.node("client")


def wait_until_heard(publisher_node: Node, key: str) -> None:
    """Wait until the node's publishers of the key have a subscriber."""
    querier = publisher_node.session.zenoh.declare_publisher(key)
    eventually(lambda: querier.matching_status.matching)  # wrong in stubs
    querier.undeclare()  # Zenoh's stubs


def test_describers_add_to_the_description(node: Node) -> None:
    """What several return for a field is joined; the fields that are always sent come first."""
    before = list(node.describe())
    assert before[6:9] == ["streams", "unread", "buffers"]
    ends = ["publishes", "subscribes", "serves", "calls"]
    assert before[9:] == ["parameters", *ends, "retained"]
    node.describers.append(lambda: {"streams": ["a"], "cameras": ["left"]})
    node.describers.append(lambda: {"streams": ["b"]})
    described = node.describe()
    assert (described["streams"], described["cameras"]) == (["a", "b"], ["left"])
    assert described["unread"] == []


class TestTopics:
    def test_a_message_arrives_as_it_was_sent(self, node: Node, other: Node) -> None:
        """What one node publishes, another one's subscription is called back with."""
        heard: list[Pose] = []
        subscription = other.create_subscription(Pose, "turtle1/pose", heard.append)
        publisher = node.create_publisher(Pose, "turtle1/pose")
        wait_until_heard(node, "turtle1/pose")
        pose = Pose(1670400305709085026, 5.544445, 5.544445, 0.0, 2.0, 0.0)
        publisher.publish(pose)
        eventually(lambda: heard)
        assert heard == [pose]
        assert (subscription.received, subscription.rejected, subscription.dropped) == (1, 0, 0)

    def test_messages_of_any_type_are_handled_as_bytes(self, node: Node, other: Node) -> None:
        """Raw ends of a topic send and hear bytes, and are described with the type's name."""
        heard: list[bytes] = []
        other.create_raw_subscription("battery", heard.append, type_name="Battery")
        publisher = node.create_raw_publisher("battery", type_name="Battery")
        wait_until_heard(node, "battery")
        publisher.publish(encode_map({"charge": 0.5}))
        eventually(lambda: heard)
        assert [decode_map(payload) for payload in heard] == [{"charge": 0.5}]
        assert node.describe()["publishes"] == {"battery": "Battery"}
        assert other.describe()["subscribes"] == {"battery": "Battery"}

    def test_a_node_hears_itself(self, node: Node) -> None:
        """A subscription receives from the publishers of its own node too."""
        heard: list[Number] = []
        node.create_subscription(Number, "count", heard.append)
        node.create_publisher(Number, "count").publish(Number(7))
        eventually(lambda: heard == [Number(7)])

    def test_messages_come_in_order(self, node: Node, other: Node) -> None:
        """Messages of one publisher are delivered in the order in which they were sent."""
        heard: list[int] = []
        other.create_subscription(Number, "count", lambda message: heard.append(message.value))
        publisher = node.create_publisher(Number, "count")
        wait_until_heard(node, "count")
        for value in range(100):
            publisher.publish(Number(value))
            eventually(lambda value=value: heard[-1:] == [value])
        assert heard == list(range(100))

    def test_a_message_of_the_wrong_shape_is_reported_once(self, node: Node, other: Node) -> None:
        """A message of the wrong shape is counted, reported once and dropped."""
        log = Records(other)
        heard: list[Number] = []
        subscription = other.create_subscription(Number, "count", heard.append)
        wait_until_heard(node, "count")
        wrong = node.create_publisher(Vector3, "count")
        for _ in range(3):
            wrong.publish(Vector3())
        node.session.publisher("count").put(b"nonsense")
        node.create_publisher(Number, "count").publish(Number(7))
        eventually(lambda: heard)
        assert heard == [Number(7)]
        assert (subscription.received, subscription.rejected) == (1, 4)
        (line,) = log.lines
        assert re.match("WARNING: .*'count' .*Number: .*'value'", line)

    def test_a_busy_node_keeps_the_newest_messages(self, node: Node, other: Node) -> None:
        """A node that is busy keeps the ten newest messages of a topic and counts the others."""
        heard: list[int] = []
        entered, leave = threading.Event(), threading.Event()

        def callback(message: Number) -> None:
            entered.set()
            leave.wait(DEADLINE_S)
            heard.append(message.value)

        subscription = other.create_subscription(Number, "count", callback)
        publisher = node.create_publisher(Number, "count")
        wait_until_heard(node, "count")
        publisher.publish(Number(0))
        assert entered.wait(DEADLINE_S)
        for value in range(1, 31):
            publisher.publish(Number(value))
        eventually(lambda: subscription.received == 31)
        leave.set()
        eventually(lambda: len(heard) == 11)
        assert heard == [0, *range(21, 31)]
        assert subscription.dropped == 20

    def test_a_message_of_another_type_is_not_published(self, node: Node) -> None:
        """A publisher sends messages of its own type only."""
        with pytest.raises(TypeError, match=r"'count' .*Number, not Vector3"):
            node.create_publisher(Number, "count").publish(Vector3())  # that is the test

    def test_a_closed_subscription_is_not_called(self, node: Node) -> None:
        """A closed subscription receives nothing; closing it twice is fine."""
        heard: list[Number] = []
        closed = node.create_subscription(Number, "count", heard.append)
        closed.close()
        closed.close()
        later: list[Number] = []
        node.create_subscription(Number, "count", later.append)
        node.create_publisher(Number, "count").publish(Number(7))
        eventually(lambda: later)
        assert heard == []

    def test_a_failing_callback_is_reported_once(self, node: Node) -> None:
        """A callback that raises is reported once, and later messages still arrive."""
        log = Records(node)
        heard: list[Number] = []

        def callback(message: Number) -> None:
            heard.append(message)
            raise RuntimeError("no")

        node.create_subscription(Number, "count", callback)
        publisher = node.create_publisher(Number, "count")
        for value in range(3):
            publisher.publish(Number(value))
        eventually(lambda: len(heard) == 3)
        [line] = log.lines
        assert line.startswith("ERROR: ") and "1 time " in line and line.endswith("(topic count)")

    def test_a_topic_can_be_remapped(self, bus: Bus) -> None:
        """A remapping puts another name in the place of a topic or service."""
        node = bus.node("node", remappings={"pose": "turtle2/pose"})
        assert node.create_publisher(Pose, "pose").name == "turtle2/pose"
        assert node.create_client(Spawn, "spawn").name == "spawn"

    def test_a_topic_that_cannot_be_is_refused(self, node: Node) -> None:
        """Names are checked where they are given."""
        with pytest.raises(InvalidNameError):
            node.create_subscription(Pose, "turtle1//pose", print)

    def test_a_timer_of_a_closed_node_is_a_bus_error(self, node: Node) -> None:
        """It would never be called."""
        node.close()
        with pytest.raises(BusError, match=r"could not create a timer: node .* is closed"):
            node.create_timer(0.1, lambda: None)

    def test_publishing_on_a_closed_node_is_a_bus_error(self, node: Node) -> None:
        """A publisher of a node that is closed says so."""
        publisher = node.create_publisher(Number, "count")
        node.close()
        with pytest.raises(BusError, match=r"publish count: .*closed"):
            publisher.publish(Number(7))


class TestServices:
    def test_a_call_gets_the_response(self, node: Node, other: Node) -> None:
        """A client's call returns what the handler returns."""
        node.create_service(Spawn, "spawn", lambda request: Spawn.Response(request.name + "!"))
        client = other.create_client(Spawn, "spawn")
        assert client.call(Spawn.Request(2, 3, 0, "turtle2")) == Spawn.Response("turtle2!")

    def test_many_calls_at_once_each_get_their_own_response(self, node: Node, other: Node) -> None:
        """Calls from several threads do not mix up their responses."""
        node.create_service(Spawn, "spawn", lambda request: Spawn.Response(request.name))
        client = other.create_client(Spawn, "spawn")
        answers: dict[str, str] = {}

        def call(name: str) -> None:
            answers[name] = client.call(Spawn.Request(0, 0, 0, name)).name

        threads = [threading.Thread(target=call, args=(f"turtle{i}",)) for i in range(20)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(DEADLINE_S)
        assert answers == {f"turtle{i}": f"turtle{i}" for i in range(20)}

    def test_a_refusal_carries_its_reason(self, node: Node, other: Node) -> None:
        """A handler refuses by ServiceError, and the caller gets the same words."""

        def refuse(request: Spawn.Request) -> Spawn.Response:
            raise ServiceError(f"{request.name!r} is taken")

        node.create_service(Spawn, "spawn", refuse)
        with pytest.raises(ServiceError) as caught:
            other.create_client(Spawn, "spawn").call(Spawn.Request(0, 0, 0, "turtle1"))
        assert str(caught.value) == "'turtle1' is taken"

    def test_a_handler_that_fails_is_a_refusal(self, node: Node, other: Node) -> None:
        """A handler that raises something else is logged there, and the caller gets a refusal."""
        log = Records(node)
        node.create_service(Spawn, "spawn", lambda request: 1 / 0)
        with pytest.raises(ServiceError, match=r"service failed \(ZeroDivisionError"):
            other.create_client(Spawn, "spawn").call(Spawn.Request(0, 0))
        eventually(lambda: log.lines)
        [line] = log.lines
        assert line.startswith("ERROR: ") and line.endswith("(service spawn)")

    def test_a_request_of_the_wrong_shape_is_refused(self, node: Node, other: Node) -> None:
        """A request with an unknown, missing or wrong field is refused with the field's name."""
        node.create_service(Spawn, "spawn", lambda request: Spawn.Response(request.name))
        assert other.create_client(Spawn, "spawn").wait_for_service(DEADLINE_S)
        for request, reason in (
            ({"x": 1.0, "y": 1.0, "z": 1.0}, "there is no field 'z'; Spawn.Request has x, y, "),
            ({"x": 1.0}, "field 'y' is missing"),
            ({"x": 1.0, "y": "2"}, "field 'y' must be a number, not a text"),
        ):
            (answer,) = other.session.ask("spawn", encode_map(request))
            assert answer.refusal is not None
            assert answer.refusal.startswith(reason)
        (answer,) = other.session.ask("spawn", None)
        assert "not msgpack" in (answer.refusal or "")

    def test_a_response_of_the_wrong_shape_is_a_decode_error(self, node: Node, other: Node) -> None:
        """A response that is not of the service's type is refused by the caller."""
        node.create_service(Spawn, "spawn", lambda request: Vector3())
        with pytest.raises(DecodeError, match="field 'name' is missing"):
            other.create_client(Spawn, "spawn").call(Spawn.Request(0, 0))

    def test_a_missing_service_is_an_error(self, other: Node) -> None:
        """A call without a service waits for its timeout, and says so."""
        client = other.create_client(Spawn, "spawn")
        assert not client.wait_for_service(0)
        with pytest.raises(ServiceError, match=r"^no service 'spawn' after 0.1 s$"):
            client.call(Spawn.Request(0, 0), timeout_s=0.1)

    def test_a_call_waits_for_the_service_to_come(self, node: Node, other: Node) -> None:
        """A call may be made before its service is there."""
        answers: list[Spawn.Response] = []
        client = other.create_client(Spawn, "spawn")
        caller = threading.Thread(
            target=lambda: answers.append(client.call(Spawn.Request(0, 0), timeout_s=DEADLINE_S))
        )
        caller.start()
        service = node.create_service(Spawn, "spawn", lambda request: Spawn.Response("x"))
        caller.join(DEADLINE_S)
        assert answers == [Spawn.Response("x")]
        service.close()
        eventually(lambda: not client.wait_for_service(0))

    def test_a_call_times_out(self, node: Node, other: Node) -> None:
        """A call does not wait longer than its timeout for the answer."""
        leave = threading.Event()

        def handler(request: Spawn.Request) -> Spawn.Response:
            leave.wait(DEADLINE_S)
            return Spawn.Response("late")

        node.create_service(Spawn, "spawn", handler)
        client = other.create_client(Spawn, "spawn")
        assert client.wait_for_service(DEADLINE_S)
        with pytest.raises(ServiceError, match=r"^'spawn' did not answer"):
            client.call(Spawn.Request(0, 0), timeout_s=0.2)
        leave.set()

    def test_a_callback_may_call_a_service_of_another_node(self, node: Node, other: Node) -> None:
        """A callback may wait for a service: answers come on other threads."""
        node.create_service(Spawn, "spawn", lambda request: Spawn.Response(request.name))
        client = other.create_client(Spawn, "spawn")
        answers: list[Spawn.Response] = []
        other.create_subscription(
            Number, "go", lambda _: answers.append(client.call(Spawn.Request(0, 0, 0, "x")))
        )
        other.create_publisher(Number, "go").publish(Number(1))
        eventually(lambda: answers == [Spawn.Response("x")])


class TestActions:
    """RotateAbsolute: a heading to turn to, what remains as feedback, the turn as result."""

    @pytest.fixture
    def handles(self, node: Node) -> list[GoalHandle]:
        """The goals that the server was given."""
        handles: list[GoalHandle] = []
        node.create_goal_server(RotateAbsolute, "rotate", handles.append)
        return handles

    def test_feedback_comes_in_order_and_then_the_result(
        self, node: Node, other: Node, handles: list[GoalHandle]
    ) -> None:
        """A goal sends feedback, then how it ended."""
        remaining: list[float] = []
        ended: list[object] = []
        sent = other.create_goal_client(RotateAbsolute, "rotate").send(
            RotateAbsolute.Goal(1.5),
            on_feedback=lambda feedback: remaining.append(feedback.remaining),
            on_result=ended.append,
        )
        (handle,) = eventually(lambda: handles)
        assert handle.request == RotateAbsolute.Goal(1.5)
        assert not sent.ended
        for value in (1.5, 1.0, 0.5):
            handle.feedback(RotateAbsolute.Feedback(value))
        handle.succeed(RotateAbsolute.Result(-1.5))
        result = sent.result(timeout_s=DEADLINE_S)
        assert (result.status, result.result) == ("succeeded", RotateAbsolute.Result(-1.5))
        assert remaining == [1.5, 1.0, 0.5]
        eventually(lambda: ended == [result])
        assert not handle.active

    def test_a_client_cancels_its_goal(self, other: Node, handles: list[GoalHandle]) -> None:
        """The client asks the server to cancel the goal; the result has how far it came."""
        client = other.create_goal_client(RotateAbsolute, "rotate")
        first, second = client.send(RotateAbsolute.Goal(1)), client.send(RotateAbsolute.Goal(2))
        eventually(lambda: len(handles) == 2)
        for handle in handles:
            handle.on_cancel(lambda h=handle: h.cancel(RotateAbsolute.Result(h.request.theta)))
        second.cancel()
        result = second.result(timeout_s=DEADLINE_S)
        assert (result.status, result.result) == ("canceled", RotateAbsolute.Result(2))
        assert not first.ended
        second.cancel()

    def test_a_goal_without_a_callback_goes_on(
        self, other: Node, handles: list[GoalHandle]
    ) -> None:
        """And the client, which cancels it, learns so."""
        sent = other.create_goal_client(RotateAbsolute, "rotate").send(RotateAbsolute.Goal(1))
        (handle,) = eventually(lambda: handles)
        assert not sent.cancel(timeout_s=DEADLINE_S)
        handle.succeed(RotateAbsolute.Result(1))
        assert sent.result(timeout_s=DEADLINE_S).status == "succeeded"

    @pytest.mark.parametrize("is_taken", [True, False])
    def test_a_coroutine_may_cancel(
        self, other: Node, handles: list[GoalHandle], *, is_taken: bool
    ) -> None:
        """If it returns False, the goal goes on."""
        client = other.create_goal_client(RotateAbsolute, "rotate")
        sent = client.send(RotateAbsolute.Goal(1))
        (handle,) = eventually(lambda: handles)

        async def decide() -> bool:
            await asyncio.sleep(0)
            return is_taken

        handle.on_cancel(decide)
        assert sent.cancel(timeout_s=DEADLINE_S) == is_taken

    def test_an_empty_id_cancels_all_goals(self, other: Node, handles: list[GoalHandle]) -> None:
        """Without an id all goals are cancelled."""
        client = other.create_goal_client(RotateAbsolute, "rotate")
        sent = [client.send(RotateAbsolute.Goal(theta)) for theta in (1, 2)]
        eventually(lambda: len(handles) == 2)
        for handle in handles:
            handle.on_cancel(lambda h=handle: h.cancel(RotateAbsolute.Result(0)))
        (answer,) = other.session.ask("rotate/cancel", encode_map({}))
        assert decode_map(answer.payload) == {"canceled": 2}
        assert {goal.result(timeout_s=DEADLINE_S).status for goal in sent} == {"canceled"}

    def test_an_aborted_goal_has_a_reason(self, other: Node, handles: list[GoalHandle]) -> None:
        """A goal that cannot be finished ends with the reason; later endings do nothing."""
        sent = other.create_goal_client(RotateAbsolute, "rotate").send(RotateAbsolute.Goal(1))
        (handle,) = eventually(lambda: handles)
        handle.abort(RotateAbsolute.Result(0.25), "replaced by another goal")
        handle.succeed(RotateAbsolute.Result(1))
        result = sent.result(timeout_s=DEADLINE_S)
        assert (result.status, result.result, result.reason) == (
            "aborted",
            RotateAbsolute.Result(0.25),
            "replaced by another goal",
        )

    def test_a_goal_is_refused_with_a_reason(self, node: Node, other: Node) -> None:
        """A server refuses a goal by ServiceError, and no goal is under way then."""

        def refuse(handle: GoalHandle) -> None:
            raise ServiceError("the turtle sleeps")

        node.create_goal_server(RotateAbsolute, "rotate", refuse)
        sent = other.create_goal_client(RotateAbsolute, "rotate").send(RotateAbsolute.Goal(1))
        with pytest.raises(ServiceError, match=r"^the turtle sleeps$"):
            sent.result(timeout_s=DEADLINE_S)
        cancel = other.create_client(CancelGoal, "rotate/cancel")
        assert cancel.call(CancelGoal.Request()).canceled == 0

    def test_a_handler_that_fails_ends_the_goal(self, node: Node, other: Node) -> None:
        """A handler that raises something else does not leave the client waiting."""
        log = Records(node)
        node.create_goal_server(RotateAbsolute, "rotate", lambda handle: 1 / 0)  # never returns
        sent = other.create_goal_client(RotateAbsolute, "rotate").send(RotateAbsolute.Goal(1))
        with pytest.raises(ServiceError, match=r"action failed \(ZeroDivisionError"):
            sent.result(timeout_s=DEADLINE_S)
        eventually(lambda: log.lines)

    def test_a_missing_action_is_an_error(self, other: Node) -> None:
        """A goal is not sent without an action server, and the error says so."""
        client = other.create_goal_client(RotateAbsolute, "rotate")
        with pytest.raises(ServiceError, match=r"^no action 'rotate' after 0.1 s$"):
            client.send(RotateAbsolute.Goal(1), timeout_s=0.1)

    def test_a_goal_ends_with_its_server(
        self, node: Node, other: Node, handles: list[GoalHandle]
    ) -> None:
        """A goal whose server is gone ends, and says so."""
        sent = other.create_goal_client(RotateAbsolute, "rotate").send(RotateAbsolute.Goal(1))
        eventually(lambda: handles)
        node.close()
        with pytest.raises(ServiceError, match=r"'rotate' is gone$"):
            sent.result(timeout_s=DEADLINE_S)

    def test_a_goal_with_an_unknown_field_is_refused(
        self, other: Node, handles: list[GoalHandle]
    ) -> None:
        """A goal of the wrong shape is refused with the field's name and reaches no handler."""
        assert other.create_goal_client(RotateAbsolute, "rotate").wait_for_server(DEADLINE_S)
        (answer,) = other.session.ask("rotate", encode_map({"theta": 1.0, "speed": 2.0}))
        assert answer.refusal and answer.refusal.endswith("'speed'; RotateAbsolute.Goal has theta")
        assert handles == []

    def test_a_wait_for_a_result_times_out(self, other: Node, handles: list[GoalHandle]) -> None:
        """Waiting for a result ends after the time given; the goal goes on."""
        sent = other.create_goal_client(RotateAbsolute, "rotate").send(RotateAbsolute.Goal(1))
        (handle,) = eventually(lambda: handles)
        with pytest.raises(ServiceError, match=r"timed out after .*'rotate'"):
            sent.result(timeout_s=0.05)
        handle.succeed(RotateAbsolute.Result(1))
        assert sent.result(timeout_s=DEADLINE_S).status == "succeeded"

    def test_a_result_of_the_wrong_shape_is_an_error(self, node: Node, other: Node) -> None:
        """An unreadable result is reported as such, not as a server that is gone."""
        node.create_goal_server(RotateAbsolute, "rotate", lambda handle: handle.succeed(Vector3()))
        sent = other.create_goal_client(RotateAbsolute, "rotate").send(RotateAbsolute.Goal(1))
        with pytest.raises(ServiceError, match=r"'rotate' .*unreadable .*'delta'"):
            sent.result(timeout_s=DEADLINE_S)


class TestParameters:
    def set(self, other: Node, name: str, value: object) -> str:
        """Set a parameter of the node from another one: the refusal, "" where there is none."""
        key = parameter_key("server", name)
        answers = eventually(lambda: list(other.session.ask(key, encode_map({"value": value}))))
        return answers[0].refusal or ""

    def test_a_parameter_has_the_type_of_its_default(self, node: Node, other: Node) -> None:
        """A value of another type is refused; a text is read as the parameter's type."""
        parameters = {
            "flag": node.declare_parameter("flag", False),
            "count": node.declare_parameter("count", 1),
            "rate": node.declare_parameter("rate", 1.0),
            "frame": node.declare_parameter("frame", "world"),
            "axes": node.declare_parameter("axes", [1, 2]),
        }
        for name, value, wanted in [
            ("flag", True, True),
            ("flag", "false", False),
            ("count", 3, 3),
            ("count", "010", 10),
            ("rate", 2, 2.0),
            ("rate", "1e-3", 0.001),
            ("frame", "7", "7"),
            ("axes", "[3, x]", [3, "x"]),
        ]:
            assert self.set(other, name, value) == ""
            assert (parameters[name].value, type(parameters[name].value)) == (wanted, type(wanted))
        for name, value, reason in [
            ("flag", "no", "'flag' must be a boolean, not 'no'"),
            ("flag", 1, "'flag' must be a boolean, not 1"),
            ("count", 1.5, "'count' must be an integer, not 1.5"),
            ("count", True, "'count' must be an integer, not True"),
            ("count", "many", "'count' must be an integer, not 'many'"),
            (
                "count",
                "99999999999999999999",
                "'count' must be an integer, not 99999999999999999999",
            ),
            ("rate", "fast", "'rate' must be a number, not 'fast'"),
            ("rate", "[", "'rate' must be a number, not '['"),
            ("frame", 7, "'frame' must be a text, not 7"),
            ("axes", "[", "'axes' must be a list, not '['"),
        ]:
            assert self.set(other, name, value) == reason
        assert parameters["count"].value == 10

    @pytest.mark.parametrize("value", ["[" * 9999, BOMB, "x" * 200_000, ["x" * 9999] * 9])
    def test_a_refusal_holds_little_of_the_value(
        self, node: Node, other: Node, value: object
    ) -> None:
        """A text that YAML reads as billions of values, or slowly, is a wrong value like others."""
        node.declare_parameter("count", 1)
        refusal = self.set(other, "count", value)
        assert refusal.startswith("'count' must be an integer")
        assert len(refusal) < 150

    def test_a_bomb_is_no_list(self, node: Node, other: Node) -> None:
        """Anchors and aliases are not read in a value of a list either."""
        axes = node.declare_parameter("axes", [1])
        assert re.match(r"'axes' .* a list, .*'\[&a", self.set(other, "axes", BOMB))
        assert axes.value == [1]

    def test_bounds_hold(self, node: Node, other: Node) -> None:
        """A number outside of the parameter's bounds is refused; the bounds are allowed."""
        red = node.declare_parameter("background_r", 69, minimum=0, maximum=255)
        assert self.set(other, "background_r", 255) == ""
        assert "at most 255, not 256" in self.set(other, "background_r", 256)
        assert "at least 0, not -1" in self.set(other, "background_r", -1)
        assert red.value == 255
        with pytest.raises(ParameterError, match="'low' must be at least 2, not 1"):
            node.declare_parameter("low", 1.0, minimum=2.0)
        node.declare_parameter("rate", 1.0, minimum=0)
        assert "finite, not nan" in self.set(other, "rate", float("nan"))
        assert "finite, not -inf" in self.set(other, "rate", "-1" + 400 * "0")

    def test_on_change_runs_on_the_nodes_thread_and_may_refuse(
        self, node: Node, other: Node
    ) -> None:
        """`on_change` is called with the new value and may refuse it; then nothing changes."""
        seen: list[int] = []

        def on_change(value: int) -> None:
            seen.append(value)
            if value == 13:
                raise ParameterError("13 brings bad luck")
            if value == 14:
                raise RuntimeError("oh")

        number = node.declare_parameter("number", 1, on_change=on_change)
        assert self.set(other, "number", 2) == ""
        assert self.set(other, "number", 13) == "13 brings bad luck"
        assert self.set(other, "number", 14).endswith("failed (RuntimeError: oh)")
        assert (number.value, seen) == (2, [2, 13, 14])

    def test_a_parameter_is_described_on_the_bus(self, node: Node, other: Node) -> None:
        """A query for its parameters returns type, value, bounds and description of each."""
        node.declare_parameter("rate", 1.5, description="In Hz.", minimum=0)
        key = node_parameters_key("server")
        (answer,) = eventually(lambda: list(other.session.ask(key)))
        assert (answer.key, decode_map(answer.payload)) == (
            "@tfbus/param/server/rate",
            {
                "name": "rate",
                "value": 1.5,
                "type": "number",
                "description": "In Hz.",
                "minimum": 0,
                "maximum": None,
            },
        )

    def test_an_unknown_parameter_is_refused_with_those_there_are(
        self, node: Node, other: Node
    ) -> None:
        """Asking for a parameter that the node has not is refused with the names it has."""
        node.declare_parameter("rate", 1.5)
        node.declare_parameter("axes", [1])
        assert self.set(other, "speed", 1).endswith("'speed'; available: axes, rate")

    def test_another_node_reads_and_sets_it(self, node: Node, other: Node) -> None:
        """A node reads another's parameter, and sets it to a value in its type and bounds."""
        node.declare_parameter("rate", 1.5, minimum=0)
        assert other.read_parameter("server", "rate") == 1.5
        assert other.set_parameter("server", "rate", "2") == 2.0
        with pytest.raises(ParameterError, match="'rate' must be at least 0, not -1"):
            other.set_parameter("/server", "rate", -1)
        assert other.read_parameter("/server", "rate") == 2.0
        with pytest.raises(ParameterError, match="'speed'; available: rate"):
            other.read_parameter("server", "speed")
        with pytest.raises(BusError, match="nobody"):
            other.set_parameter("nobody", "rate", 1.0)

    def test_a_value_given_at_the_start_is_taken(self, bus: Bus) -> None:
        """A value from the command line or a launch file goes before the default."""
        node = bus.node("node", parameters={"rate": "2", "frame": "map", "flag": True})
        assert node.declare_parameter("rate", 1.0).value == 2.0
        assert node.declare_parameter("frame", "world").value == "map"
        assert node.declare_parameter("flag", False).value is True

    def test_a_value_given_at_the_start_that_cannot_be_is_refused(self, bus: Bus) -> None:
        """A value that the parameter cannot have is refused when it is declared."""
        node = bus.node("node", parameters={"rate": "fast"})
        with pytest.raises(ParameterError, match=r"^'rate' .*number, not 'fast'$"):
            node.declare_parameter("rate", 1.0)

    def test_a_value_of_an_undeclared_parameter_is_warned_of(self, bus: Bus) -> None:
        """A misspelt parameter is warned of when the node is ready, with the nearest name."""
        node = bus.node("node", parameters={"raet": "2"})
        log = Records(node)
        node.declare_parameter("rate", 1.0)
        node.ready()
        node.ready()
        line, last = log.lines
        assert re.match("WARNING: .*'raet' .*'rate'", line) and last == "INFO: ready"

    def test_a_parameter_is_declared_once(self, node: Node) -> None:
        """A second declaration of the same name is refused."""
        node.declare_parameter("rate", 1.0)
        with pytest.raises(ParameterError, match="'rate' is already declared"):
            node.declare_parameter("rate", 2.0)

    @pytest.mark.parametrize("default", [None, {"a": 1}, object()])
    def test_a_default_of_a_type_that_no_parameter_has_is_refused(
        self, node: Node, default: object
    ) -> None:
        """A parameter is a boolean, an integer, a number, a text or a list."""
        with pytest.raises(ParameterError, match="cannot be of type"):
            node.declare_parameter("x", default)  # that is the test

    @pytest.mark.parametrize("default", [2**64, [object()]])
    def test_a_default_that_cannot_be_sent_is_refused(self, node: Node, default: Any) -> None:
        """The node could not describe itself any more."""
        with pytest.raises(ParameterError, match="the default of 'x' cannot be sent"):
            node.declare_parameter("x", default)


class TestNames:
    def test_the_second_node_of_a_name_warns(
        self, bus: Bus, capsys: pytest.CaptureFixture[str]
    ) -> None:
        """Of two nodes of one name the one that started later warns, and says what to do."""
        first_log = Records(bus.node("sim"))
        bus.node("sim")
        # It may warn before there is a handler of ours in its log.
        lines: list[str] = []
        eventually(lambda: lines.extend(capsys.readouterr().err.splitlines()) or lines)
        (line,) = lines
        assert "[WARN]" in line
        assert "[sim]: " in line and "another node /sim, on" in line
        assert "(--name)" in line and "(--namespace)" in line
        assert first_log.lines == []

    def test_an_answer_that_is_no_description_is_named_once(
        self, bus: Bus, capsys: pytest.CaptureFixture[str]
    ) -> None:
        """Another process may answer at the key of a node: one line for all, and no traceback."""
        queryable = bus.node("stranger").session.zenoh.declare_queryable(
            node_key("sim"), lambda query: [query.reply(query.key_expr, b"?") for _ in range(3)]
        )
        bus.node("sim")
        lines: list[str] = []
        eventually(lambda: lines.extend(capsys.readouterr().err.splitlines()) or lines)
        bus.node("late")  # a link that opens makes it ask again
        time.sleep(1.0)
        lines += capsys.readouterr().err.splitlines()
        (line,) = lines
        assert "[sim]: Ignored another description" in line and "node /sim: " in line
        queryable.undeclare()

    def test_nodes_of_one_name_without_end_are_warned_of_a_few_times(
        self, bus: Bus, capsys: pytest.CaptureFixture[str]
    ) -> None:
        """A program may make up as many as it likes: neither the log nor the memory grows."""
        made_up = [
            encode_message(
                NodeDescription("/sim", "", 1, "", str(number), 1, (), (), {}, {}, {}, {})
            )
            for number in range(50)
        ]
        queryable = bus.node("stranger").session.zenoh.declare_queryable(
            node_key("sim"), lambda query: [query.reply(query.key_expr, each) for each in made_up]
        )
        bus.node("sim")
        time.sleep(1.0)
        assert capsys.readouterr().err.count("There is another node /sim") == 20
        queryable.undeclare()

    def test_namespaces_keep_two_robots_apart(self, bus: Bus) -> None:
        """Nodes in two namespaces share nothing: topics, services, parameters, names."""
        heard: dict[str, list[Number]] = {"robot7": [], "robot8": []}
        nodes = {name: bus.node("sim", namespace=name) for name in heard}
        logs = {name: Records(node) for name, node in nodes.items()}
        for name, node in nodes.items():
            node.create_subscription(Number, "count", heard[name].append)
            node.create_service(Spawn, "spawn", lambda _, name=name: Spawn.Response(name))
        assert nodes["robot7"].full_name == "/robot7/sim"
        driver = bus.node("driver", namespace="robot7")
        wait_until_heard(driver, "count")
        driver.create_publisher(Number, "count").publish(Number(7))
        eventually(lambda: heard["robot7"])
        client = driver.create_client(Spawn, "spawn")
        assert client.call(Spawn.Request(0, 0)) == Spawn.Response("robot7")
        above = bus.node("driver")
        assert above.create_client(Spawn, "robot8/spawn").call(Spawn.Request(0, 0)).name == "robot8"
        assert heard == {"robot7": [Number(7)], "robot8": []}
        assert [log.lines for log in logs.values()] == [[], []]

    def test_a_node_describes_itself(self, node: Node, other: Node) -> None:
        """A query for a node returns its name, process, version and endpoints."""
        node.create_publisher(Pose, "pose")
        node.create_subscription(Number, "count", print)
        node.create_service(Spawn, "spawn", print)
        node.create_goal_server(RotateAbsolute, "rotate", print)
        node.create_client(Spawn, "other/spawn")
        node.declare_parameter("rate", 1.0)
        (answer,) = eventually(lambda: list(other.session.ask(node_key("server"))))
        described = decode_map(answer.payload)
        assert described["name"] == "/server"
        assert described["publishes"] == {"pose": "Pose"}
        assert described["subscribes"] == {"count": "Number"}
        assert described["serves"] == {"spawn": "Spawn", "rotate": "RotateAbsolute"}
        assert described["calls"] == {"other/spawn": "Spawn"}
        assert [entry["name"] for entry in described["parameters"]] == ["rate"]


class TestLife:
    @pytest.fixture
    def threads(self) -> Iterator[set[str]]:
        yield {thread.name for thread in threading.enumerate()}

    def test_a_prompt_shows_its_name_and_whether_it_is_closed(self, bus: Bus) -> None:
        """So does that of its listener, which it closes."""
        node = bus.node("eye")
        listener = TransformListener(Buffer(), node)
        assert (repr(node), repr(listener)) == ("<Node /eye>", "<TransformListener of /eye>")
        node.close()
        assert repr(node) == "<Node /eye, closed>"
        assert repr(listener) == "<TransformListener of /eye, closed>"

    def test_closing_twice_is_fine(self, node: Node, threads: set[str]) -> None:
        """A node may be closed again; nothing of it is left running."""
        node.create_timer(0.001, lambda: None)
        assert node.ok
        node.close()
        node.close()
        assert not node.ok
        assert "/server" not in {thread.name for thread in threading.enumerate()}

    def test_callbacks_run_one_at_a_time(self, node: Node, other: Node) -> None:
        """Topics, services, timers and parameters of a node are never called at the same time."""
        inside = 0
        seen: set[str] = set()

        def enter(what: str) -> None:
            nonlocal inside
            inside += 1
            assert inside == 1
            seen.add(f"{what} on {threading.current_thread().name}")
            inside -= 1

        log = Records(node)
        node.create_timer(0.001, lambda: enter("timer"))
        node.create_subscription(Number, "count", lambda _: enter("topic"))
        node.create_service(Spawn, "spawn", lambda _: (enter("service"), Spawn.Response("x"))[1])
        node.declare_parameter("rate", 1.0, on_change=lambda _: enter("parameter"))
        publisher = other.create_publisher(Number, "count")
        client = other.create_client(Spawn, "spawn")
        for _ in range(20):
            publisher.publish(Number(1))
            client.call(Spawn.Request(0, 0))
            list(other.session.ask(parameter_key("server", "rate"), encode_map({"value": 2.0})))
        eventually(lambda: len(seen) == 4)
        assert seen == {f"{what} on /server" for what in ("timer", "topic", "service", "parameter")}
        assert [line for line in log.lines if line.startswith("ERROR")] == []

    def test_wait_returns_whether_the_node_goes_on(self, node: Node) -> None:
        """`while node.wait(...)` is a loop that ends when the node is shut down."""
        assert node.wait(0.001)
        waiter = threading.Timer(0.01, node.shutdown)
        waiter.start()
        assert not node.wait(DEADLINE_S)
        assert not node.wait(DEADLINE_S)
        waiter.join()

    def test_spin_ends_at_shutdown(self, node: Node) -> None:
        """`spin` says that the node is ready and returns when it is shut down."""
        log = Records(node)
        stopper = threading.Timer(0.01, node.shutdown)
        stopper.start()
        node.spin()
        stopper.join()
        assert log.lines == ["INFO: ready"]

    @pytest.mark.real
    def test_a_node_that_cannot_join_the_bus_says_why(self, bus: Bus) -> None:
        """An endpoint it cannot listen at is a BusError in one sentence."""
        settings = NodeSettings("x", config=str(bus.config), listen=("tcp/192.0.2.1:7447",))
        with pytest.raises(BusError, match=r"could not join .*TCP"):
            Node(settings=settings)

    @pytest.mark.real
    def test_a_configuration_that_zenoh_refuses_is_an_error(self, bus: Bus) -> None:
        """The error names the configuration file and what is wrong with it."""
        bus.config.write_text("{mode: 'boss'}")
        with pytest.raises(SettingsError, match=r"zenoh\.json5 .*unknown variant"):
            Node(settings=NodeSettings("x", config=str(bus.config)))


def test_messages_are_not_published_among_transforms(bus: Bus) -> None:
    """A publisher of messages on the key of transforms is refused, also by a remapped name."""
    for name, remappings in (("tf", {}), ("speed", {"speed": "/robot7/tf/sim"})):
        node = bus.node("talker", remappings=remappings)
        with pytest.raises(InvalidNameError, match="is of transforms"):
            node.create_publisher(Pose, name)
        node.close()


@pytest.mark.parametrize(
    ("name", "ours"), [("get_logger", "log"), ("get_clock", "clock"), ("destroy_node", "close")]
)
def test_names_of_rclpy_are_answered_by_ours(bus: Bus, name: str, ours: str) -> None:
    """A method of rclpy's Node is missing, with a hint."""
    with pytest.raises(AttributeError, match=rf"no attribute '{name}'; use: node\.{ours}"):
        getattr(bus.node("talker"), name)
