"""An identity's folder: what one machine needs to be on a closed bus."""

import hashlib
import os
import stat
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

from tfbus.errors import SettingsError
from tfbus.runtime.yaml_file import Value, read_yaml_file
from tfbus.secure.rights import Identity, Rights
from tfbus.secure.rights_file import RIGHTS_FILE, read_rights

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
    fields = read_yaml_file(folder / NAME_FILE, "the identity's name").fields(_FIELDS)
    name, begins, ends = fields["name"].text(), _time(fields["begins"]), _time(fields["ends"])
    _check_time(name, begins, ends)
    digest = hashlib.sha256(rights_file.read_bytes()).hexdigest()[:16]
    rights = _rights_of(rights_file, digest)
    identity = rights.of(name)
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
    """The content of identity.yaml: what the certificate says, for those without a library."""
    return f"name: {name}\nbegins: {_shown(begins)}\nends: {_shown(ends)}\n".encode()


_FIELDS = ("name", "begins", "ends")


def _shown(time: datetime) -> str:
    return time.astimezone(UTC).isoformat()


def _time(value: Value) -> datetime:
    try:
        return datetime.fromisoformat(value.text())
    except ValueError:
        raise value.place.mistake(f"{value.text()!r} is not a time: export it again") from None


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
