"""Drives a simulated clock, and a node that follows it: ten seconds pass in a moment.

    python examples/simulated_time.py

Here both are in one process. Other processes follow the same clock with `--sim-time`; without a
simulator of your own, `tfbus clock --rate 10` is such a clock.
"""

from tfbus import Node, NodeSettings, SystemClock
from tfbus.messages import Clock

STEP_NS = 100_000_000


def main() -> None:
    ticks: list[float] = []
    simulator = Node.from_args("simulator")
    follower = NodeSettings("follower", sim_time=True)
    with simulator, Node.from_settings(follower) as node:
        clock = simulator.create_clock_publisher()
        clock.publish(Clock(stamp_ns=0))
        node.wait_for_clock(timeout_s=10.0)
        node.create_timer(2.5, lambda: ticks.append(node.now_ns() / 1e9))
        for step in range(1, 101):
            clock.publish(Clock(stamp_ns=step * STEP_NS))
            # The next step begins once the follower has come along, and its timer has run.
            while node.now_ns() < step * STEP_NS or len(ticks) < step // 25:
                simulator.wait(0.001, clock=SystemClock())
        print("simulated seconds:", node.now_ns() / 1e9)
    print("ticks of the timer:", ticks)


if __name__ == "__main__":
    main()
