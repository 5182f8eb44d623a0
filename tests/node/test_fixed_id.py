"""Two processes with one Zenoh id: the second is refused before it takes the first one's place."""

from pathlib import Path

import pytest

from tests.live_bus import Bus
from tfbus import BusError

_ID = "abcd0123"


def test_a_node_with_the_zenoh_id_of_another_is_refused(bus: Bus, tmp_path: Path) -> None:
    """The error names the file, the other node and the remedy; the first node stays."""
    config = tmp_path / "id.json5"
    config.write_text(bus.quick_config.read_text().replace("{", f"{{id: '{_ID}', ", 1))
    first = bus.node("first", config=str(config))
    assert first.session.id == _ID
    with pytest.raises(BusError, match=r"'/first' on .* remove 'id' from the file"):
        bus.node("second", config=str(config))
    first.close()
    assert bus.node("third", config=str(config)).session.id == _ID
