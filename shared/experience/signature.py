"""Signatures of experiences: the robot that learned one signs it with the key of its identity.

A signature lies in the experience's own file, beside its manifest, and so reaches every robot that
the file reaches. Keys of identities are Ed25519, and so are signatures (RFC 8032). What is signed
includes the time, at which the certificate has to be valid; a signature still counts when the
certificate has ended since. The time is the signer's word: who has its key can state an earlier
one, and only a revocation ends that.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from nufleet.shared.errors import NufleetError
from nufleet.shared.strict import Strict

if TYPE_CHECKING:
    from cryptography import x509


MAX_TIME_S = 253_402_300_799
"""The end of the year 9999, beyond which no certificate is valid."""


class UntrustedError(NufleetError):
    """A signature that does not prove who signed; the message is the end of a sentence about it."""


class Signature(Strict):
    """A signature and the certificate of its signer."""

    certificate: Annotated[str, Field(max_length=8192)]
    """Certificate of the signer in PEM."""
    signed_at_s: Annotated[int, Field(ge=0, le=MAX_TIME_S)]
    """Time at which it was signed, in s since 1970 (UTC)."""
    value: Annotated[str, Field(pattern=r"^[0-9a-f]{128}$")]
    """Ed25519 signature in hexadecimal."""


def sign(content: bytes, key: bytes, certificate: str, now: datetime) -> Signature:
    """Return the signature of some content.

    Args:
        content: What is signed.
        key: Private key of the signer in PEM, Ed25519 and unencrypted.
        certificate: Certificate of the signer in PEM.
        now: Present time, with time zone.

    Raises:
        UntrustedError: The key is of another kind, or the certificate is not valid now.
    """
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        signer = load_pem_private_key(key, password=None)
    except (ValueError, TypeError):  # without the cause, which may quote the file
        signer = None
    if not isinstance(signer, Ed25519PrivateKey):
        raise UntrustedError("its key is not an unencrypted Ed25519 key in PEM")
    at_s = int(now.timestamp())
    _check_valid(_loaded(certificate), at_s)
    value = signer.sign(_statement(content, at_s)).hex()
    return Signature(certificate=certificate, signed_at_s=at_s, value=value)


def common_name_of(certificate: str) -> str:
    """Return the common name in a certificate in PEM.

    Raises:
        UntrustedError: It is not a certificate, or has no common name.
    """
    from cryptography.x509.oid import NameOID

    try:
        (name,) = _loaded(certificate).subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    except ValueError as error:
        raise UntrustedError("its signature comes without a valid certificate") from error
    return str(name.value)


def authority_of(certificate: str, authorities: str) -> str:
    """Return the one of several certificates of authorities that signed a certificate, in PEM.

    Args:
        certificate: Certificate in PEM.
        authorities: Certificates of the authorities that are trusted, in PEM.

    Raises:
        UntrustedError: None of them signed it.
    """
    from cryptography import x509
    from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
    from cryptography.hazmat.primitives.serialization import Encoding

    signed = _loaded(certificate)
    try:
        trusted = x509.load_pem_x509_certificates(authorities.encode())
    except ValueError as error:
        raise UntrustedError("the robot's own identity names no valid authority") from error
    for authority in trusted:
        try:
            signed.verify_directly_issued_by(authority)
        except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm):
            continue
        return authority.public_bytes(Encoding.PEM).decode()
    raise UntrustedError("it was signed under another authority than this fleet's")


def signer_of(signature: Signature, content: bytes, authorities: str) -> str:
    """Return the common name in the certificate of the signer, after both have been verified.

    Args:
        signature: Signature to verify.
        content: What was signed.
        authorities: Certificates of the authorities that are trusted, in PEM.

    Raises:
        UntrustedError: The certificate is not of one of these authorities or was not valid when it
            was used, or something was altered after it was signed.
    """
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    signer = common_name_of(signature.certificate)
    authority_of(signature.certificate, authorities)
    certificate = _loaded(signature.certificate)
    try:
        key = certificate.public_key()
        if not isinstance(key, Ed25519PublicKey):
            raise UntrustedError("its certificate was not made by `nufleet fleet enroll`")
        key.verify(bytes.fromhex(signature.value), _statement(content, signature.signed_at_s))
    except InvalidSignature as error:
        raise UntrustedError("it was altered after it was signed") from error
    _check_valid(certificate, signature.signed_at_s)
    return signer


def _loaded(certificate: str) -> x509.Certificate:
    from cryptography import x509

    try:
        return x509.load_pem_x509_certificate(certificate.encode())
    except ValueError as error:
        raise UntrustedError("its signature comes without a valid certificate") from error


def _check_valid(certificate: x509.Certificate, at_s: int) -> None:
    """Raise UntrustedError unless a certificate is valid at a time in s since 1970."""
    at = datetime.fromtimestamp(at_s, UTC)
    begins, ends = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if not begins <= at <= ends:
        raise UntrustedError(
            f"it was signed on {at:%Y-%m-%d %H:%M} UTC with a certificate that is valid from "
            f"{begins:%Y-%m-%d %H:%M} to {ends:%Y-%m-%d %H:%M}"
        )


def _statement(content: bytes, at_s: int) -> bytes:
    """Return what the key signs: the content and the time, which has a fixed length."""
    return at_s.to_bytes(8, "big") + content
