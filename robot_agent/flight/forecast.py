"""What a robot's model of itself says of a path before it is flown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nufleet.robot_agent.flight.own_model import HIGH, LOW, OwnModel
from nufleet.robot_agent.flight.own_way import OwnWay, own_way
from nufleet.shared.arrays import FloatArray
from nufleet.shared.wire.motions import PredictedError


@dataclass(frozen=True, eq=False)
class Forecast:
    """The flights along one path with the baseline alone, and with the model's own correction."""

    way: OwnWay
    """How the robot flies the path best with its model of itself."""
    baseline_squares: FloatArray
    """Squared distance to the path that the baseline may leave, without noise, in unit², shape
    (draws, samples)."""
    baseline: PredictedError
    """Error of the baseline that is to be measured."""
    noise_variance: float
    """Variance of the measured error, summed over the axes, in unit²."""

    @property
    def correction(self) -> FloatArray:
        """Correction of the reference, shape (samples, axes), in the axes' units, that puts the
        robot on its path as well as is known."""
        return self.way.correction

    @property
    def own(self) -> PredictedError:
        """Error with the robot's model of itself that is to be measured."""
        return self.way.predicted

    @property
    def own_helps(self) -> bool:
        """Whether the correction leaves less error than the baseline, with hardly a doubt.

        Both are measured with the same noise.
        """
        own = np.quantile(self.way.squares, HIGH)
        return bool(own < np.quantile(self.baseline_squares.mean(axis=1), LOW))


def forecast_of(model: OwnModel | None, desired: FloatArray) -> Forecast | None:
    """Return the forecast of a path; None without a model.

    Args:
        model: The robot's model of itself.
        desired: Path, shape (samples, axes), in the axes' units.
    """
    if model is None:
        return None
    squares = np.sum(model.left(desired, np.zeros_like(desired)) ** 2, axis=2)
    return Forecast(
        way=own_way(model, desired, float(squares.mean())),
        baseline_squares=squares,
        baseline=model.predicted(squares),
        noise_variance=model.noise_variance,
    )
