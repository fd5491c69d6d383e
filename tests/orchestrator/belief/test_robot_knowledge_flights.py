"""What a robot's flights say of it, beside its tests."""

from __future__ import annotations

import numpy as np
from random_loops import BAND, SPEC, Loop

from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.orchestrator.study.tone_choice import first_look
from nufleet.shared.frequency_test.frequency_response import Flight, FrequencyResponse
from nufleet.shared.frequency_test.quality import Quality

FLOWN_RAD_S = np.linspace(0.25, 5.3, 20)


def flown(loop: Loop, speed: float, seed: int, deviation: float = 0.01) -> FrequencyResponse:
    rng = np.random.default_rng(seed)
    error = deviation * rng.standard_normal((2, len(FLOWN_RAD_S))) / np.sqrt(2)
    return FrequencyResponse(
        FLOWN_RAD_S,
        loop.z(FLOWN_RAD_S) + error[0] + 1j * error[1],
        np.full(len(FLOWN_RAD_S), deviation**2),
        3,
        Quality(),
        degrees=np.full(len(FLOWN_RAD_S), 60.0),
        flight=Flight(speed, 0.003),
    )


def spread(known: RobotKnowledge) -> float:
    draws = known.model.draw(np.linspace(*BAND, 40), 300, np.random.default_rng(0))
    return float(np.mean(np.std(draws, axis=0)))


def test_flights_at_two_speeds_that_agree_add_up_and_those_that_do_not_are_a_finding() -> None:
    same, other = (RobotKnowledge("robot", SPEC, BAND[1]) for _ in range(2))
    rng = np.random.default_rng(0)
    for known, second in ((same, Loop(3.0)), (other, Loop(2.5))):
        known.learn(flown(Loop(3.0), 0.3, 1), rng)
        known.learn(flown(second, 0.9, 2), rng)
    assert same.findings == ()
    assert same.flight_doubt == 0.0
    (finding,) = other.findings
    assert "flights at up to 0.3 and 0.9 m/s" in finding
    assert "depends on the amplitude" in finding
    assert other.flight_doubt > 0
    assert spread(other) > 2 * spread(same)


def test_a_test_that_misses_a_flight_makes_the_flight_doubtful_and_not_the_test() -> None:
    known = RobotKnowledge("robot", SPEC, BAND[1])
    rng = np.random.default_rng(0)
    known.learn(flown(Loop(2.5), 0.6, 1), rng)
    assert known.flown_only
    test = first_look(BAND, SPEC, 11, 0.7).excitation("x")
    known.learn(Loop(3.0).answer(test, 0.01, rng), rng)
    assert not known.flown_only
    assert known.flight_doubt > 0
    grid = np.linspace(*BAND, 40)
    mean = known.model.draw(grid, 300, np.random.default_rng(0)).mean(axis=0)
    assert np.max(np.abs(mean - Loop(3.0).z(grid))) < 0.03


def test_doubt_about_the_flights_of_others_is_taken_over_once() -> None:
    known = RobotKnowledge("robot", SPEC, BAND[1])
    known.learn(flown(Loop(3.0), 0.6, 1), np.random.default_rng(0))
    before = spread(known)
    known.doubt_flights(0.01)
    doubted = spread(known)
    known.doubt_flights(0.01)
    assert doubted > 2 * before
    assert spread(known) == doubted
