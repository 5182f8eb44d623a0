"""Streams in the place of sockets, if a test of Foxglove's server is simulated."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.foxglove.streams import Streams
from tfbus.testing.primitives import SimulatedEventLoop


@pytest.fixture(autouse=True)
def streams(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the server and its clients meet without sockets, unless the test is a real one."""
    if request.node.get_closest_marker("real"):
        return
    request.getfixturevalue("network")
    made = Streams()
    monkeypatch.setattr("tfbus.foxglove.front.listening_sockets", made.listen)
    for name in ("sock_accept", "connect_accepted_socket", "create_connection"):
        method = getattr(made, name)
        monkeypatch.setattr(SimulatedEventLoop, name, _as_method(method), raising=False)


def _as_method(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda loop, *args, **named: function(loop, *args, **named)
