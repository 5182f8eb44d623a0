"""What forward kinematics cost: python -m benchmarks.robots, in an environment with the peers.

tfbus, yourdfpy and pytransform3d compute where all links of a robot are in its root, in one
configuration and in 10,000. Each answers in its own way: tfbus with transforms, the others with
matrices. With --write the pages about speed are written.
"""

import argparse
import io
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from statistics import median
from typing import Any

import numpy as np

from benchmarks import machine
from benchmarks.parts import Part, Table
from benchmarks.report import amount
from tfbus import Robot
from tfbus.base.installation import installed_version
from tfbus.buffer.buffer import COMPILED

# Limbs, and the joints of each, of which every third is fixed.
ROBOTS = {"an arm": (1, 10), "a humanoid": (5, 15)}
MANY = 10_000
# The peers have no call for many: some hundred calls are measured, and 10,000 reckoned from them.
LOOPED = 100


@dataclass(frozen=True)
class Peer:
    """What one library does with a robot: read its text, one configuration, many."""

    load: Callable[[], Any]
    one: Callable[[], Any]
    many: Callable[[], Any]
    # How many times the measured calls stand for what `many` is to do.
    many_times: float = 1.0


def urdf(limbs: int, joints: int) -> str:
    """A robot whose limbs are chains of joints, all origins turned."""
    text = ["<robot name='made_up'><link name='root'/>"]
    for limb in range(limbs):
        parent = "root"
        for number in range(joints):
            link = f"limb{limb}_{number}"
            kind = "fixed" if number % 3 == 2 else "revolute"
            text.append(
                f"<link name='{link}'/><joint name='joint_{link}' type='{kind}'>"
                f"<parent link='{parent}'/><child link='{link}'/>"
                f"<origin xyz='0.1 0.2 {0.1 * limb}' rpy='0.3 {0.1 * number} -0.2'/>"
                f"<axis xyz='{number % 2} {1 - number % 2} 0'/>"
                "<limit lower='-3' upper='3' effort='1' velocity='1'/></joint>"
            )
            parent = link
    return "".join([*text, "</robot>"])


def tfbus_peer(text: str, angles: Mapping[str, float], many: Mapping[str, Any]) -> Peer:
    """tfbus itself."""
    robot = Robot.from_text(text)
    return Peer(
        lambda: Robot.from_text(text), lambda: robot.fk(angles), lambda: robot.fk_many(many)
    )


def yourdfpy_peer(text: str, angles: Mapping[str, float], many: Mapping[str, Any]) -> Peer:
    """yourdfpy, without meshes, which it would read."""
    import yourdfpy

    def load() -> Any:
        return yourdfpy.URDF.load(io.BytesIO(text.encode()), load_meshes=False)

    robot = load()
    links = list(robot.link_map)
    row = np.array([angles[name] for name in robot.actuated_joint_names])
    rows = np.column_stack([many[name][:LOOPED] for name in robot.actuated_joint_names])

    def one(configuration: Any = row) -> Any:
        robot.update_cfg(configuration)
        return {link: robot.get_transform(link) for link in links}

    return Peer(load, one, lambda: [one(each) for each in rows], MANY / LOOPED)


def pytransform3d_peer(text: str, angles: Mapping[str, float], many: Mapping[str, Any]) -> Peer:
    """pytransform3d, without the checks of its arguments, as it advises for speed."""
    from pytransform3d.urdf import UrdfTransformManager

    def load() -> Any:
        robot = UrdfTransformManager(check=False)
        robot.load_urdf(text)
        return robot

    robot = load()
    links = [node for node in robot.nodes if node != "made_up"]

    def one(configuration: Mapping[str, float] = angles) -> Any:
        for name, angle in configuration.items():
            robot.set_joint(name, angle)
        return {link: robot.get_transform(link, "root") for link in links}

    rows = [{name: float(many[name][row]) for name in many} for row in range(LOOPED)]
    return Peer(load, one, lambda: [one(each) for each in rows], MANY / LOOPED)


PEERS = {"tfbus": tfbus_peer, "yourdfpy": yourdfpy_peer, "pytransform3d": pytransform3d_peer}


def cpu_ns(work: Callable[[], Any], least_s: float = 0.05) -> float:
    """What one call takes, of as many as take a moment together."""
    calls, start = 0, time.process_time_ns()
    while (spent := time.process_time_ns() - start) < least_s * 1e9:
        work()
        calls += 1
    return spent / calls


def measure(limbs: int, joints: int, runs: int) -> dict[str, dict[str, float]]:
    """Nanoseconds by what is done and by whom."""
    text = urdf(limbs, joints)
    random = np.random.default_rng(1)
    names = [joint.name for joint in Robot.from_text(text).free_joints]
    angles = dict(zip(names, random.uniform(-3, 3, len(names)).tolist(), strict=True))
    many = {name: random.uniform(-3, 3, MANY) for name in names}
    peers = {}
    for who, make in PEERS.items():
        try:
            peers[who] = make(text, angles, many)
        except ImportError as error:
            print(f"left out: {who}: {error}", file=sys.stderr)
    found: dict[str, dict[str, list[float]]] = {}
    for _ in range(runs):
        for who, peer in peers.items():
            print(f"  {who}, {limbs} limbs", file=sys.stderr, flush=True)
            for what, work, times in (
                ("read the URDF", peer.load, 1.0),
                ("where all links are", peer.one, 1.0),
                (f"where all links are in {MANY:,} configurations", peer.many, peer.many_times),
            ):
                found.setdefault(what, {}).setdefault(who, []).append(times * cpu_ns(work))
    return {what: {who: median(times) for who, times in by.items()} for what, by in found.items()}


def table(results: Mapping[str, Mapping[str, Mapping[str, float]]]) -> Table:
    """A row for each robot and what is done with it."""
    peers = [who for who in PEERS if who != "tfbus"]
    rows = []
    for robot, done in results.items():
        for what, by in done.items():
            row = [robot, what, amount(by["tfbus"])]
            for who in peers:
                ratio = f"{by[who] / by['tfbus']:.1f} x" if who in by else "-"
                row += [amount(by.get(who)), ratio]
            rows.append(row)
    headings = [each for who in peers for each in (who, f"over {who}")]
    return Table(["robot", "what", "tfbus", *headings], rows, words=2)


def main() -> None:
    """Measure, and print the part."""
    parser = argparse.ArgumentParser(prog="benchmarks.robots", description=__doc__)
    parser.add_argument("--runs", type=int, default=5, help="of which the median counts (5)")
    parser.add_argument("--write", action="store_true", help="write the pages about speed")
    arguments = parser.parse_args()
    place = machine.describe()
    results = {robot: measure(*size, arguments.runs) for robot, size in ROBOTS.items()}
    arm, humanoid = (f"{limbs * joints} joints" for limbs, joints in ROBOTS.values())
    part = Part(
        place,
        {"peers": table(results)},
        {who: _version(who) for who in PEERS},
        {
            "runs": str(arguments.runs),
            "arm": arm,
            "humanoid": humanoid,
            "looped": str(LOOPED),
        },
    )
    part.show()
    if arguments.write:
        part.keep("robots")


def _version(package: str) -> str:
    try:
        if package == "tfbus":
            return f"{installed_version()}, {'compiled' if COMPILED else 'interpreted'}"
        return version(package)
    except PackageNotFoundError:
        return "(not installed)"


if __name__ == "__main__":
    main()
