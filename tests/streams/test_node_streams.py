"""The streams of each node."""

import threading
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.buses import DEADLINE_S
from tfbus import InvalidArgumentException, Node
from tfbus.streams import stream as stream_module
from tfbus.streams.stream import NodeStreams, stream_of_node


def node(name: str) -> Node:
    """Stands in for a node, of which streams here need only a few values."""
    unused: Any = None
    given = {"name": name, "full_name": f"/{name}", "started_ns": 1, "describers": []}
    return cast(Node, SimpleNamespace(**given, session=unused, executor=unused, log=unused))


def test_a_stream_that_begins_anew_takes_the_place_of_the_former(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """That one is closed, and its name leads to the new one."""
    closed: list[object] = []

    class Stream:
        def __init__(self, *_: object, origin: tuple[str, ...] = ()) -> None:
            self.origin = origin

        def close(self) -> None:
            closed.append(self)

    monkeypatch.setattr(stream_module, "Stream", Stream)
    robot = node("robot")
    former, streams = stream_of_node(robot), NodeStreams.of_node(robot)
    again = streams.reopen(robot, "robot", ("gid",))
    assert again.origin == ("gid",)
    assert closed == [former]
    assert stream_of_node(robot) is again
    streams.close("robot")
    assert closed == [former, again]


def test_who_is_no_node_has_no_stream() -> None:
    """A broadcaster of anything else is refused with what is right."""
    with pytest.raises(InvalidArgumentException, match=r"a Node, .* not str"):
        stream_of_node("robot")  # type: ignore[arg-type]


def test_nodes_do_not_wait_for_the_streams_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stream may take long to declare itself; a second thread of its node waits for it."""
    has_begun, may_end = threading.Event(), threading.Event()
    made: list[str] = []

    def stream(name: str, *_: object) -> object:
        if name == "slow":
            has_begun.set()
            may_end.wait(DEADLINE_S)
        made.append(name)
        return object()

    monkeypatch.setattr(stream_module, "Stream", stream)
    slow = node("slow")
    threads = [threading.Thread(target=stream_of_node, args=(slow,)) for _ in range(2)]
    for thread in threads:
        thread.start()
    assert has_begun.wait(DEADLINE_S)
    other = threading.Thread(target=stream_of_node, args=(node("other"),))
    other.start()
    other.join(DEADLINE_S)
    assert made == ["other"]
    may_end.set()
    for thread in [*threads, other]:
        thread.join(DEADLINE_S)
    assert made == ["other", "slow"]
