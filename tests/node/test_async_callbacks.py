"""Callbacks that are `async def`: they await on the node's own thread, and others run meanwhile."""

import asyncio
import functools
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
    ServiceError,
    SimulatedClock,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)
from tfbus.base.arguments import is_async
from tfbus.bus.session import Session
from tfbus.messages import RotateAbsolute, Spawn


@dataclass(frozen=True)
class Scan:
    number: int


@pytest.fixture
def node(bus: Bus) -> Node:
    return bus.node("robot")


class Gate:
    """An asyncio event that another thread opens."""

    def __init__(self) -> None:
        self._opened = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self.waiting = 0

    async def passed(self) -> None:
        self._loop = asyncio.get_running_loop()
        self.waiting += 1
        await self._opened.wait()

    def open(self) -> None:
        assert self._loop is not None
        self._loop.call_soon_threadsafe(self._opened.set)


def test_a_scan_awaits_a_transform_that_its_own_node_sends(node: Node) -> None:
    """The timer that sends it goes on meanwhile, on the same thread."""
    broadcaster = TransformBroadcaster(node)
    buffer = Buffer()
    found: list[TransformStamped] = []
    threads: set[int] = set()

    def broadcast() -> None:
        threads.add(threading.get_ident())
        stamped = TransformStamped(node.now_ns(), "odom", "base", Transform.identity())
        broadcaster.send_transform(stamped)

    async def on_scan(scan: Scan) -> None:
        threads.add(threading.get_ident())
        found.append(
            await buffer.wait_for_transform("odom", "base", scan.number, timeout_s=DEADLINE_S)
        )

    with TransformListener(buffer, node):
        node.create_subscription(Scan, "scan", on_scan)
        publisher = node.create_publisher(Scan, "scan")
        node.create_timer(0.01, broadcast)
        eventually(lambda: buffer.can_transform("odom", "base"))
        for number in range(1, 11):
            publisher.publish(Scan(node.now_ns() + 30_000_000))
            eventually(lambda number=number: len(found) == number)
    assert len(threads) == 1


def test_others_run_while_one_awaits_and_never_between(node: Node) -> None:
    """A step between two awaits is never interrupted by another callback."""
    gate, ended = Gate(), threading.Event()
    inside: list[str] = []
    together: set[tuple[str, ...]] = set()
    ticks: list[int] = []

    def step(what: str) -> None:
        inside.append(what)
        together.add(tuple(inside))
        inside.remove(what)

    async def on_scan(scan: Scan) -> None:
        step("before")
        await gate.passed()
        step("after")
        ended.set()

    def tick() -> None:
        step("tick")
        ticks.append(1)

    node.create_subscription(Scan, "scan", on_scan)
    node.create_timer(0.001, tick)
    node.create_publisher(Scan, "scan").publish(Scan(0))
    eventually(lambda: gate.waiting)
    before = len(ticks)
    eventually(lambda: len(ticks) > before + 5)
    assert not ended.is_set()
    gate.open()
    print("CANCELLED", flush=True)
    assert ended.wait(DEADLINE_S)
    assert together == {("before",), ("tick",), ("after",)}


def test_messages_are_awaited_at_once_in_their_order(node: Node) -> None:
    """At most ten; further ones wait, and are dropped and counted as ever."""
    gate = Gate()
    began: list[int] = []
    ended: list[int] = []

    async def on_scan(scan: Scan) -> None:
        began.append(scan.number)
        await gate.passed()
        ended.append(scan.number)

    subscription = node.create_subscription(Scan, "scan", on_scan)
    publisher = node.create_publisher(Scan, "scan")
    for number in range(10):
        publisher.publish(Scan(number))
    eventually(lambda: began == list(range(10)))
    for number in range(10, 25):
        publisher.publish(Scan(number))
    eventually(lambda: subscription.received == 25)
    assert (began, subscription.dropped) == (list(range(10)), 5)
    gate.open()
    eventually(lambda: len(ended) == 20)
    assert began == [*range(10), *range(15, 25)]


def test_a_service_awaits_before_it_answers(bus: Bus, node: Node) -> None:
    """Its response is what the coroutine returns; a ServiceError is a refusal."""
    gate = Gate()

    async def spawn(request: Spawn.Request) -> Spawn.Response:
        await gate.passed()
        if not request.name:
            raise ServiceError("it needs a name")
        return Spawn.Response(request.name)

    node.create_service(Spawn, "spawn", spawn)
    client = bus.node("other").create_client(Spawn, "spawn")
    answers: list[object] = []

    def call(name: str) -> None:
        try:
            answers.append(client.call(Spawn.Request(0.0, 0.0, 0.0, name), timeout_s=DEADLINE_S))
        except ServiceError as error:
            answers.append(str(error))

    callers = [threading.Thread(target=call, args=(name,)) for name in ("a", "")]
    for caller in callers:
        caller.start()
    eventually(lambda: gate.waiting == 2)
    gate.open()
    for caller in callers:
        caller.join(DEADLINE_S)
    assert sorted(answers, key=str) == [Spawn.Response("a"), "it needs a name"]


def test_a_busy_service_refuses_what_would_await_too_much(node: Node) -> None:
    """Requests that are awaited count as those that wait."""
    gate = Gate()
    for _ in range(3):
        node.executor.submit("service a", gate.passed)
    eventually(lambda: gate.waiting == 3)
    assert not node.executor.submit("service a", gate.passed, limit=3)
    assert node.executor.submit("service b", lambda: None, limit=3)
    gate.open()
    eventually(lambda: node.executor.submit("service a", lambda: None, limit=1))


def test_a_service_of_the_same_node_is_awaited(node: Node) -> None:
    """Once it is there; the node serves it meanwhile."""
    answers: list[str] = []
    client = node.create_client(Spawn, "spawn")

    async def call() -> None:
        timer.cancel()
        response = await client.call_async(Spawn.Request(0.0, 0.0, 0.0, "a"), timeout_s=DEADLINE_S)
        answers.append(response.name)

    timer = node.create_timer(0.001, call)
    eventually(lambda: timer.is_awaited)
    node.create_service(Spawn, "spawn", lambda request: Spawn.Response(request.name))
    eventually(lambda: answers == ["a"])


def test_an_awaited_call_fails_as_a_call_that_blocks(bus: Bus, node: Node) -> None:
    """With the same words: no service, no answer, a refusal, a request of another type."""

    def refuse(request: Spawn.Request) -> Spawn.Response:
        raise ServiceError("it is full")

    async def answer_never(request: Spawn.Request) -> Spawn.Response:
        await asyncio.Event().wait()
        raise AssertionError

    node.create_service(Spawn, "refuses", refuse)
    node.create_service(Spawn, "never", answer_never)
    other = bus.node("other")
    request: Any = Spawn.Request(0.0, 0.0, 0.0, "a")
    for name, given, sentence in (
        ("absent", request, "no service 'absent' after 0.05 s"),
        ("never", request, "'never' did not answer within 0.05 s"),
        ("refuses", request, "it is full"),
        ("refuses", 3, "service 'refuses' takes Spawn.Request, not 3"),
    ):
        client = other.create_client(Spawn, name)
        assert name == "absent" or client.wait_for_service(DEADLINE_S)
        with pytest.raises((ServiceError, TypeError)) as caught:
            asyncio.run(
                client.call_async(given, timeout_s=0.05 if name != "refuses" else DEADLINE_S)
            )
        assert str(caught.value) == sentence


def test_a_cancelled_call_ends_its_query(
    bus: Bus, node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also one without a timeout: nothing of it is left, though the service never answers."""
    asked, ended = asyncio.Event(), threading.Event()

    async def answer_never(request: Spawn.Request) -> Spawn.Response:
        await asyncio.Event().wait()
        raise AssertionError

    def ask_later(self: Session, key: str, *given: Any, **named: Any) -> None:
        payload, on_answer, on_end = given
        if key != "never":
            original(self, key, *given, **named)
            return
        original(self, key, payload, on_answer, lambda: (ended.set(), on_end()), **named)
        asked.set()

    async def cancel_a_call() -> None:
        call = asyncio.create_task(client.call_async(request, timeout_s=None))
        async with asyncio.timeout(DEADLINE_S):
            await asked.wait()
        call.cancel()
        await asyncio.wait([call])

    original, request = Session.ask_later, Spawn.Request(0.0, 0.0, 0.0, "a")
    monkeypatch.setattr(Session, "ask_later", ask_later)
    node.create_service(Spawn, "never", answer_never)
    client = bus.node("other").create_client(Spawn, "never")
    asyncio.run(cancel_a_call())
    assert ended.wait(DEADLINE_S)


def test_an_action_awaits_its_end(bus: Bus, node: Node) -> None:
    """With feedback on the way; what it raises ends the goal."""

    async def turn(handle: GoalHandle) -> None:
        handle.feedback(RotateAbsolute.Feedback(1.0))
        await asyncio.sleep(0)
        if handle.request.theta > 1.0:
            raise ServiceError("too far")
        handle.succeed(RotateAbsolute.Result(0.5))

    node.create_goal_server(RotateAbsolute, "rotate", turn)
    client = bus.node("other").create_goal_client(RotateAbsolute, "rotate")
    assert client.send(RotateAbsolute.Goal(1.0)).result(timeout_s=DEADLINE_S).status == "succeeded"
    with pytest.raises(ServiceError, match="too far"):
        client.send(RotateAbsolute.Goal(2.0)).result(timeout_s=DEADLINE_S)


@pytest.mark.parametrize("is_simulated", [False, True])
def test_a_timer_leaves_out_ticks_while_its_last_one_awaits(node: Node, is_simulated: bool) -> None:
    """By the system's clock or a simulated one: never two of one timer at once."""
    gate = Gate()
    ticks: list[int] = []
    clock = SimulatedClock() if is_simulated else node.clock

    async def tick() -> None:
        ticks.append(1)
        await gate.passed()

    def others_tick() -> None:
        others.append(1)
        if isinstance(clock, SimulatedClock):
            clock.set(clock.now_ns() + 1_000_000)

    others: list[int] = []
    node.create_timer(0.001, others_tick)
    node.create_timer(0.001, tick, clock=clock)
    eventually(lambda: gate.waiting)
    before = len(others)
    eventually(lambda: len(others) > before + 20)
    assert len(ticks) == 1
    gate.open()
    eventually(lambda: len(ticks) > 3)


def test_a_failure_after_an_await_is_logged_as_others_are(node: Node) -> None:
    """Once, as an error; later messages still come."""
    errors = Lines(node.log, logging.ERROR)
    seen: list[int] = []

    async def on_scan(scan: Scan) -> None:
        await asyncio.sleep(0)
        seen.append(scan.number)
        raise RuntimeError("no good")

    node.create_subscription(Scan, "scan", on_scan)
    publisher = node.create_publisher(Scan, "scan")
    for number in range(3):
        publisher.publish(Scan(number))
        eventually(lambda number=number: number in seen)
    [line] = errors.lines
    assert "failed, 1 time " in line and line.endswith("(topic scan)")


def test_a_coroutine_that_blocks_is_the_culprit(node: Node) -> None:
    """A step that does not await holds up the timers of its node, and is named."""
    warnings = Lines(node.log, logging.WARNING)
    entered, go_on = threading.Event(), threading.Event()

    async def on_scan(scan: Scan) -> None:
        await asyncio.sleep(0)
        entered.set()
        go_on.wait(DEADLINE_S)

    node.create_subscription(Scan, "scan", on_scan)
    node.create_timer(0.01, lambda: None)
    node.create_publisher(Scan, "scan").publish(Scan(0))
    assert entered.wait(DEADLINE_S)
    eventually(lambda: node.describe().get("delays"))
    go_on.set()
    eventually(lambda: any("the callback of topic scan took" in line for line in warnings.lines))


def test_close_cancels_what_awaits(bus: Bus) -> None:
    """It may clean up; nothing is logged, and its thread ends."""
    node = bus.node("closing")
    cleaned_up = threading.Event()
    buffer = Buffer()

    async def wait() -> None:
        try:
            await buffer.wait_for_transform("map", "base", timeout_s=None)
        finally:
            cleaned_up.set()

    node.create_timer(0.001, wait)
    eventually(lambda: buffer.waiting)
    warnings = Lines(node.log, logging.WARNING)
    node.close()
    assert cleaned_up.is_set()
    assert buffer.waiting == 0
    assert not warnings.lines
    assert node.full_name not in {thread.name for thread in threading.enumerate()}


def test_an_async_callback_has_no_group(node: Node) -> None:
    """The error says where it runs."""
    group = MutuallyExclusiveCallbackGroup()

    async def tick() -> None:
        """Never called."""

    with pytest.raises(TypeError, match=r"async def .*callback_group"):
        node.create_timer(1.0, tick, callback_group=group)


def test_an_async_callback_that_nothing_would_await_is_refused(node: Node) -> None:
    """Callbacks on Zenoh's threads, and those that answer at once, are plain functions."""

    async def nothing(value: Any = None) -> None:
        """Never called."""

    client = node.create_goal_client(RotateAbsolute, "rotate")
    refused: list[Callable[[], object]] = [
        lambda: node.declare_parameter("speed", 1.0, on_change=nothing),
        lambda: node.create_raw_subscription("scan", nothing),  # type: ignore[arg-type]
        lambda: client.send(RotateAbsolute.Goal(0.0), on_feedback=nothing),
        lambda: node.clock.add_jump_callback(nothing),  # type: ignore[arg-type]
        lambda: Buffer().on_change(nothing),  # type: ignore[arg-type]
        lambda: Buffer().watch_questions(nothing),
        lambda: Buffer(clock=nothing),  # type: ignore[arg-type]
    ]
    for call in refused:
        with pytest.raises(TypeError, match="not an async def"):
            call()


def test_a_lambda_may_return_a_coroutine(node: Node) -> None:
    """Also in a group: then it runs on the node's own thread."""
    names: list[str] = []

    async def tick() -> None:
        await asyncio.sleep(0)
        names.append(threading.current_thread().name)
        timer.cancel()

    group = MutuallyExclusiveCallbackGroup()
    timer = node.create_timer(0.001, lambda: tick(), callback_group=group)
    eventually(lambda: names)
    assert set(names) == {node.full_name}


def test_what_is_async_is_known() -> None:
    """Functions, methods, partials and objects; nothing else is."""

    class Both:
        async def method(self) -> None: ...

        async def __call__(self) -> None: ...

    class Inherits(Both): ...

    class Neither:
        def method(self) -> None: ...

        def __call__(self) -> None: ...

    async def function() -> None: ...

    yes: list[Any] = [function, Both().method, Both(), functools.partial(Both().method), Inherits()]
    no: list[Any] = [len, print, Neither().method, Neither(), [].append, lambda: None, Both, None]
    assert [is_async(each) for each in yes] == [True] * len(yes)
    assert [is_async(each) for each in no] == [False] * len(no)
