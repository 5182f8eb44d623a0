"""Links of a simulated network, routers, and the messages that pass them."""

import random

import pytest

from tests.simulation.actor import Actor
from tfbus.testing import Network, Process
from tfbus.testing.links import LinkLane, LinkPath

# Linux 6 between two hosts with a delay of 20 ms, 15 s each: the median and the 90th percentile of
# the times in which 100 bytes arrived, by the share of lost packets and messages a second.
MEASURED_S = {
    (0.05, 10): (0.020, 0.088),
    (0.05, 100): (0.021, 0.064),
    (0.2, 10): (0.062, 0.861),
    (0.2, 100): (0.060, 0.136),
}


@pytest.mark.parametrize(("loss", "rate_hz"), MEASURED_S)
def test_lost_packets_delay_as_by_linux(network: Network, loss: float, rate_hz: int) -> None:
    """Half and nine in ten of the messages arrive about as late as was measured, each in order."""
    lane = LinkLane(network.tasks, LinkPath(0.02, 0.0, loss))
    sent_ns: list[int] = []
    late_s: list[float] = []

    def arrive() -> None:
        late_s.append((network.tasks.now_ns - sent_ns[len(late_s)]) / 1e9)

    for _ in range(2000):
        sent_ns.append(network.tasks.now_ns)
        lane.send(arrive)
        network.run(1 / rate_hz)
    network.run(60.0)
    assert len(late_s) == 2000
    late_s.sort()
    for found_s, measured_s in zip(
        (late_s[1000], late_s[1800]), MEASURED_S[loss, rate_hz], strict=True
    ):
        assert measured_s / 3 < found_s < 3 * measured_s


_PORT = 7447


class Mesh:
    """Routers on hosts of their own, each with a client; some of them have links to each other.

    Some of those with one link are routers of a site, to which the other one is a hub.
    """

    def __init__(self, network: Network, draw: random.Random) -> None:
        self.network, self._draw = network, draw
        count = draw.randint(2, 5)
        self._hosts = [f"h{number}" for number in range(count)]
        # A tree, and perhaps more links.
        self._links = {
            number: {draw.randrange(number)} | {n for n in range(number) if draw.random() < 0.3}
            for number in range(1, count)
        }
        linked = [other for links in self._links.values() for other in links]
        self._sites = {
            number
            for number, links in self._links.items()
            if len(links) == 1 and number not in linked and draw.random() < 0.5
        }
        self._routers: dict[int, Process] = {}
        self._actors: dict[int, tuple[Process, Actor]] = {}
        for host in self._hosts:
            network.host(host)
        for number in range(count):
            self._start_router(number)
        for number in range(count):
            self._start_client(number)

    def _start_router(self, number: int) -> None:
        peers = [f"tcp/{self._hosts[other]}:{_PORT}" for other in self._links.get(number, ())]
        mode = "client" if number in self._sites else "router"
        options = {"mode": mode, "listen": f"tcp/[::]:{_PORT}", "connect": peers}
        with self.network.process(self._hosts[number], "router") as process:
            Actor(f"r{number}", options)
        self._routers[number] = process

    def _start_client(self, number: int) -> None:
        host = self._hosts[number]
        with self.network.process(host, "client") as process:
            actor = Actor(f"c{number}", {"mode": "client", "connect": f"tcp/{host}:{_PORT}"})
            actor.do("token", f"t/{number}")
            actor.do("watch", "seen", "t/*")
            actor.do("subscriber", "in", "k")
            actor.do("publisher", "k")
            actor.do("queryable", "q", f"q/{number}", "yes")
        self._actors[number] = process, actor

    def injure(self) -> None:
        """Break something."""
        network, number = self.network, self._draw.randrange(len(self._hosts))
        host, other = self._draw.sample(self._hosts, 2)
        kind = self._draw.choice(("router", "client", "partition", "cut", "stop", "roam"))
        if kind == "router":
            network.kill(self._routers[number])
            network.run(self._draw.uniform(0.0, 3.0))
            self._start_router(number)
        elif kind == "client" and not self._routers[number].is_stopped:
            network.kill(self._actors[number][0])
            network.heal()
            self._start_client(number)
        elif kind == "partition":
            network.partition(host)
        elif kind == "cut":
            network.cut(host, other, both_ways=self._draw.random() < 0.5)
        elif kind == "stop" and self._routers[number].is_running:
            network.stop(self._routers[number])
            network.run(self._draw.uniform(0.2, 3.0))
            network.go_on(self._routers[number])
        elif kind == "roam":
            network.roam(host)
        network.run(self._draw.uniform(0.0, 3.0))

    def do(self, number: int, verb: str, *args: object) -> object:
        """Let a client do something."""
        process, actor = self._actors[number]
        with self.network.within(process):
            return actor.do(verb, *args)

    def check(self) -> None:
        """All clients know all tokens, and get each message and answer once."""
        numbers = range(len(self._hosts))
        tokens = [f"t/{number}" for number in numbers]
        answers = [f"q/{number}=yes" for number in numbers]
        for number in numbers:
            assert self.do(number, "living", "t/*") == tokens
            assert self.do(number, "ask", "q/*") == answers
            assert _living_by(self.do(number, "events", "seen")) == set(tokens)
            self.do(number, "put", "k", f"last {number}")
        self.network.run(1.0)
        for number in numbers:
            events = [each for each in self.do(number, "events", "in") if "last" in each]  # type: ignore[attr-defined]
            assert sorted(events) == [f"k=last {each}" for each in numbers]


def _living_by(events: object) -> set[str]:
    """The tokens whose last news are that they live."""
    living: set[str] = set()
    for event in events:  # type: ignore[attr-defined]
        (living.add if event[0] == "+" else living.discard)(event[1:])
    return living


@pytest.mark.parametrize("seed", range(25))
def test_everything_crosses_a_healed_mesh_once(seed: int) -> None:
    """Tokens, messages and answers reach all clients, by whatever way is left."""
    draw = random.Random(seed)
    with Network(seed) as network:
        mesh = Mesh(network, draw)
        for _ in range(draw.randint(0, 8)):
            mesh.injure()
        network.heal()
        network.run(15.0)
        mesh.check()
