"""The address for Foxglove's clients, and which may connect."""

from dataclasses import dataclass

from tfbus.secure.server_access import AccessToken, ServerTls


@dataclass(frozen=True)
class Serving:
    """The address to listen at: the first free port from `port` on.

    `origins` are those of further web pages that may connect, such as `http://viewer.lan:8080`.
    With a `tls` connections are encrypted; with a `token` clients need it, as a query of the URL.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    origins: tuple[str, ...] = ()
    tls: ServerTls | None = None
    token: AccessToken | None = None
