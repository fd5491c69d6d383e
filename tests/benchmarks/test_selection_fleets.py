"""The linear noise model that the benchmark draws tests from, against simulated tests."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.nonlinear_loop import NonlinearLoop, play
from benchmarks.selection_fleets import (
    BAND_RAD_S,
    FAMILIES,
    SAMPLE_TIME_S,
    LinearLoop,
    Mode,
    drawn_response,
    random_fleet,
    spec_of,
)
from nufleet.orchestrator.study.tone_choice import first_look
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import estimate_frequency_response

NOISE_M = 0.01
LOOP = NonlinearLoop(3.0, 0.6, 0.2, 0.06, dead_zone_m_s2=0.0, rate_max_m_s3=math.inf)
LINEAR = LinearLoop((Mode(3.0, 0.6, 0.2),), 0.06)
EXCITATIONS = {
    "one tone": Excitation(axis="x", tones=(Tone(omega_rad_s=2.0),), segments=4),
    "many tones": first_look(BAND_RAD_S, spec_of(LINEAR), 11, 0.7).excitation("x"),
}


@pytest.mark.parametrize("excitation", EXCITATIONS.values(), ids=EXCITATIONS)
def test_drawn_tests_scatter_like_simulated_ones(excitation: Excitation) -> None:
    plan = plan_excitation(excitation, spec_of(LINEAR), "robot")
    reference = reference_of(plan)
    clean = play(LOOP, reference, SAMPLE_TIME_S)
    rng = np.random.default_rng(0)
    simulated = [
        estimate_frequency_response(
            reference, clean + NOISE_M * rng.standard_normal(len(clean)), plan
        )
        for _ in range(150)
    ]
    drawn = [drawn_response(LINEAR, plan, NOISE_M, rng) for _ in range(1500)]
    truth = LINEAR.response(drawn[0].omega_rad_s)
    errors = [np.array([r.z for r in responses]) - truth for responses in (simulated, drawn)]
    scatter = [np.sqrt(np.mean(np.abs(e - e.mean(axis=0)) ** 2, axis=0)) for e in errors]
    np.testing.assert_allclose(scatter[0], scatter[1], rtol=0.2)
    # The simulation integrates with steps of 5 ms, which is a delay of half of that.
    assert np.all(np.abs(errors[0].mean(axis=0)) < 0.015)
    own, given = (np.array([r.variance for r in rs]).mean(axis=0) for rs in (simulated, drawn))
    # Segments that hold no whole beats of close tones and harmonics scatter less than they should:
    # the estimator's own variances are too small there, and a drawn test does not imitate that.
    tightest = 0.8 if len(truth) == 1 else 0.3
    assert np.all((tightest < own / given) & (own / given < 1.2))


@pytest.mark.parametrize("family", FAMILIES)
def test_fleets_of_every_family_can_be_tested(family: str) -> None:
    fleet = random_fleet(family, 2, NOISE_M, np.random.default_rng(0))
    assert fleet.regret(min(fleet.psi_star, key=lambda s: fleet.psi_star[s])) == 0.0
    for robot in fleet.robots.values():
        choice = first_look(BAND_RAD_S, robot.spec, 11, 0.7)
        response, duration_s = robot.test(choice.excitation("x"))
        assert response.quality.usable, str(response.quality)
        assert duration_s == pytest.approx(choice.duration_s(robot.spec))
