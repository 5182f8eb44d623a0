"""Random histories of a small network, and the laws that hold in all of them.

A history is drawn from a seed before it runs: hosts, publishers, listeners and what happens to them
when. Each process that publishes has a number of its own, which its transforms carry: x is the
number, y the stamp in seconds. So each answer of a lookup says who sent it, and when.
"""

import logging
import random
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import tfbus
from tfbus.testing.network import Network
from tfbus.testing.processes import START_NS, Process

_SETTLE_S = 20.0
_PERIOD_S = 0.1
_LOOK_S = 0.23


@dataclass(frozen=True)
class Action:
    """One thing that happens: `kind` to `who`, with `args`, at a time."""

    at_s: float
    kind: str
    who: str
    args: tuple[Any, ...] = ()

    def __str__(self) -> str:
        return (
            f"{self.at_s:7.3f} s  {self.kind} {self.who} {' '.join(map(str, self.args))}".rstrip()
        )


@dataclass(frozen=True)
class Plan:
    """All of a history: the hosts of its publishers and listeners, and its actions."""

    seed: int
    hosts: tuple[str, ...]
    publishers: dict[str, str]
    listeners: dict[str, str]
    actions: tuple[Action, ...]
    lost_declarations: float = 0.0
    rule: str = "first"

    @classmethod
    def drawn(
        cls,
        seed: int,
        *,
        hosts: int = 3,
        publishers: int = 3,
        listeners: int = 2,
        actions: int = 14,
        seconds: float = 20.0,
    ) -> "Plan":
        """The history of a seed."""
        draw = random.Random(seed)
        names = tuple(f"h{number}" for number in range(draw.randint(2, hosts)))
        senders = {f"p{n}": draw.choice(names) for n in range(draw.randint(1, publishers))}
        readers = {f"l{n}": draw.choice(names) for n in range(draw.randint(1, listeners))}
        found = [
            Action(round(draw.uniform(0.0, 2.0), 3), "start", who) for who in (*senders, *readers)
        ]
        kinds = (
            ["static"] * 4
            + ["remove_static"] * 2
            + ["remove"] * 2
            + ["kill", "close", "power_off"]
            + ["restart"] * 3
            + ["stop"] * 2
            + ["partition"] * 3
            + ["cut"] * 2
            + ["heal"] * 3
            + ["clock"] * 1
            + ["loss"] * 1
            + ["restart_listener"]
        )
        for _ in range(draw.randint(2, actions)):
            kind = draw.choice(kinds)
            at_s = round(draw.uniform(1.0, seconds), 3)
            who = draw.choice(list(senders))
            args: tuple[Any, ...] = ()
            if kind in ("static", "remove_static"):
                args = (draw.randrange(3),)
            elif kind == "stop":
                args = (round(draw.choice((0.3, 1.0, 2.0, 5.0)) * draw.uniform(0.5, 1.5), 3),)
                who = draw.choice([*senders, *readers])
            elif kind in ("partition", "power_off", "clock"):
                who = draw.choice(names)
                args = (round(draw.uniform(-5, 5), 3),) if kind == "clock" else ()
            elif kind in ("cut", "loss"):
                one, other = draw.sample(names, 2)
                who, args = one, (other, round(draw.uniform(0.0, 0.3), 3))
            elif kind == "heal":
                who = "all"
            elif kind == "restart_listener":
                who = draw.choice(list(readers))
            found.append(Action(at_s, kind, who, args))
        return cls(
            seed,
            names,
            senders,
            readers,
            tuple(sorted(found, key=lambda each: each.at_s)),
            lost_declarations=draw.choice((0.0, 0.0, 0.05)),
            rule=draw.choice(("first", "priority")),
        )

    def without(self, dropped: Action) -> "Plan":
        """The same history without one of its actions."""
        return replace(self, actions=tuple(each for each in self.actions if each is not dropped))

    def __str__(self) -> str:
        rows = [f"seed {self.seed}: {self.publishers} {self.listeners} rule {self.rule}"]
        return "\n".join([*rows, *map(str, self.actions)])


class Violation(AssertionError):
    """A law does not hold."""


@dataclass
class Publisher:
    """A process that publishes, and what it has sent: the model."""

    number: int
    slot: str
    process: Process | None = None
    node: Any = None
    statics: dict[str, int] = field(default_factory=dict)
    removed: set[str] = field(default_factory=set)
    sends: bool = True
    is_closed: bool = False

    @property
    def is_alive(self) -> bool:
        return (
            self.process is not None
            and not self.process.is_dead
            and self.node is not None
            and not self.is_closed
        )


class Run:
    """One run of a plan."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.network = Network(plan.seed)
        self.publishers: dict[str, Publisher] = {}
        self.listeners: dict[str, tuple[Process, Any, Any]] = {}
        self.by_number: dict[int, Publisher] = {}
        self.violations: list[str] = []
        self._version = 0

    def violate(self, text: str) -> None:
        now_s = self.network.tasks.now_ns / 1e9
        self.violations.append(f"{now_s:.3f} s: {text}")

    def run(self) -> None:
        """Run it all. Raises Violation."""
        logging.disable(logging.CRITICAL)
        try:
            with self.network as network:
                network.faults.lost_declarations = self.plan.lost_declarations
                for host in self.plan.hosts:
                    network.host(host)
                for action in self.plan.actions:
                    wait_s = action.at_s - network.tasks.now_ns / 1e9
                    if wait_s > 0:
                        network.run(wait_s)
                    getattr(self, f"_{action.kind}")(action.who, *action.args)
                    self._raise()
                self._heal("all")
                for process in self._processes():
                    if process.is_stopped:
                        network.go_on(process)
                network.run(_SETTLE_S)
                self._check_end()
                self._raise()
        finally:
            logging.disable(logging.NOTSET)

    def _raise(self) -> None:
        if self.violations:
            raise Violation("\n".join([*self.violations[:5], str(self.plan)]))

    def _processes(self) -> Iterator[Process]:
        for publisher in self.publishers.values():
            if publisher.process is not None:
                yield publisher.process
        for process, _, _ in self.listeners.values():
            yield process

    # What happens

    def _start(self, who: str) -> None:
        if who in self.plan.publishers:
            self._start_publisher(who)
        elif who not in self.listeners:
            self._start_listener(who)

    def _start_publisher(self, slot: str) -> None:
        """Start the process of a slot, unless one runs."""
        former = self.publishers.get(slot)
        if former is not None and former.process is not None and not former.process.is_dead:
            return
        publisher = Publisher(len(self.by_number) + 1, slot)
        self.by_number[publisher.number] = self.publishers[slot] = publisher
        publisher.process = self.network.start(
            self.plan.publishers[slot], slot, self._publish, publisher
        )

    def _publish(self, publisher: Publisher) -> None:
        node = tfbus.Node(publisher.slot)
        priority = int(publisher.slot[1:])
        broadcaster = tfbus.TransformBroadcaster(node, priority=priority)
        statics = tfbus.StaticTransformBroadcaster(node)
        publisher.broadcaster, publisher.static_broadcaster = broadcaster, statics  # type: ignore[attr-defined]
        dynamic = f"{publisher.slot}_moving"

        def send() -> None:
            stamp_ns = node.now_ns()
            children = [] if dynamic in publisher.removed else [dynamic]
            if publisher.slot in ("p0", "p1"):
                children.append("shared")
            if children:
                pose = tfbus.Transform((publisher.number, (stamp_ns - START_NS) / 1e9, 0.0))
                broadcaster.send_transform(
                    [tfbus.TransformStamped(stamp_ns, "world", child, pose) for child in children]
                )

        node.create_timer(_PERIOD_S, send)
        publisher.node = node
        self._set_static(publisher, f"{publisher.slot}_fixed0")
        node.wait(None)
        publisher.is_closed = True
        node.close()

    def _set_static(self, publisher: Publisher, frame: str) -> None:
        self._version += 1
        version = self._version
        pose = tfbus.Transform((publisher.number, version, 0.0))
        publisher.static_broadcaster.send_transform(  # type: ignore[attr-defined]
            tfbus.TransformStamped(publisher.node.now_ns(), "world", frame, pose)
        )
        publisher.statics[frame] = version

    def _do(self, slot: str, job: Any) -> None:
        publisher = self.publishers.get(slot)
        if publisher is not None and publisher.is_alive:
            publisher.node.executor.submit("an action", lambda: job(publisher))

    def _static(self, slot: str, number: int) -> None:
        self._do(slot, lambda publisher: self._set_static(publisher, f"{slot}_fixed{number}"))

    def _remove_static(self, slot: str, number: int) -> None:
        frame = f"{slot}_fixed{number}"

        def remove(publisher: Publisher) -> None:
            if frame in publisher.statics:
                publisher.static_broadcaster.remove(frame)  # type: ignore[attr-defined]
                del publisher.statics[frame]

        self._do(slot, remove)

    def _remove(self, slot: str) -> None:
        frame = f"{slot}_moving"

        def remove(publisher: Publisher) -> None:
            if frame in publisher.removed:
                publisher.removed.discard(frame)
            else:
                try:
                    publisher.broadcaster.remove(frame)  # type: ignore[attr-defined]
                except tfbus.LookupException:
                    return
                publisher.removed.add(frame)

        self._do(slot, remove)

    def _kill(self, slot: str) -> None:
        publisher = self.publishers.get(slot)
        if publisher is not None and publisher.process is not None:
            self.network.kill(publisher.process)

    def _close(self, slot: str) -> None:
        publisher = self.publishers.get(slot)
        if publisher is not None and publisher.is_alive:
            publisher.node.shutdown()

    def _restart(self, slot: str) -> None:
        self._kill(slot)
        self._start_publisher(slot)

    def _power_off(self, host: str) -> None:
        self.network.power_off(host)

    def _stop(self, who: str, seconds: float) -> None:
        process = (
            self.listeners[who][0]
            if who in self.listeners
            else self.publishers[who].process
            if who in self.publishers
            else None
        )
        if process is not None and process.is_running:
            self.network.stop(process)
            self.network.tasks.call_after(
                seconds, lambda: process.is_stopped and self.network.go_on(process)
            )

    def _partition(self, host: str) -> None:
        self.network.partition(host)

    def _cut(self, one: str, other: str, _: float) -> None:
        self.network.cut(one, other, both_ways=False)

    def _loss(self, one: str, other: str, loss: float) -> None:
        self.network.path(one, other, delay_s=0.02, jitter_s=0.01, loss=loss)

    def _heal(self, _: str) -> None:
        self.network.heal()

    def _clock(self, host: str, step_s: float) -> None:
        self.network.host(host).step_clock(step_s)

    def _restart_listener(self, who: str) -> None:
        if who in self.listeners:
            self.network.kill(self.listeners[who][0])
            self._start_listener(who)

    def _start_listener(self, who: str) -> None:
        buffer = tfbus.Buffer()

        def listen() -> None:
            node = tfbus.Node(who)
            rule: Any = self.plan.rule
            listener = tfbus.TransformListener(buffer, node, conflicts=rule)
            node.create_timer(_LOOK_S, lambda: self._look(who, node, buffer))
            self.listeners[who] = (process, listener, buffer)
            node.wait(None)

        process = self.network.start(self.plan.listeners[who], who, listen)

    # The laws

    def _look(self, who: str, node: Any, buffer: Any) -> None:
        """No lookup answers with a value that no publisher sent for that stamp."""
        for slot in self.plan.publishers:
            frame = f"{slot}_moving"
            for stamp_ns in (None, node.now_ns() - 500_000_000):
                try:
                    found = buffer.lookup_transform("world", frame, stamp_ns)
                except tfbus.TransformException:
                    continue
                self._check_value(who, slot, frame, found)

    def _check_value(self, who: str, slot: str, frame: str, found: Any) -> None:
        x, y = found.transform.x, found.transform.y
        publisher = self.by_number.get(round(x))
        sent_s = (found.stamp_ns - START_NS) / 1e9
        if publisher is None or abs(x - publisher.number) > 1e-9 or publisher.slot != slot:
            self.violate(f"{who}: {frame} at {sent_s:.3f} has x {x}, which no process sent")
        elif abs(y - sent_s) > 1e-6:
            self.violate(f"{who}: {frame} at {sent_s:.3f} has y {y}")

    def _check_end(self) -> None:
        """All is healed since long: every listener knows what living publishers hold."""
        for who, (process, listener, buffer) in self.listeners.items():
            if process.is_dead:
                continue
            with self.network.within(process):
                infos = {info.name: info for info in listener.streams()}
                for slot, publisher in self.publishers.items():
                    self._check_stream(who, slot, publisher, infos.get(slot), buffer)
                self._check_shared(who, buffer)

    def _check_stream(
        self, who: str, slot: str, publisher: Publisher, info: Any, buffer: Any
    ) -> None:
        if not publisher.is_alive:
            if info is not None and info.alive:
                self.violate(f"{who}: {slot} is taken for living and is gone")
            return
        if info is None or not info.alive:
            self.violate(f"{who}: {slot} is taken for gone and lives ({info})")
            return
        for number in range(3):
            frame = f"{slot}_fixed{number}"
            version = publisher.statics.get(frame)
            value = _value(buffer, frame)
            wanted = None if version is None else (publisher.number, version)
            is_left = value is not None and value[0] != publisher.number and _is_gone(buffer, frame)
            # What an earlier process held stays, marked as gone, until it is sent again.
            if value != wanted and not (wanted is None and is_left):
                self.violate(f"{who}: static {frame} is {value}, its publisher has {wanted}")
        frame = f"{slot}_moving"
        value = _value(buffer, frame)
        number = None if value is None else value[0]
        wanted_number = None if frame in publisher.removed else publisher.number
        if number != wanted_number and not (
            wanted_number is None and number != publisher.number and _is_gone(buffer, frame)
        ):
            self.violate(f"{who}: {frame} is of {number}, sent by {wanted_number}")

    def _check_shared(self, who: str, buffer: Any) -> None:
        """With two publishers of a frame the rule decides, everywhere alike."""
        rivals = [
            self.publishers[slot]
            for slot in ("p0", "p1")
            if slot in self.publishers and self.publishers[slot].is_alive
        ]
        value = _value(buffer, "shared")
        if rivals and (value is None or value[0] not in [each.number for each in rivals]):
            self.violate(f"{who}: shared is of {value}, living are {rivals}")
        decides = len(rivals) == 2 and self.plan.rule == "priority" and value is not None
        if decides and value[0] != rivals[1].number:
            self.violate(f"{who}: shared is of {value[0]}, not of p1, which has priority")


def _value(buffer: Any, frame: str) -> tuple[float, float] | None:
    try:
        found = buffer.lookup_transform("world", frame)
    except tfbus.TransformException:
        return None
    return found.transform.x, found.transform.y


def _is_gone(buffer: Any, frame: str) -> bool:
    return bool(buffer.frame(frame).gone)


def violation(plan: Plan) -> str | None:
    """What a history violates; None for nothing."""
    try:
        Run(plan).run()
    except Violation as error:
        return str(error)
    return None


def shrunk(plan: Plan) -> Plan:
    """A history with as few actions as still violate a law."""
    is_smaller = True
    while is_smaller:
        is_smaller = False
        for action in plan.actions:
            smaller = plan.without(action)
            if violation(smaller):
                plan, is_smaller = smaller, True
                break
    return plan
