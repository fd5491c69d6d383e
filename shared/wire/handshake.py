"""Finds out why a router of a closed fleet does not let an identity in.

Zenoh reports every refusal as a timeout. This module makes a TLS handshake of its own with the
same certificates and says what the two sides object to.
"""

from __future__ import annotations

import socket
import ssl
from contextlib import suppress
from datetime import UTC, datetime

from nufleet.shared.wire.identity import Identity, IdentityError

TIMEOUT_S = 3.0
ALERT_S = 2.0
"""Time that a router has to object after its side of the handshake is complete: in TLS 1.3 the
client has finished before its certificate is judged."""

_WITHOUT_TLS = "the port does not speak TLS: it is no router of a closed fleet"
_NOT_YET, _EXPIRED, _NAMES = 9, 10, (62, 64)
"""Codes of OpenSSL's verification (X509_V_ERR_...)."""


def why_refused(identity: Identity) -> str | None:
    """Return why the router refuses an identity; None when its TLS handshake succeeds.

    Args:
        identity: Identity that could not connect.
    """
    host, port = _address(identity.router)
    try:
        clock = _clock_problem(identity)
        if clock is not None:
            return clock
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.load_verify_locations(cadata=identity.authority)
        context.load_cert_chain(identity.path, identity.key)
    except IdentityError as error:
        return str(error)
    except (ssl.SSLError, OSError) as error:
        return (
            f"the certificate of {identity.path} does not fit the key {identity.key} ({error}): "
            "put the key beside it that was made for it"
        )
    try:
        with socket.create_connection((host, port), timeout=TIMEOUT_S) as plain:
            return _handshake(context, plain, identity, host)
    except ConnectionRefusedError:
        return f"no program listens at {host}, port {port}: start the router there"
    except socket.gaierror as error:
        return f"the name {host} of the router is unknown here ({error.strerror})"
    except OSError as error:
        return f"{host}, port {port}, cannot be reached ({error}): check address and firewall"


def _handshake(
    context: ssl.SSLContext, plain: socket.socket, identity: Identity, host: str
) -> str | None:
    authority = f"the authority of fleet {identity.fleet} that {identity.path} names"
    try:
        with context.wrap_socket(plain, server_hostname=host) as secured:
            secured.settimeout(ALERT_S)
            with suppress(TimeoutError):
                secured.recv(1)
    except TimeoutError:
        return _WITHOUT_TLS
    except ssl.SSLCertVerificationError as error:
        if error.verify_code == _EXPIRED:
            return "the router's certificate has expired: `nufleet fleet renew --router`"
        if error.verify_code == _NOT_YET:
            return f"the router's certificate is not yet valid; the clock here is {_now()}"
        if error.verify_code in _NAMES:
            return (
                f"the router's certificate is for another name than {host}: add it to `addresses` "
                "of [router] in the inventory, then `nufleet fleet renew --router`"
            )
        return (
            f"the router's certificate was not made by {authority}: it is the router of another "
            f"fleet, or its authority was replaced ({error.verify_message})"
        )
    except ssl.SSLError as error:
        return _objection(error, identity)
    except ConnectionResetError:
        return "the router ended the handshake"
    return None


def _objection(error: ssl.SSLError, identity: Identity) -> str:
    said = (error.reason or str(error)).lower().replace(" ", "_")
    if "wrong_version" in said or "record_layer" in said or "eof" in said:
        return _WITHOUT_TLS
    if "expired" in said:
        return f"the router says that the certificate of {identity.principal} is not valid now"
    # Another authority of the same name shows in its signature alone.
    if "unknown_ca" in said or "decrypt_error" in said:
        return (
            f"the router does not know the authority that signed the certificate of "
            f"{identity.principal}: it belongs to another fleet, or was not restarted"
        )
    return f"the router refuses the certificate of {identity.principal} ({said})"


def _clock_problem(identity: Identity) -> str | None:
    start, end = validity(identity)
    now = datetime.now(UTC)
    if now > end:
        return (
            f"the certificate of {identity.principal} expired on {end:%Y-%m-%d %H:%M} UTC "
            f"(the clock here is {_now()}): `nufleet fleet renew {identity.principal}`"
        )
    if now < start:
        return (
            f"the certificate of {identity.principal} is valid from {start:%Y-%m-%d %H:%M} UTC on, "
            f"and the clock here is {_now()}: set the clock"
        )
    return None


def validity(identity: Identity) -> tuple[datetime, datetime]:
    """Return the times from which and until which an identity's certificate is valid, in UTC.

    Raises:
        IdentityError: The identity holds none.
    """
    # Loaded only when there is something to explain: it takes a while.
    from cryptography import x509

    try:
        certificate = x509.load_pem_x509_certificate(identity.certificate.encode())
    except ValueError as error:
        raise IdentityError(
            f"{identity.path} holds no valid certificate: copy the file again, or renew it"
        ) from error
    return certificate.not_valid_before_utc, certificate.not_valid_after_utc


def _now() -> str:
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"


def _address(endpoint: str) -> tuple[str, int]:
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    return host.strip("[]"), int(port)
