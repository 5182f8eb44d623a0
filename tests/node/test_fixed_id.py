"""Two processes with one Zenoh id: the second is refused before it takes the first one's place."""

import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.buses import DEADLINE_S
from tests.simulated_bus import Bus
from tfbus import BusError, NodeSettings
from tfbus.bus.query import Answer
from tfbus.node import surroundings
from tfbus.wire.codec import encode_message
from tfbus.wire.descriptions import NodeDescription

_ID = "abcd0123"


class LateBus:
    """The session of a bus on which a node answers the third question only."""

    def __init__(self) -> None:
        self.questions = 0

    def __enter__(self) -> "LateBus":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def settle(self) -> None:
        """No link opens or closes."""

    def ask(self, key: str, *, timeout_s: float) -> Iterator[Answer]:
        """The first two questions end without an answer."""
        self.questions += 1
        if self.questions == 3:
            other = NodeDescription("/first", "pc", 7, "0.1.0", _ID, 0, (), (), {}, {}, {}, {})
            yield Answer(key, encode_message(other))


@pytest.mark.real
def test_a_node_with_the_zenoh_id_of_another_is_refused(
    bus: Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error names the file, the other node and the remedy; the first node stays."""
    config = tmp_path / "id.json5"
    config.write_text(bus.quick_config.read_text().replace("{", f"{{id: '{_ID}', ", 1))
    first = bus.node("first", config=str(config))
    assert first.session.id == _ID
    with (
        monkeypatch.context() as busy,
        pytest.raises(BusError, match=r"'/first' on .* remove 'id'"),
    ):
        busy.setattr(surroundings, "_FOUND_WITHIN_S", DEADLINE_S)  # the first may answer late
        bus.node("second", config=str(config))
    first.close()
    assert bus.node("third", config=str(config)).session.id == _ID


def test_a_node_that_is_found_late_is_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy machine the first question may reach no node."""
    config = tmp_path / "id.json5"
    config.write_text(f"{{id: '{_ID}'}}")
    late = LateBus()
    monkeypatch.setattr(surroundings, "Session", lambda *_, **__: late)
    monkeypatch.setattr(surroundings, "_AGAIN_AFTER_S", 0.0)
    monkeypatch.setattr(surroundings, "_FOUND_WITHIN_S", DEADLINE_S)
    settings = NodeSettings("second", config=str(config))
    with pytest.raises(BusError, match="'/first' on pc"):
        surroundings.check_id_is_free(settings, logging.getLogger(), 60.0)
    assert late.questions == 3
