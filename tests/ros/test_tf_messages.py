"""Many messages of transforms at once: the rows that each has when it is read by itself."""

import pytest

from tests.builders import at
from tfbus.geometry.columns import Columns
from tfbus.ros.tf_message import TFMessageReader, TFMessageWriter, equal_parts, read_many

EMPTY = TFMessageWriter().write(Columns.of_transforms([]))
TWO = TFMessageWriter().write(Columns.of_transforms([at(1.0, "drone"), at(2.0, "laser")]))


@pytest.mark.parametrize("messages", [[EMPTY] * 9, [TWO] * 9, [EMPTY, TWO] * 9])
def test_each_message_has_its_own_rows(messages: list[bytes]) -> None:
    """Also where many have none, as the static set of a stream that has taken all back."""
    reader = TFMessageReader()
    found: dict[int, list[object]] = {}
    for members, rows in read_many(reader, messages):
        for index, part in zip(members, equal_parts(rows, len(members)), strict=True):
            found[index] = list(part)
    assert found == {index: list(reader.read(data)) for index, data in enumerate(messages)}
