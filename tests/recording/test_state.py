"""The state in force, with which a new file, or a replay from the middle, begins."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.builders import S, in_recording, moved
from tests.recordings import at, described, publisher, sent, statics, write
from tfbus.recording.items import ALL, EventItem, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.state import MOST_FORMER, MOST_GONE, BusState, items_of_state, last_item


def test_streams_that_are_long_gone_are_no_longer_in_force() -> None:
    """Of thousands that came and went the last thousand are, with their static transforms."""
    state = BusState()
    for number in range(3 * MOST_GONE):
        state.apply(EventItem(number, "stream", f"s{number}", {"epoch": 1}))
        state.apply(EventItem(number, "stream gone", f"s{number}"))
    assert [item.name for item in state.gone.values()] == [
        f"s{number}" for number in range(2 * MOST_GONE, 3 * MOST_GONE)
    ]
    assert state.streams.keys() == state.gone.keys()


def test_the_end_of_a_node_is_said_once() -> None:
    """Until it is there again."""
    state = BusState()
    gone, there = EventItem(1, "node gone", "/sim"), EventItem(0, "node", "/sim", {"host": "a"})
    state.apply(there)
    assert not state.says(gone)
    state.apply(gone)
    assert state.says(gone)
    state.apply(there)
    assert not state.says(gone)


def test_a_stream_that_is_there_stays_in_force() -> None:
    """However many others go."""
    state = BusState()
    laser = in_recording(0, [moved(S, "base", "laser", 1)], static=True)
    state.apply(EventItem(0, "stream", laser.stream.name, {"epoch": 1}))
    state.apply(laser)
    for number in range(2 * MOST_GONE):
        state.apply(EventItem(number, "stream gone", f"s{number}"))
    assert laser.stream.name in state.streams
    assert state.statics == [laser]


def test_a_restarted_stream_keeps_the_static_frames_that_it_does_not_set_again() -> None:
    """With their epoch, as at a listener; a set of the former process that comes late is none."""
    state = BusState()
    first = publisher("model")
    again = replace(first, epoch_ns=at(1.0))
    left, right = ("base", "left", 1.0), ("base", "right", 1.0)
    state.apply(described(first, 0.0, ("base", "left", True), ("base", "right", True)))
    state.apply(statics(first, 0.0, left, right))
    state.apply(described(again, 2.0, ("base", "right", True)))
    state.apply(statics(again, 2.0, right))
    former, own = state.statics
    assert (former.stream, former.rows.children()) == (first, {"left"})
    assert (own.stream, own.rows.children()) == (again, {"right"})
    state.apply(statics(first, 3.0, left, right, seq=1))
    assert state.statics == [former, own]


def restarted(count: int) -> BusState:
    """The state after a publisher was started `count` times, each time with another frame."""
    state = BusState()
    for number in range(count):
        stream = replace(publisher("model"), epoch_ns=at(float(number)))
        state.apply(described(stream, number, ("base", f"f{number}", True)))
        state.apply(statics(stream, number, ("base", f"f{number}", 1.0)))
    return state


def test_what_restarts_leave_is_bounded() -> None:
    """Of thousands of restarts with other frames the last ones are in force."""
    state = restarted(3 * MOST_FORMER)
    assert [item.rows.frames[1] for item in state.statics] == [
        f"f{number}" for number in range(2 * MOST_FORMER - 1, 3 * MOST_FORMER)
    ]


def test_a_publisher_whose_clock_is_behind_has_the_last_of_all_epochs() -> None:
    """A listener that hears of all sets at once takes none of before for the present one."""
    state = restarted(3)
    stream = replace(publisher("model"), epoch_ns=at(1.5))
    state.apply(EventItem(at(4.0), "stream gone", "model"))
    state.apply(described(stream, 5.0, ("base", "last", True)))
    state.apply(statics(stream, 5.0, ("base", "last", 1.0)))
    assert [item.rows.frames[1] for item in state.statics] == ["f0", "f1", "f2", "last"]
    epochs = [item.stream.epoch_ns for item in state.statics]
    assert epochs == sorted(epochs) and epochs[-1] == at(1.5)


def test_a_repetition_says_what_is_left_of_a_former_epoch() -> None:
    """A file that goes on after a gap says it: what went in the gap is not there."""
    state = BusState()
    first = publisher("model")
    again = replace(first, epoch_ns=at(1.0))
    left, right = ("base", "left", 1.0), ("base", "right", 1.0)
    state.apply(statics(first, 0.0, left, right))
    state.apply(described(again, 2.0))
    state.apply(statics(again, 2.0))
    state.apply(statics(first, 9.0, left))
    assert [item.rows.children() for item in state.statics] == [{"left"}, frozenset()]


def test_the_last_item_before_a_moment_is_found_however_far_back(tmp_path: Path) -> None:
    """Both ends are included, items that are not wanted are passed over; None where there is
    none.
    """
    pytest.importorskip("mcap")
    sim, drone = publisher("sim"), publisher("drone")
    items = [sent(drone, 0.0, ("world", "drone", 1.0), stamp_ns=at(0.0))]
    items += [sent(sim, s / 10, ("world", "sim", 1.0), stamp_ns=at(s / 10)) for s in range(300)]
    items.sort(key=lambda item: item.log_ns)

    def is_drone(item: object) -> bool:
        return isinstance(item, TransformItem) and item.stream.name == "drone"

    with RecordingReader(write(tmp_path / "run.mcap", items)) as reader:
        found = [
            last_item(reader, at(0.0), at(12.34)),
            last_item(reader, at(0.0), at(29.0), is_wanted=is_drone),
            last_item(reader, at(0.05), at(29.0), is_wanted=is_drone),
        ]
    assert [None if item is None else item.log_ns for item in found] == [at(12.3), at(0.0), None]


@pytest.mark.parametrize("frames", [5, "sim", [5], [["world"]], [["world", ["sim"], 3]]])
def test_a_list_of_frames_that_cannot_be_read_leaves_the_transforms(
    tmp_path: Path, frames: object
) -> None:
    """Facts of a file may be anything."""
    pytest.importorskip("mcap")
    item = sent(publisher("sim"), 0.0, ("world", "sim", 1.0), stamp_ns=at(0.0))
    facts = {"epoch": item.stream.epoch_ns, "frames": frames}
    later = [EventItem(at(seconds), "stream", "sim", facts) for seconds in (0.1, 1.0)]
    with RecordingReader(write(tmp_path / "run.mcap", [item, *later])) as reader:
        found = items_of_state(reader, at(1.0), ALL, (), at(1.0))
    assert [each.stream for each in found if isinstance(each, TransformItem)] == [item.stream]
