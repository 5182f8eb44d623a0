"""The end of a subscription, which is the same on each leg to ROS."""

import logging
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import patch

import pytest

from tests import needs
from tests.buses import send_until
from tests.ros.bridge.dds_domain import claim_domain
from tfbus.base.log import LogOnce
from tfbus.ros.bridge.legs import Endable, LegSettings, OnMessage, RosTopic
from tfbus.ros.bridge.legs.rospy import RospySubscription
from tfbus.ros.bridge.legs.zenoh import ZenohSubscription
from tfbus.ros.definitions import STRING

CHATTER = RosTopic("/chatter", STRING)
LOG = logging.getLogger("leg")

# "hi" as ROS 2 has it, and as ROS 1.
HI, HI_OF_ROS1 = b"\x00\x01\x00\x00\x03\x00\x00\x00hi\x00", b"\x02\x00\x00\x00hi"

Subscribe = Callable[[OnMessage], Endable]
# Subscriptions of a leg, and a call by which a message comes to all of them.
Subscriptions = tuple[Subscribe, Callable[[], None]]


@contextmanager
def on_zenoh() -> Iterator[Subscriptions]:
    """Subscriptions of the leg by rmw_zenoh's wire."""
    made: list[ZenohSubscription] = []

    def subscribe(on_message: OnMessage) -> ZenohSubscription:
        made.append(ZenohSubscription(on_message))
        return made[-1]

    yield subscribe, lambda: [each.call(b"", "") for each in made] and None


@contextmanager
def on_rospy() -> Iterator[Subscriptions]:
    """Subscriptions of the leg to ROS 1, with a rospy in memory."""

    def nothing(*_: object) -> None:
        pass

    leg: Any = SimpleNamespace(began=nothing, ended=nothing, heard=nothing)
    message = SimpleNamespace(_connection_header={"callerid": "/talker"}, payload=HI_OF_ROS1)
    made: list[Callable[[object], None]] = []

    def subscriber(name: str, data_class: type, callback: Any, **_: object) -> Any:
        made.append(callback)
        return SimpleNamespace(unregister=lambda: None)

    rospy = SimpleNamespace(Subscriber=subscriber)

    def subscribe(on_message: OnMessage) -> RospySubscription:
        return RospySubscription(leg, rospy, CHATTER, on_message, "/own", LogOnce(LOG))

    with patch.dict(sys.modules, genpy=cast(Any, SimpleNamespace(Message=object))):
        yield subscribe, lambda: [each(message) for each in made] and None


@contextmanager
def on_dds() -> Iterator[Subscriptions]:
    """Subscriptions of one of two legs over DDS."""
    needs.module("cyclonedds")
    from tfbus.ros.bridge.legs import dds

    with ExitStack() as opened:
        domain, claim = claim_domain()
        opened.enter_context(claim)
        one, two = (
            dds.open_leg(LegSettings(name, domain=domain, connect=("lo",)), LOG)
            for name in ("one", "two")
        )
        opened.callback(one.close)
        opened.callback(two.close)
        sender = two.publisher(CHATTER)
        yield lambda on_message: one.subscribe(CHATTER, on_message), lambda: sender.send(HI)


@pytest.mark.parametrize(
    "opening", [on_zenoh, on_rospy, pytest.param(on_dds, marks=pytest.mark.real)]
)
def test_no_call_goes_on_after_its_subscription_is_closed(opening: Any) -> None:
    """Closing it waits for the call, unless the call itself closes it."""
    closed, calls = threading.Event(), list[str]()

    def close() -> None:
        subscription.close()
        closed.set()

    def hear(*_: object) -> None:
        threading.Thread(target=close, daemon=True).start()
        calls.append("closed early" if closed.wait(0.2) else "heard")

    def end(*_: object) -> None:
        itself.close()
        calls.append("ended")

    with opening() as (subscribe, send):
        subscription, itself = subscribe(hear), subscribe(end)
        # More than one is heard where closing begins late.
        send_until(send, lambda: closed.is_set() and "ended" in calls)
        before = list(calls)
        send()
        subscription.close()
        itself.close()
        assert calls == before
        assert set(calls) == {"ended", "heard"} and calls.count("ended") == 1
