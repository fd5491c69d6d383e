"""A robot's agent plays a test of several axes and returns what all of them did."""

from __future__ import annotations

import numpy as np
from fleet_lab import Lab

from nufleet.orchestrator.study.tone_choice import ToneChoice
from nufleet.robot_agent.motion.excitation import reference_of
from nufleet.shared.frequency_test.frequency_response import estimate_frequency_response
from nufleet.shared.wire.messages import Outcome
from nufleet.sims.coupled_loops import CoupledLoops, CoupledLoopsSettings

SETTINGS = CoupledLoopsSettings(
    natural_frequency_rad_s=(4.0, 5.0), damping_ratio=(0.7, 0.7), coupling=(0.3,)
)


def test_tones_on_two_axes_come_back_as_every_entry_of_the_response(lab: Lab) -> None:
    robot = CoupledLoops("a", SETTINGS, np.random.default_rng(0))
    lab.agent("a", robot)
    choice = ToneChoice(10.0, (1, 5, 7, 9, 11), axes=(1, 0))
    request = choice.excitation("x", "y")
    result = lab.orchestrator().run(
        "a", "g", axis=request.axis, tones=request.tones, also=request.also
    )
    assert result.outcome is Outcome.COMPLETED
    plan = result.test_plan
    assert [played.axis for played in plan.played] == ["y", "x"]
    np.testing.assert_array_equal(result.reference, reference_of(plan))
    assert result.response.shape == (plan.samples, 2)
    response = estimate_frequency_response(result.reference, result.response, plan)
    assert response.matrix is not None
    across = response.matrix.entry(1, 0)
    z = robot.model.graph(across.omega_rad_s)[:, 2 + 0, 1]
    np.testing.assert_allclose(across.z, z, atol=2e-3)
