"""Whether an endpoint to connect to answers."""

import socket

_CONNECT_WITHIN_S = 2.0


def why_unreachable(endpoint: str) -> str:
    """Why an endpoint such as `tcp/host:7447` does not answer; "" if it does."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.partition("?")[0].rpartition(":")
    if protocol not in ("tcp", "tls", "ws") or not port.isdigit():
        return ""  # untested: tfbus does not speak its protocol
    try:
        with socket.create_connection((host.strip("[]"), int(port)), _CONNECT_WITHIN_S):
            return ""
    except OSError as error:
        return error.strerror or str(error)
