"""A declaration of a queryable that a link loses for good, as in eclipse-zenoh/zenoh#2516."""

import pytest

import tfbus
from tfbus.broadcast.stream import Stream
from tfbus.testing import Network


def _frames_known(network: Network, lost: int) -> list[str]:
    """The frames that a listener knows 10 s after the declaration of this number was lost."""
    network.host("h1"), network.host("h2")
    declared = 0

    def loses_declaration() -> bool:
        nonlocal declared
        declared += 1
        return declared == lost

    with network.process("h2", "listener"):
        listening = tfbus.Node("listener")
    with network.process("h1", "sim"):
        node = tfbus.Node("sim")
        network.run(1.0)
        network._fabric.loses_declaration = loses_declaration  # type: ignore[method-assign]
        here = tfbus.Transform((1.0, 0.0, 0.0))
        tfbus.StaticTransformBroadcaster(node).send_transform(
            tfbus.TransformStamped(node.now_ns(), "world", "fixed", here)
        )
        dynamic = tfbus.TransformBroadcaster(node)
        dynamic.send_transform(tfbus.TransformStamped(node.now_ns(), "world", "robot", here))
    network.run(5.0)
    with network.process("h2", "listener"):
        listener = tfbus.TransformListener(tfbus.Buffer(), listening, history_s=0.0)
        network.run(10.0)
        (info,) = listener.streams()
    return sorted(child for _, child, _ in info.frames) + sorted(listener.buffer.frames())


@pytest.mark.parametrize("lost", range(1, 7))
def test_a_late_listener_learns_a_stream_whichever_declaration_is_lost(
    network: Network, lost: int
) -> None:
    """It knows what the stream lists, and has its static transforms."""
    assert _frames_known(network, lost) == ["fixed", "robot", "fixed", "world"]


def test_a_publisher_of_an_earlier_version_answers_with_its_statics(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its answer to a query for the description is ignored, and is no reason to reject anything."""

    def answer(stream: Stream, query: object) -> None:
        query.answer(stream._static_key, stream._static_payload)  # type: ignore[attr-defined]
        query.close()  # type: ignore[attr-defined]

    monkeypatch.setattr(Stream, "_on_static_query", answer)
    assert _frames_known(network, 0) == ["fixed", "robot", "fixed", "world"]
