"""Many publishers of static frames, and listeners that come at any time: none misses a frame."""

import logging
import sys
import time
from pathlib import Path

import pytest

from tests.live_bus import Bus, Process, eventually, free_port
from tests.processes.many_publishers import frame, stream
from tfbus import Buffer, Change, Node, TransformListener
from tfbus.bus.session import Session
from tfbus.runtime.executor import Executor
from tfbus.wire.keys import ALL_STREAMS, stream_key

SCRIPT = Path(__file__).parent / "many_publishers.py"
STREAMS = 50
STATICS = 20

# After a listener has seen that a publisher is there; it is connected with it since then.
KNOWN_WITHIN_S = 1.0
# A query that is not answered within that may be lost, and is sent again.
BARE_QUERY_S = 2.0
# Before that: on two cores the meeting of fifty processes takes seconds, with any program.
MET_WITHIN_S = 90.0


class BareQueries:
    """How long a query of each node takes, from the moment at which the node is seen.

    It goes the same way, at the same time, on the same machine as the static transforms, and
    nothing of what tfbus does with these is in it.
    """

    def __init__(self, session: Session) -> None:
        self.took_s: dict[str, float] = {}
        self._seen_s: dict[str, float] = {}
        self._session = session
        # Zenoh must not be called from its callbacks.
        self._executor = Executor("bare queries", logging.getLogger("test"))
        session.at_close(self._executor.close)
        session.watch_living("@tfbus/node/*", self._on_token)

    def _on_token(self, key: str, alive: bool) -> None:
        if alive:
            self._seen_s.setdefault(key, time.monotonic())
            self._executor.submit("query", lambda: self._ask(key))

    def _ask(self, key: str) -> None:
        def on_answer(answer: object) -> None:
            self.took_s.setdefault(key, time.monotonic() - self._seen_s[key])

        def on_end() -> None:
            if key not in self.took_s:
                self._executor.after(0.01, lambda: self._ask(key))

        self._session.ask_later(key, None, on_answer, on_end, timeout_s=BARE_QUERY_S)


def bare_key(number: int) -> str:
    """Where the node of a stream answers bare queries."""
    return f"@tfbus/node/{stream(number)}"


class Joining:
    """A listener, and when it came to know of each stream and of its frames."""

    def __init__(self, node: Node) -> None:
        self._seen_s: dict[str, float] = {}
        self._known_s: dict[str, float] = {}
        self._bare = BareQueries(node.session)
        self.buffer = Buffer()
        self.buffer.on_change(self._on_change)
        node.session.watch_living(ALL_STREAMS, self._on_token)
        TransformListener(self.buffer, node)

    def _on_token(self, key: str, alive: bool) -> None:
        if alive:
            self._seen_s.setdefault(key, time.monotonic())

    def _on_change(self, change: Change) -> None:
        if change.kind == "added":
            self._known_s.setdefault(change.frame, time.monotonic())

    def has_met_all(self) -> bool:
        """Whether it has seen that each stream is there, and each node has answered."""
        return len(self._seen_s) == STREAMS and all(
            bare_key(number) in self._bare.took_s for number in range(STREAMS)
        )

    def knows_all(self) -> bool:
        """Whether each static frame of each stream is there, where it was put."""
        if len(self._known_s) < STREAMS * STATICS + 1:  # and `world`
            return False
        return all(
            self.buffer.lookup_transform("world", frame(number, i)).transform.xyz.tolist()
            == [number, i, 0.0]
            for number in range(STREAMS)
            for i in range(STATICS)
        )

    def longest_s(self) -> float:
        """The longest time from seeing a stream to knowing all of its static frames, without what
        the machine takes of that: the time of a bare query of the same process.
        """
        return max(
            self._known_s[frame(number, i)]
            - self._seen_s[stream_key(stream(number))]
            - self._bare.took_s[bare_key(number)]
            for number in range(STREAMS)
            for i in range(STATICS)
        )


class Meeting:
    """Publishers and listeners that are peers, each linked with each, or clients of a router."""

    def __init__(self, bus: Bus, *, clients: bool) -> None:
        self._bus = bus
        self._env = {"TFBUS_CONFIG": str(bus.quick_config)}
        self._given: dict[str, object] = {}
        if clients:
            endpoint = f"tcp/127.0.0.1:{free_port()}"
            router = bus.start("router", "--listen", endpoint)
            router.wait_for_line("Routing on")
            self._env |= {"TFBUS_MODE": "client", "TFBUS_CONNECT": endpoint}
            self._given |= {"mode": "client", "connect": (endpoint,)}

    def publish(self) -> Process:
        """Fifty processes, started."""
        command = [sys.executable, str(SCRIPT), str(STREAMS), str(STATICS)]
        return self._bus.start_command(command, env=self._env)

    def join(self, name: str) -> Joining:
        """A listener that comes now."""
        return Joining(self._bus.node(name, **self._given))


def are_ready(publishers: Process, number: int) -> bool:
    """Whether this many of the publishers have joined the bus."""
    return sum("ready" in line for line in publishers.err) >= number


@pytest.mark.parametrize("clients", [False, True], ids=["peers", "clients"])
def test_all_statics_are_known_whichever_process_starts_first(bus: Bus, clients: bool) -> None:
    """A listener knows the twenty static frames of each of fifty processes within a second of
    being connected with it, and of what a bare query takes; it may come before, amid or after
    them.
    """
    meeting = Meeting(bus, clients=clients)
    listeners = [meeting.join("before")]
    publishers = meeting.publish()
    for name, number in (("amid", STREAMS // 2), ("after", STREAMS)):
        eventually(lambda number=number: are_ready(publishers, number), within_s=MET_WITHIN_S)
        listeners.append(meeting.join(name))
    for listener in listeners:
        eventually(listener.has_met_all, within_s=MET_WITHIN_S)
        eventually(listener.knows_all, within_s=KNOWN_WITHIN_S + MET_WITHIN_S)
        assert listener.longest_s() < KNOWN_WITHIN_S
