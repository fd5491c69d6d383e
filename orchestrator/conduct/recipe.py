"""What a study is made from besides its plan and seed, as it is stored; and the study made of it.

A study that begins and one that is resumed are made in the same way, from what is stored.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field, JsonValue, ValidationError

from nufleet.orchestrator.conduct.replay import ResumeError
from nufleet.orchestrator.repository.errors import DamagedRecordError
from nufleet.orchestrator.repository.records import StudyRecord
from nufleet.orchestrator.study.adaptive_algorithm import AdaptiveStudy
from nufleet.orchestrator.study.interface import Study
from nufleet.orchestrator.study.paper_algorithm import PaperStudy
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.strict import Identifier, Name, Strict, describe_validation

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.study_store import StudyStore


class Recipe(Strict):
    """The parameters of a study.

    `specs` is what each robot said of itself when the study began, `stored` are the goals of
    earlier studies whose responses are taken instead of tests, by robot.
    """

    specs: dict[Name, RobotSpec]
    stored: Annotated[dict[Name, tuple[Identifier, ...]], Field(default_factory=dict)]

    def parameters(self) -> Mapping[str, JsonValue]:
        """Return them as they are stored."""
        document: dict[str, JsonValue] = json.loads(self.model_dump_json())
        return document


def recipe_of(record: StudyRecord) -> Recipe:
    """Return the parameters of a stored study; raises DamagedRecordError."""
    try:
        return Recipe.model_validate_json(json.dumps(dict(record.parameters)))
    except ValidationError as error:
        raise DamagedRecordError(
            f"the parameters of study {record.study_id}: {describe_validation(error)}"
        ) from error


def make_study(record: StudyRecord, studies: StudyStore) -> Study:
    """Return a study as it was before its first question.

    Raises:
        ResumeError: its algorithm is not known here.
        RepositoryError: its parameters or stored responses are not there, or damaged.
    """
    recipe = recipe_of(record)
    rng = np.random.default_rng(record.seed)
    if record.algorithm == "paper":
        return PaperStudy(record.plan, rng)
    if record.algorithm == "adaptive":
        stored = {
            robot: [studies.response(goal_id).response for goal_id in goal_ids]
            for robot, goal_ids in recipe.stored.items()
        }
        return AdaptiveStudy(record.plan, recipe.specs, rng, stored=stored)
    raise ResumeError(
        f"study {record.study_id} is of algorithm {record.algorithm!r}; resume it with the nufleet "
        "that began it"
    )
