"""The errors of the repository."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from nufleet.shared.errors import InvalidInputError, NufleetError

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.records import Renewal


class RepositoryUrlError(InvalidInputError):
    """The repository's address does not name a database that nufleet can use."""


class RepositoryError(NufleetError):
    """The database did not carry out a request; nothing of the request is stored."""


class RepositoryUnreachableError(RepositoryError):
    """The database cannot be opened, or its server does not answer."""


class RepositoryFullError(RepositoryError):
    """There is no space left for the data."""


class RepositoryReadOnlyError(RepositoryError):
    """The database can be read but not written."""


class RepositoryBusyError(RepositoryError):
    """Other processes locked the database for too long."""


class DamagedRecordError(RepositoryError):
    """The database returned a record that nufleet cannot have stored: altered or truncated."""


class SchemaVersionError(RepositoryError):
    """The database was written by a version of nufleet that this one does not know."""


class UnknownRecordError(RepositoryError):
    """A request refers to a robot, study or trial that was never stored."""


class RecordConflictError(RepositoryError):
    """Another record is already stored under the same id."""


class TrialEndedError(RepositoryError):
    """The trial has ended; it cannot end in another way or begin again."""


class StaleEpochError(RepositoryError):
    """A former owner of a robot wrote about a trial that a later owner has taken over."""


class EpochOutOfRangeError(RepositoryError):
    """No valid epoch is left for a robot that is above every epoch it has seen."""


class LeaseHeldError(RepositoryError):
    """Another orchestrator owns a robot.

    `owner` is its id and `remaining_s` the least time in s for which it keeps the robot.
    `renewals` holds the renewal of every requested robot that belongs to another orchestrator, this
    one first.
    """

    def __init__(self, renewals: Sequence[Renewal], remaining_s: float) -> None:
        first = renewals[0]
        super().__init__(
            f"robot {first.robot} is owned by {first.owner} (epoch {first.epoch}) for another "
            f"{remaining_s:.1f} s; wait until it has ended, or end it"
        )
        self.robot = first.robot
        self.owner = first.owner
        self.epoch = first.epoch
        self.remaining_s = remaining_s
        self.renewals = tuple(renewals)


class LeaseLostError(RepositoryError):
    """A lease expired or was taken over; `robot` must no longer be commanded."""

    def __init__(self, robot: str, owner: str, epoch: int, reason: str) -> None:
        super().__init__(f"{owner} no longer owns robot {robot} under epoch {epoch}: {reason}")
        self.robot = robot
