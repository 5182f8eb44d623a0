"""The items of a recording: values, of which a file of a stranger may have any."""

from typing import Any

import pytest

from tfbus.recording.items import EventItem


@pytest.mark.parametrize(
    ("messages", "dropped"), [(7, 7), ("7", 0), ([], 0), ({}, 0), (None, 0), (float("inf"), 0)]
)
def test_only_a_count_is_a_count(messages: Any, dropped: int) -> None:
    """Where a file says nonsense, no message is known to have been dropped."""
    assert EventItem(0, "dropped", "", {"messages": messages}).dropped == dropped
    assert EventItem(0, "resumed", "", {"messages": messages}).dropped == 0
