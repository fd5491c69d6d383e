"""What can go wrong with the repository, each with a name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from nufleet.shared.errors import InvalidInputError, NufleetError

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.records import Renewal


class RepositoryUrlError(InvalidInputError):
    """A repository's address that names no database that nufleet can use."""


class RepositoryError(NufleetError):
    """The database did not do what was asked; what was to be stored is not stored."""


class RepositoryUnreachableError(RepositoryError):
    """The database cannot be opened, or its server does not answer."""


class RepositoryFullError(RepositoryError):
    """There is no room left for what was to be stored."""


class RepositoryReadOnlyError(RepositoryError):
    """The database may be read and not written."""


class RepositoryBusyError(RepositoryError):
    """Other processes held the database for longer than anybody should."""


class DamagedRecordError(RepositoryError):
    """What the database returned is not what nufleet stores: altered, or cut off."""


class SchemaVersionError(RepositoryError):
    """The database was written by a nufleet that this one does not know."""


class UnknownRecordError(RepositoryError):
    """Something refers to a robot, study or trial that was never stored."""


class RecordConflictError(RepositoryError):
    """Something is stored under that id already, with another content."""


class TrialEndedError(RepositoryError):
    """A trial that has ended cannot end in another way, nor begin again."""


class StaleEpochError(RepositoryError):
    """A robot's owner of the past wrote about a trial that a later owner has taken over."""


class EpochOutOfRangeError(RepositoryError):
    """There is no epoch for a robot that it would obey and that is above all before it."""


class LeaseHeldError(RepositoryError):
    """Another orchestrator owns a robot; `owner` is who, `remaining_s` for how long at least.

    `renewals` are those of every robot that was asked for and belongs to others, this one first.
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
    """A lease ran out or was taken over; `robot` must be commanded no more."""

    def __init__(self, robot: str, owner: str, epoch: int, reason: str) -> None:
        super().__init__(
            f"{owner} does not own robot {robot} under epoch {epoch} any more: {reason}"
        )
        self.robot = robot
