"""The folder of a fleet's authority, and what is done with it: enrol, renew, revoke.

lab.authority/authority.key     the key that decides who belongs to the fleet; keep it safe
lab.authority/authority.pem     its certificate
lab.authority/issued.json       what was signed and revoked
lab.authority/router/           all that the router needs: `nufleet router --config`
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from nufleet.orchestrator.authority.access import (
    common_name,
    router_configuration,
    router_endpoint,
)
from nufleet.orchestrator.authority.certificates import (
    Issuer,
    authority_certificate,
    certificate_pem,
    key_pem,
    new_key,
    public_pem,
    read_issuers,
    read_key,
    read_public,
    requested_key,
    utc_now,
)
from nufleet.orchestrator.authority.key_files import (
    create_folder,
    create_key,
    named_files,
    read_request,
)
from nufleet.orchestrator.authority.ledger import Enrolment, Ledger, read_ledger, write_ledger
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.private_files import check_private, make_private_folder, write_privately
from nufleet.shared.robots.fleet_file import FleetFile, RouterEntry, read_fleet_file
from nufleet.shared.wire.identity import KEY_SUFFIX, SUFFIX, Identity, identity_text

FOLDER_SUFFIX = ".authority"
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
        self._listed_in = _inventory_of(self.ledger, folder)
        self.inventory = read_fleet_file(self._listed_in)
        self._router = router_of(self.inventory, self._listed_in)
        path = folder / _KEY
        try:
            check_private(path)
            key = read_key(path.read_bytes(), str(path))
            self._issuer, self._former = read_issuers((folder / _CERTIFICATE).read_bytes(), key)
        except (OSError, ValueError) as error:
            raise InvalidInputError(f"{folder} is not complete: {error}") from error

    @classmethod
    def create(cls, inventory: Path, folder: Path) -> Authority:
        """Make the authority of a fleet, with the certificate and configuration of its router.

        Args:
            inventory: Path of the fleet file that lists the principals.
            folder: Folder to create.

        Raises:
            InvalidInputError: The folder exists or cannot be written, or the inventory names no
                router.
            FleetFileError: The inventory is wrong.
        """
        fleet = read_fleet_file(inventory)
        router = router_of(fleet, inventory)
        if folder.exists():
            raise InvalidInputError(
                f"{folder} exists: an authority is never replaced, since all identities depend on "
                "it; move it away to begin again"
            )
        with named_files():
            make_private_folder(folder / "router")
            make_private_folder(folder)
            key, router_key, now = new_key(), new_key(), utc_now()
            certificate = authority_certificate(fleet.name, key, now)
            create_key(folder / _KEY, key_pem(key))
            create_key(folder / "router" / "router.key", key_pem(router_key))
            for place in (folder, folder / "router"):
                write_privately(place / _CERTIFICATE, certificate_pem(certificate).encode())
            life = timedelta(days=ROUTER_DAYS)
            signed = Issuer(certificate, key).issue(
                "router", router_key.public_key(), now, life, serves_at=router.addresses
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
        with self._changing():
            self._check_listed(name)
            known = self.ledger.enrolments.get(name)
            if known is not None and not known.revoked:
                raise InvalidInputError(
                    f"{name} is enrolled until {known.expires:%Y-%m-%d}: `nufleet fleet renew "
                    f"{name}` gives it a new certificate; if its key is lost, first `nufleet fleet "
                    f"revoke {name}`"
                )
            create_folder(out)
            key = None
            if request is None:
                made, key = new_key(), out / f"{name}{KEY_SUFFIX}"
                create_key(key, key_pem(made))
                public = made.public_key()
            else:
                public = requested_key(read_request(request), name, str(request))
            revocations = 0 if known is None else known.revocations
            return self._issue(name, public, revocations, out, days, key)

    def renew(self, name: str, out: Path, *, days: int = PRINCIPAL_DAYS) -> Enrolled:
        """Write a new certificate for the key of an enrolled principal.

        Raises:
            InvalidInputError: The principal is not enrolled, not listed, or was revoked.
        """
        with self._changing():
            self._check_listed(name)
            known = self.ledger.enrolments.get(name)
            if known is None or known.revoked:
                problem = "was revoked" if known is not None else "has never been enrolled"
                raise InvalidInputError(f"{name} {problem}: `nufleet fleet enroll {name}`")
            create_folder(out)
            return self._issue(name, read_public(known.public_key), known.revocations, out, days)

    @property
    def replaced(self) -> bool:
        """Whether the authority is being replaced: a former one is trusted beside it."""
        return bool(self._former)

    def renew_router(self) -> datetime:
        """Write a new certificate for the router, for the addresses in the inventory; its end.

        Raises:
            InvalidInputError: The authority is being replaced, so that some identities would not
                trust the new certificate.
        """
        if self.replaced:
            raise InvalidInputError(
                "the authority is being replaced, and the router's certificate is renewed at the "
                "end of that: `nufleet fleet renew --replace-authority`"
            )
        with self._changing():
            return self._sign_router()

    def replace(self) -> None:
        """Begin to replace the authority: from now on a new key signs, and both are trusted.

        The router keeps its certificate, which identities of before trust as well.

        Raises:
            InvalidInputError: A file cannot be written.
        """
        with self._changing():
            key = new_key()
            certificate = authority_certificate(self.inventory.name, key, utc_now())
            self._former = (self._issuer.certificate, *self._former)
            # Before the key, which decides which of them is the authority.
            self._write_certificates(certificate, *self._former)
            write_privately(self.folder / _KEY, key_pem(key))
            self._issuer = Issuer(certificate, key)

    def finish_replacing(self) -> datetime:
        """Trust the former authority no longer; return the end of the router's new certificate.

        Raises:
            InvalidInputError: A principal still has a certificate of the former authority.
        """
        with self._changing():
            behind = [
                name
                for name, one in self.ledger.enrolments.items()
                if not one.revoked and one.issuer != self._issuer.serial
            ]
            if behind:
                raise InvalidInputError(
                    f"{', '.join(behind)}: signed by the former authority. First `nufleet fleet "
                    "renew` and copy each identity to its machine; revoke those that are gone"
                )
            expires = self._sign_router()
            self._write_certificates(self._issuer.certificate)
            self._former = ()
        return expires

    def _write_certificates(self, *certificates: x509.Certificate) -> None:
        text = "".join(map(certificate_pem, certificates)).encode()
        for place in (self.folder / "router", self.folder):
            write_privately(place / _CERTIFICATE, text)

    def _sign_router(self) -> datetime:
        folder = self.folder / "router"
        key = read_key((folder / "router.key").read_bytes(), str(folder / "router.key"))
        now, life = utc_now(), timedelta(days=ROUTER_DAYS)
        signed = self._issuer.issue(
            "router", key.public_key(), now, life, serves_at=self._router.addresses
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
        with self._changing():
            known = self.ledger.enrolments.get(name)
            if known is None or known.revoked:
                there = [n for n, one in self.ledger.enrolments.items() if not one.revoked]
                raise InvalidInputError(
                    f"{name} is not enrolled; enrolled are {', '.join(sorted(there)) or 'none'}"
                )
            revoked = {"revoked": True, "revocations": known.revocations + 1}
            self._keep(name, known.model_copy(update=revoked))
            self._configure()

    @contextmanager
    def _changing(self) -> Iterator[None]:
        """Hold the folder alone, with the ledger as it is on disk now.

        Of two commands at the same time, the second would otherwise write the ledger without the
        change of the first, and admit a principal that the first revoked.
        """
        with named_files():
            held = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY)
            try:
                fcntl.flock(held, fcntl.LOCK_EX)
                self.ledger = read_ledger(self.folder)
                yield
            finally:
                os.close(held)

    def _check_listed(self, name: str) -> None:
        if name not in self.inventory.principals:
            raise InvalidInputError(
                f"{name} is not in the inventory {self._listed_in}, which lists "
                f"{', '.join(self.inventory.principals)}; add it there first"
            )

    def _issue(
        self,
        name: str,
        public: Ed25519PublicKey,
        revocations: int,
        out: Path,
        days: int,
        key: Path | None = None,
    ) -> Enrolled:
        now, life = utc_now(), timedelta(days=days)
        certificate = self._issuer.issue(common_name(name, revocations), public, now, life)
        # The ledger comes first: a certificate that it does not list could not be revoked.
        self._keep(
            name,
            Enrolment(
                public_key=public_pem(public),
                expires=now + life,
                revocations=revocations,
                issuer=self._issuer.serial,
            ),
        )
        router_changed = self._configure()
        identity = Identity(
            path=out / f"{name}{SUFFIX}",
            fleet=self.inventory.name,
            principal=name,
            role=self.inventory.principals[name],
            router=router_endpoint(self._router, self._router.addresses[0]),
            certificate=certificate_pem(certificate),
            authority=(self.folder / _CERTIFICATE).read_text(),
        )
        write_privately(identity.path, identity_text(identity).encode())
        return Enrolled(identity.path, key, now + life, router_changed)

    def _keep(self, name: str, enrolment: Enrolment) -> None:
        enrolments = {**self.ledger.enrolments, name: enrolment}
        self.ledger = self.ledger.model_copy(update={"enrolments": enrolments})
        write_ledger(self.folder, self.ledger)

    def _configure(self) -> bool:
        """Write the router's configuration again; return whether it changed."""
        text = router_configuration(self.inventory, self._router, self.ledger.revocations)
        if self.configuration.exists() and self.configuration.read_text() == text:
            return False
        create_folder(self.configuration.parent)
        write_privately(self.configuration, text.encode())
        return True


def router_of(fleet: FleetFile, path: Path) -> RouterEntry:
    """Return the router of an inventory; raises InvalidInputError with an example if none."""
    if fleet.router is None:
        raise InvalidInputError(
            f"{path} does not say where the fleet's router is. Add for example:\n{EXAMPLE}"
        )
    return fleet.router


def _inventory_of(ledger: Ledger, folder: Path) -> Path:
    """Return where the inventory is: where it was, or beside the folder if both were moved."""
    path = Path(ledger.inventory)
    beside = folder.resolve().parent / path.name
    found = next((there for there in (path, beside) if there.exists()), None)
    if found is None:
        raise InvalidInputError(
            f"the inventory of {folder} is neither {path} nor {beside}; put it at one of them"
        )
    return found
