"""Ten topics of small numbered messages, 50 a second on each: their sender, or their counter.

python numbered_topics.py send|count

The counter counts 500 messages of each topic from the first one that comes, and then prints a line
of JSON: the share of them that the network has lost, and the ages of the others (p50, p99, in s).
"""

import json
import sys
import threading
import time
from dataclasses import dataclass
from functools import partial

from tfbus import Node

TOPICS = 10
PERIOD_S = 0.02
COUNTED = 500


@dataclass
class Numbered:
    """One message of about 100 bytes."""

    number: int
    stamp_ns: int
    rest: str = "-" * 60


def send() -> None:
    """Send until a signal."""
    with Node("sender") as node:
        publishers = [node.create_publisher(Numbered, f"topic{at}") for at in range(TOPICS)]
        number = 0
        due_s = time.monotonic()
        while node.wait(max(0.0, due_s - time.monotonic())):
            for publisher in publishers:
                publisher.publish(Numbered(number, time.time_ns()))
            number += 1
            due_s += PERIOD_S


def count() -> None:
    """Count, print, and wait for a signal."""
    firsts: dict[str, int] = {}
    ages: dict[str, list[float]] = {f"topic{at}": [] for at in range(TOPICS)}
    ended: set[str] = set()
    is_done = threading.Event()

    def take(topic: str, message: Numbered) -> None:
        first = firsts.setdefault(topic, message.number)
        if message.number < first + COUNTED:
            ages[topic].append((time.time_ns() - message.stamp_ns) / 1e9)
        else:
            ended.add(topic)
            if len(ended) == TOPICS:
                is_done.set()

    with Node("counter") as node:
        subscriptions = [
            node.create_subscription(Numbered, topic, partial(take, topic)) for topic in ages
        ]
        while not is_done.is_set() and node.wait(0.1):
            pass
        every = sorted(age for each in ages.values() for age in each)
        p50, p99 = (every[int(part * len(every))] for part in (0.5, 0.99))
        # What a busy process was too late for has arrived.
        arrived = len(every) + sum(each.dropped for each in subscriptions)
        told = {"lost": 1.0 - arrived / (TOPICS * COUNTED), "p50_s": p50, "p99_s": p99}
        print(json.dumps(told), flush=True)
        while node.wait(1.0):
            pass


if __name__ == "__main__":
    {"send": send, "count": count}[sys.argv[1]]()
