"""ROS's Zenoh router, as `rmw_zenohd` runs it: on loopback, without multicast."""

import json
from typing import Any

import zenoh

from tests.live_bus import free_port


class RosRouter:
    """A router that can go and come back at its endpoint."""

    def __init__(self) -> None:
        self.port = free_port()
        self.endpoint = f"tcp/127.0.0.1:{self.port}"
        self._session: Any = None

    def start(self) -> None:
        """Begin to route."""
        values = {
            "mode": "router",
            "listen/endpoints": [self.endpoint],
            "scouting/multicast/enabled": False,
            # Tests on a busy machine must not lose links.
            "transport/link/tx/lease": 60_000,
        }
        config = zenoh.Config()
        for key, value in values.items():
            config.insert_json5(key, json.dumps(value))
        self._session = zenoh.open(config)

    def stop(self) -> None:
        """End it; twice is fine."""
        session, self._session = self._session, None
        if session is not None:
            session.close()
