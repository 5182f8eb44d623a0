"""Whether an endpoint to connect to answers, and how."""

import socket

from tfbus.runtime import scheduler

_CONNECT_WITHIN_S = 2.0


def split_endpoint(endpoint: str) -> tuple[str, str, int]:
    """The protocol, the host and the port of an endpoint such as tcp/[::]:7447#iface=eth0; 0 for
    one without a port.
    """
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.partition("#")[0].partition("?")[0].rpartition(":")
    return protocol, host.strip("[]"), int(port) if port.isdigit() else 0


def host_of(endpoint: str) -> str:
    """The host of an endpoint, an address of IPv4 as such."""
    return split_endpoint(endpoint)[1].removeprefix("::ffff:")


def why_unreachable(endpoint: str) -> str:
    """Why an endpoint such as `tcp/host:7447` does not answer; "" if it does."""
    address = _address(endpoint)
    if address is None:
        return ""  # untested: tfbus does not speak its protocol
    try:
        with socket.create_connection(address, _CONNECT_WITHIN_S):
            return ""
    except OSError as error:
        return error.strerror or str(error)


def speaks_tls(endpoint: str) -> bool | None:
    """Whether an endpoint encrypts, as those of a closed bus do; None if it does not answer.

    For one that gives no link: it takes up to 2 s if that does not encrypt.
    """
    import ssl  # slow to import, and most processes do not need it

    address = _address(endpoint)
    if address is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        with socket.create_connection(address, _CONNECT_WITHIN_S) as plain:
            try:
                with context.wrap_socket(plain):
                    return True
            except ssl.SSLError as error:
                # Where it asks for a certificate at once, it has begun to encrypt.
                return "ALERT" in (error.reason or "")
            except OSError:
                return False
    except OSError:
        return None


def _address(endpoint: str) -> tuple[str, int] | None:
    """The host and port of an endpoint; None for one of another protocol, and in a simulation."""
    if scheduler.is_simulated:
        return None
    protocol, host, port = split_endpoint(endpoint)
    return (host, port) if protocol in ("tcp", "tls", "ws") and port else None
