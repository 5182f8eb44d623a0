"""The master of ROS 1 and its nodes, by XML-RPC."""

from collections.abc import Mapping, Sequence
from http.client import HTTPConnection
from typing import Any, NamedTuple
from urllib.parse import urlsplit
from xmlrpc.client import ServerProxy, Transport

from tfbus.wording import printable

DEFAULT_MASTER = "http://localhost:11311"

# The answer of ROS 1's XML-RPC to a call that worked.
_DONE = 1


class Ros1State(NamedTuple):
    """The full names of the nodes that publish each topic, subscribe to it, and offer services."""

    publishers: Mapping[str, Sequence[str]]
    subscribers: Mapping[str, Sequence[str]]
    services: Mapping[str, Sequence[str]]


class Ros1Master:
    """A master, or a node, at a URI; `caller` is the full name of the node that asks, which waits
    at most `within_s` seconds. Raises OSError if the URI is none. Not thread-safe.
    """

    def __init__(self, uri: str, caller: str, within_s: float = 2.0) -> None:
        try:
            parts = urlsplit(uri)
            is_one = parts.scheme == "http" and bool(parts.hostname) and parts.port != 0
        except ValueError:
            is_one = False
        if not is_one:
            raise OSError(f"{printable(uri, 100)!r} is no URI of ROS 1, such as {DEFAULT_MASTER}")
        self._proxy = ServerProxy(uri, transport=_Transport(within_s))
        self._caller = caller

    def call(self, method: str, *values: Any) -> Any:
        """Its answer. Raises OSError if it does not, or not as ROS does."""
        try:
            code, said, answer = getattr(self._proxy, method)(self._caller, *values)
        except OSError:
            raise
        except Exception as error:  # http, xmlrpc and expat raise what their parsers do
            reason = f"{type(error).__name__} {printable(str(error), 100)}"
            raise OSError(f"it does not answer as ROS 1 does: {reason}") from error
        if code != _DONE:
            raise OSError(printable(str(said), 200))
        return answer

    def state(self) -> Ros1State:
        """The knowledge of a master. Raises OSError as `call` does."""
        answer = self.call("getSystemState")
        try:
            first, second, third = (
                {str(name): [str(node) for node in nodes] for name, nodes in kind}
                for kind in answer
            )
        except (TypeError, ValueError) as error:
            raise OSError(f"it does not answer as a master of ROS 1 does: {error}") from error
        return Ros1State(first, second, third)


class _Transport(Transport):
    """A master that hangs is as good as none."""

    def __init__(self, within_s: float) -> None:
        super().__init__()
        self._within_s = within_s

    def make_connection(self, host: Any) -> HTTPConnection:
        made = super().make_connection(host)
        made.timeout = self._within_s
        return made
