"""The cost of a fleet, and what it takes to follow one: python -m benchmarks.fleet --robots 100

A hub, a router for each 25 robots, whose hub it is (tfbus router --hub), and robots of 50 frames,
20 of them static, each with its namespace and session, several to a process. CPU time counts, since
the machine may be shared. With --write the rows go into docs/guide/scaling.md.
"""

import argparse
import json
import os
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks import machine
from benchmarks.bus.air import HEADERS
from benchmarks.bus.fleet import SECONDS, SETTLE_S, WITHIN_S, Awaited, Joined, memory_mb
from benchmarks.bus.place import ROOT, Place, Process, free_port, place
from benchmarks.parts import Table

A_SITE = 25
SOME = 20
# After this silence a link is lost, as tfbus sets it.
LEASE_S = 1.5
PAGE = ROOT / "docs" / "guide" / "scaling.md"
_TICKS = os.sysconf("SC_CLK_TCK")

COSTS = (
    "robots (Hz)",
    "a robot",
    "it sends, receives",
    f"listener of {SOME} (`needed`)",
    "listener of all",
    "hub, site router",
    "load",
)
CHANGES = (
    "robots (Hz)",
    "new robot",
    "silent robot",
    "hub is back",
    "router of 25 is back",
    "joined afterwards",
)


class Fleet:
    """A fleet whose processes end with `stack`."""

    def __init__(self, at: Place, stack: ExitStack, robots: int, hz: float, lease_s: float) -> None:
        self._at, self._stack, self.robots, self._hz = at, stack, robots, hz
        self._lease_s = lease_s
        self.hub_at = f"tcp/127.0.0.1:{free_port()}"
        self.hub = self._open(self.hub_at, "")
        self.sites: list[Process] = []
        self._sites_at: list[str] = []
        self.senders: list[Process] = []
        for first in range(0, robots, A_SITE):
            self._sites_at.append(f"tcp/127.0.0.1:{free_port()}")
            self.sites.append(self._open(self._sites_at[-1], self.hub_at))
            self.senders.append(self.publish(first, min(A_SITE, robots - first)))
            # All at once they would leave the routers no CPU, and lose their links.
            self.senders[-1].hear()

    def _open(self, listen: str, hub: str) -> Process:
        """A hub, or the router of a site, which others take for silent after the lease."""
        config = self._at.folder / "router.json5"
        lease = f"transport: {{link: {{tx: {{lease: {self._lease_s * 1e3:.0f}}}}}}}"
        config.write_text(Path(self._at.env["TFBUS_CONFIG"]).read_text()[:-1] + f", {lease}}}")
        env = {
            **self._at.env,
            "TFBUS_CONFIG": str(config),
            "TFBUS_MODE": "client" if hub else "router",
            "TFBUS_LISTEN": listen,
            "TFBUS_CONNECT": hub,
        }
        router = self._stack.enter_context(Process(self._at, "interest:route", env))
        router.hear()
        return router

    def publish(self, first: int, count: int) -> Process:
        """A process of robots at the last site."""
        env = _client(self._at, self._sites_at[-1])
        sender = Process(self._at, "fleet:publish", env, first=first, count=count, hz=self._hz)
        return self._stack.enter_context(sender)

    def listen(self, wanted: int, reads: str) -> tuple[Process, Joined]:
        """A listener at the hub, and how it joined."""
        env = _client(self._at, self.hub_at)
        given: dict[str, Any] = {"robots": self.robots, "wanted": wanted, "reads": reads}
        process = self._stack.enter_context(Process(self._at, "fleet:listen", env, **given))
        return process, Joined(**process.hear())

    def restart_hub(self) -> None:
        """Kill the hub, and start it again."""
        self.hub.kill()
        self.hub = self._open(self.hub_at, "")

    def restart_site(self) -> None:
        """Kill the router of the first site, and start it again."""
        self.sites[0].kill()
        self.sites[0] = self._open(self._sites_at[0], self.hub_at)


def measure(robots: int, hz: float, lease_s: float = LEASE_S) -> tuple[Table, Table]:
    """The row of one fleet: what it costs, and how soon its changes are known."""
    with place() as at, ExitStack() as stack:
        fleet = Fleet(at, stack, robots, hz, lease_s)
        time.sleep(SETTLE_S)
        name = f"{robots:,} ({hz:g}{'' if lease_s == LEASE_S else f'; {lease_s:g} s'})"
        alone = _alone(fleet)
        some, joined_some = fleet.listen(min(SOME, robots), "needed")
        every, joined_every = fleet.listen(robots, "everything")
        costs = [
            name,
            *alone,
            _joined(joined_some),
            _joined(joined_every),
            f"{_mb([fleet.hub])}, {_mb(fleet.sites)} MB",
            f"{os.getloadavg()[0]:.0f}",
        ]
        changes = [name, *_changes(fleet, [some, every])]
        _, late = fleet.listen(robots, "everything")
        changes.append(f"{late.read} of {robots}")
    return Table(COSTS, [costs]), Table(CHANGES, [changes])


def _alone(fleet: Fleet) -> tuple[str, str]:
    """The CPU, memory and traffic of a robot while no one reads it."""
    cpu_s, began_s = sum(map(_cpu_s, fleet.senders)), time.monotonic()
    counted = _counts(fleet.senders)
    time.sleep(SECONDS)
    passed_s = (time.monotonic() - began_s) * fleet.robots
    share = (sum(map(_cpu_s, fleet.senders)) - cpu_s) / passed_s
    more = [now - then for now, then in zip(_counts(fleet.senders), counted, strict=True)]
    out, back = ((more[way] + HEADERS * more[way + 2]) / passed_s for way in (0, 1))
    memory = sum(memory_mb(each.pid) for each in fleet.senders) / fleet.robots
    return f"{100 * share:.2f} %, {memory:.1f} MB", f"{out:.0f}, {back:.0f} B/s"


def _counts(senders: Sequence[Process]) -> list[int]:
    for sender in senders:
        sender.tell()
    return [sum(parts) for parts in zip(*(sender.hear() for sender in senders), strict=True)]


def _joined(joined: Joined) -> str:
    after = f"{joined.read} of {joined.wanted} in {WITHIN_S:.0f} s"
    if joined.join_s is not None:
        after = f"{joined.join_s:.2f} s"
    cost = f"{joined.cpu_percent:.1f} %, {joined.memory_mb:.0f} MB"
    return f"{after} ({joined.join_cpu_s:.2f} s), {cost}"


def _changes(fleet: Fleet, listeners: Sequence[Process]) -> Iterator[str]:
    """How soon all listeners know of each change."""
    new = fleet.publish(fleet.robots, 1)
    names = [f"robot{fleet.robots}"]
    yield _known(listeners, Awaited(names), since_s=new.hear())
    new.signal(signal.SIGSTOP)
    yield _known(listeners, Awaited(names, gone=True))
    new.kill()
    for restart, count in ((fleet.restart_hub, fleet.robots), (fleet.restart_site, A_SITE)):
        restart()
        names = [f"robot{number}" for number in range(min(count, fleet.robots))]
        yield _known(listeners, Awaited(names, since_ns=time.time_ns()))


def _known(listeners: Sequence[Process], awaited: Awaited, since_s: float | None = None) -> str:
    since_s = time.monotonic() if since_s is None else since_s
    for listener in listeners:
        listener.tell(json.dumps(asdict(awaited)))
    answers = [listener.hear() for listener in listeners]
    at_s, left = max(at_s for at_s, _ in answers), max(left for _, left in answers)
    if left:
        return f"{len(awaited.robots) - left} in {WITHIN_S:.0f} s"
    return f"{max(0.0, at_s - since_s):.1f} s"


def _client(at: Place, router: str) -> dict[str, str]:
    return {**at.env, "TFBUS_MODE": "client", "TFBUS_CONNECT": router}


def _cpu_s(process: Process) -> float:
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def _mb(processes: Sequence[Process]) -> str:
    return f"{sum(memory_mb(each.pid) for each in processes) / len(processes):.0f}"


def write(text: str, table: Table) -> str:
    """The text of a page with the rows of a table in that of the same headings, in the order of
    their first numbers, and in place of those with the same first cell.
    """
    lines, heading = text.splitlines(), table.as_markdown().splitlines()[0]
    begin = lines.index(heading) + 2
    end = next(at for at in range(begin, len(lines) + 1) if lines[at : at + 1] in ([], [""]))
    rows = {_fleet_of(line): line for line in lines[begin:end]}
    rows |= {_fleet_of(line): line for line in table.as_markdown().splitlines()[2:]}
    lines[begin:end] = [rows[each] for each in sorted(rows)]
    return "\n".join(lines) + "\n"


def _fleet_of(row: str) -> tuple[int, str]:
    """The number of robots in the first cell, and the cell."""
    cell = row.split("|")[1].strip()
    return int(cell.partition(" ")[0].replace(",", "")), cell


def main() -> None:
    """Measure one fleet, and print its tables."""
    parser = argparse.ArgumentParser(prog="benchmarks.fleet", description=__doc__)
    parser.add_argument("--robots", type=int, default=100, help="how many; 100")
    parser.add_argument("--hz", type=float, default=10.0, help="messages of each a second; 10")
    parser.add_argument("--lease", type=float, default=LEASE_S, help="of routers, in s; 1.5")
    parser.add_argument("--write", action="store_true", help=f"write the rows into {PAGE.name}")
    given = parser.parse_args()
    print(f"{given.robots} robots at {given.hz:g} Hz. {machine.describe()}")
    for table in measure(given.robots, given.hz, given.lease):
        print(f"\n{table.as_markdown()}")
        if given.write:
            PAGE.write_text(write(PAGE.read_text(), table))


if __name__ == "__main__":
    main()
