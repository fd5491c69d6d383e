"""One test of several axes gives every entry of a coupled robot's response."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.orchestrator.study.tone_choice import (
    ToneChoice,
    first_look,
    lowest_look_together,
)
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.excitation import ExcitationPlan
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.shared.frequency_test.matrix_response import MatrixResponse
from nufleet.sims.coupled_loops import CoupledLoops, CoupledLoopsSettings

NAMES = ("x", "y", "z", "w")
BAND = (0.3, 8.0)


def robot_of(axes: int, noise_std_m: float = 0.0, seed: int = 0, **more: object) -> CoupledLoops:
    settings = CoupledLoopsSettings.model_validate(
        {
            "natural_frequency_rad_s": (4.0, 5.0, 3.5, 4.5)[:axes],
            "damping_ratio": (0.7, 0.6, 0.8, 0.5)[:axes],
            "coupling": (0.2, -0.1, 0.15, 0.1, 0.05, -0.2)[: axes * (axes - 1) // 2],
            "axes": NAMES[:axes],
            "noise_std_m": noise_std_m,
            **more,
        }
    )
    robot = CoupledLoops("robot", settings, np.random.default_rng(seed))
    robot.connect()
    return robot


def planned(robot: CoupledLoops, axes: tuple[int, ...]) -> ExcitationPlan:
    choice: ToneChoice = first_look(BAND, robot.spec, 11, 0.7, axes)
    return plan_excitation(choice.excitation(*NAMES), robot.spec, "robot")


def matrix_of(response: FrequencyResponse) -> MatrixResponse:
    assert response.matrix is not None
    return response.matrix


def answer_of(robot: CoupledLoops, axes: tuple[int, ...]) -> MatrixResponse:
    plan = planned(robot, axes)
    reference = reference_of(plan)
    return matrix_of(estimate_frequency_response(reference, robot.run(reference), plan))


def true_rows(robot: CoupledLoops, matrix: MatrixResponse) -> ComplexArray:
    """Return z_ij at every tone, shape (outputs, tones)."""
    z = robot.model.graph(matrix.rows[0].omega_rad_s)[:, len(robot.spec.axes) :]
    return np.stack([row[np.arange(len(row)), matrix.played_by] for row in np.moveaxis(z, 1, 0)])


@pytest.mark.parametrize("axes", [2, 3, 4])
def test_without_noise_every_entry_is_that_of_the_known_model(axes: int) -> None:
    robot = robot_of(axes)
    matrix = answer_of(robot, tuple(range(axes)))
    assert matrix.axes == NAMES[:axes]
    assert matrix.quality.usable
    estimates = np.stack([row.z for row in matrix.rows])
    np.testing.assert_allclose(estimates, true_rows(robot, matrix), atol=2e-4)
    for i in range(axes):
        for j in range(axes):
            entry = matrix.entry(i, j)
            expected = robot.model.graph(entry.omega_rad_s)[:, axes + i, j]
            np.testing.assert_allclose(entry.z, expected, atol=2e-4)


def test_the_regions_of_all_entries_hold_the_truth_as_often_as_they_say() -> None:
    inside, count = 0, 0
    for seed in range(30):
        robot = robot_of(2, noise_std_m=0.003, seed=seed)
        matrix = answer_of(robot, (0, 1))
        error = np.abs(np.stack([row.z for row in matrix.rows]) - true_rows(robot, matrix))
        radius = np.stack([row.radius() for row in matrix.rows])
        inside, count = inside + int(np.sum(error <= radius)), count + error.size
    assert 0.93 <= inside / count <= 0.98


def test_noise_that_disturbs_two_axes_together_is_estimated_as_such() -> None:
    robot = robot_of(2)
    plan = planned(robot, (0, 1))
    reference = reference_of(plan)
    output = robot.run(reference)
    shared, found = np.array([[1.0, 0.0], [-0.8, 0.6]]), []
    for seed in range(20):
        noise = 0.003 * np.random.default_rng(seed).standard_normal(output.shape) @ shared.T
        matrix = matrix_of(estimate_frequency_response(reference, output + noise, plan))
        found.append(matrix.correlation[0, 1])
        covariance = matrix.covariance
        np.testing.assert_allclose(
            np.einsum("tii->ti", covariance).real.T, [row.variance for row in matrix.rows]
        )
        assert np.linalg.eigvalsh(covariance).min() >= 0
    assert np.mean(found) == pytest.approx(-0.8, abs=0.05)


def test_noise_that_is_out_of_phase_on_two_axes_has_a_complex_correlation() -> None:
    robot = robot_of(2)
    plan = planned(robot, (0, 1))
    reference = reference_of(plan)
    output = robot.run(reference)
    white = 0.003 * np.random.default_rng(0).standard_normal(len(output))
    late = np.fft.irfft(-1j * np.fft.rfft(white), len(white))  # a quarter of a period
    noise = np.stack([white, late], axis=1)
    matrix = matrix_of(estimate_frequency_response(reference, output + noise, plan))
    assert matrix.correlation[0, 1] == pytest.approx(1j, abs=0.15)
    assert matrix.correlation[1, 0] == matrix.correlation[0, 1].conj()


def test_the_unit_of_an_axis_scales_its_entries_and_changes_no_verdict() -> None:
    robot = robot_of(2, noise_std_m=0.002)
    plan = planned(robot, (0, 1))
    reference = reference_of(plan)
    output = robot.run(reference)
    units = np.array([1.0, 1000.0])
    also = (plan.also[0].model_copy(update={"amplitude": 1000.0 * plan.also[0].amplitude}),)
    metres = matrix_of(estimate_frequency_response(reference, output, plan))
    mixed = matrix_of(
        estimate_frequency_response(
            reference * units, output * units, plan.model_copy(update={"also": also})
        )
    )
    assert mixed.quality == metres.quality
    for i in range(2):
        for j in range(2):
            factor = units[i] / units[j]
            np.testing.assert_allclose(mixed.entry(i, j).z, factor * metres.entry(i, j).z)
            np.testing.assert_allclose(
                mixed.entry(i, j).variance, factor**2 * metres.entry(i, j).variance
            )


def test_an_axis_that_does_not_respond_is_named_and_the_others_are_not() -> None:
    robot = robot_of(2, noise_std_m=0.001)
    plan = planned(robot, (0, 1))
    reference = reference_of(plan)
    output = robot.run(reference)
    output[:, 1] = 0.001 * np.random.default_rng(1).standard_normal(len(output))
    response = estimate_frequency_response(reference, output, plan)
    texts = [finding.text for finding in response.quality.warnings]
    assert any(text.startswith("axis y: no response exceeds the noise") for text in texts)
    assert not any(text.startswith("axis x: no response") for text in texts)


def test_axes_that_are_not_coupled_are_not_silent() -> None:
    robot = robot_of(2, noise_std_m=0.001, coupling=())
    matrix = answer_of(robot, (0, 1))
    assert not any("no-response" in finding.code for finding in matrix.quality.warnings)
    assert np.all(np.abs(matrix.entry(1, 0).z) < 5 * np.sqrt(matrix.entry(1, 0).variance))


@pytest.mark.parametrize("low", [1, 2, 3])
def test_tones_less_than_a_beat_apart_at_the_lower_end_are_told_apart(low: int) -> None:
    robot = robot_of(4)
    choice = lowest_look_together((0.2, 8.0), robot.spec, 0.5, (1, 2, 3, 0), low)
    assert choice is not None
    assert [bool(choice.omegas_of(axis)[0] <= 0.5) for axis in (1, 2, 3)] == [
        place < low for place in range(3)
    ]
    inside = []
    for seed in range(12):
        noisy = robot_of(4, noise_std_m=0.006, seed=seed)
        plan = plan_excitation(choice.excitation(*NAMES), noisy.spec, "robot")
        assert plan.duration_s == pytest.approx(choice.duration_s(noisy.spec), abs=0.1)
        order = [NAMES.index(one.axis) for one in plan.played]
        references = np.zeros((plan.samples, 4))
        references[:, order] = reference_of(plan)
        output = noisy.run(references)[:, order]
        matrix = matrix_of(estimate_frequency_response(reference_of(plan), output, plan))
        assert matrix.quality.usable
        slow = matrix.rows[0].omega_rad_s <= 0.5
        assert slow.sum() == low
        z = noisy.model.graph(matrix.rows[0].omega_rad_s)[:, 4:]
        at = np.array(order)[matrix.played_by]
        for place, row in zip(order, matrix.rows, strict=True):
            errors = np.abs(row.z - z[np.arange(len(at)), place, at])
            assert np.max(errors[slow]) < 0.3
            inside.append(errors[slow] <= row.radius()[slow])
    assert np.mean(np.concatenate(inside)) > 0.9


@pytest.mark.parametrize("column", [0, 1])
def test_samples_that_are_not_finite_fail_the_whole_test(column: int) -> None:
    robot = robot_of(2)
    plan = planned(robot, (0, 1))
    reference: FloatArray = reference_of(plan)
    output = robot.run(reference)
    output[plan.first_measured_sample + 5, column] = np.nan
    response = estimate_frequency_response(reference, output, plan)
    assert not response.quality.usable
    assert np.isnan(matrix_of(response).rows[0].z).all()


def test_the_decay_of_coupled_axes_is_fitted_along_with_the_tones() -> None:
    robot = robot_of(2, damping_ratio=(0.2, 0.2))
    choice = first_look(BAND, robot.spec, 11, 0.3, (0, 1))
    plan = plan_excitation(choice.excitation(*NAMES, settle_s=2.0), robot.spec, "robot")
    reference = reference_of(plan)
    matrix = matrix_of(estimate_frequency_response(reference, robot.run(reference), plan))
    assert "ringing" in {finding.code for finding in matrix.quality.warnings}
    estimates = np.stack([row.z for row in matrix.rows])
    np.testing.assert_allclose(estimates, true_rows(robot, matrix), atol=0.02)
