"""What the repository takes and returns: frozen values, without anything of the database."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum

from pydantic import JsonValue

from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Outcome


@dataclass(frozen=True)
class RobotRecord:
    """A robot as it last described itself, and the agent process that did."""

    fleet: str
    robot: str
    spec: RobotSpec
    boot_id: str


class StudyStatus(StrEnum):
    """How far a study is; an open one can be resumed."""

    OPEN = "open"
    COMPLETE = "complete"
    FAILED = "failed"


@dataclass(frozen=True)
class StudyRecord:
    """All that a study is made from, so that it can be made again.

    `study_id` is the prefix of its goal ids. `parameters` is what the algorithm was given besides
    plan and seed, for example the goal ids of the earlier responses that it began with. `result` is
    the document that a complete one printed.
    """

    study_id: str
    fleet: str
    algorithm: str
    plan: StudyPlan
    seed: int
    parameters: Mapping[str, JsonValue] = field(default_factory=dict)
    status: StudyStatus = StudyStatus.OPEN
    reason: str = ""
    result: Mapping[str, JsonValue] | None = None


class TrialStatus(StrEnum):
    """How far one attempt at one test is; the last three are ends."""

    INTENDED = "intended"
    ACCEPTED = "accepted"
    MEASURED = "measured"
    FAILED = "failed"
    LOST = "lost"

    @property
    def ended(self) -> bool:
        """Whether nothing more can come of it."""
        return self in (TrialStatus.MEASURED, TrialStatus.FAILED, TrialStatus.LOST)


@dataclass(frozen=True)
class TrialIntent:
    """What is about to be sent: stored first. `epoch` is of the lease under which it is sent."""

    goal_id: str
    study_id: str
    iteration: int
    robot: str
    attempt: int
    excitation: Excitation
    epoch: int


@dataclass(frozen=True)
class TrialRecord:
    """One attempt and what came of it.

    `boot_id` is of the agent process that accepted it, `plan` what was played. `reason` says why a
    trial gave no usable response, and `retry` what its robot plays in the next attempt; None there
    means that it is given up in this iteration. One that was `interrupted` ended with its
    orchestrator and says nothing against the robot. `response` is there for every complete test,
    also one that failed because the response is not usable.
    """

    intent: TrialIntent
    status: TrialStatus
    boot_id: str | None = None
    plan: ExcitationPlan | None = None
    outcome: Outcome | None = None
    reason: str = ""
    retry: Excitation | None = None
    interrupted: bool = False
    robot_time_s: float = 0.0
    response: FrequencyResponse | None = None


@dataclass(frozen=True)
class ResponseRecord:
    """A robot's response on one axis, the goal that measured it, and when, in UTC.

    `kind` is what the robot said of itself then; empty where that was not stored.
    """

    fleet: str
    robot: str
    axis: str
    goal_id: str
    study_id: str
    kind: str
    measured_at: datetime
    response: FrequencyResponse


@dataclass(frozen=True)
class ExperienceRecord:
    """A trained model as the bytes of its file, and what is known of it."""

    fleet: str
    robot: str
    manifest: Mapping[str, JsonValue]
    data: bytes

    @property
    def sha256(self) -> str:
        """Its id: the hash of the bytes, in hexadecimal."""
        return hashlib.sha256(self.data).hexdigest()


@dataclass(frozen=True)
class ExperienceSummary:
    """An experience without its bytes."""

    sha256: str
    fleet: str
    robot: str
    manifest: Mapping[str, JsonValue]
    size_bytes: int


@dataclass(frozen=True)
class Lease:
    """A robot is `owner`'s under `epoch` until it is released or was not renewed for `term_s`."""

    fleet: str
    robot: str
    owner: str
    epoch: int
    term_s: float


@dataclass(frozen=True)
class Renewal:
    """A lease as it was last renewed; while its owner lives, another one follows within seconds.

    `expires_s` is by the database's clock, and means nothing where that was set back since.
    """

    robot: str
    owner: str
    epoch: int
    term_s: float
    expires_s: float
    before_set_back: bool = field(default=False, compare=False)


@dataclass(frozen=True)
class LastLease:
    """Who was given a robot last. A `silent` owner did not renew in time and released nothing."""

    owner: str
    epoch: int
    silent: bool
