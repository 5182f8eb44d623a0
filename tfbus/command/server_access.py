"""A browser's way in to a server: TLS 1.3, a token to show, and the web pages that may connect.

A browser lets each page that its user opens connect to any machine, and the header Origin alone
says which page it is. A server's own page has the same Host, which must be an address or one of the
server's names: the owner of any other name can let it point here.
"""

import hmac
import ipaddress
import os
import secrets
import ssl
import tempfile
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from urllib.parse import SplitResult, urlsplit

from tfbus.base.addresses import address_of, is_local, main_address, own_names
from tfbus.base.bounded import Bounded
from tfbus.base.errors import SettingsError
from tfbus.base.wording import printable
from tfbus.bus.identity_folder import SecureFolder, check_is_private

# One that is made is for one run.
_DAYS = 365.0


@dataclass(frozen=True)
class ServerTls:
    """The certificate and key that connections are accepted with; `names` are the certificate's, in
    small letters.

    `note` is a sentence on the certificate for users who open the page.
    """

    context: ssl.SSLContext
    names: frozenset[str]
    note: str


def tls_of_files(certificate: Path, key: Path | None = None) -> ServerTls:
    """With a certificate in PEM, followed by further ones up to its authority, and its private
    key, by default in the same file. Raises SettingsError if they cannot be used.
    """
    names, ends = _facts(certificate)
    return ServerTls(_context(certificate, key), names, f"The certificate is {certificate}{ends}")


def tls_of_identity(folder: SecureFolder) -> ServerTls:
    """With the certificate of an identity. Raises SettingsError if it cannot be used."""
    names, ends = _facts(folder.certificate)
    note = (
        f"The certificate is that of identity {folder.identity.name!r}{ends}: browsers trust it "
        f"that have imported {folder.authority}, under names of --hosts"
    )
    return ServerTls(_context(folder.certificate, folder.key), names, note)


def made_tls(host: str) -> ServerTls:
    """With a new certificate for this machine, and the name or address that it listens at.

    Raises ImportError without the library cryptography.
    """
    from tfbus.bus.keystore import fingerprint_of, make_for_server

    own = {name for name in own_names() if name.isascii()}
    local = {f"{name}.local" for name in own if "." not in name and name != "localhost"}
    found = {host, main_address(), *own, *local, "localhost", "127.0.0.1", "::1"}
    names = sorted(found - {"", "0.0.0.0", "::"})
    made = make_for_server(names, _DAYS)
    # A context reads files only; the folder is its owner's alone.
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "server.pem")
        path.touch(0o600)
        path.write_bytes(made.certificate + made.key)
        context = _context(path, None)
    note = (
        "The certificate is made for this run: browsers warn once, and show its SHA-256 "
        f"fingerprint, {fingerprint_of(made.certificate)}"
    )
    return ServerTls(context, frozenset(names), note)


def _context(certificate: Path, key: Path | None) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    try:
        # An encrypted key would be asked for at the terminal.
        context.load_cert_chain(certificate, key, password="")
    except OSError as error:
        what = os.fspath(certificate) if key is None else f"{certificate} with {key}"
        raise SettingsError(
            f"{what} cannot be used: needs a certificate and its private key, in PEM and not "
            f"encrypted ({error.strerror or error})"
        ) from error
    return context


def _facts(certificate: Path) -> tuple[frozenset[str], str]:
    """Its names, and until when it is valid; neither without the library cryptography."""
    try:
        from tfbus.bus.keystore import facts_of
    except ImportError:
        return frozenset(), ""
    try:
        facts = facts_of(certificate.read_bytes())
    except (OSError, ValueError) as error:
        raise SettingsError(f"{certificate} is not a certificate in PEM: {error}") from error
    if mistake := facts.mistake():
        raise SettingsError(f"the certificate {certificate} is {mistake}")
    return frozenset(name.lower() for name in facts.hosts), f", valid until {facts.ends:%Y-%m-%d}"


# A token that someone chose has at least as many characters: with few guesses that is enough.
LEAST = 12

# From one address as many wrong tokens are answered in this time.
_GUESSES = 10
_WITHIN_S = 60.0

# Of addresses that guessed; of more, the first are forgotten.
_MOST_ADDRESSES = 10_000

Verdict = Literal["right", "wrong", "too often"]


class AccessToken:
    """A secret text, and the addresses that have guessed at it; for one thread.

    Without a text it is new: 128 random bits. Raises SettingsError for a text that is too short.
    """

    def __init__(self, text: str = "") -> None:
        if text and len(text) < LEAST:
            raise SettingsError(
                f"the token has {len(text)} characters, and needs at least {LEAST}; where none is "
                "given, one is made"
            )
        self.is_new = not text
        self.text = text or secrets.token_urlsafe(16)
        self._guesses: Bounded[str, list[float]] = Bounded(_MOST_ADDRESSES)

    def derived(self, purpose: str) -> str:
        """A text of 64 digits and letters a to f that only holders of the token can make."""
        return hmac.new(self.text.encode(), purpose.encode(), "sha256").hexdigest()

    def judge(self, given: str, address: str) -> Verdict:
        """Whether a text from an address is the token; after 10 wrong ones in a minute, none is."""
        who = _network_of(address)
        now_s = time.monotonic()
        recent = [at_s for at_s in self._guesses.get(who, ()) if now_s - at_s < _WITHIN_S]
        if len(recent) >= _GUESSES:
            return "too often"
        if is_same(given, self.text):
            return "right"
        self._guesses[who] = [*recent, now_s]
        return "wrong"

    def __repr__(self) -> str:
        return "AccessToken(...)"


def is_same(given: str, secret: str) -> bool:
    """Whether a text is a secret; takes as long for any text of its length."""
    return hmac.compare_digest(given.encode(errors="replace"), secret.encode())


def read_token(path: Path) -> AccessToken:
    """The token in a file: its first line.

    Raises SettingsError if there is none, the file cannot be read, or others may read it.
    """
    try:
        check_is_private(path, "token")
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"the token cannot be read from {path}: {error}") from error
    text = lines[0].strip() if lines else ""
    if not text:
        raise SettingsError(f"{path} has no token in its first line")
    return AccessToken(text)


def _network_of(address: str) -> str:
    """Of IPv6 the first half: one machine has all addresses of it."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if found.version == 4:
        return address
    return str(ipaddress.ip_network((int(found), 64), strict=False).network_address)


# Of an origin in an error, so many letters.
_MOST = 100


@dataclass(frozen=True)
class PageGate:
    """The pages that may connect to a server: its own; pages of `allowed` origins, or for which
    `is_allowed(scheme, host)`; and with `knows_neighbours` pages of the browser's own machine.

    A server that knows its clients by a cookie has no neighbours: a browser sends a cookie of one
    port to all ports. `names` are the server's, of which none is needed for this machine alone.
    `advice` ends the sentence of a refusal.
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
            return ""  # no web page has another scheme, as file: and the schemes of applications
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
