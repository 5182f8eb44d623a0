"""The cost of a fleet to a listener: python -m benchmarks.fleet --robots 100

A hub, a router for each 25 robots connected to it, and robots of 50 frames, 20 of them static,
each with its namespace and session, several to a process. CPU time counts, since the machine may be
shared.
"""

import argparse
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from benchmarks import machine
from benchmarks.bus.fleet import JOIN_WITHIN_S, SECONDS, SETTLE_S, Joined, memory_mb
from benchmarks.bus.place import Place, Process, free_port, place
from benchmarks.parts import Table

A_SITE = 25
SOME = 20
_TICKS = os.sysconf("SC_CLK_TCK")


def measure(robots: int, hz: float) -> Table:
    """The rows of one fleet."""
    with place() as at, ExitStack() as stack:
        hub = f"tcp/127.0.0.1:{free_port()}"
        router = stack.enter_context(_router(at, hub, ""))
        sites, senders = [], []
        for first in range(0, robots, A_SITE):
            site = f"tcp/127.0.0.1:{free_port()}"
            sites.append(stack.enter_context(_router(at, site, hub)))
            env = _client(at, site)
            count = min(A_SITE, robots - first)
            sender = Process(at, "fleet:publish", env, first=first, count=count, hz=hz)
            senders.append(stack.enter_context(sender))
        for sender in senders:
            sender.hear()
        time.sleep(SETTLE_S)
        alone = _share(senders, robots)
        some = _listen(at, hub, robots, min(SOME, robots), "needed")
        every = _listen(at, hub, robots, robots, "everything")
        rows = [
            ["a robot that no one reads", "", "", f"{100 * alone:.2f} %", _mb(senders, robots)],
            _row(f"a listener of {some.wanted} robots", some),
            _row("a listener of all", every),
            ["the hub", "", "", "", _mb([router], 1)],
            ["a site's router", "", "", "", _mb(sites, len(sites))],
        ]
    return Table(["process", "joined after", "for CPU of", "CPU after", "MB"], rows)


def _listen(at: Place, hub: str, robots: int, wanted: int, reads: str) -> Joined:
    env = _client(at, hub)
    with Process(at, "fleet:listen", env, robots=robots, wanted=wanted, reads=reads) as listener:
        return Joined(**listener.hear())


def _row(name: str, joined: Joined) -> list[str]:
    late = f"{joined.read} of {joined.wanted} in {JOIN_WITHIN_S:.0f} s"
    return [
        name,
        late if joined.join_s is None else f"{joined.join_s:.2f} s",
        f"{joined.join_cpu_s:.2f} s",
        f"{joined.cpu_percent:.1f} %",
        f"{joined.memory_mb:.0f}",
    ]


def _client(at: Place, router: str) -> dict[str, str]:
    return {**at.env, "TFBUS_MODE": "client", "TFBUS_CONNECT": router}


@contextmanager
def _router(at: Place, listen: str, connect: str) -> Iterator[Process]:
    env = {**at.env, "TFBUS_MODE": "router", "TFBUS_LISTEN": listen, "TFBUS_CONNECT": connect}
    with Process(at, "interest:route", env) as router:
        router.hear()
        yield router


def _share(processes: list[Process], robots: int) -> float:
    """The CPU of a robot as a share of a core."""
    before_s, began_s = sum(_cpu_s(each.pid) for each in processes), time.monotonic()
    time.sleep(SECONDS)
    used_s = sum(_cpu_s(each.pid) for each in processes) - before_s
    return used_s / (time.monotonic() - began_s) / robots


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def _mb(processes: list[Process], parts: int) -> str:
    return f"{sum(memory_mb(each.pid) for each in processes) / parts:.1f}"


def main() -> None:
    """Measure one fleet, and print its table."""
    parser = argparse.ArgumentParser(prog="benchmarks.fleet", description=__doc__)
    parser.add_argument("--robots", type=int, default=100, help="how many; 100")
    parser.add_argument("--hz", type=float, default=10.0, help="messages of each a second; 10")
    given = parser.parse_args()
    place_of_it = machine.describe()
    table = measure(given.robots, given.hz)
    print(f"{given.robots} robots at {given.hz:g} Hz. {place_of_it}\n\n{table.as_markdown()}")
    print(f"\nLoad at the end: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
