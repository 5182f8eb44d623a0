"""Where Foxglove's clients connect, and which may."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Serving:
    """The address to listen at: the first free port from `port` on.

    `origins` are those of further web pages that may connect, such as `http://viewer.lan:8080`.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    origins: tuple[str, ...] = ()
