"""Verdicts, against transfers that are simulated exactly."""

from __future__ import annotations

import numpy as np
import pytest
from random_loops import BAND, SPEC, Loop, answers
from scipy.signal import lsim

from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.orchestrator.study.adaptive_algorithm import AdaptiveStudy
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.orchestrator.study.trajectory_spectrum import Spectrum, spectrum_of
from nufleet.orchestrator.study.verdict import Verdict, predict_transfer
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

STEP_S = 0.01
TIMES_S = np.arange(6000) * STEP_S


def drawing(rng: np.random.Generator, fastest_rad_s: float = 3.0) -> FloatArray:
    """Return a smooth closed trajectory, 60 s long."""
    harmonics = np.arange(2, int(fastest_rad_s * 60 / (2 * np.pi)))
    phases = rng.uniform(0, 2 * np.pi, len(harmonics))
    omega = 2 * np.pi * harmonics / 60
    return np.asarray((1 / harmonics) @ np.cos(np.outer(omega, TIMES_S) + phases[:, None]))


def tracking_error(target: Loop, reference: FloatArray, wanted: FloatArray) -> float:
    """Fly a reference three times in a row, and return the error of the last time."""
    gain, lead, log_omega, log_damping, delay_s = target.theta
    w, damping = np.exp(log_omega), np.exp(log_damping)
    system = ([lead / w, gain], [1 / w**2, 2 * damping / w, 1.0])
    late = np.roll(reference, round(delay_s / STEP_S))
    thrice = np.tile(late, 3)
    _, flown, _ = lsim(system, thrice, np.arange(len(thrice)) * STEP_S)
    return float(np.sqrt(np.mean((flown[-len(wanted) :] - wanted) ** 2)))


def through_inverse(source: Loop, wanted: FloatArray) -> FloatArray:
    """Return the reference that the source's inverse makes of a closed trajectory."""
    omega = 2 * np.pi * np.fft.rfftfreq(len(wanted), STEP_S)
    amplitudes = np.fft.rfft(wanted)
    moving = np.abs(amplitudes) > 1e-9 * np.abs(amplitudes).max()
    amplitudes[moving] /= source.z(omega[moving])
    return np.fft.irfft(amplitudes, len(wanted))


def drawn(
    robot: str,
    responses: list[FrequencyResponse],
    omega_rad_s: FloatArray,
    rng: np.random.Generator,
) -> ComplexArray:
    knowledge = RobotKnowledge(robot, SPEC, BAND[1])
    for response in responses:
        knowledge.learn(response, rng)
    return knowledge.model.draw(omega_rad_s, 300, rng)


def known(loop: Loop, omega_rad_s: FloatArray, samples: int = 3) -> ComplexArray:
    return np.tile(loop.z(omega_rad_s), (samples, 1))


@pytest.mark.parametrize(
    ("source", "target"),
    [
        (Loop(3.0), Loop(3.3)),
        (Loop(3.3), Loop(3.0)),
        (Loop(1.5, delay_s=0.3), Loop(5.0)),
        (Loop(5.0), Loop(1.5, delay_s=0.3)),
    ],
)
def test_predicted_errors_are_those_of_a_simulated_transfer(source: Loop, target: Loop) -> None:
    wanted = drawing(np.random.default_rng(0))
    spectrum = spectrum_of(wanted, STEP_S)
    omega = spectrum.omega_rad_s
    found = predict_transfer(
        ("source", known(source, omega)), ("target", known(target, omega)), spectrum, BAND
    )
    size = float(np.std(wanted))
    with_transfer = tracking_error(target, through_inverse(source, wanted), wanted) / size
    without = tracking_error(target, wanted, wanted) / size
    assert float(found.error_with.median) == pytest.approx(with_transfer, rel=0.03, abs=0.003)
    assert float(found.error_without.median) == pytest.approx(without, rel=0.03)
    helps = with_transfer < without
    assert found.verdict is (Verdict.TRANSFER if helps else Verdict.DO_NOT_TRANSFER)


@pytest.mark.thorough
def test_verdicts_from_tests_are_right_and_never_harmful() -> None:
    given, right, harmful = 0, 0, 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        names = ["target", "a", "b", "c"]
        fleet = {
            n: Loop(rng.uniform(1.5, 5.0), damping=rng.uniform(0.4, 1), delay_s=rng.uniform(0, 0.3))
            for n in names
        }
        plan = StudyPlan("target", ("a", "b", "c"), BAND, 4, "x")
        study = AdaptiveStudy(plan, dict.fromkeys(names, SPEC), rng)
        while (question := study.ask()) is not None:
            study.tell(answers(fleet, question, 0.02, rng), {})
        spectrum = spectrum_of(drawing(rng), STEP_S)
        omega, share = spectrum.omega_rad_s, spectrum.power / spectrum.power.sum()
        believed = {robot: drawn(robot, study.responses[robot], omega, rng) for robot in names}
        for source, target in [(s, "target") for s in "abc"] + [("target", s) for s in "abc"]:
            found = predict_transfer(
                (source, believed[source]), (target, believed[target]), spectrum, BAND
            )
            if found.verdict is Verdict.NEED_MORE_TESTS:
                continue
            z_s, z_t = fleet[source].z(omega), fleet[target].z(omega)
            helps = share @ np.abs(1 - z_t / z_s) ** 2 < share @ np.abs(1 - z_t) ** 2
            given += 1
            right += (found.verdict is Verdict.TRANSFER) == helps
            harmful += found.verdict is Verdict.TRANSFER and not helps
    assert given >= 36
    assert right >= 0.95 * given
    assert harmful == 0


def test_the_two_directions_differ_by_the_ratio_of_the_gains() -> None:
    slow, quick = Loop(1.5), Loop(5.0)
    spectrum = Spectrum.flat(BAND)
    omega = spectrum.omega_rad_s
    there, back = (
        predict_transfer(("s", known(a, omega)), ("t", known(b, omega)), spectrum, BAND)
        for a, b in ((slow, quick), (quick, slow))
    )
    ratio = np.abs(quick.z(omega)) / np.abs(slow.z(omega))
    np.testing.assert_allclose(there.gain_with.median / back.gain_with.median, ratio)


def test_what_is_not_known_well_enough_needs_more_tests() -> None:
    rng = np.random.default_rng(0)
    spectrum = Spectrum.flat(BAND)
    noise = 0.8 * rng.standard_normal((2, 400, 1))
    vague = known(Loop(3.0), spectrum.omega_rad_s, 400) + noise[0] + 1j * noise[1]
    target = known(Loop(3.0), spectrum.omega_rad_s, 400)
    found = predict_transfer(("s", vague), ("t", target), spectrum, BAND)
    assert found.verdict is Verdict.NEED_MORE_TESTS
    assert "helps with probability" in found.reason


@pytest.mark.parametrize(
    ("fastest_rad_s", "verdict"), [(3.0, Verdict.TRANSFER), (12.0, Verdict.NEED_MORE_TESTS)]
)
def test_a_trajectory_that_leaves_the_tested_band_is_said(
    fastest_rad_s: float, verdict: Verdict
) -> None:
    spectrum = spectrum_of(drawing(np.random.default_rng(1), fastest_rad_s), STEP_S)
    omega = spectrum.omega_rad_s
    found = predict_transfer(
        ("s", known(Loop(3.0), omega)), ("t", known(Loop(3.1), omega)), spectrum, BAND
    )
    assert found.verdict is verdict
    assert ("above the tested band" in found.reason) == (verdict is Verdict.NEED_MORE_TESTS)


def test_a_source_that_is_closer_is_expected_to_leave_a_smaller_error() -> None:
    spectrum = Spectrum.flat((0.1, 1.0))
    omega = spectrum.omega_rad_s
    target = ("t", known(Loop(3.0), omega))
    sources = {"far": Loop(1.5), "near": Loop(3.05), "middle": Loop(2.4)}
    found = [
        predict_transfer((name, known(loop, omega)), target, spectrum, BAND)
        for name, loop in sources.items()
    ]
    by_error = sorted(found, key=lambda prediction: float(prediction.error_with.median))
    assert [prediction.source for prediction in by_error] == ["near", "middle", "far"]
