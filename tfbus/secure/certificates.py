"""Certificates and private keys, by the library `cryptography`: elliptic curve P-256, X.509."""

import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

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
    except Exception:  # of several kinds: another issuer, another key, a spoilt signature
        return False
    return True


def is_key_of(key: bytes, pem: bytes) -> bool:
    """Whether a private key is that of a certificate."""
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
        return x509.DNSName(host)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def _read_key(pem: bytes) -> ec.EllipticCurvePrivateKey:
    key = serialization.load_pem_private_key(pem, None)
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise ValueError("the private key is not of an elliptic curve")
    return key
