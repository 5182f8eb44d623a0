"""Uses the buffer without a network: interpolation, many stamps in one call, an error.

    python examples/buffer_alone.py

Fill a buffer so from a log file, a simulation or a test.
"""

import numpy as np

from tfbus import Buffer, Sampling, Transform, TransformException, TransformStamped

SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND


def main() -> None:
    buffer = Buffer(cache_time_s=30.0)
    for second in range(11):  # a robot drives at 1 m/s along x; its pose is known once a second
        pose = Transform((float(second), 0.0, 0.0))
        buffer.set_transform(TransformStamped(START_NS + second * SECOND, "map", "robot", pose))
    lidar = Transform((0.2, 0.0, 0.5))
    mount = TransformStamped(frame_id="robot", child_frame_id="lidar", transform=lidar)
    buffer.set_transform(mount, static=True)

    between = buffer.lookup_transform("map", "lidar", START_NS + 2 * SECOND + SECOND // 4)
    print("at 2.25 s:", between.transform.xyz)

    stamps_ns = START_NS + np.linspace(0, 10 * SECOND, 1001, dtype=np.int64)
    track = buffer.lookup_transforms("map", "lidar", stamps_ns)
    print("track:", len(track), "poses from", track[0].xyz, "to", track.xyz[-1])

    too_late = START_NS + 10 * SECOND + SECOND // 10
    try:
        buffer.lookup_transform("map", "lidar", too_late)
    except TransformException as error:
        print(f"{type(error).__name__}: {error}")

    ahead = Sampling(extrapolation_s=0.5)
    beyond = buffer.lookup_transform("map", "lidar", too_late, sampling=ahead)
    print("extrapolated:", beyond.transform.xyz.round(3))


if __name__ == "__main__":
    main()
