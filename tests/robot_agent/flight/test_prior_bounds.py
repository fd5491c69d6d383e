"""A prior is asked, before it is kept, what it would answer on the paths that the robot flies."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from learned_things import experience, layout
from robots_that_learn import double_integrator

from nufleet.orchestrator.experience.lesson_record import LearningRecord, pooled_pairs
from nufleet.orchestrator.experience.linear_inverse import linear_experience
from nufleet.orchestrator.experience.training import Origin, TrainingData
from nufleet.robot_agent.experience_service import ExperienceService
from nufleet.robot_agent.flight.inverse_model import NetworkInverse
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.prior_bounds import gamma_max, out_of_bounds
from nufleet.robot_agent.flight.rich_flight import fly_record
from nufleet.robot_agent.network.trust import Trust
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.file import Experience, decode_experience, digest, encode_experience
from nufleet.shared.experience.layout import Architecture, InverseLayout
from nufleet.shared.paths.references import rich_references
from nufleet.shared.robots.fleet_file import RobotPolicy
from nufleet.shared.wire.codec import Message
from nufleet.shared.wire.messages import ExperienceOffer, InstallRequest, Refusal

SPEC = double_integrator().spec


@pytest.mark.parametrize("architecture", ["state", "preview"])
@pytest.mark.parametrize("horizon_samples", [4, 20, 45])
@pytest.mark.parametrize("gain", [1.0, 1.25])
def test_the_inverses_of_robots_are_in_bounds(
    architecture: Architecture, horizon_samples: int, gain: float
) -> None:
    robot = double_integrator(noise_std_m=0.002)
    names = robot.state_names if architecture == "state" else robot.state_names[:1]
    known = InverseLayout(
        architecture=architecture,
        states=names,
        sample_time_s=SPEC.sample_time_s,
        horizon_samples=horizon_samples,
    )
    flown = fly_record(robot, rich_references(SPEC, 60.0, np.random.default_rng(0)))
    record = LearningRecord(flown.references, flown.states, robot.state_names)
    data = TrainingData(*pooled_pairs(known, record, (0,)))
    origin = Origin("source", SPEC.kind, ("x",), "m", 1)
    inverse = NetworkInverse(linear_experience(data, known, origin, gain=gain))
    assert out_of_bounds(inverse, known, SPEC) is None


@pytest.mark.parametrize("scale", [2.0, 1e30, np.inf, np.nan])
def test_a_prior_whose_answers_no_correction_needs_is_refused(scale: float) -> None:
    known = layout()
    assert SPEC.tracking is not None
    most = gamma_max(known, SPEC.tracking)

    def constant(inputs: FloatArray) -> FloatArray:
        return np.full(len(inputs), scale * most)

    reason = out_of_bounds(constant, known, SPEC)
    assert reason is not None
    assert "on paths that the robot may fly" in reason
    # It is not asked by a robot that flies no paths.
    assert out_of_bounds(constant, known, SPEC.model_copy(update={"tracking": None})) is None


def test_a_prior_at_its_bound_is_kept() -> None:
    known = layout()
    assert SPEC.tracking is not None
    most = gamma_max(known, SPEC.tracking)
    assert out_of_bounds(lambda inputs: np.full(len(inputs), most), known, SPEC) is None


def test_the_owner_of_the_robot_may_set_the_bound() -> None:
    known = layout()
    assert SPEC.tracking is not None
    most = gamma_max(known, SPEC.tracking)
    for allowed, output in ((0.5 * most, 0.6 * most), (2.0 * most, 3.0 * most)):
        constant = partial(_constant, output)
        reason = out_of_bounds(constant, known, SPEC, most=allowed)
        assert reason is not None
        assert f"its fleet file allows {allowed:.3g} (`prior_output_max`)" in reason
        assert out_of_bounds(partial(_constant, allowed), known, SPEC, most=allowed) is None


def _constant(output: float, inputs: FloatArray) -> FloatArray:
    return np.full(len(inputs), output)


def test_a_poisoned_prior_is_not_installed_and_the_one_before_it_stays() -> None:
    robot, memory = double_integrator(), Memory(None)
    trust = Trust("target", RobotPolicy(), None, frozenset)
    service = ExperienceService("target", robot, memory, lambda sender: None, trust)
    good = experience("source", "state")
    fine = decode_experience(good)
    poison = encode_experience(
        Experience(fine.manifest.model_copy(update={"output_scale": 1e30}), fine.arrays)
    )

    def answer(payload: bytes) -> Message:
        request = InstallRequest(sender="me", payload=payload, sha256=digest(payload))
        return service.install_prior(request)

    assert isinstance(answer(good), ExperienceOffer)
    refusal = answer(poison)
    assert isinstance(refusal, Refusal)
    assert refusal.code == "bounds"
    assert "source" in refusal.reason
    assert memory.prior is not None
    assert memory.prior.sha256 == digest(good)
