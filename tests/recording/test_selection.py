"""Which part of a bus or of a recording is meant."""

from tfbus.recording.selection import Selection


def test_the_topic_tf_stands_for_transforms() -> None:
    """`tf` takes all streams, `robot7/tf` those of a namespace, and neither is a topic itself."""
    assert Selection(topics=("tf",)).takes_stream("sim")
    assert Selection(topics=("pose", "tf_static")).takes_stream("robot7/sim")
    of_robot7 = Selection(topics=("robot7/tf",))
    assert of_robot7.takes_stream("robot7/sim") and not of_robot7.takes_stream("robot8/sim")
    assert not Selection(topics=("pose",)).takes_stream("sim")
    assert not Selection(topics=("tf",), exclude="sim").takes_stream("sim")


def test_some_topics_are_always_taken() -> None:
    """Whatever else is chosen or excluded, and only their own messages."""
    some = Selection(topics=("tf",), exclude="clock", always=("clock",))
    assert some.takes_topic("clock") and not some.takes_topic("pose")
    assert some.takes_stream("sim") and not some.takes_stream("clock")
