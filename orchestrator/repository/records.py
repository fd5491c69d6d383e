"""The values that the repository stores and returns: frozen, and independent of the database."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum

from pydantic import JsonValue

from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.shared.experience.file import digest
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan
from nufleet.shared.frequency_test.frequency_response import Flight, FrequencyResponse
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Description, GoalResult, Outcome


@dataclass(frozen=True)
class RobotRecord:
    """A robot's last description of itself."""

    fleet: str
    """Name of the fleet."""
    robot: str
    """Name of the robot."""
    spec: RobotSpec
    """Spec that the robot reported."""
    boot_id: str
    """Boot id of the agent process that reported it."""

    @staticmethod
    def of(fleet: str, robot: Description) -> RobotRecord:
        """Return the record of a robot of a fleet that has described itself."""
        return RobotRecord(fleet, robot.robot, robot.spec, robot.boot_id)


class StudyStatus(StrEnum):
    """The status of a study; an open one can be resumed."""

    OPEN = "open"
    COMPLETE = "complete"
    FAILED = "failed"


@dataclass(frozen=True)
class StudyRecord:
    """Everything that is needed to rebuild a study, and its result."""

    study_id: str
    """Id of the study, the prefix of all its goal ids."""
    fleet: str
    """Name of the fleet."""
    algorithm: str
    """Name of the algorithm, `paper` or `adaptive`."""
    plan: StudyPlan
    """Plan of the study."""
    seed: int
    """Seed of its random generator."""
    parameters: Mapping[str, JsonValue] = field(default_factory=dict)
    """Further input of the algorithm, for example the goal ids of reused responses."""
    status: StudyStatus = StudyStatus.OPEN
    """Status of the study."""
    reason: str = ""
    """Reason why the study ended."""
    result: Mapping[str, JsonValue] | None = None
    """Document that the study printed; None unless it is complete."""


class TrialStatus(StrEnum):
    """The status of one attempt at a test; the last three are final."""

    INTENDED = "intended"
    ACCEPTED = "accepted"
    MEASURED = "measured"
    FAILED = "failed"
    LOST = "lost"

    @property
    def ended(self) -> bool:
        """Whether the status is final."""
        return self in (TrialStatus.MEASURED, TrialStatus.FAILED, TrialStatus.LOST)


@dataclass(frozen=True)
class TrialIntent:
    """An attempt at a test, stored before it is sent."""

    goal_id: str
    """Id of the goal to be sent."""
    study_id: str
    """Id of the study."""
    iteration: int
    """Number of the round, from 1."""
    robot: str
    """Name of the robot under test."""
    attempt: int
    """Number of the attempt in the round, from 1."""
    excitation: Excitation
    """Motion that the robot is to play."""
    epoch: int
    """Epoch of the lease under which the goal is sent."""


@dataclass(frozen=True)
class TrialRecord:
    """One attempt at a test and its outcome."""

    intent: TrialIntent
    """The attempt as it was about to be sent."""
    status: TrialStatus
    """Status of the attempt."""
    boot_id: str | None = None
    """Boot id of the agent process that accepted it."""
    plan: ExcitationPlan | None = None
    """Excitation as the robot executed it."""
    outcome: Outcome | None = None
    """Outcome of the motion, as the robot reported it."""
    reason: str = ""
    """Reason why the attempt gave no usable response."""
    retry: Excitation | None = None
    """Excitation of the next attempt; None if the robot is given up in this round."""
    interrupted: bool = False
    """Whether the attempt ended with its orchestrator, and so is no failure of the robot."""
    robot_time_s: float = 0.0
    """Time that the robot moved, in s."""
    response: FrequencyResponse | None = None
    """Response of a complete test, even if it is not usable."""

    @property
    def given_up(self) -> bool:
        """Whether it ended without a usable response, and no attempt is to follow."""
        return self.status in (TrialStatus.FAILED, TrialStatus.LOST) and self.retry is None


@dataclass(frozen=True)
class TrialEnd:
    """How an attempt at a test ended, with the data that it gave."""

    status: TrialStatus
    """MEASURED for a usable response, FAILED without one, LOST if its result is lost for good."""
    reason: str = ""
    """Reason why the attempt gave no usable response."""
    retry: Excitation | None = None
    """Excitation of the next attempt; None if the robot is given up in this round."""
    interrupted: bool = False
    """Whether the attempt ended with its orchestrator, and so is no failure of the robot."""
    result: GoalResult | None = None
    """Result that the robot returned, with its samples; None if it returned none."""
    response: FrequencyResponse | None = None
    """Response of a complete test, even if it is not usable."""


class Origin(StrEnum):
    """What a response was measured in."""

    TEST = "test"
    """A frequency test of a study."""
    FLIGHT = "flight"
    """A flight along a path, with nufleet."""
    LOG = "log"
    """A flight with another program, whose log was imported."""


@dataclass(frozen=True)
class FlightCircumstances:
    """What a response that no test measured is valid for."""

    spec: RobotSpec
    """Spec of the robot at the time, or when its log was imported."""
    band_rad_s: tuple[float, float]
    """Lowest and highest frequency in rad/s at which the reference had power."""
    flight: Flight
    """Speed and noise of the flight."""
    duration_s: float
    """Duration of the record."""


@dataclass(frozen=True)
class ResponseRecord:
    """A robot's measured response on one axis."""

    fleet: str
    """Name of the fleet."""
    robot: str
    """Name of the robot."""
    axis: str
    """Name of the axis."""
    goal_id: str
    """Id of the goal that measured it, or of the response itself where no test did."""
    study_id: str
    """Id of the study that the goal belonged to, or name of the run or log."""
    kind: str
    """Kind that the robot reported at the time; empty if it was not stored."""
    measured_at: datetime
    """Time of the measurement, in UTC."""
    response: FrequencyResponse
    """The response."""
    origin: Origin = Origin.TEST
    """What it was measured in."""
    flown: FlightCircumstances | None = None
    """Circumstances of the flight; None for a test, whose study holds them."""


@dataclass(frozen=True)
class ExperienceRecord:
    """An experience that a robot learned, as the bytes of its file."""

    fleet: str
    """Name of the fleet."""
    run: str
    """Name of the run in which it was learned."""
    payload: bytes
    """Content of the experience's file, which holds its manifest."""

    @property
    def sha256(self) -> str:
        """Hash of the file, in hexadecimal."""
        return digest(self.payload)


@dataclass(frozen=True)
class StoredExperience:
    """A stored experience without its file."""

    sha256: str
    """Hash of the file, in hexadecimal."""
    fleet: str
    """Name of the fleet."""
    robot: str
    """Name of the robot that learned it."""
    architecture: Architecture
    """Architecture of the inverse model."""
    run: str
    """Name of the run in which it was learned."""
    learned_at: datetime
    """Time at which its robot had learned it, in UTC."""
    size_bytes: int
    """Size of the file."""


@dataclass(frozen=True)
class Lease:
    """A lease: `owner` owns the robot under `epoch` until release, or `term_s` without renewal."""

    fleet: str
    """Name of the fleet."""
    robot: str
    """Name of the robot."""
    owner: str
    """Id of the owner."""
    epoch: int
    """Epoch of the lease."""
    term_s: float
    """Time in s for which the lease holds without being renewed."""


@dataclass(frozen=True)
class Renewal:
    """The latest renewal of a lease; a living owner renews it again within seconds."""

    robot: str
    """Name of the robot."""
    owner: str
    """Id of the owner."""
    epoch: int
    """Epoch of the lease."""
    term_s: float
    """Time in s for which the lease holds without being renewed."""
    expires_s: float
    """Expiry time in s on the database's clock; meaningless if the clock was set back since."""
    before_set_back: bool = field(default=False, compare=False)
    """Whether the renewal happened before the database's clock was set back."""


@dataclass(frozen=True)
class LastLease:
    """The last lease of a robot; a `silent` owner neither renewed it in time nor released it."""

    owner: str
    """Id of the last owner."""
    epoch: int
    """Epoch of its lease."""
    silent: bool
    """Whether the owner let the lease expire without releasing it."""
