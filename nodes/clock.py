"""Publishes a simulated time, at any rate, which can be paused and set.

    tfbus clock --rate 10
    tfbus call clock/set '{stamp_ns: 0}'

All nodes with `--sim-time` in its namespace, or below, follow it. Services: clock/pause,
clock/resume, clock/set. Parameter: rate.
"""

import time
from dataclasses import replace

import click

from tfbus import Node, NodeSettings, Number, ServiceError, node_options
from tfbus.base.wording import stamp_text
from tfbus.command.parameters import Declared, NodeCommand
from tfbus.command.types import Moment, MomentType
from tfbus.messages import Clock, Empty, SetClock

# The time is published at most this often; shorter steps are joined.
SHORTEST_TICK_S = 0.001

# Stamps have 64 bits; this leaves 146 years.
LATEST_NS = 2**62

SLOWEST, FASTEST = 1e-3, 1e4

RATE = Declared("rate", 1.0, "Simulated seconds per real second.", minimum=SLOWEST, maximum=FASTEST)


class SimulatedTime:
    """A time that advances in whole steps, on a node's thread, and is published at each.

    Paused at first. On a slow machine the steps get longer, so that the rate holds.
    """

    def __init__(self, node: Node, *, start_ns: int, step_ns: int, rate: float):
        self._node = node
        self._now_ns = start_ns
        self._step_ns = step_ns
        self.paused = True
        self._publisher = node.create_clock_publisher()
        self.rate = replace(RATE, default=rate).on(node, on_change=self._change_rate).value
        self._publish()
        node.create_service(Empty, "clock/pause", self._pause)
        node.create_service(Empty, "clock/resume", self._resume)
        node.create_service(SetClock, "clock/set", self._set)

    def resume(self) -> None:
        """Go on, if it is paused."""
        if self.paused:
            self.paused = False
            self._publish()
            self._go()

    def _go(self) -> None:
        self._owed_ns = 0.0
        self._real_ns = time.monotonic_ns()
        tick_s = max(SHORTEST_TICK_S, self._step_ns / 1e9 / self.rate)
        self._timer = self._node.create_timer(tick_s, self._tick)

    def _tick(self) -> None:
        real_ns = time.monotonic_ns()
        self._owed_ns += (real_ns - self._real_ns) * self.rate
        self._real_ns = real_ns
        steps = int(self._owed_ns // self._step_ns)
        if steps:
            self._owed_ns -= steps * self._step_ns
            self._now_ns += steps * self._step_ns
            self._publish()

    def _publish(self) -> None:
        self._publisher.publish(Clock(self._now_ns, self.rate, self.paused))

    def _change_rate(self, rate: float) -> None:
        self.rate = rate
        self._publish()
        if not self.paused:
            self._timer.cancel()
            self._go()

    def _pause(self, request: Empty.Request) -> Empty.Response:
        if not self.paused:
            self.paused = True
            self._timer.cancel()
            self._publish()
        return Empty.Response()

    def _resume(self, request: Empty.Request) -> Empty.Response:
        self.resume()
        return Empty.Response()

    def _set(self, request: SetClock.Request) -> SetClock.Response:
        if request.stamp_ns >= LATEST_NS:
            raise ServiceError(f"stamp_ns must be between 1970 and 2116, not {request.stamp_ns}")
        self._now_ns = request.stamp_ns
        self._publish()
        return SetClock.Response()


@click.command(
    cls=NodeCommand,
    declared=(RATE,),
    epilog="Example: tfbus clock --rate 10 --start 0",
)
@click.option(
    "--rate",
    type=Number(least=SLOWEST, most=FASTEST),
    default=1.0,
    show_default=True,
    help="Simulated seconds per real second.",
)
@click.option(
    "--start",
    metavar="TIME",
    default="now",
    type=MomentType(),
    show_default=True,
    help="Where to start: seconds or ns since 1970, ISO 8601, -3s from now, or now.",
)
@click.option(
    "--step",
    "step_s",
    type=Number(least=1e-9, most=1e6),
    default=0.01,
    metavar="SECONDS",
    show_default=True,
    help="How far one step advances the time.",
)
@click.option("--paused", is_flag=True, help="Start paused; clock/resume starts it.")
@node_options("clock")
def main(settings: NodeSettings, rate: float, start: Moment, step_s: float, paused: bool) -> None:
    """Publish the simulated time for nodes with --sim-time."""
    start_ns = start.at(time.time_ns())
    if not 0 <= start_ns < LATEST_NS:
        raise click.UsageError("--start must be between 1970 and 2116")
    with Node.from_settings(replace(settings, sim_time=False)) as node:
        step_ns = round(step_s * 1e9)
        simulated = SimulatedTime(node, start_ns=start_ns, step_ns=step_ns, rate=rate)
        speed = "paused" if paused else f"at {simulated.rate:g} times the real speed"
        node.ready(f"It is {stamp_text(start_ns)} s, {speed}, in steps of {step_s:g} s")
        if not paused:
            simulated.resume()
        node.spin()


if __name__ == "__main__":
    main()
