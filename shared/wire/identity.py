"""Identity files: how to reach a closed fleet, and as which of its principals.

An identity file is TOML with the fleet, the principal, the router's endpoint, and two certificates
in PEM, so that programs that read PEM read it as well. The private key is in a file of its own
beside it (`desk.key` beside `desk.nufleet`), which never leaves the machine that uses it. The file
is checked without pydantic, because a stop must not wait for heavy imports.
"""

from __future__ import annotations

import logging
import os
import re
from dataclasses import dataclass
from pathlib import Path

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.private_files import check_private
from nufleet.shared.text import is_name, read_toml

SCHEME = "identity/"
"""Beginning of an address that names an identity file instead of an endpoint."""

IDENTITY_VARIABLE = "NUFLEET_IDENTITY"
SUFFIX, KEY_SUFFIX = ".nufleet", ".key"
ROLES = ("robot", "orchestrator", "operator", "watcher")
_log = logging.getLogger(__name__)
_ROUTER = re.compile(r"tls/(\[[0-9A-Fa-f:.]+\]|[0-9A-Za-z.-]+):[0-9]{1,5}")
_FIELDS = ("fleet", "principal", "role", "router", "certificate", "authority")


class IdentityError(InvalidInputError):
    """An identity that cannot be used: names the file, what is wrong, and what to do."""


@dataclass(frozen=True)
class Identity:
    """One principal of one fleet, as its identity file describes it."""

    path: Path
    """Identity file."""
    fleet: str
    """Name of the fleet."""
    principal: str
    """Name of the principal in the fleet's inventory."""
    role: str
    """Role of the principal, one of `ROLES`."""
    router: str
    """Endpoint of the router, such as `tls/192.168.1.10:7447`."""
    certificate: str
    """Certificate of the principal in PEM."""
    authority: str
    """Certificate of the fleet's authority in PEM, or several while it is being replaced."""

    @property
    def key(self) -> Path:
        """File with the private key, beside the identity file."""
        return self.path.with_suffix(KEY_SUFFIX)

    def now(self) -> Identity:
        """Return the identity as its file is now, which may have been renewed since it was read.

        If the file cannot be used, this identity is returned and a warning says why.
        """
        try:
            return read_identity(self.path)
        except IdentityError as error:
            _log.warning("%s", error)
            return self

    def zenoh_settings(self) -> dict[str, object]:
        """Return Zenoh's settings of `transport/link/tls`.

        All are given as files, which Zenoh reads at each connection: what is renewed takes effect
        at the next one. The identity's own certificate thus counts as an authority to itself,
        which lets no one in who does not hold its key already.
        """
        return {
            "root_ca_certificate": str(self.path),
            "connect_certificate": str(self.path),
            "connect_private_key": str(self.key),
            "enable_mtls": True,
            "verify_name_on_connect": True,
        }


def identity_text(identity: Identity) -> str:
    """Return the contents of an identity's file; it holds no secret."""
    return (
        f'schema = 1\nfleet = "{identity.fleet}"\nprincipal = "{identity.principal}"\n'
        f'role = "{identity.role}"\nrouter = "{identity.router}"\n'
        # Its own certificate comes first: Zenoh presents all that it finds in this order.
        f'certificate = """\n{identity.certificate}"""\nauthority = """\n{identity.authority}"""\n'
    )


def read_identity(path: Path) -> Identity:
    """Read an identity file and check that its key is there and private.

    Args:
        path: Identity file.

    Raises:
        IdentityError: A file is missing or wrong, or the key can be read by other users.
    """
    path = path.absolute()
    document = read_toml(path, IdentityError)
    schema = document.pop("schema", None)
    wrong = sorted(set(document) ^ set(_FIELDS))
    texts = (name for name in _FIELDS if not isinstance(document.get(name, ""), str))
    wrong += sorted(set(texts) - set(wrong))
    if schema != 1 or wrong:
        problem = f"wrong or missing: {', '.join(wrong)}" if wrong else "schema 1 was expected"
        raise IdentityError(
            f"{path} is not an identity file ({problem}); `nufleet fleet enroll` writes one"
        )
    identity = Identity(path, **document)
    _check(identity)
    return identity


def _check(identity: Identity) -> None:
    path, key = identity.path, identity.key
    names = is_name(identity.fleet) and is_name(identity.principal)
    if not names or identity.role not in ROLES or not _ROUTER.fullmatch(identity.router):
        raise IdentityError(
            f"{path} is not an identity file: fleet, principal, role or router is not valid; "
            "`nufleet fleet enroll` writes one"
        )
    certificates = identity.certificate, identity.authority
    if not all("-----BEGIN CERTIFICATE" in pem for pem in certificates):
        raise IdentityError(f"{path} is not an identity file: a certificate is not in PEM")
    try:
        check_private(key)
    except OSError as error:
        raise IdentityError(
            f"the key of {path} is missing: {key} ({error.strerror}); it was made where `nufleet "
            "fleet request` or `enroll` ran, and has to lie beside the identity"
        ) from error
    except InvalidInputError as error:
        raise IdentityError(str(error)) from error


def identity_folder() -> Path:
    """Return the user's folder for identities (XDG Base Directory Specification)."""
    base = os.environ.get("XDG_CONFIG_HOME")
    return (Path(base) if base else Path.home() / ".config") / "nufleet"


def found_identities() -> tuple[Path, ...]:
    """Return the identities in the user's folder, sorted."""
    return tuple(sorted(identity_folder().glob(f"*{SUFFIX}")))


def address_of(path: Path) -> str:
    """Return the address that stands for an identity file, to be given to `open_client`."""
    return f"{SCHEME}{path.absolute()}"


def identity_at(address: str) -> Identity | None:
    """Return the identity that an address names; None for an endpoint; raises IdentityError."""
    if not address.startswith(SCHEME):
        return None
    return read_identity(Path(address.removeprefix(SCHEME)))
