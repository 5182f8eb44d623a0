"""A bad link between two hosts: two TUN devices, and a process that passes packets between them.

The process is this file: it is given the network namespaces and the addresses of both ends, and
reads lines of JSON with new conditions. It answers each with its counts, and ends with its input.
"""

import fcntl
import heapq
import itertools
import json
import os
import random
import select
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

# From Linux's <linux/if_tun.h>.
_TUNSETIFF = 0x400454CA
_TUN_WITHOUT_HEADER = 0x0001 | 0x1000

_LARGEST = 65536
MTU = 1500

# The name of the device on each host.
INTERFACE = "radio0"


@dataclass(frozen=True)
class Conditions:
    """The conditions of one direction of a link.

    A packet takes `delay_s`, up to `jitter_s` more or less, and overtakes none. `loss` is the share
    of packets that are lost, on average `burst` in a row (1: each by itself). `bytes_a_second` is
    the bandwidth (0: without bound); a packet that would wait for longer than `queue_s` for it is
    dropped. With `is_up` false nothing arrives.
    """

    delay_s: float = 0.0
    jitter_s: float = 0.0
    loss: float = 0.0
    burst: float = 1.0
    bytes_a_second: float = 0.0
    queue_s: float = 1.0
    is_up: bool = True


@dataclass
class Counts:
    """Packets that were sent into one direction, their bytes, and how many did not arrive."""

    packets: int = 0
    bytes: int = 0
    lost: int = 0


@dataclass
class Way:
    """One direction: it says when each packet arrives. `chance()` is a random number below 1."""

    chance: Callable[[], float]
    conditions: Conditions = Conditions()
    counts: Counts = field(default_factory=Counts)
    _is_losing: bool = False
    _free_s: float = 0.0
    _last_s: float = 0.0

    def arrival_s(self, size: int, now_s: float) -> float | None:
        """When a packet of `size` bytes that is sent now arrives; None if it never does."""
        self.counts.packets += 1
        self.counts.bytes += size
        arrival_s = self._arrival_s(size, now_s)
        self.counts.lost += arrival_s is None
        return arrival_s

    def _arrival_s(self, size: int, now_s: float) -> float | None:
        at = self.conditions
        if not at.is_up:
            return None
        left_s = max(now_s, self._free_s) if at.bytes_a_second else now_s
        if left_s - now_s > at.queue_s:
            return None
        if at.bytes_a_second:
            left_s = self._free_s = left_s + size / at.bytes_a_second
        # Lost on the air: it has taken its part of the bandwidth.
        if self._loses():
            return None
        jitter_s = at.jitter_s * (2.0 * self.chance() - 1.0)
        self._last_s = max(self._last_s, left_s + max(at.delay_s + jitter_s, 0.0))
        return self._last_s

    def _loses(self) -> bool:
        """Whether the next packet is lost: a chain of two states, after Gilbert."""
        at = self.conditions
        if not 0.0 < at.loss < 1.0:
            return at.loss >= 1.0
        burst = max(at.burst, 1.0 / (1.0 - at.loss))
        stays = 1.0 - 1.0 / burst
        begins = at.loss / (burst * (1.0 - at.loss))
        self._is_losing = self.chance() < (stays if self._is_losing else begins)
        return self._is_losing


class LossyLink:
    """The link between two network namespaces, until `close()`.

    `addresses` are those of the two ends, in one network of 24 bits.
    """

    def __init__(self, spaces: tuple[str, str], addresses: tuple[str, str], *, seed: int = 1):
        self._conditions = [Conditions(), Conditions()]
        command = [sys.executable, str(Path(__file__)), str(seed), *spaces, *addresses]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.counts()

    def set(self, there: Conditions, back: Conditions | None = None) -> None:
        """Set the conditions from the first end to the second, and those of the way back if these
        are others.
        """
        self._conditions = [there, there if back is None else back]
        self.counts()

    def counts(self) -> tuple[Counts, Counts]:
        """What went from the first end to the second so far, and what went back."""
        assert self._process.stdin is not None and self._process.stdout is not None
        conditions = [asdict(each) for each in self._conditions]
        self._process.stdin.write(json.dumps(conditions) + "\n")
        self._process.stdin.flush()
        there, back = json.loads(self._process.stdout.readline() or "[{}, {}]")
        return Counts(**there), Counts(**back)

    def close(self) -> None:
        """End it. Twice is fine."""
        if self._process.poll() is None:
            self._process.communicate()


def _open_end(space: str, address: str) -> int:
    """A TUN device of this address, in a network namespace; its file."""
    end = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    # Until it is in its namespace its name is among those of the machine.
    name = f"tf{os.getpid()}"
    fcntl.ioctl(end, _TUNSETIFF, struct.pack("16sH", name.encode(), _TUN_WITHOUT_HEADER))
    _ip("link", "set", name, "netns", space, "name", INTERFACE)
    _ip("-n", space, "addr", "add", f"{address}/24", "dev", INTERFACE)
    _ip("-n", space, "link", "set", INTERFACE, "mtu", str(MTU), "multicast", "on", "up")
    return end


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, timeout=10)


def _pass_packets(ends: Sequence[int], ways: Sequence[Way]) -> None:
    """Pass packets until the input ends."""
    due: list[tuple[float, int, int, bytes]] = []
    numbers = itertools.count()
    lines = sys.stdin.fileno()
    poll = select.poll()
    for file in (*ends, lines):
        poll.register(file, select.POLLIN | select.POLLHUP)
    text = b""
    while True:
        left_s = due[0][0] - time.monotonic() if due else 1.0
        ready = poll.poll(max(0.0, left_s * 1e3))
        now_s = time.monotonic()
        for file, _ in ready:
            if file == lines:
                read = os.read(lines, _LARGEST)
                if not read:
                    return
                *complete, text = (text + read).split(b"\n")
                for line in complete:
                    for way, conditions in zip(ways, json.loads(line), strict=True):
                        way.conditions = Conditions(**conditions)
                    print(json.dumps([asdict(way.counts) for way in ways]), flush=True)
                continue
            side = ends.index(file)
            with suppress(BlockingIOError):
                while True:
                    packet = os.read(file, _LARGEST)
                    # What the interface itself asks of its neighbours, as IPv6 does.
                    if packet[0] >> 4 != 4:
                        continue
                    arrival_s = ways[side].arrival_s(len(packet), now_s)
                    if arrival_s is not None:
                        heapq.heappush(due, (arrival_s, next(numbers), 1 - side, packet))
        now_s = time.monotonic()
        while due and due[0][0] <= now_s:
            _, _, side, packet = heapq.heappop(due)
            with suppress(OSError):  # that host's interface is down
                os.write(ends[side], packet)


def _main(seed: int, spaces: Sequence[str], addresses: Sequence[str]) -> None:
    with suppress(OSError):  # a busy machine should not make it worse than it is told to be
        os.nice(-15)
    ends = [_open_end(*end) for end in zip(spaces, addresses, strict=True)]
    _pass_packets(ends, [Way(random.Random(seed + side).random) for side in range(2)])


if __name__ == "__main__":
    _main(int(sys.argv[1]), sys.argv[2:4], sys.argv[4:6])
