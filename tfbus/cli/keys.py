"""`tfbus keys`: makes and looks after the identities of a closed bus."""

import shlex
from collections.abc import Callable
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tfbus.base.errors import SettingsError, TfbusError
from tfbus.base.installation import install_command
from tfbus.base.wording import listed, printable
from tfbus.bus.rights import RIGHTS, ROLES, Identity
from tfbus.cli import Verbs
from tfbus.cli.output import json_option, paint, print_json, print_lines, print_text, table
from tfbus.command.options import click_error
from tfbus.command.types import Number

if TYPE_CHECKING:
    from tfbus.bus.keystore import Keystore, Listed

F = TypeVar("F", bound=Callable[..., Any])

_AUTHORITY_DAYS = 3650.0
_IDENTITY_DAYS = 365.0
_MOST_DAYS = 36500.0


class _Keys(Verbs):
    def invoke(self, ctx: click.Context) -> Any:
        if find_spec("cryptography") is None:
            raise click.ClickException(
                f"certificates need the library cryptography: {install_command('secure')}"
            )
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise  # of the output, and no fault
        except TfbusError as error:
            raise click_error(error) from error
        except OSError as error:
            raise click.ClickException(
                f"{printable(str(error.filename))}: {error.strerror or error}"
                if error.filename
                else str(error.strerror or error)
            ) from error


@click.group(cls=_Keys, hints={"remove": "use: tfbus keys revoke", "create": "use: tfbus keys add"})
def command() -> None:
    """Make identities for a closed bus: who may do what, encrypted.

    The folder of a keystore has the authority and the identities; `keys` in the current folder, or
    that of --keys. Keep it where no robot is: what it holds can make any identity.
    """


def _keystore_option(function: F) -> F:
    return click.option(
        "--keys",
        "place",
        type=click.Path(path_type=Path, file_okay=False),
        default=Path("keys"),
        envvar="TFBUS_KEYS",
        metavar="DIR",
        help="The keystore (default keys).",
    )(function)


def _keystore() -> "type[Keystore]":
    from tfbus.bus.keystore import Keystore

    return Keystore


def _open(place: Path) -> "Keystore":
    return _keystore().open(place)


def _days_option(default: float) -> Callable[[F], F]:
    return click.option(
        "--days",
        type=Number(least=0.001, most=_MOST_DAYS),
        default=default,
        help=f"How long the certificate is valid (default {default:.0f}).",
    )


@command.command(epilog="Example: tfbus keys init")
@click.argument("place", metavar="[DIR]", default="keys", type=click.Path(path_type=Path))
@_days_option(_AUTHORITY_DAYS)
def init(place: Path, days: float) -> None:
    """Make a keystore with a new authority in DIR (default keys)."""
    _keystore().init(place, days)
    print_text(f"Made {place}. It can make any identity: keep it to yourself, off the robots.")
    print_text(f"Next: tfbus keys add NAME --role publisher{_with_keys(place)}")


@command.command(epilog="Example: tfbus keys add arm --role publisher --namespace robot7")
@click.argument("name")
@click.option("--role", type=click.Choice(ROLES), required=True, help="What it may do.")
@click.option("--namespace", default="", metavar="PATH", help="All its names are in here.")
@click.option("--nodes", multiple=True, metavar="PATTERN", help="Names of its nodes and streams.")
@click.option("--frames", multiple=True, metavar="PATTERN", help="Child frames it may publish.")
@click.option("--topics", multiple=True, metavar="PATTERN", help="Topics it may publish.")
@click.option("--serves", multiple=True, metavar="PATTERN", help="Services it may serve.")
@click.option("--calls", multiple=True, metavar="PATTERN", help="Services it may call.")
@click.option("--sets", multiple=True, metavar="NODE/PARAM", help="Parameters it may set.")
@click.option("--hosts", multiple=True, metavar="HOST", help="Names and addresses of its machine.")
@_days_option(_IDENTITY_DAYS)
@_keystore_option
def add(name: str, role: str, days: float, place: Path, **given: Any) -> None:
    """Make the identity NAME: a private key, a certificate, and its rights.

    All options but --role, --namespace and --days can be repeated. Patterns have * for any letters
    of a name, and ** for any parts: arm/*. Rights that are not given are those of the role.
    """
    values: dict[str, Any] = {
        key: value or None if key in RIGHTS else value for key, value in given.items()
    }
    identity = Identity(name, role, **values)
    folder = _open(place).add(identity, days)
    print_text(f"Made {folder}: {_may(identity)}.")
    print_text(f"Use it: tfbus --secure {folder} node list")


@command.command("list", epilog="Example: tfbus keys list")
@json_option("Print a JSON object for each identity.")
@_keystore_option
def list_command(place: Path, as_json: bool) -> None:
    """Print the identities: name, role, namespace, until when."""
    found = _open(place).listed()
    if as_json:
        print_json([_as_map(each) for each in found])
        return
    rows = [
        (each.identity.name, each.identity.role, each.identity.namespace or "/", _until(each))
        for each in found
    ]
    print_lines(table(("IDENTITY", "ROLE", "NAMESPACE", "VALID"), rows))


@command.command(epilog="Example: tfbus keys show arm")
@click.argument("name")
@_keystore_option
def show(name: str, place: Path) -> None:
    """Print what the identity NAME may do."""
    identity = _open(place).rights.identity(name)
    print_text(f"{paint(name, 'name')}: {_may(identity)}")
    for right in RIGHTS:
        print_text(f"  {right + ':':<8} {listed(identity.may(right), most=20) or 'none'}")


@command.command(epilog="Example: tfbus keys renew arm")
@click.argument("name")
@_days_option(_IDENTITY_DAYS)
@_keystore_option
def renew(name: str, days: float, place: Path) -> None:
    """Make a new key and certificate for NAME; its rights stay."""
    folder = _open(place).renew(name, days)
    print_text(f"Made a new certificate in {folder}; the old one stays valid until it expires.")
    print_text(f"Put it on the machine of {name}: tfbus keys export {name}{_with_keys(place)}")


@command.command(epilog="Example: tfbus keys revoke arm")
@click.argument("name")
@_keystore_option
def revoke(name: str, place: Path) -> None:
    """End all rights of NAME, everywhere the new rights are."""
    store = _open(place)
    store.revoke(name)
    print_text(
        f"Revoked {name} in {place / 'rights.yaml'}. Copy that file to every machine and router, "
        "and restart what runs there: until then its rights hold."
    )


@command.command(epilog="Example: tfbus keys check")
@_keystore_option
def check(place: Path) -> None:
    """Say what is expired or soon to expire, readable by others, missing, or exported with former
    rights; exits with 1 if so.
    """
    store = _open(place)
    problems = list(store.problems())
    print_lines(problems)
    if problems:
        raise SystemExit(1)
    print_text(f"identities: {len(store.rights.identities)}, all is well")


@command.command(epilog="Example: tfbus keys export arm -o /media/stick/arm")
@click.argument("name")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="The new folder (default NAME, here).",
)
@_keystore_option
def export(name: str, output: Path | None, place: Path) -> None:
    """Write the folder that goes onto the machine of NAME: its key, certificate, and all rights."""
    target = output or Path(name)
    if target.resolve() == (place / name).resolve():
        raise SettingsError(f"{target} is the keystore's own: give another place with -o")
    _open(place).export(name, target)
    print_text(f"Wrote {target}. On that machine: tfbus --secure {target.name} …")


def _with_keys(place: Path) -> str:
    return "" if place == Path("keys") else f" --keys {shlex.quote(str(place))}"


def _may(identity: Identity) -> str:
    where = f" in {identity.namespace}" if identity.namespace else ""
    ended = f", revoked on {identity.revoked}" if identity.revoked else ""
    return f"{identity.role}{where}{ended}"


def _until(each: "Listed") -> str:
    if each.identity.revoked:
        return paint(f"revoked on {each.identity.revoked}", "faint")
    if each.facts is None:
        return paint("no certificate", "bad")
    mistake = each.facts.mistake()
    left = each.facts.ends - datetime.now(UTC)
    role = "bad" if mistake else "warning" if left.days < 30 else "good"
    return paint(mistake or f"until {each.facts.ends:%Y-%m-%d}", role)


def _as_map(each: "Listed") -> dict[str, Any]:
    identity, facts = each.identity, each.facts
    return {
        "name": identity.name,
        "role": identity.role,
        "namespace": identity.namespace,
        **{right: list(identity.may(right)) for right in RIGHTS},
        "revoked": identity.revoked or None,
        "valid_from": facts.begins.isoformat() if facts else None,
        "valid_until": facts.ends.isoformat() if facts else None,
    }
