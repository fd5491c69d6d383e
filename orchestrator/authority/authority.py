"""The folder of a fleet's authority, and what is done with it: enrol, renew, revoke.

lab.authority/authority.key     the key that decides who belongs to the fleet; keep it safe
lab.authority/authority.pem     its certificate
lab.authority/issued.json       what was signed and revoked
lab.authority/router/           all that the router needs: `nufleet router --config`
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from nufleet.orchestrator.authority.access import (
    common_name,
    router_configuration,
    router_endpoint,
)
from nufleet.orchestrator.authority.certificates import (
    MAX_REQUEST_BYTES,
    authority_certificate,
    certificate_pem,
    key_pem,
    new_key,
    principal_certificate,
    public_pem,
    read_certificate,
    read_key,
    read_public,
    request_pem,
    requested_key,
    router_certificate,
    utc_now,
)
from nufleet.orchestrator.authority.ledger import Enrolment, Ledger, read_ledger, write_ledger
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.private_files import (
    create_privately,
    make_private_folder,
    write_privately,
)
from nufleet.shared.robots.fleet_file import FleetFile, RouterEntry, read_fleet_file
from nufleet.shared.wire.identity import KEY_SUFFIX, SUFFIX, Identity, identity_text

FOLDER_SUFFIX = ".authority"
REQUEST_SUFFIX = ".request"
ROUTER_DAYS = 365
PRINCIPAL_DAYS = 90
_KEY, _CERTIFICATE, _CONFIGURATION = "authority.key", "authority.pem", "router.json5"

EXAMPLE = """[router]
addresses = ["192.168.1.10"]
[orchestrators.desk]
[operators.anna]"""


@dataclass(frozen=True)
class Enrolled:
    """What was written for a principal."""

    identity: Path
    """Identity file."""
    key: Path | None
    """Its private key; None if the principal made the key itself."""
    expires: datetime
    """End of its certificate."""
    router_changed: bool
    """Whether the router has to be restarted, because its list changed."""


def make_request(name: str, folder: Path) -> tuple[Path, Path]:
    """Make a key, and a request for a certificate of it, on the machine that will use the key.

    Args:
        name: Principal of the inventory.
        folder: Folder for both files; created if necessary, and private.

    Returns:
        The paths of the key and of the request.

    Raises:
        InvalidInputError: There is a key of this name, which is never replaced.
    """
    make_private_folder(folder)
    key = new_key()
    path = folder / f"{name}{KEY_SUFFIX}"
    _create_key(path, key_pem(key))
    request = folder / f"{name}{REQUEST_SUFFIX}"
    write_privately(request, request_pem(key, name))
    return path, request


class Authority:
    """A fleet's authority with its inventory, as both are on disk now."""

    def __init__(self, folder: Path) -> None:
        """Open the folder of an authority.

        Raises:
            InvalidInputError: The folder is not an authority's, or is not private.
            FleetFileError: The inventory is wrong.
        """
        self.folder = folder
        self.ledger = read_ledger(folder)
        self.inventory = read_fleet_file(Path(self.ledger.inventory))
        self._router = router_of(self.inventory, Path(self.ledger.inventory))
        path = folder / _KEY
        try:
            if path.stat().st_mode & 0o077:
                raise InvalidInputError(f"other users can read the key {path}: chmod 600 {path}")
            self._key = read_key(path.read_bytes(), str(path))
            self._certificate = read_certificate((folder / _CERTIFICATE).read_bytes())
        except (OSError, ValueError) as error:
            raise InvalidInputError(f"{folder} is not complete: {error}") from error

    @classmethod
    def create(cls, inventory: Path, folder: Path) -> Authority:
        """Make the authority of a fleet, with the certificate and configuration of its router.

        Args:
            inventory: Path of the fleet file that lists the principals.
            folder: Folder to create.

        Raises:
            InvalidInputError: The folder exists, or the inventory names no router.
            FleetFileError: The inventory is wrong.
        """
        fleet = read_fleet_file(inventory)
        router = router_of(fleet, inventory)
        if folder.exists():
            raise InvalidInputError(
                f"{folder} exists: an authority is never replaced, since all identities depend on "
                "it; move it away to begin again"
            )
        make_private_folder(folder / "router")
        make_private_folder(folder)
        key, router_key, now = new_key(), new_key(), utc_now()
        certificate = authority_certificate(fleet.name, key, now)
        _create_key(folder / _KEY, key_pem(key))
        _create_key(folder / "router" / "router.key", key_pem(router_key))
        for place in (folder, folder / "router"):
            write_privately(place / _CERTIFICATE, certificate_pem(certificate).encode())
        life = timedelta(days=ROUTER_DAYS)
        signed = router_certificate(
            certificate, key, router.addresses, router_key.public_key(), now, life
        )
        write_privately(folder / "router" / "router.pem", certificate_pem(signed).encode())
        ledger = Ledger(
            inventory=str(inventory.resolve()), router_expires=now + life, enrolments={}
        )
        configured = router_configuration(fleet, router, {})
        write_privately(folder / "router" / _CONFIGURATION, configured.encode())
        # Written last: a folder without it is not an authority.
        write_ledger(folder, ledger)
        return cls(folder)

    @property
    def configuration(self) -> Path:
        """File to start the router with."""
        return self.folder / "router" / _CONFIGURATION

    def enroll(
        self, name: str, out: Path, *, request: Path | None = None, days: int = PRINCIPAL_DAYS
    ) -> Enrolled:
        """Write the identity of a principal.

        Args:
            name: Principal of the inventory.
            out: Folder for the identity, and for its key if there is no request.
            request: Request that was made where the principal runs; None to make a key here, which
                then has to travel.
            days: Days for which the certificate is valid.

        Raises:
            InvalidInputError: The inventory does not list the principal, it is enrolled already,
                the request is wrong, or there is a key in `out`.
        """
        self._check_listed(name)
        known = self.ledger.enrolments.get(name)
        if known is not None and not known.revoked:
            raise InvalidInputError(
                f"{name} is enrolled until {known.expires:%Y-%m-%d}: `nufleet fleet renew {name}` "
                f"gives it a new certificate; if its key is lost, first `nufleet fleet revoke "
                f"{name}`"
            )
        if not out.exists():
            make_private_folder(out)
        key = None
        if request is None:
            made, key = new_key(), out / f"{name}{KEY_SUFFIX}"
            _create_key(key, key_pem(made))
            public = made.public_key()
        else:
            public = requested_key(_bounded(request), name, str(request))
        revocations = 0 if known is None else known.revocations
        identity = out / f"{name}{SUFFIX}"
        life = timedelta(days=days)
        expires = self._sign(name, identity, public, revocations, life)
        self._keep(
            name,
            Enrolment(public_key=public_pem(public), expires=expires, revocations=revocations),
        )
        return Enrolled(identity, key, expires, self._configure())

    def renew(self, name: str, out: Path, *, days: int = PRINCIPAL_DAYS) -> Enrolled:
        """Write a new certificate for the key of an enrolled principal.

        Raises:
            InvalidInputError: The principal is not enrolled, not listed, or was revoked.
        """
        self._check_listed(name)
        known = self.ledger.enrolments.get(name)
        if known is None or known.revoked:
            problem = "was revoked" if known is not None else "has never been enrolled"
            raise InvalidInputError(f"{name} {problem}: `nufleet fleet enroll {name}`")
        identity, public = out / f"{name}{SUFFIX}", read_public(known.public_key)
        life = timedelta(days=days)
        expires = self._sign(name, identity, public, known.revocations, life)
        self._keep(name, known.model_copy(update={"expires": expires}))
        return Enrolled(identity, None, expires, self._configure())

    def renew_router(self) -> datetime:
        """Write a new certificate for the router, for the addresses in the inventory; its end."""
        folder = self.folder / "router"
        key = read_key((folder / "router.key").read_bytes(), str(folder / "router.key"))
        now, life = utc_now(), timedelta(days=ROUTER_DAYS)
        signed = router_certificate(
            self._certificate, self._key, self._router.addresses, key.public_key(), now, life
        )
        write_privately(folder / "router.pem", certificate_pem(signed).encode())
        self.ledger = self.ledger.model_copy(update={"router_expires": now + life})
        write_ledger(self.folder, self.ledger)
        self._configure()
        return now + life

    def revoke(self, name: str) -> None:
        """Take a principal's certificates out of the router's list; this needs its restart.

        Raises:
            InvalidInputError: The principal is not enrolled.
        """
        known = self.ledger.enrolments.get(name)
        if known is None or known.revoked:
            there = [n for n, one in self.ledger.enrolments.items() if not one.revoked]
            raise InvalidInputError(
                f"{name} is not enrolled; enrolled are {', '.join(sorted(there)) or 'none'}"
            )
        revoked = {"revoked": True, "revocations": known.revocations + 1}
        self._keep(name, known.model_copy(update=revoked))
        self._configure()

    def _check_listed(self, name: str) -> None:
        if name not in self.inventory.principals:
            raise InvalidInputError(
                f"{name} is not in the inventory {self.ledger.inventory}, which lists "
                f"{', '.join(self.inventory.principals)}; add it there first"
            )

    def _sign(
        self, name: str, path: Path, public: Ed25519PublicKey, revocations: int, life: timedelta
    ) -> datetime:
        now = utc_now()
        certificate = principal_certificate(
            self._certificate,
            self._key,
            common_name(name, revocations),
            public,
            now,
            life,
        )
        identity = Identity(
            path=path,
            fleet=self.inventory.name,
            principal=name,
            role=self.inventory.principals[name],
            router=router_endpoint(self._router, self._router.addresses[0]),
            certificate=certificate_pem(certificate),
            authority=(self.folder / _CERTIFICATE).read_text(),
        )
        write_privately(path, identity_text(identity).encode())
        return now + life

    def _keep(self, name: str, enrolment: Enrolment) -> None:
        enrolments = {**self.ledger.enrolments, name: enrolment}
        self.ledger = self.ledger.model_copy(update={"enrolments": enrolments})
        write_ledger(self.folder, self.ledger)

    def _configure(self) -> bool:
        """Write the router's configuration again; return whether it changed."""
        text = router_configuration(self.inventory, self._router, self.ledger.revocations)
        if self.configuration.read_text() == text:
            return False
        write_privately(self.configuration, text.encode())
        return True


def router_of(fleet: FleetFile, path: Path) -> RouterEntry:
    """Return the router of an inventory; raises InvalidInputError with an example if none."""
    if fleet.router is None:
        raise InvalidInputError(
            f"{path} does not say where the fleet's router is. Add for example:\n{EXAMPLE}"
        )
    return fleet.router


def _create_key(path: Path, pem: bytes) -> None:
    try:
        create_privately(path, pem)
    except FileExistsError as error:
        raise InvalidInputError(f"{path} exists, and a key is never replaced") from error


def _bounded(request: Path) -> bytes:
    try:
        with request.open("rb") as file:
            return file.read(MAX_REQUEST_BYTES)
    except OSError as error:
        raise InvalidInputError(f"{request}: cannot be read: {error.strerror}") from error
