"""Publishers whose token is lost, and that go on to send."""

import pytest

from tests.buses import eventually, keep_sending, tell_token
from tests.simulated_bus import Bus
from tfbus import Buffer, Transform, TransformBroadcaster, TransformListener, TransformStamped
from tfbus.base import scheduler
from tfbus.base.executor import Executor


def test_a_publisher_that_sends_is_not_gone_without_its_token(
    bus: Bus, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stream whose token is lost is back once its messages have gone on for a while."""
    publisher, buffer = bus.node("sim"), Buffer()
    keep_sending(publisher, "world", "robot")
    node = bus.node("listener")
    with TransformListener(buffer, node) as listener:
        eventually(lambda: [each.name for each in listener.streams() if each.alive] == ["sim"])
        eventually(lambda: "robot" in buffer.frames())
        # Half a link: the token ends here alone.
        tell_token(node, alive=False)
        eventually(lambda: buffer.frame("robot").gone)
        eventually(lambda: not buffer.frame("robot").gone)
        assert [each.name for each in listener.streams() if each.alive] == ["sim"]
        # And it is gone for good once it no longer sends; the log says it once.
        publisher.close()
        eventually(lambda: buffer.frame("robot").gone)
    said = " ".join(capsys.readouterr().err.split())
    assert said.count("is gone; its last transforms stay, marked as gone: 'robot'") == 1


def test_messages_under_way_bring_no_publisher_back(bus: Bus) -> None:
    """What comes within two seconds of the end of a token may be the last of a process that was
    killed.
    """
    buffer, changes = Buffer(), list[tuple[str, float]]()
    buffer.on_change(lambda change: changes.append((change.kind, scheduler.monotonic())))
    keep_sending(bus.node("sim"), "world", "robot")
    node = bus.node("listener")
    with TransformListener(buffer, node) as listener:
        eventually(lambda: [each.alive for each in listener.streams()] == [True])
        eventually(lambda: "robot" in buffer.frames())
        changes.clear()
        tell_token(node, alive=False)
        eventually(lambda: len(changes) == 2)
    (gone, gone_s), (back, back_s) = changes
    assert (gone, back) == ("publisher gone", "publisher back")
    assert back_s - gone_s > 2.0


def test_a_publisher_whose_token_is_back_is_no_longer_looked_at(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its token says when it is gone: it may be silent."""
    looks: list[float] = []
    publisher, buffer = bus.node("sim"), Buffer()
    sending = keep_sending(publisher, "world", "robot")
    node = bus.node("listener")
    with TransformListener(buffer, node) as listener:
        eventually(lambda: [each.alive for each in listener.streams()] == [True])
        eventually(lambda: "robot" in buffer.frames())
        tell_token(node, alive=False)
        eventually(lambda: buffer.frame("robot").gone)
        eventually(lambda: not buffer.frame("robot").gone)
        tell_token(node, alive=True)
        bus.network.run(1.0)
        sending.cancel()
        bus.network.run(20.0)
        assert not buffer.frame("robot").gone
        monkeypatch.setattr(Executor, "after", lambda self, delay_s, call: looks.append(delay_s))
        bus.network.run(20.0)
        assert looks == []


def test_a_publisher_that_is_gone_costs_no_wake_ups(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stream that is gone and silent is not looked at again and again."""
    looks: list[float] = []
    publisher, buffer = bus.node("sim"), Buffer()
    keep_sending(publisher, "world", "robot")
    with TransformListener(buffer, bus.node("listener")):
        eventually(lambda: "robot" in buffer.frames())
        monkeypatch.setattr(Executor, "after", lambda self, delay_s, call: looks.append(delay_s))
        publisher.close()
        eventually(lambda: buffer.frame("robot").gone)
    assert looks == []


def test_a_publisher_without_a_token_is_gone_once_it_is_silent(bus: Bus) -> None:
    """A stream that was back for its messages alone is gone after the last of them."""
    publisher, buffer = bus.node("sim"), Buffer()
    broadcaster = TransformBroadcaster(publisher)

    def send() -> None:
        pose = Transform.identity()
        broadcaster.send_transform(TransformStamped(publisher.now_ns(), "world", "robot", pose))

    sending = publisher.create_timer(0.05, send)
    node = bus.node("listener")
    with TransformListener(buffer, node) as listener:
        eventually(lambda: "robot" in buffer.frames())
        eventually(lambda: [each.alive for each in listener.streams()] == [True])
        tell_token(node, alive=False)
        eventually(lambda: buffer.frame("robot").gone)
        eventually(lambda: not buffer.frame("robot").gone)
        # Its token does not end here, as it was not there.
        sending.cancel()
        eventually(lambda: buffer.frame("robot").gone)
