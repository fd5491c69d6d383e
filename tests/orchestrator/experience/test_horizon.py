"""The horizon of an inverse is the one that its own robot tracks best with."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pytest
from robots_that_learn import LIMITS, double_integrator

from nufleet.orchestrator.experience.horizon import (
    FAILURES_MAX,
    Fly,
    HorizonChoice,
    candidate_layouts,
    choose_horizon,
)
from nufleet.orchestrator.experience.lesson_record import LearningRecord
from nufleet.orchestrator.experience.training import Origin
from nufleet.robot_agent.flight.inverse_model import NetworkInverse
from nufleet.robot_agent.flight.online_gp import OnlineGp
from nufleet.robot_agent.flight.rich_flight import fly_record
from nufleet.robot_agent.flight.tracking import Learner, track
from nufleet.shared.errors import StudyError
from nufleet.shared.experience.file import Experience
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.paths.references import rich_references
from nufleet.shared.paths.trajectories import travel

ORIGIN = Origin("source", "double-integrator", ("x",), "m", 1)
PATH = travel(np.array([[0.0], [0.9], [-0.5], [0.6], [0.0]]), 0.8, 1.8, 0.015)


@lru_cache
def record() -> LearningRecord:
    robot = double_integrator()
    flown = fly_record(robot, rich_references(robot.spec, 60.0, np.random.default_rng(0)))
    return LearningRecord(flown.references, flown.states, robot.state_names)


def fly(experience: Experience) -> float:
    layout = experience.manifest.layout
    process = OnlineGp(layout, (NetworkInverse(experience),), window=0)
    return track(double_integrator(), PATH, LIMITS, Learner(layout, process)).rms_error


def choose(architecture: Architecture, fly: Fly, degree: int = 1) -> HorizonChoice:
    layouts = candidate_layouts(
        architecture, record().state_names, 0.015, degree, candidates_s=(0.15, 0.2, 0.3, 0.4)
    )
    return choose_horizon(layouts, record(), (0,), ORIGIN, fly)


@pytest.mark.parametrize("architecture", ["state", "preview"])
def test_the_horizon_that_tracks_best_is_chosen(architecture: Architecture) -> None:
    choice = choose(architecture, fly)
    errors = {trial.horizon_samples: trial.rms_error for trial in choice.trials}
    assert list(errors) == [10, 13, 20, 27]
    assert errors[choice.layout.horizon_samples] <= 1.05 * min(errors.values())


def test_of_feedbacks_alike_the_longest_and_of_previews_alike_the_shortest_is_taken() -> None:
    assert choose("state", lambda _: 0.1).layout.horizon_samples == 27
    assert choose("preview", lambda _: 0.1).layout.horizon_samples == 10


def test_no_horizon_is_shorter_than_the_delay() -> None:
    layouts = candidate_layouts("state", ("position",), 0.015, 25)
    assert min(layout.horizon_samples for layout in layouts) == 25


def test_after_two_failures_in_a_row_shorter_horizons_are_not_flown() -> None:
    flown: list[int] = []

    def unstable_when_short(experience: Experience) -> float:
        flown.append(experience.manifest.layout.horizon_samples)
        return 0.1 if flown[-1] == 27 else math.inf

    choice = choose("state", unstable_when_short)
    assert flown == [27, 27, 20, 13]
    assert FAILURES_MAX == 2
    assert choice.layout.horizon_samples == 27
    assert [trial.rms_error for trial in choice.trials[:3]] == [math.inf] * 3


def test_a_horizon_that_cannot_win_any_more_is_not_flown_a_second_time() -> None:
    flown: list[int] = []

    def best_at_twenty(experience: Experience) -> float:
        flown.append(experience.manifest.layout.horizon_samples)
        return 0.1 * (1 + abs(flown[-1] - 20) / 10)

    assert choose("state", best_at_twenty).layout.horizon_samples == 20
    assert flown == [27, 27, 20, 20, 13, 10]


def test_shorter_horizons_are_left_once_two_were_far_off() -> None:
    flown: list[int] = []

    def worse_when_short(experience: Experience) -> float:
        flown.append(experience.manifest.layout.horizon_samples)
        return 0.1 if flown[-1] == 27 else 0.3

    assert choose("preview", worse_when_short).layout.horizon_samples == 27
    assert flown == [27, 20, 13]


def test_horizons_that_are_too_long_do_not_end_the_search() -> None:
    def flies_when_short(experience: Experience) -> float:
        return 0.1 if experience.manifest.layout.horizon_samples == 10 else math.inf

    assert choose("state", flies_when_short).layout.horizon_samples == 10


def test_a_robot_that_cannot_be_flown_with_any_horizon_says_so() -> None:
    with pytest.raises(StudyError, match=r"robot source .*any horizon.*--architecture preview"):
        choose("state", lambda _: math.inf)
