"""What the legs say of publishers in ROS that they cannot hear."""

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
    assert unheard(TF, TYPE, [offer("", reliable=False)] * 2) == [
        "a node without a name publishes /tf as best effort, and it is read as reliable: such "
        "messages do not come"
    ]
    assert unheard(TF_STATIC, TYPE, [offer("/a"), offer("/b"), offer("/a")]) == [
        "/a, /b publish /tf_static as volatile, and it is read as transient local: such messages "
        "do not come"
    ]


def test_another_type_is_said_with_the_own_one() -> None:
    """Once for each node."""
    assert unheard(TF, TYPE, [offer("/a", "std_msgs/msg/String")] * 2) == [
        "/a publishes /tf as std_msgs/msg/String, not tf2_msgs/msg/TFMessage"
    ]
