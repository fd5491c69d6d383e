"""What an authority has signed and revoked, in one file of its folder."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.private_files import write_privately
from nufleet.shared.strict import Document, Name, Strict, describe_validation

LEDGER = "issued.json"


class Enrolment(Strict):
    """What is known of one principal that was enrolled at least once."""

    public_key: str
    """Its public key in PEM, for which certificates are renewed without a new request."""
    expires: datetime
    """End of its latest certificate."""
    revocations: Annotated[int, Field(ge=0)] = 0
    """Number of times that it was revoked."""
    issuer: str = ""
    """Serial number of the certificate of the authority that signed its latest certificate."""
    revoked: bool = False
    """Whether it has to be enrolled again before it can connect."""


class Ledger(Document):
    """The enrolments of a fleet, by principal."""

    inventory: str
    """Path of the fleet file that is the inventory."""
    router_expires: datetime
    """End of the router's certificate."""
    enrolments: Annotated[dict[Name, Enrolment], Field(default_factory=dict)]
    """Enrolments by principal."""

    @property
    def revocations(self) -> dict[str, int]:
        """Number of revocations of each principal."""
        return {name: enrolment.revocations for name, enrolment in self.enrolments.items()}


def read_ledger(folder: Path) -> Ledger:
    """Return the ledger of an authority's folder; raises InvalidInputError if there is none."""
    path = folder / LEDGER
    try:
        return Ledger.model_validate_json(path.read_bytes())
    except OSError as error:
        raise InvalidInputError(
            f"{folder} is not the folder of an authority: {path.name} cannot be read "
            f"({error.strerror}); `nufleet fleet init INVENTORY` makes one"
        ) from error
    except ValidationError as error:
        raise InvalidInputError(f"{path}: {describe_validation(error)}") from error


def write_ledger(folder: Path, ledger: Ledger) -> None:
    """Replace the ledger of an authority's folder."""
    write_privately(folder / LEDGER, ledger.document().encode())
