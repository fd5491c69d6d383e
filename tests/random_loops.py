"""Loops, robots and answers for studies: exact responses with measurement noise, no simulation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from nufleet.orchestrator.belief.loop_features import response
from nufleet.orchestrator.study.interface import Question
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Quality
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

BAND = (0.1, 5.4)

SPEC = RobotSpec(
    kind="random-loop",
    axes=(AxisSpec(name="x", unit="m", amplitude_max=0.5, velocity_max=1, acceleration_max=4),),
    sample_time_s=0.02,
    omega_min_rad_s=0.05,
    omega_max_rad_s=20.0,
    duration_max_s=1800.0,
    settling_time_s=4.0,
    simulated=False,
)


class Loop:
    """A second-order loop with lead and delay, whose tests have a deviation of each ẑ."""

    def __init__(
        self,
        omega_rad_s: float,
        *,
        damping: float = 0.7,
        lead: float = 0.5,
        delay_s: float = 0.05,
        gain: float = 1.0,
    ) -> None:
        self.theta = np.array([gain, lead, np.log(omega_rad_s), np.log(damping), delay_s])

    def z(self, omega_rad_s: FloatArray) -> ComplexArray:
        """Return the true response."""
        return response(self.theta, omega_rad_s)

    def answer(
        self, test: Excitation, deviation: float, rng: np.random.Generator
    ) -> FrequencyResponse:
        """Return what a test of it gives."""
        omega = np.array([tone.omega_rad_s for tone in test.tones])
        error = deviation * rng.standard_normal((2, len(omega))) / np.sqrt(2)
        degrees = 2 * (test.segments - 1)
        return FrequencyResponse(
            omega_rad_s=omega,
            z=self.z(omega) + error[0] + 1j * error[1],
            variance=deviation**2 * rng.chisquare(degrees, len(omega)) / degrees,
            segments=test.segments,
            quality=Quality(),
        )


def answers(
    loops: Mapping[str, Loop], question: Question, deviation: float, rng: np.random.Generator
) -> dict[str, FrequencyResponse]:
    """Return what every robot of a question answers."""
    return {name: loops[name].answer(test, deviation, rng) for name, test in question.tests.items()}
