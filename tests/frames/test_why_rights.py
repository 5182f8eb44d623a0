"""`explain` if rights on a closed bus are the reason."""

from tfbus.buffer.buffer import Buffer
from tfbus.frames.moment import BusMoment
from tfbus.frames.snapshot import FrameTree
from tfbus.frames.why import explain
from tfbus.streams.info import StreamInfo


def remedies(*streams: StreamInfo, reads_only: str = "") -> tuple[str, ...]:
    """The remedies of a lookup of a frame that is not there."""
    tree = FrameTree({}, {each.name: each for each in streams}, 0)
    return explain(
        BusMoment(at_ns=0, tree=tree), Buffer(), "world", "hand", reads_only=reads_only
    ).remedies


def test_frames_that_a_stream_may_not_have_are_named_as_the_reason() -> None:
    """A stream whose transforms were refused by rights is the first thing to look at."""
    first, *_ = remedies(StreamInfo("arm", node="/arm", host="h", alive=True, forbidden=3))
    assert "sent 3 transforms" in first and "its identity may not" in first
    assert not [each for each in remedies(StreamInfo("arm")) if "identity" in each]


def test_an_identity_of_a_namespace_is_told_what_it_reads() -> None:
    """A frame of another namespace cannot be seen by an identity that reads only its own."""
    first, *_ = remedies(reads_only="robot7")
    assert "only the namespace 'robot7'" in first
