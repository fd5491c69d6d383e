"""Keys, certificates and requests for certificates of a closed fleet, all Ed25519 and X.509.

Each certificate has one use: a router's serves only, all others connect only, so that the key of a
stolen robot cannot pretend to be the router.
"""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from nufleet.shared.errors import InvalidInputError

AUTHORITY_DAYS = 3650
CLOCKS_DIFFER = timedelta(hours=1)
"""Time by which certificates begin before they are made, since the clocks of robots differ."""

MAX_REQUEST_BYTES = 16 * 1024


def new_key() -> Ed25519PrivateKey:
    """Return a new private key."""
    return Ed25519PrivateKey.generate()


def key_pem(key: Ed25519PrivateKey) -> bytes:
    """Return a private key in PEM (PKCS #8), unencrypted, as Zenoh reads it."""
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def read_key(pem: bytes, where: str) -> Ed25519PrivateKey:
    """Return the private key of a file's contents.

    Args:
        pem: Contents of the file.
        where: Name of the file, for the error message.

    Raises:
        InvalidInputError: It is not an Ed25519 key; the message holds nothing of the contents.
    """
    try:
        key = serialization.load_pem_private_key(pem, password=None)
    except (ValueError, TypeError):
        key = None
    if not isinstance(key, Ed25519PrivateKey):
        raise InvalidInputError(f"{where} does not hold an unencrypted Ed25519 key in PEM")
    return key


def public_pem(key: Ed25519PublicKey) -> str:
    """Return a public key in PEM."""
    encoding, form = serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo
    return key.public_bytes(encoding, form).decode()


def read_public(pem: str) -> Ed25519PublicKey:
    """Return the public key that `public_pem` wrote."""
    key = serialization.load_pem_public_key(pem.encode())
    if not isinstance(key, Ed25519PublicKey):
        raise InvalidInputError("the ledger holds a key that is not Ed25519")
    return key


def request_pem(key: Ed25519PrivateKey, name: str) -> bytes:
    """Return a request for a certificate of a key, signed with the key."""
    request = x509.CertificateSigningRequestBuilder().subject_name(_subject(name)).sign(key, None)
    return request.public_bytes(serialization.Encoding.PEM)


def requested_key(pem: bytes, name: str, where: str) -> Ed25519PublicKey:
    """Return the public key of a request; nothing else in it counts.

    Args:
        pem: Contents of the request's file.
        name: Principal that the request must be for.
        where: Name of the file, for error messages.

    Raises:
        InvalidInputError: It is no request, was altered, or is for another principal.
    """
    try:
        request = x509.load_pem_x509_csr(pem)
        key = request.public_key()
        signed = request.is_signature_valid
    except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm) as error:
        raise InvalidInputError(f"{where} is not a request of `nufleet fleet request`") from error
    named = [str(part.value) for part in request.subject]
    if not signed or not isinstance(key, Ed25519PublicKey):
        raise InvalidInputError(f"{where} was altered, or is not a request of `nufleet`")
    if named != [name]:
        raise InvalidInputError(f"{where} is a request of {', '.join(named)}, not of {name}")
    return key


def authority_certificate(fleet: str, key: Ed25519PrivateKey, now: datetime) -> x509.Certificate:
    """Return the certificate of a fleet's authority, which it signs itself."""
    usage = x509.KeyUsage(
        digital_signature=False,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=True,
        crl_sign=True,
        encipher_only=False,
        decipher_only=False,
    )
    subject = _subject(f"{fleet} authority")
    return (
        _builder(key.public_key(), subject, subject, now, timedelta(days=AUTHORITY_DAYS))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, None)
    )


@dataclass(frozen=True)
class Issuer:
    """An authority, which signs the certificates of its fleet."""

    certificate: x509.Certificate
    """Its own certificate."""
    key: Ed25519PrivateKey
    """Its key."""

    @property
    def serial(self) -> str:
        """Serial number of its certificate, in hexadecimal."""
        return f"{self.certificate.serial_number:x}"

    def issue(
        self,
        common_name: str,
        key: Ed25519PublicKey,
        now: datetime,
        life: timedelta,
        *,
        serves_at: tuple[str, ...] = (),
    ) -> x509.Certificate:
        """Return a certificate with which a principal connects, or with which a router serves.

        Args:
            common_name: Name by which the router's list knows a principal.
            key: Public key of the principal or of the router.
            now: Present time, with time zone.
            life: Time for which the certificate is valid.
            serves_at: IP addresses and host names at which a router is reached. A certificate
                with any of them serves only, one without them connects only.
        """
        above = x509.AuthorityKeyIdentifier.from_issuer_public_key(self.key.public_key())
        use = ExtendedKeyUsageOID.SERVER_AUTH if serves_at else ExtendedKeyUsageOID.CLIENT_AUTH
        builder = (
            _builder(key, _subject(common_name), self.certificate.subject, now, life)
            .add_extension(x509.ExtendedKeyUsage([use]), critical=True)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(above, critical=False)
        )
        if serves_at:
            names = x509.SubjectAlternativeName([_address(address) for address in serves_at])
            builder = builder.add_extension(names, critical=False)
        return builder.sign(self.key, None)


def certificate_pem(certificate: x509.Certificate) -> str:
    """Return a certificate in PEM."""
    return certificate.public_bytes(serialization.Encoding.PEM).decode()


def read_issuers(pem: bytes, key: Ed25519PrivateKey) -> tuple[Issuer, tuple[x509.Certificate, ...]]:
    """Return the authority that has a key, and the others in a file's contents.

    There is another one while an authority is being replaced.

    Raises:
        ValueError: No certificate in the file belongs to the key.
    """
    found, public = x509.load_pem_x509_certificates(pem), key.public_key()
    own = next((one for one in found if one.public_key() == public), None)
    if own is None:
        raise ValueError("no certificate of the authority belongs to its key")
    return Issuer(own, key), tuple(one for one in found if one != own)


def utc_now() -> datetime:
    """Return the present time in UTC."""
    return datetime.now(UTC)


def _builder(
    key: Ed25519PublicKey, subject: x509.Name, issuer: x509.Name, now: datetime, life: timedelta
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .public_key(key)
        .subject_name(subject)
        .issuer_name(issuer)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCKS_DIFFER)
        .not_valid_after(now + life)
    )


def _subject(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _address(address: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(address))
    except ValueError:
        return x509.DNSName(address)
