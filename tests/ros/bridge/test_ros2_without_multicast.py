"""The leg over DDS on a network that carries no multicast, as some Wi-Fi."""

import pytest

from tests import needs
from tests.ros.bridge.ros2_network import DISTROS, Ros2Network

REASON = needs.why_no_hosts()
pytestmark = [
    pytest.mark.real,  # nodes of ROS 2
    pytest.mark.skipif(bool(REASON), reason=REASON or "-"),
]

TF, TF_STATIC = "/tf", "/tf_static"


@pytest.mark.parametrize("distro", DISTROS)
def test_a_host_is_asked_where_multicast_does_not_reach(distro: str) -> None:
    """With the address of a host of ROS both have each other's frames without multicast."""
    network = Ros2Network("dds", distro)
    try:
        network.hosts.set_multicast("desk", on=False)
        leg = network.start_leg("leg_dynamic", "leg_static", network.hosts.address["robot"])
        node = network.start_node("node", "--tf", "node_dynamic", "--static", "node_static")
        leg.wait_for(TF, "node_dynamic")
        leg.wait_for(TF_STATIC, "node_static")
        node.wait_for(TF, "leg_dynamic")
        node.wait_for(TF_STATIC, "leg_static")
    finally:
        network.close()
