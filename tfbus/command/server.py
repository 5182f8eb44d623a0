"""The address and the access of a server for browsers, on a command line."""

import functools
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from tfbus.base.addresses import is_local
from tfbus.base.errors import SettingsError
from tfbus.base.installation import install_command
from tfbus.bus.settings import NodeSettings
from tfbus.command.types import IN_FILE

if TYPE_CHECKING:
    from tfbus.command.server_access import AccessToken, ServerTls

F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class Public:
    """The key for others to get in: a token, over encrypted connections."""

    token: "AccessToken"
    tls: "ServerTls"
    origin: str = ""

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes on both for its user."""
        if self.token.is_new:
            return (self.tls.note,)
        return (self.tls.note, f"It asks for the token of {self.origin}")


@dataclass(frozen=True)
class ServerOptions:
    """The address, and the options of `--public`, as a command line gives them."""

    host: str
    port: int
    is_public: bool
    variable: str
    token_file: Path | None = None
    certificate: Path | None = None
    key: Path | None = None

    def public(self, settings: NodeSettings) -> Public | None:
        """The token and the certificate; None without --public.

        The certificate is from the options, the identity's, or a new one. Raises
        SettingsError if these cannot be used.
        """
        if not self.is_public:
            return None
        token, origin = self._token()
        return Public(token, self._tls(settings), origin)

    def _token(self) -> "tuple[AccessToken, str]":
        from tfbus.command.server_access import AccessToken, read_token

        if self.token_file is not None:
            return read_token(self.token_file), str(self.token_file)
        try:
            return AccessToken(os.environ.get(self.variable, "")), self.variable
        except SettingsError as error:
            raise SettingsError(f"{self.variable}: {error}") from error

    def _tls(self, settings: NodeSettings) -> "ServerTls":
        from tfbus.command.server_access import made_tls, tls_of_files, tls_of_identity

        if self.certificate is not None:
            return tls_of_files(self.certificate, self.key)
        if settings.closed is not None:
            return tls_of_identity(settings.closed)
        try:
            return made_tls(self.host)
        except ImportError as error:
            raise SettingsError(
                "to make a certificate needs the library cryptography: "
                f"{install_command('secure')}; or give one, by --certificate and --key"
            ) from error


def server_options(program: str, port: int) -> Callable[[F], F]:
    """Add `--host`, `--port`, `--public` and its options to a click command, which gets them as
    `listening`: a ServerOptions.

    Raises click.UsageError for an address that others reach without --public, and for its options
    without it.
    """
    variable = f"TFBUS_{program.upper()}_TOKEN"

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def command(
            *args: Any,
            host: str | None,
            port: int,
            public: bool,
            token_file: Path | None,
            certificate: Path | None,
            key: Path | None,
            **values: Any,
        ) -> Any:
            host = host or ("0.0.0.0" if public else "127.0.0.1")
            listening = ServerOptions(host, port, public, variable, token_file, certificate, key)
            _check(listening)
            return function(*args, listening=listening, **values)

        decorated: Any = command
        for option in reversed(_options(variable, port)):
            decorated = option(decorated)
        return cast(F, decorated)

    return decorate


def _options(variable: str, port: int) -> list[Callable[[Any], Any]]:
    return [
        click.option(
            "--host",
            metavar="ADDRESS",
            help="The address to listen on (default 127.0.0.1, with --public 0.0.0.0).",
        ),
        click.option(
            "--port",
            default=str(port),
            callback=_port,
            metavar="NUMBER",
            help=f"The port, or the first free one after it (default {port}).",
        ),
        click.option(
            "--public",
            is_flag=True,
            help=f"Let other machines in, with a token (a new one, or that of {variable}), over "
            "TLS.",
        ),
        click.option(
            "--token-file",
            type=IN_FILE,
            metavar="FILE",
            help="With --public: the token is in this file.",
        ),
        click.option(
            "--certificate",
            type=IN_FILE,
            metavar="FILE",
            help="With --public: the certificate, in PEM (default: that of --secure, or a new "
            "one).",
        ),
        click.option(
            "--key",
            type=IN_FILE,
            metavar="FILE",
            help="With --certificate: its private key (default: in the same file).",
        ),
    ]


def _port(ctx: click.Context, param: click.Parameter, text: str) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= 65535):
        raise click.BadParameter(f"{text!r} is not a port number from 1 to 65535")
    return int(text)


def _check(listening: ServerOptions) -> None:
    host, port = listening.host, listening.port
    if not listening.is_public and not is_local(host):
        raise click.UsageError(
            f"--host {host} lets all in who reach this machine: add --public, for a token and "
            f"encryption; or leave --host out and open a tunnel from the other machine: ssh -L "
            f"{port}:127.0.0.1:{port} THIS_MACHINE"
        )
    given = {
        "--token-file": listening.token_file,
        "--certificate": listening.certificate,
        "--key": listening.key,
    }
    for name, value in given.items():
        if value is not None and not listening.is_public:
            raise click.UsageError(f"{name} is for --public: give both")
    if listening.key is not None and listening.certificate is None:
        raise click.UsageError("--key is the private key of a --certificate: give both")
