"""The messages that a stream keeps: as far back as was asked for, and no removed frame."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.builders import S
from tests.fakes import Clock
from tfbus import Transform, TransformBatch, TransformStamped
from tfbus.streams.retained import SentHistory, without_removed
from tfbus.wire.transforms import TransformMessage, decode_transforms, encode_transforms


@settings(deadline=None)
@given(
    # Of up to three seconds; large numbers would be drawn small, as hardly any pause at all.
    st.lists(st.integers(0, 30).map(lambda tenths: tenths * S // 10), max_size=20),
    st.integers(0, 8).map(float),
    st.integers(0, 12).map(float) | st.just(float("inf")),
)
def test_what_was_sent_in_the_last_seconds_is_kept(
    pauses_ns: list[int], history_s: float, last_s: float
) -> None:
    """Asked for the last seconds, exactly those messages come that were sent in them, oldest
    first, as far back as the history goes.
    """
    clock = Clock()
    kept = SentHistory(history_s, clock_ns=clock)
    sent: list[tuple[int, bytes]] = []
    for number, pause_ns in enumerate(pauses_ns):
        clock.now_ns += pause_ns
        sent.append((clock.now_ns, b"%d" % number))
        kept.append("tf/sim", sent[-1][1])
    clock.now_ns += S // 2
    window_ns = min(last_s, history_s) * S
    assert kept.last(last_s) == [
        ("tf/sim", payload) for sent_ns, payload in sent if sent_ns >= clock.now_ns - window_ns
    ]


def test_what_is_kept_is_bounded() -> None:
    """However much is sent, what is kept stays within its bytes: the oldest goes first."""
    kept = SentHistory(10.0, most_bytes=3000, clock_ns=Clock())
    for number in range(100):
        kept.append("tf/sim", b"%2d" % number * 250)
    assert [payload[:2] for _, payload in kept.last(10.0)] == [b"96", b"97", b"98", b"99"]
    kept.append("tf/sim", bytes(4000))
    assert kept.last(10.0) == []


@given(st.lists(st.tuples(st.booleans(), st.sets(st.sampled_from("abc"), min_size=1))))
def test_nothing_is_kept_of_a_removed_frame(
    steps: list[tuple[bool, set[str]]],
) -> None:
    """Of each frame comes back what was sent since it was last removed, and nothing else."""
    kept = SentHistory(10.0, clock_ns=Clock())
    expected: dict[str, list[int]] = {}
    for number, (is_sent, children) in enumerate(steps):
        for child in children if not is_sent else ():
            kept.remove(child)
            expected.pop(child, None)
        if is_sent:
            batch = TransformBatch.from_transforms(
                TransformStamped(number, "world", child, Transform()) for child in sorted(children)
            )
            kept.append("tf/sim", encode_transforms(TransformMessage(batch, 1, number)))
            for child in children:
                expected.setdefault(child, []).append(number)
    found: dict[str, list[int]] = {}
    for key, payload in without_removed(kept.last(10.0)):
        assert key == "tf/sim"
        for ts in decode_transforms(payload).batch:
            found.setdefault(ts.child_frame_id, []).append(ts.stamp_ns)
    assert found == expected


@pytest.mark.parametrize("numbers", ["", "1", "x.9", "1.x", "-1.9", "1.9.9"])
def test_a_place_that_none_has_named_is_none(numbers: str) -> None:
    """Any peer may ask for one: all of the last seconds come."""
    kept = SentHistory(10.0, clock_ns=Clock())
    kept.append("tf/sim", b"first")
    kept.append("tf/sim", b"second")
    span = kept.span(10.0)
    assert kept.span(10.0, f"{span.name}.{numbers}") == span
    assert kept.span(10.0, f"{span.name}.1.2").entries == [("tf/sim", b"second")]
