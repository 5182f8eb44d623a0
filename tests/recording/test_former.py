"""The last item before a moment."""

from pathlib import Path

import pytest

from tests.recordings import at, publisher, sent, write
from tfbus.recording.former import last_item
from tfbus.recording.items import TransformItem
from tfbus.recording.reader import RecordingReader

pytest.importorskip("mcap")


def test_the_last_item_before_a_moment_is_found_however_far_back(tmp_path: Path) -> None:
    """Both ends are included, items that are not wanted are passed over; None where there is
    none.
    """
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
