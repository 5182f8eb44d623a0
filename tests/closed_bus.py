"""A closed bus for tests: on loopback, with an authority and identities of its own."""

import json
import logging
from pathlib import Path
from typing import Any

import zenoh

from tests.live_bus import AT_ONCE, PATIENT, free_port
from tfbus import Node, NodeSettings
from tfbus.bus.keystore import Keystore
from tfbus.bus.rights import Identity, Rights, access_control
from tfbus.bus.session import Session

_QUICK = f"{AT_ONCE}{PATIENT}}}"
_ANY_PORT = "tls/127.0.0.1:0"


class ClosedBus:
    """Peers that meet on loopback, each by its identity; `meeting` is one that only reads."""

    def __init__(self, folder: Path, *identities: Identity, name: str = "keys") -> None:
        self.folder = folder
        self.keystore = Keystore.init(folder / name, days=10)
        for identity in (Identity("meeting", "reader"), *identities):
            self.keystore.add(identity, days=5)
        self.endpoint = f"tls/127.0.0.1:{free_port()}"
        self.config = folder / "quick.json5"
        self.config.write_text(_QUICK)
        self._ends: list[Any] = []

    def open(self) -> None:
        """Open the meeting point, once all identities are made."""
        self.session("meeting", listen=(self.endpoint,), connect=())

    def path(self, identity: str) -> Path:
        """The folder of an identity."""
        return self.keystore.path / identity

    def node(self, identity: str, name: str = "", **given: Any) -> Node:
        """A node of an identity; what is given are fields of NodeSettings."""
        node = Node(settings=self._settings(identity, name or identity, **given))
        self._ends.append(node)
        return node

    def session(
        self, identity: str, name: str = "", *, opens_alone: bool = False, **given: Any
    ) -> Session:
        """A session of an identity, as `node`."""
        settings = self._settings(identity, name or identity, **given)
        session = Session(settings, logging.getLogger("test"), opens_alone=opens_alone)
        self._ends.append(session)
        return session

    def _settings(self, identity: str, name: str, **given: Any) -> NodeSettings:
        fields: dict[str, Any] = {
            "config": str(self.config),
            "connect": (self.endpoint,),
            "listen": (_ANY_PORT,),
            **given,
        }
        return NodeSettings(name, secure=str(self.path(identity)), **fields)

    def raw(self, folder: Path, **changes: Any) -> zenoh.Session:
        """A session of Zenoh's own by the certificate in a folder, which checks no rights: that of
        an attacker who took it. `changes` are settings of Zenoh by their keys.
        """
        tls = {
            "root_ca_certificate": str(folder / "authority.pem"),
            "enable_mtls": True,
            "verify_name_on_connect": False,
            **{
                f"{side}_{what}": str(folder / file)
                for side in ("listen", "connect")
                for what, file in (("certificate", "certificate.pem"), ("private_key", "key.pem"))
            },
        }
        return self.open_raw(**{"transport/link/tls": tls, **changes})

    def open_raw(self, **settings: Any) -> zenoh.Session:
        """A session of Zenoh's own with these settings, by their keys."""
        config = zenoh.Config.from_file(str(self.config))
        given = {
            "connect/endpoints": [self.endpoint],
            "listen/endpoints": [_ANY_PORT],
            "connect/exit_on_failure": False,
            "connect/timeout_ms": 0,
            **settings,
        }
        for key, value in given.items():
            config.insert_json5(key, json.dumps(value))
        session = zenoh.open(config)
        self._ends.append(session)
        return session

    def links(self) -> dict[str, set[str]]:
        """The nodes that each node has a link to, without the meeting point."""
        sessions = [getattr(each, "session", each) for each in self._ends]
        names = {
            str(each.zenoh.zid()): each.settings.name
            for each in sessions
            if isinstance(each, Session) and each.settings.name != "meeting"
        }
        return {
            each.settings.name: {
                names[zid] for zid in map(str, each.zenoh.info.peers_zid()) if zid in names
            }
            for each in sessions
            if isinstance(each, Session)
        }

    def close(self) -> None:
        """End all that was opened on it."""
        for each in reversed(self._ends):
            each.close()


def rules_of(*identities: Identity) -> dict[str, Any]:
    """Zenoh's access control of these identities."""
    return access_control(Rights({identity.name: identity for identity in identities}))
