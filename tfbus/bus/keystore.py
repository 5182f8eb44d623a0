"""The authority of a closed bus: its folder, and the certificates that it issues.

It makes identities, renews and revokes them, and checks all. Certificates are X.509 with the
elliptic curve P-256, by the library `cryptography`; a server for browsers has one of its own.
"""

import ipaddress
import os
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from tfbus.base.errors import SettingsError, TfbusError
from tfbus.base.file_lock import locked
from tfbus.base.whole_file import replacing, taking_place_of
from tfbus.base.wording import counted, listed, printable
from tfbus.bus.identity_folder import (
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
from tfbus.bus.rights import Identity, Rights

# A certificate holds from a moment before it was made: another machine's clock may be behind.
_BEFORE = timedelta(minutes=10)


@dataclass(frozen=True)
class Issued:
    """A certificate, and its private key if it was just made; in PEM."""

    certificate: bytes
    key: bytes


@dataclass(frozen=True)
class Facts:
    """The contents of a certificate: whose it is, by whom, from when until when, in UTC."""

    name: str
    issuer: str
    begins: datetime
    ends: datetime
    hosts: tuple[str, ...]

    def mistake(self, now: datetime | None = None) -> str:
        """Why it is not valid at a time (None: now); "" if it is."""
        now = now or datetime.now(UTC)
        if now < self.begins:
            return (
                f"not valid before {self.begins:%Y-%m-%d %H:%M} UTC: is this machine's clock right?"
            )
        return f"expired on {self.ends:%Y-%m-%d}" if now > self.ends else ""


def make_authority(name: str, days: float) -> Issued:
    """A certificate authority that signs itself and only identities, no other authority."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = _name(name)
    certificate = (
        _builder(subject, subject, key.public_key(), days)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs_certificates=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    return Issued(_pem(certificate), _key_pem(key))


def issue(authority: Issued, name: str, days: float, hosts: Sequence[str] = ()) -> Issued:
    """A new private key, and the authority's certificate that it is of identity `name`.

    It ends with the authority's at the latest. `hosts` are names and addresses of its machine.
    """
    signer = _read_key(authority.key)
    parent = x509.load_pem_x509_certificate(authority.certificate)
    key = ec.generate_private_key(ec.SECP256R1())
    both = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    certificate = (
        _builder(_name(name), parent.subject, key.public_key(), days, parent.not_valid_after_utc)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(both), critical=False)
        .add_extension(
            x509.SubjectAlternativeName([_host(host) for host in hosts or (name,)]), critical=False
        )
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()), critical=False
        )
        .sign(signer, hashes.SHA256())
    )
    return Issued(_pem(certificate), _key_pem(key))


def make_for_server(hosts: Sequence[str], days: float) -> Issued:
    """A certificate that signs itself, for a server under these names and addresses."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name("tfbus")
    certificate = (
        _builder(name, name, key.public_key(), days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.SubjectAlternativeName([_host(host) for host in hosts]), critical=False)
        .sign(key, hashes.SHA256())
    )
    return Issued(_pem(certificate), _key_pem(key))


def fingerprint_of(pem: bytes) -> str:
    """The SHA-256 fingerprint of a certificate, as browsers show it."""
    return x509.load_pem_x509_certificate(pem).fingerprint(hashes.SHA256()).hex(":").upper()


def facts_of(pem: bytes) -> Facts:
    """The contents of a certificate. Raises ValueError if it is none."""
    certificate = x509.load_pem_x509_certificate(pem)
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        hosts = tuple(str(name.value) for name in names)
    except x509.ExtensionNotFound:
        hosts = ()
    return Facts(
        _common_name(certificate.subject),
        _common_name(certificate.issuer),
        certificate.not_valid_before_utc,
        certificate.not_valid_after_utc,
        hosts,
    )


def is_signed_by(pem: bytes, authority: bytes) -> bool:
    """Whether an authority signed a certificate."""
    parent = x509.load_pem_x509_certificate(authority)
    try:
        x509.load_pem_x509_certificate(pem).verify_directly_issued_by(parent)
    # Another issuer, another kind of key, a spoilt signature, another algorithm.
    except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm):
        return False
    return True


def is_key_of(key: bytes, pem: bytes) -> bool:
    """Whether a private key is a certificate's."""
    public = x509.load_pem_x509_certificate(pem).public_key()
    return _read_key(key).public_key() == public


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    public_key: ec.EllipticCurvePublicKey,
    days: float,
    latest: datetime | None = None,
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    ends = now + timedelta(days=days)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _BEFORE)
        .not_valid_after(min(ends, latest) if latest else ends)
    )


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _common_name(name: x509.Name) -> str:
    found = name.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(found[0].value) if found else ""


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    try:
        if host:
            return x509.DNSName(host)
    except ValueError:  # letters beyond ASCII
        pass
    raise SettingsError(
        f"'{printable(host, 60)}' is no name or address of a machine: use ASCII letters, digits, "
        "'-' and '.', or an address such as 10.0.0.7"
    )


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def _read_key(pem: bytes) -> ec.EllipticCurvePrivateKey:
    """A private key. Raises ValueError if it is none, or encrypted."""
    try:
        key = serialization.load_pem_private_key(pem, None)
    except TypeError as error:
        raise ValueError("the private key is encrypted") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise ValueError("the private key is not of an elliptic curve")
    return key


# The rights that an identity's folder had when it was exported last: its machine has them.
_EXPORTED_FILE = "exported.yaml"
_SOON = timedelta(days=30)
_NEW_AUTHORITY = "tfbus keys init DIR makes a new one, which needs new identities"
# X.509's limit of a common name.
_MOST_NAME_BYTES = 64


@dataclass(frozen=True)
class Listed:
    """An identity and its certificate's facts; None if that cannot be read."""

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
        key, certificate = map(store._authority_file, (KEY_FILE, CERTIFICATE_FILE))
        # The private key may be kept elsewhere.
        if certificate.exists():
            raise SettingsError(f"{path} has an authority already; tfbus keys add makes identities")
        for left in (key, path / RIGHTS_FILE):
            if left.exists():
                raise SettingsError(
                    f"{path} had an authority, and has {left} of it: put back its certificate "
                    f"{certificate}, which each identity has as {AUTHORITY_FILE}, or remove {left}"
                )
        path.mkdir(parents=True, exist_ok=True)
        certificate.parent.mkdir(mode=0o700, exist_ok=True)
        issued = make_authority(_authority_name(path), days)
        write_private(key, issued.key)
        write_rights(path / RIGHTS_FILE, Rights())
        _write(certificate, issued.certificate)
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
        with locked(self.path, waits=True):
            known = self.rights.identities
            if identity.name in known or identity.name == AUTHORITY:
                raise SettingsError(
                    f"there is an identity {identity.name!r} already; its rights are in "
                    f"{self.path / RIGHTS_FILE}, and tfbus keys renew makes a new certificate"
                )
            rights = Rights({**known, identity.name: identity})
            folder = self._issue(identity, days)
            self.set_rights(rights)
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
        with locked(self.path, waits=True):
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
        """All identities with their certificates' facts."""
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
        try:
            yield from _time_problems("the authority", facts_of(authority), _NEW_AUTHORITY)
            if self._authority_file(KEY_FILE).exists():
                self._read_authority()
        except SettingsError as error:
            yield str(error)
        except ValueError as error:
            yield f"{self._authority_file(CERTIFICATE_FILE)} is no certificate: {error}"
            return
        rights = self.rights
        former: dict[tuple[str, ...], list[str]] = {}
        for name, identity in rights.identities.items():
            folder = self.path / name
            if changed := _changed_since_export(name, folder, rights):
                former.setdefault(changed, []).append(name)
            if identity.revoked:
                continue
            missing = [file for file in OWN_FILES if not (folder / file).is_file()]
            if missing:
                yield f"{name}: {counted(len(missing), 'file')} missing: {', '.join(missing)}"
                continue
            yield from _key_problems(folder / KEY_FILE)
            yield from _certificate_problems(name, folder, authority)
        for changed, names in former.items():
            yield _former_rights(changed, names)

    def _issue(self, identity: Identity, days: float) -> Path:
        authority = self._read_authority()
        if mistake := facts_of(authority.certificate).mistake():
            raise SettingsError(f"the authority of {self.path}: {mistake}; {_NEW_AUTHORITY}")
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
        issued = Issued(self._authority_file(CERTIFICATE_FILE).read_bytes(), key.read_bytes())
        try:
            if not is_key_of(issued.key, issued.certificate):
                raise ValueError("the private key is not that of the certificate")
        except ValueError as error:
            raise SettingsError(
                f"{key} and {CERTIFICATE_FILE} beside it are no authority: {error}; put back both "
                "as tfbus keys init made them"
            ) from error
        return issued

    def _authority_file(self, name: str) -> Path:
        return self.path / AUTHORITY / name


def _authority_name(folder: Path) -> str:
    name = f"tfbus authority {folder.resolve().name}"
    return name.encode("utf-8", "replace")[:_MOST_NAME_BYTES].decode("utf-8", "ignore")


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


def _changed_since_export(name: str, folder: Path, rights: Rights) -> tuple[str, ...]:
    """The identities of which the machine of this one has other rights than are to be in force."""
    # Of a keystore of before, it has the rights of the copy in the folder.
    places = [folder / file for file in (_EXPORTED_FILE, RIGHTS_FILE) if (folder / file).is_file()]
    if not places or rights.identities[name].revoked:
        return ()
    try:
        had = read_rights(places[0]).identities
    except TfbusError:
        had = {}
    now = rights.identities
    return tuple(sorted(each for each in {*had, *now} if had.get(each) != now.get(each)))


def _former_rights(changed: Sequence[str], names: Sequence[str]) -> str:
    """The sentence on machines that have the former rights of the changed identities."""
    if len(names) == 1:
        return (
            f"{names[0]}: its machine has the former rights of {listed(changed)}: "
            f"tfbus keys export {names[0]}, copy the folder, or its {RIGHTS_FILE}, there, and "
            "restart what runs there"
        )
    return (
        f"{listed(names)}: their machines have the former rights of {listed(changed)}: "
        f"tfbus keys export each, copy the folder, or its {RIGHTS_FILE}, there, and restart what "
        "runs there"
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
    yield from _time_problems(name, facts, f"tfbus keys renew {name}")


def _time_problems(name: str, facts: Facts, remedy: str) -> Iterator[str]:
    if mistake := facts.mistake():
        yield f"{name}: {mistake}"
    elif facts.ends - datetime.now(UTC) < _SOON:
        yield f"{name}: expires on {facts.ends:%Y-%m-%d}: {remedy}"
