"""Distortion in a test, and how uncertain it makes the response to other motions of that size."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.belief.amplitude_dependence import differ
from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.nonlinearity import DISTORTION_REPORTED

NONLINEAR_ELSEWHERE = 8.0
"""Change of the response in another motion of the same size, as a multiple of the distortion that a
test shows. Among 48 loops of each kind it is 2 in the median with backlash, 3 with two kinds at
once, 4 with a hardening spring, 6 with friction, and 10 where the actuator saturates.
"""

HIDDEN_BY_NOISE = 2.0
"""Distortion that passes for noise, as a multiple of the estimates' standard deviation: on ten
lines, noise may be five times as strong as on ten others (`nonlinearity.intermodulation`)."""

ASSUMED_ANEW = 0.1
"""Relative change of an assumed distortion from which models are fitted again."""


@dataclass(frozen=True)
class Distortion:
    """The distortion of one test, as a ratio of the nonlinear to the linear part of the output."""

    found: float = 0.0
    """What was found; 0 if nothing was."""
    hidden: float = 0.0
    """What may be there unnoticed, or unreported; 0 for a flight, whose distortion is unknown."""
    amplitude: float | None = None
    """Amplitude of the test; None if it is unknown."""

    @staticmethod
    def of(response: FrequencyResponse, tones: Tones) -> Distortion:
        """Return the distortion of a test.

        Args:
            response: Response with its findings.
            tones: Its estimates, with the variances that are believed.
        """
        if response.flight is not None:
            return Distortion()
        bent = [f for f in response.quality.warnings if f.code == "nonlinear"]
        values = [DISTORTION_REPORTED if one.value is None else one.value for one in bent]
        noise = float(np.sum(tones.variance) / max(np.sum(np.abs(tones.z) ** 2), 1e-300))
        hidden = max(HIDDEN_BY_NOISE * math.sqrt(noise), DISTORTION_REPORTED / 2)
        return Distortion(max(values, default=0.0), hidden, response.amplitude)

    def open_share(self, others: Sequence[Distortion], assumed: float) -> float:
        """Return the share of the response that this test leaves open.

        A test that finds nothing at a smaller amplitude says nothing of a larger one, and one in
        which noise may hide it says nothing against what others of its kind have shown.

        Args:
            others: Distortions of all tests of the robot.
            assumed: Distortion that robots of its kind have shown.
        """
        larger = [
            one.found
            for one in others
            if differ(one.amplitude, self.amplitude)
            and (one.amplitude or 0.0) > (self.amplitude or 0.0)
        ]
        return NONLINEAR_ELSEWHERE * max(self.found, *larger, min(assumed, self.hidden))


def of_kind(found: Sequence[float]) -> float:
    """Return what distortion may be expected of a robot in which none was found.

    Args:
        found: Distortion of each tested robot of its kind, shape (robots,); 0 where none was found.
    """
    return float(np.sqrt(np.mean(np.square(found)))) if found else 0.0
