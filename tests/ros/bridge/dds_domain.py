"""Domains of DDS, of which tests that run at once have each its own."""

import socket

# Their ports are below those that systems give out, so that each has its own.
DOMAINS = range(50, 100)


def claim_domain() -> tuple[int, socket.socket]:
    """A domain that no other process with these tests has, until the socket is closed."""
    for domain in DOMAINS:
        claim = socket.socket()
        try:
            # That of its multicast, by UDP; nothing else is at the same port by TCP.
            claim.bind(("127.0.0.1", 7400 + 250 * domain))
        except OSError:
            claim.close()
        else:
            return domain, claim
    raise OSError("all domains of DDS are in use")
