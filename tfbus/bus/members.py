"""Watches who opens a link on a closed bus, and names those who have no rights there."""

import logging

from tfbus.bus.session import Session
from tfbus.runtime.log_once import LogOnce
from tfbus.wording import printable


def watch_members(session: Session, log: logging.Logger) -> None:
    """Log each identity without rights that opens a link, once; nothing on an open bus.

    Its certificate is by the authority, so it gets a link. Zenoh takes nothing from it.
    """
    closed = session.settings.closed
    if closed is None:
        return
    once, known = LogOnce(log), closed.rights.identities

    def look() -> None:
        for name in session.identities().values():
            identity = known.get(name)
            if identity is None:
                why = "its name is not in the rights of this process"
            elif identity.revoked:
                why = f"it was revoked on {identity.revoked}"
            else:
                continue
            once.warning(
                ("no rights", name),
                "Identity '%s' opened a link, and has no rights: %s. Nothing is taken from it",
                printable(name, 64),
                why,
            )

    session.watch_links(look)
