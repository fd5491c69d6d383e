"""Errors that the motion of one axis leaves on another, beside those of the whole matrices."""

from __future__ import annotations

import numpy as np
import pytest
from loops_on_axes import AXES, answer, spec_of
from random_loops import BAND, Loop

from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.comparison import Comparison
from nufleet.orchestrator.study.errors_across import ErrorsAcross
from nufleet.orchestrator.study.interface import DesiredMotion, SourceEstimate, StudyPlan
from nufleet.orchestrator.study.tone_choice import first_look
from nufleet.orchestrator.study.trajectory_spectrum import Spectrum
from nufleet.orchestrator.study.transfer_verdicts import judge_transfers
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

SHARE = 0.3
"""Share of its own response with which each axis of the target answers to the other."""

TARGET = {"x": Loop(3.0), "y": Loop(3.5)}
SOURCE = {"x": Loop(3.1), "y": Loop(3.4)}
LINES = np.linspace(0.5, 4.0, 30)
POWER = {"x": np.full(30, 0.7 / 30), "y": np.full(30, 0.3 / 30)}
MOTION = DesiredMotion(
    "path",
    tuple(LINES.tolist()),
    (1 / 30,) * 30,
    {axis: tuple(power.tolist()) for axis, power in POWER.items()},
)
PLAN = StudyPlan("target", ("source",), BAND, 8, "x", MOTION, also=("y",))
SPEC = spec_of()


def measured(loops: dict[str, Loop], across: float) -> list[FrequencyResponse]:
    rng = np.random.default_rng(0)
    tests = [first_look(BAND, SPEC, 44, 0.7, turn) for turn in ((0, 1), (1, 0))]
    return [answer(loops, test.excitation(*AXES), 1e-3, rng, across) for test in tests]


def known(robot: str, loops: dict[str, Loop], across: float) -> AxesKnowledge:
    found, rng = AxesKnowledge(robot, SPEC, BAND[1], AXES), np.random.default_rng(0)
    for response in measured(loops, across):
        found.learn(response, rng, check=False)
    return found


def matrix(loops: dict[str, Loop], across: float) -> ComplexArray:
    """Return Z(ω) at the lines, shape (lines, axes, axes)."""
    z = np.stack([loops[axis].z(LINES) for axis in AXES], axis=1)
    return np.asarray(z[:, :, None] * np.where(np.eye(2, dtype=bool), 1.0, across))


def left(power: dict[str, FloatArray], outputs: list[int], *, transferred: bool) -> float:
    """Return √Σ |E_ij|² P_j over √Σ P with E = I − Z_T D_S⁻¹, or I − Z_T without a transfer."""
    z, d = matrix(TARGET, SHARE), np.einsum("kii->ki", matrix(SOURCE, 0.0))
    error = np.eye(2) - (z / d[:, None, :] if transferred else z)
    squares = np.abs(error) ** 2 * np.stack([power[axis] for axis in AXES], axis=1)[:, None, :]
    total = sum(power[AXES[place]].sum() for place in outputs)
    return float(np.sqrt(squares[:, outputs].sum() / total))


def test_both_axes_answer_as_the_closed_form_says() -> None:
    rng = np.random.default_rng(0)
    spectra = {axis: Spectrum(LINES, power) for axis, power in POWER.items()}
    across = ErrorsAcross.of(known("target", TARGET, SHARE), spectra, 50, rng)
    assert set(across.z) == {("x", "y"), ("y", "x")}
    truth = matrix(TARGET, SHARE)
    np.testing.assert_allclose(across.z["y", "x"].mean(axis=0), truth[:, 1, 0], atol=0.02)
    np.testing.assert_allclose(across.z["x", "y"].mean(axis=0), truth[:, 0, 1], atol=0.02)
    on_y = np.linalg.norm(across.on(["y"], spectra["y"]), axis=1)
    wanted = np.sqrt(np.sum(np.abs(truth[:, 1, 0]) ** 2 * POWER["x"]) / POWER["y"].sum())
    assert float(np.median(on_y)) == pytest.approx(float(wanted), rel=0.05)


def test_axes_that_do_not_answer_to_each_other_leave_nothing() -> None:
    rng = np.random.default_rng(0)
    spectra = {axis: Spectrum(LINES, power) for axis, power in POWER.items()}
    across = ErrorsAcross.of(known("target", TARGET, 0.0), spectra, 50, rng)
    assert across.z == {}
    assert across.on(AXES, spectra["x"]).shape == (50, 0)


def test_errors_on_a_path_and_verdicts_are_those_of_the_whole_matrices() -> None:
    rng = np.random.default_rng(0)
    robots = {"target": known("target", TARGET, SHARE), "source": known("source", SOURCE, 0.0)}
    settings = AdaptiveSettings(samples=200, grid_points=64)
    compared = Comparison(PLAN, settings, robots, rng).of(["source"])
    assert compared.belief.errors is not None
    expected = left(POWER, [0, 1], transferred=True)
    error = float(np.median(compared.belief.errors.total))
    assert error == pytest.approx(expected, rel=0.05)
    said = "errors include what one axis of target does to another"
    assert any(said in finding for finding in compared.findings)

    responses = {"target": measured(TARGET, SHARE), "source": measured(SOURCE, 0.0)}
    ranking = [SourceEstimate("source", 0.1, 0.1, 0.1, 1.0, 1)]
    specs = dict.fromkeys(robots, SPEC)
    judged = judge_transfers(PLAN, ranking, specs, responses, rng)
    found = judged.verdicts["source"]
    assert found.error_with.median == pytest.approx(expected, rel=0.05)
    without = left(POWER, [0, 1], transferred=False)
    assert found.error_without.median == pytest.approx(without, rel=0.05)
    assert found.axes is not None
    on_y = left(POWER, [1], transferred=True)
    assert found.axes["y"].error_with.median == pytest.approx(on_y, rel=0.05)
    assert any(said in finding for finding in judged.findings)
