"""The server's end of encrypted connections of browsers: TLS 1.3, with a certificate."""

import os
import ssl
import tempfile
from dataclasses import dataclass
from pathlib import Path

from tfbus.errors import SettingsError
from tfbus.runtime.addresses import main_address, own_names
from tfbus.secure.folder import SecureFolder

# One that is made is for one run.
_DAYS = 365.0


@dataclass(frozen=True)
class ServerTls:
    """The certificate and key that connections are accepted with; `names` are those of the
    certificate, in small letters.

    `note` is a sentence on the certificate that who opens the page should know.
    """

    context: ssl.SSLContext
    names: frozenset[str]
    note: str


def tls_of_files(certificate: Path, key: Path | None = None) -> ServerTls:
    """With a certificate in PEM, followed by those that lead to its authority, and its private
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
    from tfbus.secure.certificates import fingerprint_of, make_for_server

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
        from tfbus.secure.certificates import facts_of
    except ImportError:
        return frozenset(), ""
    try:
        facts = facts_of(certificate.read_bytes())
    except (OSError, ValueError) as error:
        raise SettingsError(f"{certificate} is not a certificate in PEM: {error}") from error
    if mistake := facts.mistake():
        raise SettingsError(f"the certificate {certificate} is {mistake}")
    return frozenset(name.lower() for name in facts.hosts), f", valid until {facts.ends:%Y-%m-%d}"
