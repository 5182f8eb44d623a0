"""An identity's folder: the files that one machine needs to be on a closed bus."""

import hashlib
import os
import stat
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from tfbus.base.errors import SettingsError, TfbusError
from tfbus.base.whole_file import replacing
from tfbus.base.yaml_file import Value, read_yaml_file
from tfbus.bus.rights import RIGHTS, Identity, Rights

RIGHTS_FILE = "rights.yaml"

_IDENTITY_FIELDS = ("role", "namespace", *RIGHTS, "hosts", "revoked")
_LISTS = (*RIGHTS, "hosts")

_HEAD = """\
# Who may do what on this bus. `tfbus keys` writes this file; edit it as you like, then copy it to
# every machine (tfbus keys export), and restart what runs there.
#
# Each identity has a role: reader, publisher, operator, router or admin. All names are within its
# namespace. A right that is not here is that of the role; patterns have * for letters and ** for
# any parts: arm/*.
#   nodes   names of its nodes and of their streams     topics  topics that it may publish
#   frames  child frames that it may publish            serves  services that it may serve
#   calls   services that it may call                   sets    node/parameter that it may set
"""


def read_rights(path: Path) -> Rights:
    """The rights in a file. Raises YamlFileError, with the line of a mistake."""
    document = read_yaml_file(path, "identities, with a role each").fields(("identities",))
    if "identities" not in document:
        return Rights()
    entries = document["identities"]
    named = {} if entries.is_empty else entries.entries()
    identities = {name: _identity(name, value) for name, value in named.items()}
    try:
        return Rights(identities)
    except TfbusError as error:
        raise entries.place.mistake(str(error)) from error


def _identity(name: str, value: Value) -> Identity:
    fields = value.fields(_IDENTITY_FIELDS)
    if "role" not in fields:
        raise value.place.mistake("has no role: write role: reader")
    given: dict[str, Any] = {}
    for key, each in fields.items():
        given[key] = tuple(part.text() for part in each.items()) if key in _LISTS else each.text()
    try:
        return Identity(name, **given)
    except TfbusError as error:
        raise value.place.mistake(str(error)) from error


def write_rights(path: Path, rights: Rights) -> None:
    """Write the rights, whole or not at all."""
    identities = {name: _as_map(each) for name, each in rights.identities.items()}
    text = yaml.safe_dump(
        {"identities": identities}, sort_keys=False, allow_unicode=True, default_flow_style=None
    )
    with replacing(path) as file:
        file.write((_HEAD + text).encode())


def _as_map(identity: Identity) -> Mapping[str, object]:
    values = {key: getattr(identity, key) for key in _IDENTITY_FIELDS}
    return {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in values.items()
        if value not in (None, "", ()) or (key in RIGHTS and value == ())
    }


AUTHORITY_FILE = "authority.pem"
CERTIFICATE_FILE = "certificate.pem"
KEY_FILE = "key.pem"
NAME_FILE = "identity.yaml"

# The files of an identity, beside which an exported folder has the rights of all.
OWN_FILES = (AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE, NAME_FILE)

# The folder of a keystore that has the authority.
AUTHORITY = "authority"

# Any other user who may read a private key can take the identity.
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


@dataclass(frozen=True)
class SecureFolder:
    """An identity's folder that can be used: all files are there, its key is its own, and its
    certificate is valid until `ends`. `digest` is the same for the same rights.
    """

    path: Path
    identity: Identity
    rights: Rights
    ends: datetime
    digest: str

    @property
    def authority(self) -> Path:
        """The certificate of the authority."""
        return self.path / AUTHORITY_FILE

    @property
    def certificate(self) -> Path:
        """The identity's certificate."""
        return self.path / CERTIFICATE_FILE

    @property
    def key(self) -> Path:
        """The identity's private key."""
        return self.path / KEY_FILE


def open_folder(path: str | os.PathLike[str]) -> SecureFolder:
    """The identity's folder at a path.

    Raises SettingsError if it is not one, a file is missing, others may read its private key,
    or its identity has no rights; YamlFileError for a mistake in a file.
    """
    folder = Path(path).resolve()
    if not folder.is_dir():
        raise SettingsError(f"there is no folder {str(path)!r}: tfbus keys add makes one")
    missing = [name for name in OWN_FILES if not (folder / name).is_file()]
    if NAME_FILE in missing:
        raise SettingsError(_no_identity(path, folder))
    rights_file = _rights_file(folder)
    if not rights_file.is_file():
        missing.append(RIGHTS_FILE)
    if missing:
        raise SettingsError(f"{path} has no {', '.join(missing)}: export the identity again")
    check_key_is_own(folder / KEY_FILE)
    document = read_yaml_file(folder / NAME_FILE, "the identity's name")
    fields = document.fields(_FIELDS)
    if lacking := [each for each in _FIELDS if each not in fields]:
        raise document.place.mistake(f"has no {', '.join(lacking)}: export the identity again")
    name, begins, ends = fields["name"].text(), _time(fields["begins"]), _time(fields["ends"])
    _check_time(name, begins, ends)
    digest = hashlib.sha256(rights_file.read_bytes()).hexdigest()[:16]
    rights = _rights_of(rights_file, digest)
    identity = rights.identity(name)
    if identity.revoked:
        raise SettingsError(f"identity {name!r} was revoked on {identity.revoked}")
    return SecureFolder(folder, identity, rights, ends, digest)


def _rights_file(folder: Path) -> Path:
    """The file with the rights of all: in a keystore that of the keystore, which people edit, and
    in an exported folder its own.
    """
    is_in_keystore = (folder.parent / AUTHORITY / CERTIFICATE_FILE).is_file()
    return (folder.parent if is_in_keystore else folder) / RIGHTS_FILE


@lru_cache(maxsize=8)
def _rights_of(path: Path, digest: str) -> Rights:
    """The rights in a file with this content: settings are often made of others, and the rules of
    200 identities take 0.1 s to read.
    """
    return read_rights(path)


def name_file(name: str, begins: datetime, ends: datetime) -> bytes:
    """The content of identity.yaml: the certificate's facts, for programs without a library."""
    return f"name: {name}\nbegins: {_shown(begins)}\nends: {_shown(ends)}\n".encode()


_FIELDS = ("name", "begins", "ends")


def _shown(time: datetime) -> str:
    return time.astimezone(UTC).isoformat()


def _time(value: Value) -> datetime:
    with suppress(ValueError):
        time = datetime.fromisoformat(value.text())
        if time.tzinfo is not None:
            return time
    raise value.place.mistake(f"{value.text()!r} is not a time with its zone: export it again")


def _check_time(name: str, begins: datetime, ends: datetime) -> None:
    now = datetime.now(UTC)
    if now > ends:
        raise SettingsError(
            f"identity {name!r} expired on {ends:%Y-%m-%d}: tfbus keys renew {name}, and export it"
        )
    if now < begins:
        raise SettingsError(
            f"identity {name!r} is not valid before {begins:%Y-%m-%d %H:%M} UTC, and the clock of "
            f"this machine says {now:%Y-%m-%d %H:%M}: set the clock"
        )


def check_key_is_own(path: Path) -> None:
    """Raises SettingsError if others than its owner may read or write a private key."""
    check_is_private(path, "private key")


def check_is_private(path: Path, what: str) -> None:
    """Raises SettingsError if others than its owner may read or write this secret."""
    if os.name == "posix" and path.stat().st_mode & _OTHERS:
        raise SettingsError(f"others may read the {what} {path}: chmod 600 {path}")


def _no_identity(path: str | os.PathLike[str], folder: Path) -> str:
    names = sorted(each.parent.name for each in folder.glob(f"*/{NAME_FILE}"))
    if names:
        choices = " or ".join(f"{path}/{name}" for name in names[:3])
        return f"{path} has the identities of all: use one of them, {choices}"
    return f"{path} is not an identity's folder: it has no {NAME_FILE}; tfbus keys add makes one"
