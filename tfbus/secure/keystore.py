"""The authority's folder: makes identities, renews and revokes them, and checks all."""

import os
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from tfbus.errors import SettingsError, TfbusError
from tfbus.runtime.whole_file import replacing, taking_place_of
from tfbus.secure.certificates import (
    Facts,
    Issued,
    facts_of,
    is_key_of,
    is_signed_by,
    issue,
    make_authority,
)
from tfbus.secure.folder import (
    AUTHORITY,
    AUTHORITY_FILE,
    CERTIFICATE_FILE,
    KEY_FILE,
    NAME_FILE,
    OWN_FILES,
    RIGHTS_FILE,
    check_key_is_own,
    name_file,
    read_rights,
    write_rights,
)
from tfbus.secure.rights import Identity, Rights
from tfbus.wording import counted, listed

# The rights that an identity's folder had when it was exported last: what its machine has.
_EXPORTED_FILE = "exported.yaml"
_SOON = timedelta(days=30)


@dataclass(frozen=True)
class Listed:
    """An identity and what its certificate says; None if that cannot be read."""

    identity: Identity
    facts: Facts | None


@dataclass(frozen=True)
class Keystore:
    """The folder of a certificate authority, with a folder for each identity in it.

    The folder `authority` in it is enough to make any identity.
    """

    path: Path

    @classmethod
    def init(cls, path: Path, days: float) -> "Keystore":
        """Make the folder and its authority. Raises SettingsError if there is one."""
        store = cls(path)
        if store._authority_file(KEY_FILE).exists():
            raise SettingsError(f"{path} has an authority already; tfbus keys add makes identities")
        path.mkdir(parents=True, exist_ok=True)
        own = path / AUTHORITY
        own.mkdir(mode=0o700, exist_ok=True)
        issued = make_authority(f"tfbus authority {path.resolve().name}", days)
        write_private(own / KEY_FILE, issued.key)
        _write(own / CERTIFICATE_FILE, issued.certificate)
        write_rights(path / RIGHTS_FILE, Rights())
        return store

    @classmethod
    def open(cls, path: Path) -> "Keystore":
        """The keystore at a path. Raises SettingsError if there is none."""
        store = cls(path)
        if not store._authority_file(CERTIFICATE_FILE).is_file():
            command = shlex.join(["tfbus", "keys", "init", str(path)])
            raise SettingsError(f"{path} has no authority: {command}")
        return store

    @property
    def rights(self) -> Rights:
        """The rights of all identities."""
        return read_rights(self.path / RIGHTS_FILE)

    def add(self, identity: Identity, days: float) -> Path:
        """Make an identity; returns its folder. Raises SettingsError if there is one."""
        rights = self.rights
        if identity.name in rights.identities or identity.name == AUTHORITY:
            raise SettingsError(
                f"there is an identity {identity.name!r} already; its rights are in "
                f"{self.path / RIGHTS_FILE}, and tfbus keys renew makes a new certificate"
            )
        folder = self._issue(identity, days)
        self.set_rights(Rights({**rights.identities, identity.name: identity}))
        return folder

    def renew(self, name: str, days: float) -> Path:
        """Make a new private key and certificate for an identity; returns its folder."""
        identity = self.rights.identity(name)
        if identity.revoked:
            raise SettingsError(
                f"identity {name!r} was revoked on {identity.revoked}: add another name"
            )
        return self._issue(identity, days)

    def revoke(self, name: str) -> None:
        """End all rights of an identity, for all that have the new rights."""
        rights = self.rights
        revoked = replace(rights.identity(name), revoked=f"{datetime.now(UTC):%Y-%m-%d}")
        self.set_rights(Rights({**rights.identities, name: revoked}))

    def set_rights(self, rights: Rights) -> None:
        """Write the rights of all."""
        write_rights(self.path / RIGHTS_FILE, rights)

    def export(self, name: str, target: Path) -> None:
        """Copy an identity's folder, with the rights as they are now, to a place of its own."""
        self.rights.identity(name)
        if target.exists() and any(target.iterdir() if target.is_dir() else [target]):
            raise SettingsError(f"{target} is there already, and not empty: give another place")
        target.mkdir(mode=0o700, parents=True, exist_ok=True)
        for file in OWN_FILES:
            content = (self.path / name / file).read_bytes()
            (write_private if file == KEY_FILE else _write)(target / file, content)
        rights = (self.path / RIGHTS_FILE).read_bytes()
        _write(target / RIGHTS_FILE, rights)
        _write(self.path / name / _EXPORTED_FILE, rights)
        # Former keystores had a copy in each folder, which did not follow the one that is edited.
        (self.path / name / RIGHTS_FILE).unlink(missing_ok=True)

    def listed(self) -> list[Listed]:
        """All identities with what their certificates say."""
        return [
            Listed(identity, self._facts(name)) for name, identity in self.rights.identities.items()
        ]

    def _facts(self, name: str) -> Facts | None:
        try:
            return facts_of((self.path / name / CERTIFICATE_FILE).read_bytes())
        except (OSError, ValueError):
            return None

    def problems(self) -> Iterator[str]:
        """Mistakes of now or of soon: missing, expired, readable by others, not matching."""
        authority = self._authority_file(CERTIFICATE_FILE).read_bytes()
        yield from _time_problems("the authority", facts_of(authority))
        key = self._authority_file(KEY_FILE)
        if key.exists():
            yield from _key_problems(key)
        rights = self.rights
        for name, identity in rights.identities.items():
            folder = self.path / name
            yield from _exported_problems(name, folder, rights)
            if identity.revoked:
                continue
            missing = [file for file in OWN_FILES if not (folder / file).is_file()]
            if missing:
                yield f"{name}: {counted(len(missing), 'file')} missing: {', '.join(missing)}"
                continue
            yield from _key_problems(folder / KEY_FILE)
            yield from _certificate_problems(name, folder, authority)

    def _issue(self, identity: Identity, days: float) -> Path:
        authority = self._read_authority()
        issued = issue(authority, identity.name, days, identity.hosts)
        folder = self.path / identity.name
        folder.mkdir(mode=0o700, exist_ok=True)
        write_private(folder / KEY_FILE, issued.key)
        _write(folder / CERTIFICATE_FILE, issued.certificate)
        _write(folder / AUTHORITY_FILE, authority.certificate)
        facts = facts_of(issued.certificate)
        _write(folder / NAME_FILE, name_file(facts.name, facts.begins, facts.ends))
        return folder

    def _read_authority(self) -> Issued:
        key = self._authority_file(KEY_FILE)
        if not key.is_file():
            raise SettingsError(
                f"{self.path} has no private key of the authority ({key}): it is needed to make "
                "identities, and nowhere else"
            )
        check_key_is_own(key)
        return Issued(self._authority_file(CERTIFICATE_FILE).read_bytes(), key.read_bytes())

    def _authority_file(self, name: str) -> Path:
        return self.path / AUTHORITY / name


def write_private(path: Path, content: bytes) -> None:
    """Write a file that only its owner can read, from its first byte, whole or not at all."""
    with taking_place_of(path) as beside:
        descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)


def _write(path: Path, content: bytes) -> None:
    with replacing(path) as file:
        file.write(content)


def _key_problems(path: Path) -> Iterator[str]:
    try:
        check_key_is_own(path)
    except SettingsError as error:
        yield str(error)


def _exported_problems(name: str, folder: Path, rights: Rights) -> Iterator[str]:
    """Whether the machine of an identity has other rights than those that are to be in force."""
    # Of a keystore of before, it has what the copy in the folder says.
    places = [folder / file for file in (_EXPORTED_FILE, RIGHTS_FILE) if (folder / file).is_file()]
    if not places or rights.identities[name].revoked:
        return
    try:
        had = read_rights(places[0]).identities
    except TfbusError:
        had = {}
    now = rights.identities
    changed = sorted(each for each in {*had, *now} if had.get(each) != now.get(each))
    if changed:
        yield (
            f"{name}: its machine has the former rights of {listed(changed)}: "
            f"tfbus keys export {name}, copy the folder, or its {RIGHTS_FILE}, there, and restart "
            "what runs there"
        )


def _certificate_problems(name: str, folder: Path, authority: bytes) -> Iterator[str]:
    pem = (folder / CERTIFICATE_FILE).read_bytes()
    try:
        facts = facts_of(pem)
        if not is_key_of((folder / KEY_FILE).read_bytes(), pem):
            yield f"{name}: its private key is not that of its certificate: tfbus keys renew {name}"
    except ValueError as error:
        yield f"{name}: a file is not a certificate or key: {error}"
        return
    if facts.name != name:
        yield f"{name}: its certificate is of {facts.name!r}: tfbus keys renew {name}"
    if not is_signed_by(pem, authority):
        yield f"{name}: its certificate is of another authority: tfbus keys renew {name}"
    yield from _time_problems(name, facts)


def _time_problems(name: str, facts: Facts) -> Iterator[str]:
    if mistake := facts.mistake():
        yield f"{name}: {mistake}"
    elif facts.ends - datetime.now(UTC) < _SOON:
        yield f"{name}: expires on {facts.ends:%Y-%m-%d}: tfbus keys renew {name}"
