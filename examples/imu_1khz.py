"""Integrates the gyroscope of an IMU at 1 kHz, and sends every orientation; says what that costs.

    python examples/imu_1khz.py
    python examples/imu_1khz.py --param batch=1

A message has `batch` samples, each with its own stamp, as an IMU hands them out. More in a message
cost less, and come later: `tfbus monitor` shows the delay. The IMU is simulated, with noise and a
bias, which is a good part of the cost. Ctrl-C ends it.
"""

import time

import numpy as np
from numpy.typing import NDArray

from tfbus import Node, Transform, TransformBroadcaster, TransformStamped

PERIOD_NS = 1_000_000
AXIS = np.array([0.6, 0.0, 0.8])
BIAS = np.array([0.001, 0.0, 0.0])  # rad/s


def truth(sample: int) -> Transform:
    """How the IMU is held: it sways about one axis by one radian."""
    return Transform.from_rotvec(AXIS * np.sin(sample * 0.003))


def gyroscope(sample: int, random: np.random.Generator) -> NDArray[np.float64]:
    """The mean angular velocity (3,) in rad/s from one sample to the next, in the IMU's axes."""
    turn = (truth(sample).inverse() @ truth(sample + 1)).as_rotvec()
    return turn / (PERIOD_NS / 1e9) + BIAS + random.normal(0.0, 0.005, 3)


def main() -> None:
    random = np.random.default_rng(1)
    sent = 0
    messages = 0
    orientation = truth(0)
    with Node.from_args("imu") as node:
        batch = node.declare_parameter("batch", 10, minimum=1, maximum=1000).value
        broadcaster = TransformBroadcaster(node)
        start_ns = node.now_ns()
        reported = (0, 0, time.process_time(), time.monotonic())

        def send() -> None:
            nonlocal sent, messages, orientation
            # By the clock, not by the timer: one that was late sends what is due meanwhile.
            while start_ns + (sent + batch) * PERIOD_NS <= node.now_ns():
                message = []
                for sample in range(sent, sent + batch):
                    turn = gyroscope(sample, random) * (PERIOD_NS / 1e9)
                    orientation @= Transform.from_rotvec(turn)
                    stamp_ns = start_ns + (sample + 1) * PERIOD_NS
                    message.append(TransformStamped(stamp_ns, "world", "imu", orientation))
                broadcaster.send_transform(message)
                sent += batch
                messages += 1

        def report() -> None:
            nonlocal reported
            now = (sent, messages, time.process_time(), time.monotonic())
            samples, sends, cpu_s, past_s = np.subtract(now, reported)
            reported = now
            print(
                f"{samples / past_s:.0f} samples/s in {sends / past_s:.0f} messages/s, "
                f"{100 * cpu_s / past_s:.1f} % of a core, "
                f"{orientation.angle(truth(sent), degrees=True):.2f} degrees off"
            )

        node.create_timer(batch * PERIOD_NS / 1e9, send)
        node.create_timer(1.0, report)
        node.spin()


if __name__ == "__main__":
    main()
