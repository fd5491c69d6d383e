"""How a robot flies a path with its model of itself: what it sends, and what is to be expected.

The model is inverted along the whole path. What no linear response explains (friction, coupling,
gusts) and what is not known yet of the response remain; where they last longer than the loop takes
to answer, a feedback of the measured output takes most of them away. Against the noise of a sensor
there is none, so a robot that is linear and well known flies references that are all known ahead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nufleet.robot_agent.flight.output_feedback import OutputFeedback
from nufleet.robot_agent.flight.own_model import DRAWS, OwnModel, predicted_error
from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.error_belief import MODEL_ERROR, ErrorBelief
from nufleet.shared.models.unexplained import autocovariance
from nufleet.shared.models.wiener_feedback import WienerFeedback, wiener_feedback
from nufleet.shared.text import in_thousandths
from nufleet.shared.wire.motions import PredictedError

_WORTH = 0.97
"""Share of the expected error without a feedback that must be left at most with one."""

_LEAST = 0.002
"""Share of the baseline's error by which a feedback must lessen the expected error at least:
references that are known ahead show more of the robot."""

_GENTLE = 0.25
"""Share of a path's largest acceleration that the feedback may ask for, root mean square."""

_WRONG = 0.1
"""Least share of its error response by which a loop may differ from its model without becoming
unstable with the feedback, one of two standard deviations."""

_SCALES = (1.0, 10.0)
"""Bounds on the power that is expected of what is unexplained, as multiples of what was seen: it
grows with the baseline's error as friction and coupling do, but gusts do not fall with it."""

_SCALE_SPREAD = 0.4
"""Standard deviation of the logarithm of its size: a share of the baseline's error is a rule of
thumb for what is not linear."""

_ROUGH = 0.15
"""Standard deviation of the logarithm of what a model is expected to leave: an answer that is
linear between a few nodes is never exact."""

_SEED = 1


@dataclass(frozen=True, eq=False)
class OwnWay:
    """A flight with the robot's model of itself."""

    correction: FloatArray
    """Correction of the reference known ahead, shape (samples, axes), in the axes' units."""
    feedback: OutputFeedback | None
    """Feedback of what is measured on the way; None where it would not help."""
    predicted: PredictedError
    """Error that is to be measured."""
    squares: FloatArray
    """Mean squared errors without noise, for draws from what is known, shape (draws,), in unit²."""
    reason: str
    """Which of the two is flown, and why, for people."""


@dataclass(frozen=True, eq=False)
class _Axis:
    """What disturbs one axis along a path."""

    belief: ErrorBelief
    left: FloatArray  # what the response, as far as it is known, may leave, (draws, samples)
    lasting: FloatArray  # autocovariance of what it does not explain, (lags,)
    noise: float  # variance of what is measured at random
    noise_lasts: float  # its correlation time in samples
    relative_error: float

    def feedback(self, acceleration_max: float) -> WienerFeedback | None:
        covariance = self.lasting.copy()
        lags = min(len(covariance), self.left.shape[1])
        covariance[:lags] += autocovariance(self.left, lags)
        return wiener_feedback(
            self.belief,
            covariance,
            self.noise,
            relative_error=self.relative_error,
            safe_error=max(self.relative_error, _WRONG),
            acceleration_max=_GENTLE * acceleration_max,
        )

    def squares(
        self, feedback: WienerFeedback | None, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Return the mean squared errors and those of the noise about them, shape (draws,) each."""
        scales = np.exp(2 * _SCALE_SPREAD * rng.standard_normal(DRAWS))
        # The mean square of n samples of noise varies by √(2/n) of itself; so did the one known.
        independent = self.left.shape[1] / self.noise_lasts
        luck = np.exp(rng.standard_normal(DRAWS) * np.sqrt(4 / independent))
        if feedback is None:
            known, lasting, noise, doubtful = self.left, self.lasting[0], self.noise, 0.0
        else:
            known = feedback.closed(self.left)
            lasting = feedback.variance(self.lasting)
            noise = feedback.variance(np.array([self.noise]))
            doubtful = feedback.doubtful
        rough = np.exp(2 * _ROUGH * rng.standard_normal(DRAWS))
        # The error of a response is one number, however long the flight.
        wrong = doubtful * rng.standard_normal(DRAWS) ** 2
        return rough * np.mean(known**2, axis=1) + scales * lasting + wrong, luck * noise


def own_way(model: OwnModel, desired: FloatArray, baseline_square: float) -> OwnWay:
    """Return how a robot flies a path best with its model of itself.

    Args:
        model: The robot's model of itself.
        desired: Path, shape (samples, axes), in the axes' units.
        baseline_square: Mean squared distance to the path that the baseline would leave, in unit².
    """
    correction = model.correction(desired)
    left = model.left(desired, correction)
    sizes = np.std(desired, axis=0)
    axes = [_axis(model, i, left[:, :, i], baseline_square, sizes[i]) for i in range(len(sizes))]
    found = [axis.feedback(model.acceleration_max) for axis in axes]
    known, fed = _Expected.of(axes, [None] * len(axes)), _Expected.of(axes, found)
    ahead, closed = known.measured, fed.measured
    without, fed_back = (in_thousandths(each.rms, model.unit) for each in (ahead, closed))
    worth = min(_WORTH * ahead.rms, ahead.rms - _LEAST * np.sqrt(baseline_square))
    if closed.rms > worth:
        return OwnWay(
            correction,
            None,
            ahead,
            known.squares,
            f"it flew with references known ahead: {without} RMS were expected, and {fed_back} "
            "with a feedback of its output",
        )
    lasting = np.sqrt(sum(axis.lasting[0] + np.mean(axis.left**2) for axis in axes))
    return OwnWay(
        correction,
        OutputFeedback(
            tuple(axis.belief.impulse_response() for axis in axes),
            tuple(np.zeros(1) if f is None else f.taps for f in found),
        ),
        closed,
        fed.squares,
        f"it flew with a feedback of its output: {fed_back} RMS were expected, and {without} "
        "without it, since what its model does not foresee, "
        f"{in_thousandths(lasting, model.unit)} RMS, lasts long enough to be corrected",
    )


@dataclass(frozen=True, eq=False)
class _Expected:
    """What a way is expected to leave."""

    measured: PredictedError
    squares: FloatArray  # mean squared errors without noise, (draws,)

    @staticmethod
    def of(axes: list[_Axis], found: list[WienerFeedback | None]) -> _Expected:
        rng = np.random.default_rng(_SEED)  # both ways have the same luck
        parts = [axis.squares(each, rng) for axis, each in zip(axes, found, strict=True)]
        squares, noise = np.sum(parts, axis=0)
        return _Expected(predicted_error(squares + noise), squares)


def _axis(model: OwnModel, i: int, left: FloatArray, baseline_square: float, size: float) -> _Axis:
    belief, seen = model.axes[i], model.unexplained[i]
    wrong = belief.open(size)
    if seen is None:
        lasting, noise = np.zeros(max(3, int(belief.basis.nodes[-1]))), belief.noise_std**2
        return _Axis(belief, left, lasting, noise, belief.lasting, max(MODEL_ERROR, wrong))
    lasting, noise = seen.parts()
    ratio = lasting[0] / seen.error_square if seen.error_square > 0 else 0.0
    scale = baseline_square / seen.error_square if seen.error_square > 0 else 1.0
    return _Axis(
        belief,
        left,
        lasting * float(np.clip(scale, *_SCALES)),
        noise,
        1.0,
        max(belief.model_error, wrong, min(1.0, float(np.sqrt(ratio)))),
    )
