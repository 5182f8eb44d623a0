"""Hosts with faults: the faults, their ends, and the promises that hold after that."""

import json
import random
import sys
import time
from collections.abc import Callable
from pathlib import Path
from signal import SIGCONT, SIGSTOP
from typing import Any

from tests.buses import eventually
from tests.hosts.fault_publisher import STATICS, dynamic_frame, static_frame
from tests.hosts.network import Hosts
from tests.live_bus import Bus, Process

ROUTER_HOST = "hub"
# Those of the desk are clients of the router; the others find each other, and it, by scouting.
CLIENTS = "desk"
PUBLISHERS = {"arm": "robot", "base": "robot", "crane": "dock", "drone": "desk"}
WITNESSES = {"witness_robot": "robot", "witness_dock": "dock", "witness_desk": "desk"}
LINKS = ("robot", "dock", "desk", ROUTER_HOST)

FRESH_S = 1.0
MOST_GROWTH_KB = 30_000

_HERE = Path(__file__).parent


class InjuredHosts:
    """Publishers, witnesses and a router on four hosts, and what was done to them."""

    def __init__(self, bus: Bus, seed: int):
        self._bus = bus
        self._random = random.Random(seed)
        self._hosts = Hosts("robot", "dock", "desk", ROUTER_HOST)
        self._router: Process | None = None
        self._processes: dict[str, Process] = {}
        self._links_down: set[str] = set()
        self._half_down: dict[str, Callable[[str], None]] = {}
        self._stopped: set[str] = set()
        self.history: list[str] = []
        self._start_router()
        for name in (*PUBLISHERS, *WITNESSES):
            self._start(name)

    def close(self) -> None:
        """Take the network down; the bus ends the processes."""
        self._hosts.close()

    # What is there

    def living(self, names: dict[str, str]) -> list[str]:
        """The names whose process was not killed."""
        return sorted(name for name in names if name in self._processes)

    def report(self, witness: str) -> dict[str, Any]:
        """The last line that a witness printed."""
        out = self._processes[witness].out
        report: dict[str, Any] = json.loads(out[-1]) if out else {}
        return report

    def died(self) -> list[str]:
        """Processes that ended without having been killed, with their last lines."""
        router = {} if self._router is None else {"router": self._router}
        return [
            f"{name}: {process.err[-5:]}"
            for name, process in (self._processes | router).items()
            if process.popen.poll() is not None
        ]

    # What is done to it

    def injure(self) -> None:
        """Break one to four things, one after the other."""
        faults: tuple[Callable[[], None], ...] = (
            self._kill_publisher,
            self._kill_witness,
            self._kill_router,
            self._cut_link,
            self._cut_half_a_link,
            self._restart,
            self._renumber,
            self._replace_interface,
            self._stop,
        )
        for _ in range(self._random.randint(1, 4)):
            self._random.choice(faults)()
            pause_s = self._random.uniform(0.2, 2.5)
            self.history.append(f"  wait {pause_s:.1f} s")
            time.sleep(pause_s)  # a fault lasts, and the next comes in the midst of its healing

    def heal(self) -> None:
        """Restore the links, start the router and the witnesses, and most of the publishers."""
        self.history.append("heal")
        for host in sorted(self._links_down):
            self._hosts.set_link(host, up=True)
        self._links_down.clear()
        for host, heal in self._half_down.items():
            heal(host)
        self._half_down.clear()
        for name in self._stopped & self._processes.keys():
            self._processes[name].signal(SIGCONT)
        self._stopped.clear()
        if self._router is None:
            self._start_router()
        for name in (*PUBLISHERS, *WITNESSES):
            if name not in self._processes and (name in WITNESSES or self._random.random() < 0.7):
                self._start(name)

    def _kill_publisher(self) -> None:
        self._kill(PUBLISHERS)

    def _kill_witness(self) -> None:
        self._kill(WITNESSES)

    def _kill(self, names: dict[str, str]) -> None:
        if living := self.living(names):
            name = self._random.choice(living)
            self.history.append(f"  kill {name}")
            self._processes.pop(name).kill()

    def _kill_router(self) -> None:
        if self._router is not None:
            self.history.append("  kill the router")
            self._router.kill()
            self._router = None

    def _cut_link(self) -> None:
        host = self._random.choice(LINKS)
        self.history.append(f"  cut {host} off")
        self._hosts.set_link(host, up=False)
        self._links_down.add(host)

    def _cut_half_a_link(self) -> None:
        host = self._random.choice(LINKS)
        if host in self._half_down:
            return
        if self._random.random() < 0.5:
            self.history.append(f"  make {host} deaf")
            self._hosts.set_deaf(host, deaf=True)
            self._half_down[host] = lambda host: self._hosts.set_deaf(host, deaf=False)
        else:
            self.history.append(f"  make {host} mute")
            self._hosts.set_mute(host, mute=True)
            self._half_down[host] = lambda host: self._hosts.set_mute(host, mute=False)

    def _restart(self) -> None:
        """One that begins while other things are broken."""
        if living := self.living(PUBLISHERS | WITNESSES):
            name = self._random.choice(living)
            self.history.append(f"  restart {name}")
            self._processes.pop(name).kill()
            self._stopped.discard(name)
            self._start(name)

    def _renumber(self) -> None:
        # The router's address is the one that its clients know.
        host = self._random.choice([each for each in LINKS if each != ROUTER_HOST])
        taken = set(self._hosts.address.values())
        free = [each for at in range(20, 250) if (each := f"10.99.0.{at}") not in taken]
        address = self._random.choice(free)
        self.history.append(f"  give {host} the address {address}")
        self._hosts.set_network(host, address)

    def _replace_interface(self) -> None:
        host = self._random.choice(LINKS)
        if host not in self._links_down and host not in self._half_down:
            self.history.append(f"  replace the interface of {host}")
            self._hosts.replace_interface(host)

    def _stop(self) -> None:
        if living := self.living(PUBLISHERS | WITNESSES):
            name = self._random.choice(living)
            self.history.append(f"  stop {name}")
            self._processes[name].signal(SIGSTOP)
            self._stopped.add(name)

    def _start_router(self) -> None:
        command = [sys.executable, "-m", "tfbus", "router"]
        self._router = self._start_on(ROUTER_HOST, command)
        self._router.wait_for_line("Routing on")

    def _start(self, name: str) -> None:
        self.history.append(f"  start {name}")
        program = "fault_publisher.py" if name in PUBLISHERS else "fault_witness.py"
        host = (PUBLISHERS | WITNESSES)[name]
        self._processes[name] = self._start_on(host, [sys.executable, str(_HERE / program), name])

    def _start_on(self, host: str, command: list[str]) -> Process:
        env = {"TFBUS_CONFIG": "", "TFBUS_CONNECT": ""}
        if host == CLIENTS:
            router = f"tcp/{self._hosts.address[ROUTER_HOST]}:7447"
            env |= {"TFBUS_MODE": "client", "TFBUS_CONNECT": router}
        return self._bus.start_command(self._hosts.command(host, *command), env=env)

    # What must hold

    def wrongs(self, witness: str) -> list[str]:
        """What a witness does not know, or knows wrongly; [] where all is well."""
        report = self.report(witness)
        if not report:
            return ["it has said nothing yet"]
        living = self.living(PUBLISHERS)
        wrong = []
        if report["alive"] != living:
            wrong.append(f"streams {report['alive']}, but {living} live")
        for name in living:
            wrong += _wrongs_of_frames(report["frames"], name)
        of_living = {
            frame
            for name in living
            for frame in (dynamic_frame(name), *(static_frame(name, i) for i in range(STATICS)))
        }
        wrong += [
            f"{frame} is there although its publisher is not"
            for frame, known in report["frames"].items()
            if frame not in of_living and not known["gone"]
        ]
        return wrong


def _wrongs_of_frames(frames: dict[str, Any], publisher: str) -> list[str]:
    wrong = []
    dynamic = frames.get(dynamic_frame(publisher), {})
    if dynamic.get("gone", True) or not dynamic.get("age_s", FRESH_S) < FRESH_S:
        wrong.append(f"{dynamic_frame(publisher)} is {dynamic or 'not known'}")
    for number in range(STATICS):
        static = frames.get(static_frame(publisher, number))
        if static != {"gone": False, "static": True, "x": float(number)}:
            wrong.append(f"{static_frame(publisher, number)} is {static or 'not known'}")
    return wrong


def wait_until_well(world: InjuredHosts) -> float:
    """Wait until every witness knows all that lives and nothing else; the time in s, or what is
    wrong, if it lasts.
    """
    began_s = time.monotonic()

    def is_well() -> bool:
        return not any(world.wrongs(witness) for witness in WITNESSES)

    try:
        eventually(is_well)
        return time.monotonic() - began_s
    except AssertionError:
        wrongs = {witness: world.wrongs(witness) for witness in WITNESSES}
        history = "\n".join(world.history)
        raise AssertionError(
            f"not well: {json.dumps(wrongs, indent=2)}\nafter:\n{history}"
        ) from None
