"""What is in force: what a new file, or a replay from the middle, begins with."""

from tests.builders import S, in_recording, moved
from tfbus.recording.items import EventItem
from tfbus.recording.state import MOST_GONE, BusState


def test_streams_that_are_long_gone_are_no_longer_in_force() -> None:
    """Of thousands that came and went the last thousand are, with their static transforms."""
    state = BusState()
    for number in range(3 * MOST_GONE):
        state.take(EventItem(number, "stream", f"s{number}", {"epoch": 1}))
        state.take(EventItem(number, "stream gone", f"s{number}"))
    assert [item.name for item in state.gone.values()] == [
        f"s{number}" for number in range(2 * MOST_GONE, 3 * MOST_GONE)
    ]
    assert state.streams.keys() == state.gone.keys()


def test_the_end_of_a_node_is_said_once() -> None:
    """Until it is there again."""
    state = BusState()
    gone, there = EventItem(1, "node gone", "/sim"), EventItem(0, "node", "/sim", {"host": "a"})
    state.take(there)
    assert not state.says(gone)
    state.take(gone)
    assert state.says(gone)
    state.take(there)
    assert not state.says(gone)


def test_a_stream_that_is_there_stays_in_force() -> None:
    """However many others go."""
    state = BusState()
    laser = in_recording(0, [moved(S, "base", "laser", 1)], static=True)
    state.take(EventItem(0, "stream", laser.stream.name, {"epoch": 1}))
    state.take(laser)
    for number in range(2 * MOST_GONE):
        state.take(EventItem(number, "stream gone", f"s{number}"))
    assert laser.stream.name in state.streams
    assert state.statics == {laser.stream.name: laser}
