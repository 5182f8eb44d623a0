"""Waiting for the other processes: `Session.settle`."""

import logging

import tfbus
from tfbus.bus.session import Session
from tfbus.testing import Network


def test_a_given_endpoint_is_waited_for(network: Network) -> None:
    """Silence counts only once there is a link: its process may be slow to answer."""
    for host in ("robot", "desk"):
        network.host(host)
    with network.process("robot", "base"):
        tfbus.Node(settings=tfbus.NodeSettings("base", listen=("tcp/[::]:7447",)))
    network.path("robot", "desk", multicast=False)
    network.partition("robot", "desk")
    with network.process("desk", "tool"):
        settings = tfbus.NodeSettings("tool", connect=("tcp/robot:7447",))
        with Session(settings, logging.getLogger()) as session:
            assert not session.linked()
            network.heal()
            session.settle(timeout_s=10.0)
            assert session.linked()
