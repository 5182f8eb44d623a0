"""Makes a recording of the log of a drone or a phone, and plays it as if it were live.

    pip install 'tfbus[bag]'
    python examples/drone_log.py
    python examples/drone_log.py flight.csv flight.mcap

A row of the log has a time, a place by GPS, and angles as autopilots have them: roll to the right,
pitch upwards, heading from north to the east, of a body with x ahead, y to the right, z down.
Without a file the program writes such a log, drone_example.csv. The recording has a frame `drone`
(x ahead, y to the left, z up) in `map` (x east, y north, z up), whose origin is the first row.
`tfbus view` shows it, and `tfbus bag play` plays it again. It ends with the log, or by Ctrl-C.
"""

import csv
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from decimal import Decimal
from tempfile import TemporaryDirectory

from mcap.writer import Writer

from tfbus import Transform, stamp_ns

COLUMNS = ("time_s", "latitude", "longitude", "altitude_m", "roll", "pitch", "heading")
EARTH_M = 6_378_137.0


def write_log(path: str) -> None:
    """A round with a radius of 30 m in ten seconds, banked to the right, ten rows a second."""
    with open(path, "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(COLUMNS)
        for tick in range(101):
            angle = 2 * math.pi * tick / 100
            north = math.degrees(30 * math.sin(angle) / EARTH_M)
            east = math.degrees(30 * (1 - math.cos(angle)) / EARTH_M / math.cos(math.radians(48)))
            heading = f"{math.degrees(angle) % 360:.1f}"
            place = (f"{48 + north:.8f}", f"{11 + east:.8f}", f"{520 + tick / 10:.1f}")
            rows.writerow((Decimal(tick) / 10 + 1_700_000_000, *place, 20, 2, heading))


def poses(path: str) -> Iterator[tuple[int, Transform]]:
    """The stamp and the pose of each row. The map is flat: right for a few kilometres."""
    first = None
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            latitude, longitude, altitude, roll, pitch, heading = (
                float(row[name]) for name in COLUMNS[1:]
            )
            first = first or (latitude, longitude, altitude)
            east = math.radians(longitude - first[1]) * EARTH_M * math.cos(math.radians(first[0]))
            north = math.radians(latitude - first[0]) * EARTH_M
            xyz = (east, north, altitude - first[2])
            # y and z of the body are turned over, and the heading is counted from the y axis.
            pose = Transform.from_rpy(roll, -pitch, 90 - heading, xyz, degrees=True)
            yield stamp_ns(Decimal(row["time_s"])), pose


def write_foxglove(log: str, path: str) -> None:
    """The log as Foxglove's FrameTransform, which `tfbus bag import` reads."""
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.FrameTransform", "jsonschema", b"{}")
        channel = writer.register_channel("/tf", "json", schema)
        for stamp, pose in poses(log):
            transform = {
                "timestamp": {"sec": stamp // 10**9, "nsec": stamp % 10**9},
                "parent_frame_id": "map",
                "child_frame_id": "drone",
                "translation": dict(zip("xyz", pose.xyz.tolist(), strict=True)),
                "rotation": dict(zip("xyzw", pose.quat_xyzw.tolist(), strict=True)),
            }
            writer.add_message(channel, stamp, json.dumps(transform).encode(), stamp)
        writer.finish()


def main() -> None:
    if len(sys.argv) == 1:
        log, recording, options = "drone_example.csv", "drone_example.mcap", ["--force"]
        write_log(log)
    elif len(sys.argv) == 3:
        log, recording, options = *sys.argv[1:], []
    else:
        raise SystemExit("Usage: drone_log.py [LOG.csv RECORDING.mcap]")
    tfbus = [sys.executable, "-m", "tfbus", "bag"]
    with TemporaryDirectory() as folder:
        foxglove = f"{folder}/log.mcap"
        try:
            write_foxglove(log, foxglove)
        except (OSError, KeyError, ValueError) as error:
            raise SystemExit(f"Error: cannot read {log}: {error!r}") from None
        imported = subprocess.run([*tfbus, "import", foxglove, "-o", recording, *options])
    if imported.returncode:
        raise SystemExit(imported.returncode)
    os.execv(sys.executable, [*tfbus, "play", recording])


if __name__ == "__main__":
    main()
