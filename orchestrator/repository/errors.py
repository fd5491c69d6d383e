"""What can go wrong with the repository, each with a name."""

from __future__ import annotations

from shared.errors import InvalidInputError, NufleetError


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


class LeaseHeldError(RepositoryError):
    """Another orchestrator owns the robot; `owner` is who, `remaining_s` for how long at least."""

    def __init__(self, robot: str, owner: str, epoch: int, remaining_s: float) -> None:
        super().__init__(
            f"robot {robot} is owned by {owner} (epoch {epoch}) for another {remaining_s:.1f} s; "
            "wait until it has ended, or end it"
        )
        self.robot = robot
        self.owner = owner
        self.epoch = epoch
        self.remaining_s = remaining_s


class LeaseLostError(RepositoryError):
    """A lease ran out or was taken over; `robot` must be commanded no more."""

    def __init__(self, robot: str, owner: str, epoch: int, reason: str) -> None:
        super().__init__(
            f"{owner} does not own robot {robot} under epoch {epoch} any more: {reason}"
        )
        self.robot = robot
