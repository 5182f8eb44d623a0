"""Peers that have lost their link, and whom nobody else brings together again.

Zenoh calls again whom it was told to call (`--connect`), and by multicast peers find each other.
But peers that know each other by a third are introduced by it once only: where their link breaks
while both keep theirs with the third, as on a machine or a network that was too busy for a moment,
neither calls the other again.

Here the one of the two that had called the other, and so knows where it listens, looks whether it
still does, and then sends a guest: a session without anything in it, which meets all peers for a
moment. Each of them hears from the guest whom else it has met, and calls who is missing.
"""

import json
import logging
import random
import socket
import threading
import time
from contextlib import suppress
from dataclasses import replace

import zenoh

from tfbus.declaration import Declaration, direct
from tfbus.executor import Executor
from tfbus.settings import NodeSettings
from tfbus.zenoh_config import zenoh_config

# At random, so that not all peers send a guest at once: one brings together all that it meets.
_LOOK_EVERY_S = (2.0, 6.0)
# Who answers may be about to call, or to be introduced, by itself: Zenoh calls every 4 s. Two that
# are brought together while they meet have two links, which Zenoh does not always bear.
_MEETS_WITHIN_S = 5.0
# So often is looked for one that does not answer: ten minutes.
_MOST_LOOKS = 150

_ANSWERS_WITHIN_S = 0.5
_GUEST_STAYS_S = 2.0


class LostLinks:
    """Brings the peer of a session together again with those whose link is lost."""

    def __init__(self, session: zenoh.Session, settings: NodeSettings, log: logging.Logger) -> None:
        self._session = session
        self._settings = settings
        self._executor = Executor("lost links", log)
        self._closed = False
        self._linked = threading.Event()
        calls = json.loads(zenoh_config(settings).get_json("connect/endpoints"))
        self._called_by_zenoh = calls.get("peer", []) if isinstance(calls, dict) else calls
        self._listener = Declaration(
            session.info.declare_link_events_listener(direct(self._on_link))
        )

    def close(self) -> None:
        """Look for nobody any more. Twice is fine."""
        self._closed = True
        self._linked.set()
        self._listener.close()
        self._executor.close()

    def _on_link(self, event: zenoh.LinkEvent) -> None:
        if event.kind == zenoh.SampleKind.PUT:
            self._linked.set()
            return
        peer, endpoint = str(event.link.zid), str(event.link.dst)
        if endpoint not in self._called_by_zenoh:
            self._look_later(peer, endpoint, _MOST_LOOKS)

    def _look_later(self, peer: str, endpoint: str, looks: int) -> None:
        if looks:
            pause_s = random.uniform(*_LOOK_EVERY_S)
            self._executor.after(pause_s, lambda: self._look(peer, endpoint, looks - 1))

    def _look(self, peer: str, endpoint: str, looks: int) -> None:
        if self._is_linked(peer):
            return
        is_there = answers(endpoint)
        if is_there is None:
            self._look_later(peer, endpoint, looks)
        elif is_there:
            self._executor.after(
                _MEETS_WITHIN_S, lambda: self._bring_together(peer, endpoint, looks)
            )

    def _bring_together(self, peer: str, endpoint: str, looks: int) -> None:
        if not self._is_linked(peer):
            if answers(endpoint):
                self._send_guest(peer, endpoint)
            self._look_later(peer, endpoint, looks)

    def _is_linked(self, peer: str) -> bool:
        info = self._session.info
        return any(str(zid) == peer for zid in (*info.peers_zid(), *info.routers_zid()))

    def _send_guest(self, peer: str, endpoint: str) -> None:
        """Have a session meet the peer at this endpoint, and all whom it and the third know,
        until we are linked.
        """
        config = zenoh_config(replace(self._settings, namespace=""))
        calls = [endpoint, *self._called_by_zenoh]
        config.insert_json5("connect/endpoints", json.dumps(calls))
        config.insert_json5("listen/endpoints", json.dumps([]))
        # Nobody can call a guest.
        config.insert_json5("scouting/gossip/autoconnect_strategy", json.dumps("always"))
        deadline = time.monotonic() + _GUEST_STAYS_S
        with suppress(zenoh.ZError), zenoh.open(config):
            self._linked.clear()
            while not self._is_linked(peer) and self._linked.wait(deadline - time.monotonic()):
                if self._closed:
                    return
                self._linked.clear()


def answers(endpoint: str) -> bool | None:
    """Whether somebody listens at a TCP endpoint; None where it cannot be reached now."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.partition("?")[0].partition("#")[0].rpartition(":")
    if protocol != "tcp":
        return False
    try:
        socket.create_connection((host.strip("[]"), int(port)), _ANSWERS_WITHIN_S).close()
    except ConnectionRefusedError:
        return False
    except OSError:
        return None
    return True
