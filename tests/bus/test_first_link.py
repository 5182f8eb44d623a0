"""A client that opens before its router is there."""

import json
import sys
from pathlib import Path

import pytest
import zenoh

from tests.live_bus import free_port
from tfbus.bus.first_link import open_alone

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(sys.platform != "linux", reason="needs /proc, as the first link does"),
]


def test_nobody_can_listen_where_the_first_link_was() -> None:
    """A client tries all of its endpoints for as long as it lives."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{free_port()}"]))
    with open_alone(config) as client:
        assert client.info.routers_zid() == []
        _, place = json.loads(config.get_json("connect/endpoints"))
        with pytest.raises(FileNotFoundError):
            Path(place.partition("/")[2]).touch()
