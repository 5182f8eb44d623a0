"""Retained publishers beside retained subscribers of the same session."""

import subprocess
import sys

import pytest

from tests.buses import DEADLINE_S, eventually
from tests.simulated_bus import Bus
from tfbus.bus.retained import declare_retained_subscriber

# While a callback runs, Zenoh holds a lock of its subscriber, and the end of a publisher waits for
# that lock. Where it holds Python's too, the whole process stands still: so it is one of its own.
_PROGRAM = """
import logging, sys, threading
from tfbus import NodeSettings
from tfbus.bus.retained import (
    declare_caching_publisher, declare_retained_publisher, declare_retained_subscriber
)
from tfbus.bus.session import Session

is_called = threading.Event()

def on_message(key, payload):
    is_called.set()
    threading.Event().wait(0.1)

settings = NodeSettings("a", config=sys.argv[1], connect=(sys.argv[2],))
with Session(settings, logging.getLogger()) as session:
    end_of = {
        "of a node": lambda: declare_retained_publisher(session, "key").close,
        "in ROS": lambda: declare_caching_publisher(session.zenoh, "key", 1).undeclare,
    }
    declare_retained_subscriber(session, "key", on_message)
    sender = declare_retained_publisher(session, "key")
    for _ in range(3):
        end = end_of[sys.argv[3]]()
        is_called.clear()
        sending = threading.Thread(target=sender.put, args=(b"x",))
        sending.start()
        is_called.wait()
        end()
        sending.join()
"""

# Publishers that end as their heartbeat comes, while callbacks of a subscriber follow each other.
# Another process beats beside them: where Python stands still its beats pile up, 100 in the 10 s
# that Zenoh waits; where the machine is busy both have few turns.
_HEARTBEAT = """
import logging, os, subprocess, sys, threading, time
from tfbus import NodeSettings
from tfbus.bus import retained
from tfbus.bus.session import Session

retained._HEARTBEAT_S = 0.01
is_ended = threading.Event()
beats = subprocess.Popen(["sh", "-c", "while sleep 0.1; do echo; done"], stdout=subprocess.PIPE)
piled_up = 0

def watch():
    global piled_up
    while not is_ended.is_set():
        piled_up = max(piled_up, len(os.read(beats.stdout.fileno(), 4096)))

def flood(sender):
    while not is_ended.is_set():
        sender.put(b"x")

settings = NodeSettings("a", config=sys.argv[1], connect=(sys.argv[2],))
with Session(settings, logging.getLogger()) as session:
    retained.declare_retained_subscriber(session, "key", lambda key, payload: sum(range(10000)))
    sender = retained.declare_retained_publisher(session, "key")
    threads = [threading.Thread(target=flood, args=(sender,)) for _ in range(2)]
    for thread in (*threads, threading.Thread(target=watch)):
        thread.start()
    for _ in range(40):
        ends = retained.declare_retained_publisher(session, "key")
        until_s = time.monotonic() + retained._HEARTBEAT_S
        while time.monotonic() < until_s:
            ends.put(b"y")
        ends.close()
        if piled_up > 50:
            break
    is_ended.set()
    for thread in threads:
        thread.join()
beats.kill()
sys.exit(f"Python stood still for {piled_up} beats" if piled_up > 50 else 0)
"""


@pytest.mark.parametrize("kind", ["of a node", "in ROS"])
@pytest.mark.real
def test_a_retained_publisher_ends_while_a_subscriber_of_its_key_is_called(
    bus: Bus, kind: str
) -> None:
    """The end waits for the callback, and the callback for Python, which the end leaves free."""
    command = [sys.executable, "-c", _PROGRAM, str(bus.quick_config), bus.endpoint, kind]
    subprocess.run(command, check=True, timeout=DEADLINE_S)


@pytest.mark.real
def test_an_end_that_meets_the_heartbeat_leaves_python_free(bus: Bus) -> None:
    """The end waits for the heartbeat, that for callbacks, and these for Python."""
    command = [sys.executable, "-c", _HEARTBEAT, str(bus.quick_config), bus.endpoint]
    subprocess.run(command, check=True, timeout=DEADLINE_S)


def test_the_end_of_a_retained_subscriber_leaves_nothing_declared(bus: Bus) -> None:
    """Zenoh's own end leaves the subscriptions by which it finds lost messages and publishers."""
    session = bus.node("a").session
    heartbeats = session.watch_heard("key/@adv/pub/1/2/_")
    subscriber = declare_retained_subscriber(session, "key", lambda key, payload: None)
    eventually(lambda: heartbeats.heard)
    subscriber.close()
    subscriber.close()
    eventually(lambda: not heartbeats.heard)
