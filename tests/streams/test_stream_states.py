"""The states of streams, as several threads change them."""

import logging

import pytest

from tfbus.base.log import LogOnce
from tfbus.streams import stream_states
from tfbus.streams.info import StreamState
from tfbus.streams.stream_states import StreamStates
from tfbus.wire.keys import stream_key


def test_an_unreadable_description_undoes_no_change(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stream that goes while Zenoh's thread reads its description is gone."""
    log = LogOnce(logging.getLogger("test"))
    states = StreamStates(log, None, lambda state: None, lambda state: None)
    key = stream_key("sim")
    states.change(StreamState("sim", alive=True, key=key))

    def go_meanwhile(text: str) -> str:
        states.change(StreamState("sim", alive=False, key=key))
        return text

    monkeypatch.setattr(stream_states, "printable", go_meanwhile)
    assert states.read(key, b"?") is None
    state = states.known("sim")
    assert state is not None and state.unreadable and not state.alive
