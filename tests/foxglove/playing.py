"""A recording that is served, and a client that watches its transforms."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from tests.buses import DEADLINE_S
from tests.foxglove.client import Client
from tfbus.foxglove.playback import PlaybackBridge


@contextmanager
def watching_transforms(bridge: PlaybackBridge) -> Iterator[Client]:
    """A client that watches all transforms of a bridge."""
    player = threading.Thread(target=bridge.run, daemon=True)
    player.start()
    try:
        with Client(bridge.front.port) as client:
            client.subscribe("/tf")
            client.subscribe("/tf_static")
            yield client
    finally:
        bridge.stop()
        player.join(DEADLINE_S)
        bridge.close()
