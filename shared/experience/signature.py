"""Signatures of experiences: the robot that learned one signs it with the key of its identity.

A signature lies in the experience's own file, beside its manifest, and so reaches every robot that
the file reaches. Keys of identities are Ed25519, and so are signatures (RFC 8032). The end of the
certificate does not matter here: it limits connections, and what was learned before stays true.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from nufleet.shared.errors import NufleetError
from nufleet.shared.strict import Strict


class UntrustedError(NufleetError):
    """A signature that does not prove who signed; the message is the end of a sentence about it."""


class Signature(Strict):
    """A signature and the certificate of its signer."""

    certificate: Annotated[str, Field(max_length=8192)]
    """Certificate of the signer in PEM."""
    value: Annotated[str, Field(pattern=r"^[0-9a-f]{128}$")]
    """Ed25519 signature in hexadecimal."""


def sign(content: bytes, key: bytes, certificate: str) -> Signature:
    """Return the signature of some content.

    Args:
        content: What is signed.
        key: Private key of the signer in PEM, Ed25519 and unencrypted.
        certificate: Certificate of the signer in PEM.

    Raises:
        UntrustedError: The key is of another kind.
    """
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        signer = load_pem_private_key(key, password=None)
    except (ValueError, TypeError):  # without the cause, which may quote the file
        signer = None
    if not isinstance(signer, Ed25519PrivateKey):
        raise UntrustedError("its key is not an unencrypted Ed25519 key in PEM")
    return Signature(certificate=certificate, value=signer.sign(content).hex())


def common_name_of(certificate: str) -> str:
    """Return the common name in a certificate in PEM.

    Raises:
        UntrustedError: It is not a certificate, or has no common name.
    """
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    try:
        subject = x509.load_pem_x509_certificate(certificate.encode()).subject
        (name,) = subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    except ValueError as error:
        raise UntrustedError("its signature comes without a valid certificate") from error
    return str(name.value)


def signer_of(signature: Signature, content: bytes, authorities: str) -> str:
    """Return the common name in the certificate of the signer, after both have been verified.

    Args:
        signature: The signature.
        content: What was signed.
        authorities: Certificates of the authorities that are trusted, in PEM.

    Raises:
        UntrustedError: The certificate is not of one of these authorities, or something was
            altered after it was signed.
    """
    from cryptography import x509
    from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    signer = common_name_of(signature.certificate)
    certificate = x509.load_pem_x509_certificate(signature.certificate.encode())
    for authority in x509.load_pem_x509_certificates(authorities.encode()):
        try:
            certificate.verify_directly_issued_by(authority)
            break
        except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm):
            continue
    else:
        raise UntrustedError("it was signed under another authority than this fleet's")
    try:
        key = certificate.public_key()
        if not isinstance(key, Ed25519PublicKey):
            raise UntrustedError("its certificate was not made by `nufleet fleet enroll`")
        key.verify(bytes.fromhex(signature.value), content)
    except InvalidSignature as error:
        raise UntrustedError("it was altered after it was signed") from error
    return signer
