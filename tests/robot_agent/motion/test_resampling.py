"""Outputs at the samples, from measurements that came late, irregularly, or not at all."""

from __future__ import annotations

import numpy as np
import pytest
from puppet_robot import PuppetRobot, puppet_spec

from nufleet.robot_agent.motion.pace import HaltSwitch
from nufleet.robot_agent.motion.perform import AxisMotion, perform
from nufleet.robot_agent.motion.resampling import outputs_at_samples
from nufleet.robot_agent.robot import Record, RobotAround
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.frequency_test.timing import Timing, late_findings, timing_findings
from nufleet.shared.wire.messages import Outcome

SPEC = puppet_spec(sample_time_s=0.02)
SAMPLES = 500
OMEGA_RAD_S = 6.0


def truth(times_s: FloatArray) -> FloatArray:
    return np.stack([np.sin(OMEGA_RAD_S * times_s), np.cos(OMEGA_RAD_S * times_s)], axis=1)


def recorded(*, jitter_s: float = 0.0, loss: float = 0.0, seed: int = 0) -> Record:
    """Samples at 50 Hz and measurements at 100 Hz, off their times; some of the latter are lost."""
    rng = np.random.default_rng(seed)
    sent_s = 7.0 + 0.02 * np.arange(SAMPLES) + jitter_s * rng.uniform(0, 1, SAMPLES)
    measured_s = 6.993 + 0.01 * np.arange(2 * SAMPLES + 4)
    measured_s += jitter_s / 2 * rng.uniform(0, 1, len(measured_s))
    measured_s = measured_s[rng.random(len(measured_s)) >= loss]
    return Record(sent_s, measured_s, truth(measured_s))


@pytest.mark.parametrize(("jitter_s", "loss", "error"), [(0, 0, 1e-6), (0.008, 0.05, 3e-4)])
def test_outputs_are_those_at_the_moments_when_the_references_were_sent(
    jitter_s: float, loss: float, error: float
) -> None:
    record = recorded(jitter_s=jitter_s, loss=loss)
    outputs, timing = outputs_at_samples(record, SAMPLES, SPEC)
    # At either end the truth here moves, where a robot rests.
    assert np.abs(outputs - truth(record.sample_s))[5:-5].max() < error
    assert timing is not None
    assert timing.period_s == pytest.approx(0.02, rel=1e-4)
    assert timing.jitter_std_s == pytest.approx(jitter_s / np.sqrt(12), rel=0.1, abs=1e-12)
    assert timing.unmeasured == 0.0
    codes = [finding.code for finding in timing_findings(timing, 0.02)]
    assert codes == (["jitter"] if jitter_s else [])


def test_samples_in_a_gap_are_counted_and_reported() -> None:
    record = recorded()
    kept = (record.measured_s < 9.0) | (record.measured_s > 9.2)
    record = Record(record.sample_s, record.measured_s[kept], record.outputs[kept], 3e-4)
    _, timing = outputs_at_samples(record, SAMPLES, SPEC)
    assert timing is not None
    assert timing.clock_std_s == 3e-4
    assert timing.gap_max_s == pytest.approx(0.21)
    assert timing.unmeasured == pytest.approx(9 / SAMPLES, abs=2 / SAMPLES)
    (finding,) = timing_findings(timing, 0.02)
    assert finding.code == "gaps"
    assert "the longest gap was 210 ms" in finding.text


def test_a_wrong_sample_time_is_reported_with_its_effect_on_the_frequencies() -> None:
    timing = Timing(period_s=0.0204, jitter_std_s=0, gap_max_s=0.01, unmeasured=0)
    (finding,) = timing_findings(timing, 0.02)
    assert finding.code == "period"
    assert "-2 % off" in finding.text


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda r: Record(r.sample_s[:-1], r.measured_s, r.outputs), "499 samples, and 500 were"),
        (lambda r: Record(r.sample_s, r.measured_s[1:], r.outputs), "outputs of shape"),
        (lambda r: Record(r.sample_s[::-1], r.measured_s, r.outputs), "references go back"),
        (lambda r: Record(r.sample_s, r.measured_s[::-1], r.outputs), "measurements go back"),
        (lambda r: Record(r.sample_s + np.nan, r.measured_s, r.outputs), "not finite"),
        (lambda r: Record(r.sample_s, r.measured_s, r.outputs * np.inf), "not finite"),
        (lambda r: Record(r.sample_s, r.measured_s[:600], r.outputs[:600]), "nothing was measured"),
        (lambda r: Record(r.sample_s, r.measured_s[:0], r.outputs[:0]), "nothing was measured"),
    ],
)
def test_a_record_that_cannot_be_right_is_refused_with_a_sentence(spoil, said: str) -> None:
    with pytest.raises(RobotError, match=said):
        outputs_at_samples(spoil(recorded()), SAMPLES, SPEC)


class Late(RobotAround):
    """Returns outputs that are two samples old, and records the right ones."""

    record_: Record | None = None

    def run(self, references: FloatArray) -> FloatArray:
        outputs = self._robot.run(references)
        times_s = 0.02 * np.arange(len(outputs))
        self.record_ = Record(times_s, times_s, outputs)
        return np.concatenate([np.zeros((2, 2)), outputs[:-2]])

    def record(self) -> Record | None:
        return self.record_


def test_a_tests_response_is_what_its_robot_recorded() -> None:
    robot = Late(PuppetRobot(SPEC))
    robot.connect()
    reference = np.sin(np.linspace(0.0, 6.0, 200))
    switch = HaltSwitch()

    def played():
        motion = AxisMotion(
            robot, ["y"], reference, realtime=None, switch=switch, on_samples=lambda *_: None
        )
        return perform(robot, motion, switch, on_resting=lambda: None)

    result = played()
    assert result.outcome is Outcome.COMPLETED
    np.testing.assert_allclose(result.samples.response, reference, atol=1e-12)
    assert result.samples.timing is not None
    robot.record = lambda: Record(np.zeros(3), np.zeros(3), np.zeros((3, 2)))  # type: ignore[method-assign]
    result = played()
    assert (result.outcome, result.fault) == (Outcome.FAILED, None)
    assert "the times of 3 samples" in result.reason
    assert robot._robot.at_rest  # type: ignore[attr-defined]


def test_many_late_samples_are_a_finding_with_a_remedy() -> None:
    assert not list(late_findings(1, 1000))
    (finding,) = late_findings(2, 1000)
    assert finding.text.startswith("2 of 1000 samples began more than a sample time late")
    assert "grant the agent real-time priority" in finding.text
