"""Callback groups of a node: callbacks that wait beside the node's own."""

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from tests.buses import DEADLINE_S, eventually
from tests.fakes import Lines
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    GoalHandle,
    MutuallyExclusiveCallbackGroup,
    Node,
    ReentrantCallbackGroup,
    TimeoutException,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)
from tfbus.messages import RotateAbsolute, Spawn
from tfbus.wire.codec import encode_map
from tfbus.wire.keys import parameter_key


@dataclass(frozen=True)
class Scan:
    stamp_ns: int


@pytest.fixture
def node(bus: Bus) -> Node:
    return bus.node("robot")


def test_a_callback_of_a_group_waits_for_a_transform_that_its_own_node_sends(
    bus: Bus, node: Node
) -> None:
    """Each scan gets its transform."""
    broadcaster = TransformBroadcaster(node)
    buffer = Buffer()
    found: list[TransformStamped] = []
    failed: list[Exception] = []

    def broadcast() -> None:
        stamped = TransformStamped(node.now_ns(), "odom", "base", Transform.identity())
        broadcaster.send_transform(stamped)

    def on_scan(scan: Scan) -> None:
        try:
            found.append(
                buffer.lookup_transform("odom", "base", scan.stamp_ns, timeout_s=DEADLINE_S)
            )
        except Exception as error:
            failed.append(error)

    group = MutuallyExclusiveCallbackGroup()
    with TransformListener(buffer, node):
        node.create_subscription(Scan, "scan", on_scan, callback_group=group)
        publisher = node.create_publisher(Scan, "scan")
        node.create_timer(0.01, broadcast)
        eventually(lambda: buffer.can_transform("odom", "base"))
        for number in range(1, 11):
            publisher.publish(Scan(node.now_ns() + 30_000_000))
            eventually(lambda number=number: len(found) + len(failed) == number)
    assert (len(found), failed) == (10, [])


def test_topics_services_timers_actions_and_parameters_take_a_group(bus: Bus, node: Node) -> None:
    """All of them run while the node's own thread is blocked."""
    group = ReentrantCallbackGroup()
    go_on, blocked = threading.Event(), threading.Event()
    called: set[str] = set()

    def note(what: str) -> Callable[..., Any]:
        return lambda *_: called.add(what)

    def on_spawn(request: Spawn.Request) -> Spawn.Response:
        called.add("service")
        return Spawn.Response("a")

    def on_goal(handle: GoalHandle) -> None:
        called.add("action")
        handle.succeed(RotateAbsolute.Result(0.0))

    node.create_subscription(Scan, "scan", note("topic"), callback_group=group)
    node.create_timer(0.01, note("timer"), callback_group=group)
    node.create_service(Spawn, "spawn", on_spawn, callback_group=group)
    node.create_goal_server(RotateAbsolute, "rotate", on_goal, callback_group=group)
    node.declare_parameter("speed", 1.0, on_change=note("parameter"), callback_group=group)
    node.executor.submit("blocked", lambda: (blocked.set(), go_on.wait(DEADLINE_S)))
    assert blocked.wait(DEADLINE_S)
    node.create_publisher(Scan, "scan").publish(Scan(0))
    other = bus.node("other")
    other.create_client(Spawn, "spawn").call(Spawn.Request(0.0, 0.0, 0.0, "a"))
    other.create_goal_client(RotateAbsolute, "rotate").send(RotateAbsolute.Goal(0.0)).result(
        timeout_s=DEADLINE_S
    )
    key = parameter_key("robot", "speed")
    eventually(lambda: list(other.session.ask(key, encode_map({"value": 2.0}))))
    eventually(lambda: len(called) == 5)
    go_on.set()


def test_a_service_of_the_same_node_is_called_from_another_group(node: Node) -> None:
    """And answers on the node's own thread."""
    answers: list[str] = []
    client = node.create_client(Spawn, "spawn")
    node.create_service(Spawn, "spawn", lambda request: Spawn.Response(request.name))

    def call() -> None:
        timer.cancel()
        answers.append(client.call(Spawn.Request(0.0, 0.0, 0.0, "a"), timeout_s=DEADLINE_S).name)

    timer = node.create_timer(0.001, call, callback_group=MutuallyExclusiveCallbackGroup())
    eventually(lambda: answers == ["a"])


def test_a_node_without_groups_has_no_thread_for_them(node: Node) -> None:
    """They start with the first callback of a group."""
    ticked = threading.Event()

    def threads() -> set[str]:
        return {thread.name for thread in threading.enumerate()}

    node.create_subscription(Scan, "scan", print, callback_group=ReentrantCallbackGroup())
    node.create_timer(0.001, ticked.set)
    assert ticked.wait(DEADLINE_S)
    assert "/robot groups" not in threads()
    node.create_timer(1000.0, print, callback_group=ReentrantCallbackGroup())
    assert "/robot groups" in threads()


def test_a_lookup_in_a_callback_ends_when_the_node_closes(bus: Bus) -> None:
    """In a group and on the node's own thread; nobody waits for its timeout, and no failure is
    logged.
    """
    node = bus.node("closing")
    buffer = Buffer()
    group = MutuallyExclusiveCallbackGroup()

    def wait() -> None:
        buffer.lookup_transform("map", "base", timeout_s=1000.0)

    node.create_timer(0.001, wait)
    node.create_timer(0.001, wait, callback_group=group)
    eventually(lambda: buffer.waiting == 2)
    warnings = Lines(node.log, logging.WARNING)
    node.close()
    assert buffer.waiting == 0
    assert not warnings.lines


@pytest.mark.parametrize("wrong", [ReentrantCallbackGroup, "group", 3])
def test_what_is_no_group_is_refused(node: Node, wrong: Any) -> None:
    """The error says what is one; a class is a usual mistake."""
    with pytest.raises(TypeError, match=r"callback_group .*tfbus\.Mutually"):
        node.create_timer(1.0, lambda: None, callback_group=wrong)


@pytest.mark.parametrize("threads", [0, 1001, 2.5, True])
def test_an_impossible_number_of_threads_is_refused(bus: Bus, threads: Any) -> None:
    """Before the node joins the bus."""
    with pytest.raises(ValueError, match=r"callback_threads .* 1 to 1000"):
        Node("x", callback_threads=threads)


def test_a_callback_that_does_not_return_is_described(node: Node) -> None:
    """Also before it has returned, when no timer can say that it was late."""
    go_on = threading.Event()
    node.create_timer(0.01, print)
    node.executor.submit("topic scan", lambda: go_on.wait(DEADLINE_S))
    described = eventually(lambda: node.describe().get("delays"))
    assert (described[0]["what"], described[0]["by"]) == ("timer of 10 ms (print)", "topic scan")
    go_on.set()


def test_callbacks_that_fail_are_described(node: Node) -> None:
    """Of each group, a plain one and an `async def`: how often, and the last exception."""

    def fail() -> None:
        raise ValueError("no scan")

    async def fail_later() -> None:
        raise SystemExit(3)

    assert "failures" not in node.describe()
    node.create_timer(0.01, fail, callback_group=MutuallyExclusiveCallbackGroup())
    node.create_timer(0.01, fail_later)
    eventually(lambda: len(node.describe().get("failures", ())) == 2)
    failures = {each["error"]: each for each in node.describe()["failures"]}
    assert failures.keys() == {"ValueError: no scan", "SystemExit: 3"}
    assert "timer of 10 ms" in failures["SystemExit: 3"]["what"]
    assert all(each["count"] > 0 and each["last_ns"] > 0 for each in failures.values())


class Unspeakable(Exception):
    """An exception whose text raises another one."""

    def __str__(self) -> str:
        raise TypeError("no text")


def test_a_callback_goes_on_after_an_exception_without_a_text(node: Node) -> None:
    """The exception is called by its kind."""
    calls: list[None] = []

    def fail() -> None:
        calls.append(None)
        raise Unspeakable

    node.create_timer(0.01, fail)
    eventually(lambda: len(calls) > 5)
    assert node.describe()["failures"][0]["error"] == "Unspeakable"


def test_a_lookup_that_holds_up_its_own_broadcaster_says_so(node: Node) -> None:
    """Not that one should query the latest: the remedy is a group, or an `async def`."""
    broadcaster = TransformBroadcaster(node)
    buffer = Buffer()
    errors: list[str] = []

    def broadcast() -> None:
        stamped = TransformStamped(node.now_ns(), "odom", "base", Transform.identity())
        broadcaster.send_transform(stamped)

    def on_scan(scan: Scan) -> None:
        with pytest.raises(TimeoutException) as caught:
            buffer.lookup_transform("odom", "base", scan.stamp_ns, timeout_s=0.05)
        errors.append(str(caught.value))

    with TransformListener(buffer, node):
        node.create_timer(0.01, broadcast)
        eventually(lambda: buffer.can_transform("odom", "base"))
        node.create_subscription(Scan, "scan", on_scan)
        publisher = node.create_publisher(Scan, "scan")
        publisher.publish(Scan(node.now_ns() + 1_000_000_000))
        eventually(lambda: errors)
        on_scan(Scan(node.now_ns() + 1_000_000_000))
    held_up, elsewhere = errors
    assert "timer of 10 ms" in held_up and ".broadcast)" in held_up
    assert "buffer.wait_for_transform(" in held_up and held_up.endswith(" a callback_group")
    assert elsewhere.endswith("; query the latest (stamp_ns=None)")
