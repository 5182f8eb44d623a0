"""The gate of a server for browsers: which web pages may connect.

A browser lets each page that its user opens connect to any machine, and the header Origin alone
says which page it is. A server's own page has the same Host, which must be an address or one of the
server's names: the owner of any other name can let it point here.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from urllib.parse import SplitResult, urlsplit

from tfbus.runtime.addresses import address_of, is_local, own_names
from tfbus.wording import printable

# Of an origin in an error, so many letters.
_MOST = 100


@dataclass(frozen=True)
class Gate:
    """The pages that may connect to a server: its own; those of `allowed` origins, and those that
    `is_allowed(scheme, host)`; and with `knows_neighbours` those of the browser's own machine.

    A server that knows its clients by a cookie has no neighbours: a browser sends a cookie of one
    port to all ports. `names` are those of the server, of which none is needed for this machine
    alone. `advice` says what else to do.
    """

    names: Collection[str] = ()
    allowed: Collection[str] = ()
    is_allowed: Callable[[str, str], bool] = lambda scheme, host: False
    knows_neighbours: bool = True
    advice: str = "open the page directly"

    def refusal(self, origin: str | None, host: str) -> str:
        """Why a page of this origin is refused at a server that it calls `host`, a name and maybe
        a port, in a sentence; "" if it may connect, or is no page.
        """
        if origin is None or origin in self.allowed:
            return ""
        page, host = _parts(origin.lower()), host.lower()
        if host and page.netloc == host and not self.stranger(host):
            return ""
        name = page.hostname or ""
        is_neighbour = page.scheme not in ("http", "https", "") or (name and is_local(name))
        if (self.knows_neighbours and is_neighbour) or self.is_allowed(page.scheme, name):
            return ""  # no web page has another scheme, as file: and those of applications
        return f"a page of '{printable(origin, _MOST)}' may not connect: {self.advice}"

    def stranger(self, host: str) -> str:
        """Why a server is not to be used as `host`, in a sentence; "" if the name is its own."""
        name = _parts(f"//{host.lower()}").hostname or ""
        if not self.names:
            if is_local(name):
                return ""
            return f"this server is for its machine only: open it as localhost, not as {name!r}"
        if name in self.names or f"*.{name.partition('.')[2]}" in self.names:  # of a certificate
            return ""
        # Names in .local are resolved on the local network only (RFC 6762).
        if is_local(name) or name.endswith(".local") or address_of(name) is not None:
            return ""
        return (
            f"the server is not {name or host!r}, a name that anyone could point here: open the IP "
            "address of its machine, its host name, or that with .local"
        )


def machine_names(host: str) -> frozenset[str]:
    """The names under which others may reach a server that listens at `host`: that one, and this
    machine's host name with and without its domain; none if only this machine reaches it.
    """
    if is_local(host):
        return frozenset()
    return own_names() | {host.lower()}


def _parts(url: str) -> SplitResult:
    """The parts of a URL; all empty if it is malformed."""
    try:
        return urlsplit(url)
    except ValueError:
        return urlsplit("")
