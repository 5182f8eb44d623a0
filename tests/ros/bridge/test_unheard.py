"""The legs' warnings of publishers in ROS that they cannot hear."""

from tfbus.ros.bridge.legs import Offer, RosTopic, unheard
from tfbus.ros.definitions import TF_MESSAGE

TYPE = TF_MESSAGE.name
TF = RosTopic("/tf", TF_MESSAGE)
TF_STATIC = RosTopic("/tf_static", TF_MESSAGE, retained=True)


def offer(node: str, type_: str = TYPE, *, reliable: bool = True, retained: bool = False) -> Offer:
    return Offer(node, type_, reliable, retained)


def test_those_that_are_heard_are_not_named() -> None:
    """Volatile publishers are, where nothing of before is asked for."""
    assert unheard(TF, TYPE, [offer("/a"), offer("/b", retained=True)]) == []
    assert unheard(TF_STATIC, TYPE, [offer("/b", retained=True)]) == []


def test_nodes_are_named_once_and_with_their_verb() -> None:
    """In one sentence for each reason; several publishers may have no name."""
    [line] = unheard(TF, TYPE, [offer("", reliable=False)] * 2)
    assert "publishes /tf as best effort" in line and "read as reliable" in line
    [line] = unheard(TF_STATIC, TYPE, [offer("/a"), offer("/b"), offer("/a")])
    assert line.startswith("/a, /b publish /tf_static as volatile") and "transient local" in line


def test_another_type_is_said_with_the_own_one() -> None:
    """Once for each node."""
    [line] = unheard(TF, TYPE, [offer("/a", "std_msgs/msg/String")] * 2)
    assert line == f"/a publishes /tf as std_msgs/msg/String, not {TYPE}"
