"""All that is measured of the bus."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from benchmarks.bus import (
    bridge_relay,
    growth,
    intake,
    interest,
    latency,
    paced,
    robot,
    ros,
    startup,
)
from benchmarks.bus.growth import Size
from benchmarks.bus.intake import Intake
from benchmarks.bus.interest import Cost
from benchmarks.bus.latency import Latency

# Sends of each kind in one run of the latency.
_SENDS = 2_000


@dataclass(frozen=True)
class Measured:
    """Intake of messages of one transform and of fifty, beside that of tf2_ros, or why there is
    none; CPU for a message that comes alone, and latency, beside bare Zenoh's; listeners by what
    they read; startup in seconds by phase, for each way to be found; growth; joint states through
    robot_state, and messages of their sizes through a relay on bare Zenoh; messages of one
    transform through the bridge to ROS, by their way.
    """

    single: Intake
    fifty: Intake
    theirs: Intake | str
    paced_s: dict[str, float]
    ours: Latency
    bare: Latency
    reading: dict[str, Cost]
    starts: dict[str, dict[str, float]]
    publishers: Sequence[Size]
    frames: Sequence[Size]
    robot_state: robot.Cost
    bare_relay: robot.Cost
    bridged: dict[str, bridge_relay.Relayed]


def measure(runs: int, tell: Callable[[str], None]) -> Measured:
    """Measure all of it, which takes some minutes."""
    tell("intake")
    single, fifty = intake.measure(1, runs), intake.measure(50, runs)
    tell("tf2_ros under rospy")
    theirs: Intake | str
    try:
        theirs = ros.measure(50, runs)
    except ros.NotInstalled as error:
        theirs = str(error)
    tell("paced messages")
    paced_s = paced.measure(runs)
    tell("latency")
    ours, bare = latency.measure(_SENDS, runs)
    tell("interest")
    reading = interest.measure(min(runs, 3))
    tell("startup")
    starts = {
        "found by scouting": startup.measure(3 * runs, scouting=True),
        "at a given endpoint": startup.measure(3 * runs, scouting=False),
        startup.BARE: startup.measure(3 * runs, scouting=False, bare=True),
    }
    tell("joint states")
    robot_state, bare_relay = robot.measure(min(runs, 3))
    tell("the bridge to ROS")
    bridged = bridge_relay.measure(min(runs, 3))
    tell("growth")
    return Measured(
        single,
        fifty,
        theirs,
        paced_s,
        ours,
        bare,
        reading,
        starts,
        growth.of_publishers(),
        growth.of_frames(),
        robot_state,
        bare_relay,
        bridged,
    )
