"""The stored parameters of a study besides its plan and seed, and the study built from them.

A new study and a resumed one are built in the same way, from the stored record.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field, JsonValue

from nufleet.orchestrator.conduct.replay import ResumeError
from nufleet.orchestrator.repository.errors import DamagedRecordError
from nufleet.orchestrator.repository.records import StudyRecord
from nufleet.orchestrator.study.adaptive_algorithm import AdaptiveStudy
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.algorithms import load_algorithm
from nufleet.orchestrator.study.interface import Study
from nufleet.orchestrator.study.paper_algorithm import PaperStudy
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.strict import Identifier, Name, Strict, validation_errors_as
from nufleet.shared.wire.messages import Description

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.study_store import StudyStore


MATCH_PERIODS = 33
"""Duration of the first test where simulators are matched with a robot, in periods of the band's
upper end: 16 tones over the upper nine tenths of the band, the same for all robots."""


AWAY = "away"
"""Boot id in the description of a robot that is not there: its last known spec stands for it."""


class Recipe(Strict):
    """The parameters of a study, besides its plan and seed."""

    specs: dict[Name, RobotSpec]
    """Spec of each robot when the study began, by name."""
    stored: Annotated[dict[Name, tuple[Identifier, ...]], Field(default_factory=dict)]
    """Ids of the responses of earlier tests and flights that replace tests, by robot."""
    absent: tuple[Name, ...] | None = None
    """Names of the robots that are not there to be tested; None in studies that tested no robot
    with stored responses."""

    @classmethod
    def of(
        cls, descriptions: Mapping[str, Description], stored: Mapping[str, tuple[str, ...]]
    ) -> Recipe:
        """Return the parameters of a study that has not begun; see `Archive.begin`."""
        specs = {robot: description.spec for robot, description in descriptions.items()}
        absent = tuple(robot for robot, one in descriptions.items() if one.boot_id == AWAY)
        return cls(specs=specs, stored=dict(stored), absent=absent)

    @property
    def untestable(self) -> frozenset[str]:
        """Names of the robots that the study does not test."""
        return frozenset(self.stored if self.absent is None else self.absent)

    def parameters(self) -> Mapping[str, JsonValue]:
        """Return the parameters as the JSON object that is stored."""
        document: dict[str, JsonValue] = json.loads(self.model_dump_json())
        return document


def recipe_of(record: StudyRecord) -> Recipe:
    """Return the parameters of a stored study.

    Raises:
        DamagedRecordError: The stored parameters are not valid.
    """
    with validation_errors_as(DamagedRecordError, f"the parameters of study {record.study_id}"):
        return Recipe.model_validate_json(json.dumps(dict(record.parameters)))


def make_study(record: StudyRecord, studies: StudyStore) -> Study:
    """Build a study from its record, in its state before the first question.

    Args:
        record: Stored plan, seed, algorithm and parameters.
        studies: Store of the responses that replace tests.

    Raises:
        ResumeError: This version does not know the study's algorithm.
        RepositoryError: The parameters or the stored responses are missing or damaged.
    """
    recipe = recipe_of(record)
    rng = np.random.default_rng(record.seed)
    if record.algorithm == "paper":
        return PaperStudy(record.plan, rng)
    if record.algorithm in ("adaptive", "match"):
        stored = {
            robot: [studies.response(goal_id).response for goal_id in goal_ids]
            for robot, goal_ids in recipe.stored.items()
        }
        settings = AdaptiveSettings()
        if record.algorithm == "match":
            settings = replace(settings, first_periods=MATCH_PERIODS)
        return AdaptiveStudy(
            record.plan,
            recipe.specs,
            rng,
            stored=stored,
            absent=recipe.untestable,
            settings=settings,
        )
    try:
        algorithm = load_algorithm(record.algorithm)
    except InvalidInputError as error:
        raise ResumeError(
            f"study {record.study_id} uses the algorithm {record.algorithm!r}; resume it with the "
            f"version of nufleet, or the package, that began it: {error}"
        ) from error
    study: Study = algorithm(record.plan, recipe.specs, rng)
    return study
