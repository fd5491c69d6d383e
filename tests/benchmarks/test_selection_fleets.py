"""The robots that the selection benchmark draws can be tested, and what is true of them is true."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.nonlinear_loop import NonlinearLoop, play
from benchmarks.selection_families import (
    FAMILIES,
    NONLINEAR,
    SAMPLE_TIME_S,
    LinearLoop,
    Mode,
)
from benchmarks.selection_fleets import (
    RUNAWAY_GAIN,
    TestedRobot,
    random_fleet,
    true_responses,
)
from benchmarks.selection_oracle import oracle_time_s
from nufleet.orchestrator.study.tone_choice import first_look
from nufleet.shared.frequency_test.nonlinearity import Nonlinearity, nonlinearity_of

NOISE_M = 0.003
LINEAR = LinearLoop((Mode(3.0, 0.6, 0.2),), 0.06)


def test_a_loop_without_nonlinearity_moves_like_the_linear_one() -> None:
    rng = np.random.default_rng(0)
    linear = TestedRobot(LINEAR, 0.0, rng)
    reference = 0.2 * np.sin(2.0 * SAMPLE_TIME_S * np.arange(1000)) ** 3
    bent = play(NonlinearLoop(3.0, 0.6, 0.2, 0.06), reference, SAMPLE_TIME_S)
    # The simulation integrates with steps of 5 ms, which is a delay of half of that.
    assert np.max(np.abs(linear.moved(reference) - bent)) < 0.01 * np.ptp(bent)


@pytest.mark.parametrize("family", FAMILIES)
def test_fleets_of_every_family_can_be_tested(family: str) -> None:
    fleet = random_fleet(family, 1, NOISE_M, np.random.default_rng(0))
    assert fleet.regret(min(fleet.psi_star, key=lambda s: fleet.psi_star[s])) == 0.0
    for robot in fleet.robots.values():
        choice = first_look(fleet.band_rad_s, robot.spec, 11, 0.7)
        response, duration_s = robot.test(choice.excitation("x"))
        assert response.quality.usable, str(response.quality)
        assert duration_s >= choice.duration_s(robot.spec) * (1 - 1e-9)


def test_in_place_of_a_robot_that_runs_away_another_is_drawn() -> None:
    family, rng = FAMILIES["rate-limited"], np.random.default_rng(0)
    drawn = [TestedRobot(family.draw(rng), NOISE_M, rng, family) for _ in range(5)]
    _, z = true_responses(drawn, family.band_rad_s)
    ran_away = np.abs(z).max(axis=1) > RUNAWAY_GAIN
    assert ran_away.sum() == 1
    fleet = random_fleet("rate-limited", 4, NOISE_M, np.random.default_rng(0))
    same = [one.loop == kept.loop for one, kept in zip(drawn, fleet.robots.values(), strict=True)]
    assert same == (~ran_away).tolist()
    assert all(np.abs(one).max() < RUNAWAY_GAIN for one in fleet.z.values())


def test_estimates_scatter_about_the_truth_as_they_say() -> None:
    robot = TestedRobot(LINEAR, NOISE_M, np.random.default_rng(0))
    test = first_look((0.1, 5.4), robot.spec, 11, 0.7).excitation("x")
    responses = [robot.test(test)[0] for _ in range(100)]
    truth = LINEAR.response(responses[0].omega_rad_s)
    inside = np.mean([np.abs(one.z - truth) <= one.radius() for one in responses])
    assert inside > 0.9


def test_the_true_response_of_a_loop_without_nonlinearity_is_the_linear_one() -> None:
    rng = np.random.default_rng(0)
    bent = TestedRobot(NonlinearLoop(3.0, 0.6, 0.2, 0.06), 0.0, rng)
    omega, z = true_responses([bent], (0.1, 5.4))
    # The simulation integrates with steps of 5 ms, which is a delay of half of that.
    assert np.max(np.abs(z[0] - LINEAR.response(omega))) < 0.02


def test_an_oracle_needs_the_less_time_the_less_noise_there_is() -> None:
    quiet, noisy = (
        random_fleet("second-order", 3, noise_m, np.random.default_rng(0))
        for noise_m in (0.003, 0.3)
    )
    # Each robot plays at least three periods of its tone and two ramps.
    shortest_s = 4 * 5 * 2 * np.pi / 5.4
    assert shortest_s <= oracle_time_s(quiet) < 0.5 * oracle_time_s(noisy)


SAID = {
    "saturating": Nonlinearity.SATURATION,
    "dead-zone": Nonlinearity.DEAD_ZONE,
    "backlash": Nonlinearity.BACKLASH,
    "friction": Nonlinearity.FRICTION,
    "hardening": Nonlinearity.HARDENING,
}


@pytest.mark.parametrize(("kind", "expected"), SAID.items())
def test_what_half_the_amplitude_does_tells_most_nonlinearities_apart(
    kind: str, expected: Nonlinearity
) -> None:
    said = []
    for seed in range(12):
        rng = np.random.default_rng([seed, 5])
        robot = TestedRobot(NONLINEAR[kind](rng), 0.0, rng)
        choice = first_look((0.1, 5.4), robot.spec, 11, 0.7)
        full, _ = robot.test(choice.excitation("x"))
        half, _ = robot.test(choice.excitation("x", amplitudes=[0.5 * (full.amplitude or 1.0)]))
        if np.max(np.abs(half.z - full.z)) > 0.05:
            said.append(nonlinearity_of(full.z, half.z) is expected)
    assert said
    assert np.mean(said) > 0.5
