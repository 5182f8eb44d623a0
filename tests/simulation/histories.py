"""Random histories of a network: run from their plans, and held against the laws."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import tfbus
from tests.simulation.laws import Laws
from tests.simulation.model import Publisher, Sent
from tests.simulation.plans import LARGE, PLAIN, Action, Plan
from tests.simulation.told import Told
from tfbus.base import scheduler
from tfbus.base.errors import TfbusError
from tfbus.geometry.columns import Columns
from tfbus.streams import clock_offset
from tfbus.testing.network import Network
from tfbus.testing.processes import START_NS, Process
from tfbus.wire.keys import transforms_key
from tfbus.wire.transforms import TransformMessage, encode_transforms

_SETTLE_S = 22.0

# A task that gets no processor gets none for at most this long.
_STALL_S = 0.2

# What processes ask of each other takes at most this long.
_PATIENCE_S = (0.3, 1.0, 2.0)


class Violation(AssertionError):
    """A law does not hold."""


class Ask:
    """A service that answers with the number of its process."""

    @dataclass
    class Request:
        """Nothing is asked."""

    @dataclass
    class Response:
        """The process that answers."""

        number: int = 0


@dataclass
class Count:
    """A message of a topic: its number, and whose it is."""

    process: int = 0
    number: int = 0


@dataclass
class Part:
    """A listener of a process, and what it fills."""

    who: str
    process: Process
    node: Any
    listener: Any
    buffer: Any
    told: Told
    options: dict[str, Any] = field(default_factory=dict)
    slots: list[str] = field(default_factory=list)
    began_s: float = 0.0
    is_closed: bool = False

    @property
    def name(self) -> str:
        """Its name in a violation."""
        return f"{self.who}{' by interest' if 'reads' in self.options else ''}"


class Run:
    """One run of a plan."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.network = Network(plan.seed)
        self.sent = Sent()
        # The processes of each slot, the last one last; and all of them by their numbers.
        self.publishers: dict[str, list[Publisher]] = {}
        self.by_number: dict[int, Publisher] = {}
        self.readers: dict[str, Process] = {}
        self.parts: list[Part] = []
        self.violations: list[str] = []
        self.laws = Laws(self)
        self._version = 0
        self._looked_s = 0.0

    @property
    def now_s(self) -> float:
        """The time of the history, in seconds."""
        return self.network.tasks.now_ns / 1e9

    def violate(self, text: str) -> None:
        """Note that a law does not hold."""
        self.violations.append(f"{self.now_s:.3f} s: {text}")

    def run(self) -> None:
        """Run it all. Raises Violation, and SimulationError where nothing can go on."""
        logging.disable(logging.CRITICAL)
        again_s = clock_offset.AGAIN_S
        if self.plan.size is LARGE:
            # Each listener measures 190 clocks twice a minute, which would take most of the time.
            clock_offset.AGAIN_S = 1200.0
        try:
            with self.network as network:
                for fault, share in self.plan.faults:
                    setattr(network.faults, fault, share)
                if self.plan.stalls:
                    network.tasks.stalls = (self.plan.stalls, _STALL_S)
                for host in self.plan.hosts:
                    network.host(host)
                for action in self.plan.actions:
                    self._go_on_until(action.at_s)
                    getattr(self, f"_{action.kind}")(action.who, *action.args)
                    self.laws.note_calm()
                self._heal("all")
                for process in [*self._processes()]:
                    if process.is_stopped:
                        network.go_on(process)
                self._go_on_until(self.now_s + _SETTLE_S)
                self._end_all()
        finally:
            clock_offset.AGAIN_S = again_s
            logging.disable(logging.NOTSET)

    def _go_on_until(self, end_s: float) -> None:
        while (left_s := end_s - self.now_s) > 1e-9:
            look_s = self._looked_s + self.plan.size.look_s - self.now_s
            self.network.run(min(left_s, max(look_s, 0.0)))
            if look_s > left_s:
                continue
            self._looked_s = self.now_s
            self.laws.check()
            if self.violations:
                raise Violation("\n".join([*self.violations[:5], str(self.plan)]))

    def _end_all(self) -> None:
        """Close all nodes: nothing of theirs is left."""
        living = [each for each in self._processes() if not each.is_dead]
        for publisher in self.by_number.values():
            if publisher.is_alive:
                publisher.node.shutdown()
        for part in self.parts:
            if not part.process.is_dead:
                part.node.shutdown()
        self._go_on_until(self.now_s + 5.0)
        for process in living:
            if not process.is_dead:
                self.violate(f"{process.name} does not end: {self.laws.tasks_of(process)}")
        self._go_on_until(self.now_s + 0.1)

    def _processes(self) -> Iterator[Process]:
        for publisher in self.by_number.values():
            if publisher.process is not None:
                yield publisher.process
        yield from self.readers.values()

    def living(self, slot: str) -> list[Publisher]:
        """The processes of a slot that are there."""
        return [each for each in self.publishers.get(slot, ()) if each.is_alive]

    # What happens

    def _start(self, who: str) -> None:
        if who in self.plan.publishers:
            if not self._is_there(who):
                self._start_publisher(who, self.plan.publishers[who])
        elif who not in self.readers:
            self._start_reader(who)

    def _is_there(self, slot: str) -> bool:
        return any(
            each.process is not None and not each.process.is_dead
            for each in self.publishers.get(slot, ())
        )

    def _kill(self, slot: str) -> None:
        for publisher in self.publishers.get(slot, ()):
            if publisher.process is not None:
                self.network.kill(publisher.process)

    def _close(self, slot: str) -> None:
        for publisher in self.living(slot):
            publisher.node.shutdown()

    def _restart(self, slot: str) -> None:
        self._fail_over(slot, self.plan.publishers[slot])

    def _fail_over(self, slot: str, host: str) -> None:
        """The process ends, and another of the same name begins on this host."""
        self._kill(slot)
        self._start_publisher(slot, host)

    def _twin(self, slot: str, host: str) -> None:
        """A second process of the same name, while the first goes on."""
        if len(self.living(slot)) < 2:
            self._start_publisher(slot, host)

    def _power_off(self, host: str) -> None:
        self.network.power_off(host)

    def _stop(self, who: str, seconds: float) -> None:
        found = [self.readers[who]] if who in self.readers else []
        found += [each.process for each in self.living(who) if each.process is not None]
        for process in found:
            if process.is_running:
                self.network.stop(process)
                self.network.tasks.call_after(
                    seconds, lambda each=process: each.is_stopped and self.network.go_on(each)
                )

    def _partition(self, host: str) -> None:
        self.network.partition(host)

    def _flap(self, host: str, seconds: float) -> None:
        self.network.partition(host)
        self.network.tasks.call_after(seconds, self.network.heal)

    def _cut(self, one: str, other: str) -> None:
        self.network.cut(one, other, both_ways=False)

    def _slow(
        self, one: str, other: str, delay_s: float, loss: float, bytes_a_second: float
    ) -> None:
        self.network.path(
            one,
            other,
            delay_s=delay_s,
            jitter_s=0.5 * delay_s,
            loss=loss,
            bytes_a_second=bytes_a_second,
        )

    def _heal(self, _: str) -> None:
        for one in self.plan.hosts:
            for other in self.plan.hosts:
                if one < other:
                    self.network.path(one, other)
        self.network.heal()

    def _clock(self, host: str, step_s: float) -> None:
        self.network.host(host).step_clock(step_s)
        self.laws.note_clock(host)

    # Publishers

    def _start_publisher(self, slot: str, host: str) -> None:
        publisher = Publisher(len(self.by_number) + 1, slot, began_s=self.now_s)
        self.by_number[publisher.number] = publisher
        self.publishers.setdefault(slot, []).append(publisher)
        publish = self._publish_plainly if slot == PLAIN else self._publish
        publisher.process = self.network.start(host, slot, publish, publisher)

    def _publish_plainly(self, publisher: Publisher) -> None:
        node = tfbus.Node(f"of_{publisher.slot}")
        publisher.plain = node.session.publisher(transforms_key(publisher.slot))
        publisher.plain_epoch_ns = node.now_ns()
        node.create_timer(self.plan.period_s, lambda: self._send(publisher))
        publisher.node = node
        node.wait(None)
        publisher.is_closed = True
        node.close()

    def _publish(self, publisher: Publisher) -> None:
        slot = publisher.slot
        node = tfbus.Node(slot)
        publisher.dynamic = tfbus.TransformBroadcaster(node, priority=int(slot[1:]), history_s=5.0)
        publisher.static = tfbus.StaticTransformBroadcaster(node)
        counts = node.create_publisher(Count, f"{slot}/count")
        number = 0

        def send() -> None:
            nonlocal number
            self._send(publisher)
            number += 1
            counts.publish(Count(publisher.number, number))

        node.create_timer(self.plan.period_s, send)
        self._race_timers(node, publisher.process)
        node.create_service(Ask, f"{slot}/ask", lambda _: Ask.Response(publisher.number))
        publisher.node = node
        self._set_static(publisher, f"{slot}_fixed0")
        node.wait(None)
        publisher.is_closed = True
        node.close()
        self._check_closed(publisher.process)

    def _send(self, publisher: Publisher) -> None:
        stamp_ns = publisher.node.now_ns()
        frames = [] if publisher.moving in publisher.removed else [publisher.moving]
        if publisher.slot in ("p0", "p1"):
            frames.append("shared")
        if not frames:
            return
        epoch = publisher.epoch
        series = self.sent.note(publisher, frames, stamp_ns)
        y = (stamp_ns - START_NS) / 1e9
        transforms = [
            tfbus.TransformStamped(stamp_ns, "world", each.frame, tfbus.Transform((each.x, y, 0.0)))
            for each in series
        ]
        if publisher.plain is None:
            publisher.dynamic.send_transform(transforms)
            return
        if epoch != publisher.epoch:
            publisher.plain_epoch_ns = max(stamp_ns, publisher.plain_epoch_ns + 1)
        rows = Columns.of_transforms(transforms)
        publisher.plain.put(encode_transforms(TransformMessage(rows, publisher.plain_epoch_ns)))

    def _race_timers(self, node: Any, process: Process | None) -> None:
        """Two timers that are due at once, the first of which cancels the second now and then."""
        assert process is not None
        period_s = 5.0 * self.plan.period_s
        cancelled = False

        def second() -> None:
            if cancelled:
                self.violate(f"{process.name}: a cancelled timer ticks")

        def first() -> None:
            nonlocal cancelled, rival
            if cancelled:
                cancelled, rival = False, node.create_timer(period_s, second)
            elif process.random.random() < 0.3:
                rival.cancel()
                cancelled = True

        node.create_timer(period_s, first)
        rival = node.create_timer(period_s, second)

    def _set_static(self, publisher: Publisher, frame: str) -> None:
        self._version += 1
        version = self._version
        publisher.versions.setdefault(frame, set()).add(version)
        publisher.ever_sent.add(frame)
        publisher.static.send_transform(
            tfbus.TransformStamped(
                publisher.node.now_ns(),
                "world",
                frame,
                tfbus.Transform((publisher.number, version, 0.0)),
            )
        )
        publisher.statics[frame] = version
        publisher.changed_s = self.now_s

    def _do(self, slot: str, job: Callable[[Publisher], None]) -> None:
        for publisher in self.living(slot)[-1:] if slot != PLAIN else ():
            publisher.node.executor.submit("an action", partial(job, publisher))

    def _static(self, slot: str, number: int) -> None:
        self._do(slot, lambda publisher: self._set_static(publisher, f"{slot}_fixed{number}"))

    def _remove_static(self, slot: str, number: int) -> None:
        frame = f"{slot}_fixed{number}"

        def remove(publisher: Publisher) -> None:
            if frame in publisher.statics:
                publisher.static.remove(frame)
                del publisher.statics[frame]
                publisher.changed_s = self.now_s

        self._do(slot, remove)

    def _remove(self, slot: str) -> None:
        def remove(publisher: Publisher) -> None:
            frame = publisher.moving
            if frame in publisher.removed:
                del publisher.removed[frame]
            elif frame in publisher.series:
                publisher.dynamic.remove(frame)
                publisher.removed[frame] = self.now_s
                self.sent.end(publisher, frame)
            publisher.changed_s = self.now_s

        self._do(slot, remove)

    # Listeners

    def _start_reader(self, who: str) -> None:
        host, history_s, by_interest = self.plan.listeners[who]
        options: list[dict[str, Any]] = [{"history_s": history_s}]
        if by_interest:
            options.append({"reads": "needed", "history_s": history_s})

        def read() -> None:
            node = tfbus.Node(who)
            for each in options:
                self._listen(who, process, node, each)
            self._ask_now_and_then(who, process, node)
            self._race_timers(node, process)
            node.wait(None)
            for part in self.parts:
                part.is_closed |= part.node is node
            node.close()
            self._check_closed(process)

        process = self.readers[who] = self.network.start(host, who, read)

    def _listen(self, who: str, process: Process, node: Any, options: dict[str, Any]) -> None:
        rule: Any = self.plan.rule
        buffer = tfbus.Buffer(self.plan.size.cache_s)
        told = Told(buffer)
        listener = tfbus.TransformListener(buffer, node, conflicts=rule, **options)
        slots = [*self.plan.publishers]
        if "reads" in options:
            slots = process.random.sample(slots, min(len(slots), 5))
            for slot in slots:
                for frame in ("moving", "fixed0", "fixed1", "fixed2"):
                    listener.need("world", f"{slot}_{frame}")
            listener.need("world", "shared")
        part = Part(who, process, node, listener, buffer, told, options, slots, self.now_s)
        buffer.on_change(lambda change: self.laws.check_change(part, change))
        self.parts.append(part)

    def _restart_listener(self, who: str) -> None:
        if who in self.readers:
            self.network.kill(self.readers[who])
            self._start_reader(who)

    def _close_listener(self, who: str) -> None:
        """Its node is closed, and another begins."""
        for part in self.parts:
            if part.who == who and not part.process.is_dead:
                part.node.shutdown()
                break
        if who in self.readers and self.readers[who].is_dead:
            self._start_reader(who)

    def _listen_again(self, who: str) -> None:
        """The first listener of a node is closed, and another one takes its place."""
        for part in self.parts:
            if part.who == who and not part.process.is_dead and not part.is_closed:

                def change(former: Part = part) -> None:
                    if not former.is_closed:
                        former.is_closed = True
                        former.listener.close()
                        self._listen(former.who, former.process, former.node, former.options)

                part.node.executor.submit("an action", change)
                return

    # Questions

    def _ask_now_and_then(self, who: str, process: Process, node: Any) -> None:
        group = tfbus.ReentrantCallbackGroup()
        slots = [slot for slot in self.plan.publishers if slot != PLAIN]
        slots = process.random.sample(slots, min(len(slots), 4))
        clients = {slot: node.create_client(Ask, f"{slot}/ask") for slot in slots}
        draw = process.random
        last: dict[int, int] = {}

        def on_count(message: Count) -> None:
            # What comes by a link that is lost and by the next one may change places.
            is_calm = self.laws.calm_for_s(process, self.by_number[message.process]) > 3.0
            if is_calm and message.number <= last.get(message.process, 0):
                self.violate(
                    f"{who}: message {message.number} of process {message.process} comes after "
                    f"{last[message.process]}"
                )
            last[message.process] = message.number

        for slot in slots:
            node.create_subscription(Count, f"{slot}/count", on_count)

        def call() -> None:
            slot, patience_s = draw.choice(slots), draw.choice(_PATIENCE_S)
            with self._question(process, f"service {slot}/ask", patience_s):
                answer = clients[slot].call(Ask.Request(), timeout_s=patience_s)
                if self.by_number[answer.number].slot != slot:
                    self.violate(f"{who}: {slot}/ask is answered by {answer.number}")

        def wanted() -> tuple[Any, str, float]:
            parts = [part for part in self.parts if part.node is node]
            frame = draw.choice([f"{draw.choice(slots)}_moving", "shared", "nothing"])
            return draw.choice(parts).buffer, frame, draw.choice(_PATIENCE_S)

        def look_up() -> None:
            buffer, frame, patience_s = wanted()
            stamp_ns = draw.choice((None, node.now_ns() - 300_000_000, node.now_ns()))
            with self._question(process, f"lookup of {frame}", patience_s):
                buffer.lookup_transform("world", frame, stamp_ns, timeout_s=patience_s)

        async def wait() -> None:
            buffer, frame, patience_s = wanted()
            with self._question(process, f"wait for {frame}", patience_s):
                await buffer.wait_for_transform("world", frame, timeout_s=patience_s)

        pause_s = 13 * self.plan.period_s
        node.create_timer(pause_s, call, callback_group=group)
        node.create_timer(1.3 * pause_s, look_up, callback_group=group)
        node.create_timer(1.7 * pause_s, wait)

    @contextmanager
    def _question(self, process: Process, what: str, patience_s: float) -> Iterator[None]:
        """A question that ends in time; a refusal is an end, too."""
        end = self.laws.expect_end(process, what, patience_s)
        try:
            yield
        except TfbusError:
            pass
        finally:
            end()

    def _check_closed(self, process: Process | None) -> None:
        """A node that has been closed leaves nothing behind, but for a moment."""
        assert process is not None
        deadline_s = scheduler.monotonic() + 2.0
        while left := self.laws.tasks_of(process):
            if scheduler.monotonic() > deadline_s:
                self.violate(f"{process.name}: after its end there are {left}")
                return
            scheduler.sleep(0.05)


def violation(plan: Plan) -> str | None:
    """The law that a history violates, or the error that ended a thread of it; None for none."""
    try:
        Run(plan).run()
    except Violation as error:
        return str(error)
    except Exception as error:
        return f"{type(error).__name__}: {error}\n{plan}"
    return None


def shrunk(plan: Plan, *, seconds: float = 60.0) -> Plan:
    """A history with as few actions as still violate a law, as far as that is found in time."""
    end_s = time.monotonic() + seconds
    actions, size = list(plan.actions), max(len(plan.actions) // 2, 1)
    while size and time.monotonic() < end_s:
        is_smaller = False
        for at in range(0, len(actions), size):
            fewer: list[Action] = actions[:at] + actions[at + size :]
            if violation(plan.only(fewer)):
                actions, is_smaller = fewer, True
                break
            if time.monotonic() > end_s:
                break
        if not is_smaller:
            size //= 2
        size = min(size, max(len(actions) // 2, 1)) if size else 0
    return plan.only(actions)
