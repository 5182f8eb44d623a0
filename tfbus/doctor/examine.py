"""Looks at a bus: gathers all that the checks need, once or again and again."""

import math
from collections.abc import Callable, Generator
from dataclasses import replace

from tfbus.buffer.buffer import Buffer
from tfbus.bus.settings import NodeSettings
from tfbus.discover.out_of_reach import bus_out_of_reach
from tfbus.doctor.examination import Examination
from tfbus.doctor.host import RosWatch, examine_host
from tfbus.errors import DecodeError
from tfbus.frames.command_listener import Listening, answers_of_nodes, wait_for_clock
from tfbus.listen.listener import TransformListener
from tfbus.monitor.meter import TransformMeter
from tfbus.node.node import Node
from tfbus.runtime import scheduler
from tfbus.runtime.clock import SYSTEM_CLOCK
from tfbus.wire.fleet import Fleet

# What publishers keep shows the rates before.
_HISTORY_S = 10.0


def examine(
    settings: NodeSettings,
    listen_s: float,
    on_unreadable: Callable[[DecodeError], object],
    fleet: Fleet | None = None,
) -> Generator[Examination]:
    """Look at this host and, for `listen_s` seconds, at the transforms of its namespace or fleet;
    then for as long again, and so on, if a further examination is asked for: it counts from where
    the one before has ended.

    Raises BusError if the bus cannot be joined, TimeoutException if simulated time is used and no
    clock runs.
    """
    quiet = replace(settings, log_level="error")
    with RosWatch(settings) as ros, Node(settings=quiet, patience_s=0.0) as node:
        wait_for_clock(node)
        node.session.settle()
        # Before we subscribe: a listener that nodes report is not ours.
        answers = answers_of_nodes(node.session, on_unreadable)
        out_of_reach = "" if answers.nodes else bus_out_of_reach(node.session)
        host = examine_host(settings, len(node.session.routers()))
        buffer, before = Buffer(_HISTORY_S), None
        with TransformListener(buffer, node, history_s=_HISTORY_S, fleet=fleet) as listener:
            heard = Listening(node, buffer, listener, fleet)
            while True:
                # Rates are compared with those by the stamps.
                meter = TransformMeter(node, fleet, recent_s=math.inf, clock=node.clock)
                listened_s = _listen(node, listen_s)
                if before is not None:
                    answers = answers_of_nodes(node.session, on_unreadable)
                heard.note(answers)
                now = heard.moment()
                yield Examination(
                    settings,
                    now if before is None else now.since(before),
                    tuple(meter.edges()),
                    listened_s,
                    host,
                    ros.around(node.session),
                    dict(meter.largest),
                    "" if now.nodes else out_of_reach,
                )
                meter.close()
                before = now
    raise KeyboardInterrupt  # the node's `with` swallowed it


def _listen(node: Node, listen_s: float) -> float:
    start_s = scheduler.monotonic()
    if not node.wait(listen_s, clock=SYSTEM_CLOCK):
        raise KeyboardInterrupt
    return scheduler.monotonic() - start_s
