"""The target's inverse model with several experiences as its prior, weighed while it flies.

The prior mean is a weighted mean of the sources' inverse models and of none, γ = 0. The weights are
those that would have predicted best the references that led where the robot went (see
`nufleet.robot_agent.flight.mixture`); the online Gaussian process learns what that mean leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nufleet.robot_agent.flight.inverse_model import InverseModel
from nufleet.robot_agent.flight.inverse_stack import InverseStack
from nufleet.robot_agent.flight.mixture import Mixture
from nufleet.robot_agent.flight.online_gp import WINDOW_POINTS, Correction, OnlineGp
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.combined_layout import CombinedLayout
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.gaussian_process.exact import posterior_weights

CONCENTRATION = 3.0
"""How firmly the weights at the start are believed, see `Mixture`.

Of 1 to 100, 10 left the least error with good weights at the start, by 2 %, and above 3 a source
that does harm keeps some of its weight for longer than 3 s."""

FORGETTING = 0.98
"""Share of the evidence that remains from pair to pair. Its memory of 50 pairs is as long as the
window of the online process."""

EASE = 0.2
"""Share of the way from its present to its new value that a weight goes at each pair.

A prior mean that jumped would excite the robot. At a pair every 0.12 s the time constant is half a
second, so a source that is found wrong has lost 99 % of its weight after 2.5 s."""


@dataclass(frozen=True, eq=False)
class Expert:
    """A model that takes part in the mixture, and how much it is trusted before the flight."""

    name: str
    """Name of the source, for people."""

    layout: InverseLayout
    """Inputs and output of its inverse model."""

    inverse: InverseModel
    """Its inverse model."""

    weight: float
    """Weight before anything is flown, above 0."""

    axes: tuple[bool, ...]
    """For each axis of the robot, whether the model applies there; where not, it says γ = 0."""


class MixtureProcess:
    """The online process over a mixture of experts; used in flight as an `OnlineGp` is.

    What an expert predicts of a pair is its own inverse and, on top, what the online process would
    say if this expert had been its prior from the beginning of the window, with the covariance that
    was fitted to the mixture. An expert is thus judged by what remains after learning. The errors
    of neighbouring pairs are alike, and this covariance says how much.
    """

    def __init__(
        self, layout: CombinedLayout, experts: Sequence[Expert], *, window: int = WINDOW_POINTS
    ) -> None:
        """Prepare for one flight.

        Args:
            layout: Combined layout of the experts.
            experts: Models to weigh, at least one, whose weights add up to less than 1; the rest is
                the weight of none.
            window: Number of latest pairs that the online process is fitted to; 0 learns nothing,
                and the weights stay as they are at the start.
        """
        axes = len(experts[0].axes)
        self._layout, self._experts, self._window = layout, tuple(experts), window
        self._groups = [
            (
                used,
                np.array([i for i, expert in enumerate(experts) if expert.layout == used]),
                InverseStack([expert.inverse for expert in experts if expert.layout == used]),
            )
            for used in dict.fromkeys(expert.layout for expert in experts)
        ]
        self._applies = np.array([expert.axes for expert in experts] + [(False,) * axes])
        start = np.array([expert.weight for expert in experts])
        self._mixture = Mixture(
            np.append(start, 1.0 - start.sum()),
            concentration=CONCENTRATION,
            forgetting=FORGETTING,
            ease=EASE,
        )
        # The process has no prior of its own: what the mixture leaves is handed to it.
        self._process = OnlineGp(layout, (None,) * axes, window=window)
        self._left = [np.empty((0, len(start) + 1)) for _ in range(axes)]
        self._new: list[tuple[int, FloatArray, float]] = []

    @property
    def weights(self) -> FloatArray:
        """Present weight of every expert and, last, of none, shape (experts + 1,); the sum is 1."""
        return self._mixture.weights

    @property
    def dropped(self) -> int:
        """Number of pairs dropped because they were not finite."""
        return self._process.dropped

    def learn(self, axis: int, inputs: FloatArray, gamma: float) -> None:
        """Take a pair, by which the next `correct` judges every expert.

        Args:
            axis: Index of the axis.
            inputs: Inputs ξ of the combined layout, shape (inputs,).
            gamma: Output γ of the leading layout that belongs to them, in unit/s.
        """
        if self._window and np.isfinite(inputs).all() and np.isfinite(gamma):
            self._new.append((axis, inputs, gamma))
        else:
            self._process.learn(axis, inputs, gamma)  # which drops and counts it

    def correct(self, inputs: FloatArray) -> Correction:
        """Return γ at the inputs; to be called exactly once per sample, as `OnlineGp.correct` is.

        Args:
            inputs: Inputs ξ of every axis, shape (axes, inputs), of the combined layout.
        """
        # New pairs and the query are evaluated together, since each call of the networks costs.
        rows = np.concatenate([*(row[np.newaxis] for _, row, _ in self._new), inputs])
        axes = np.array([axis for axis, _, _ in self._new] + list(range(len(inputs))))
        values = self._values(rows, axes)
        if self._new:
            self._weigh(values)
        found = self._process.correct(inputs)
        prior = self._mixture.mean(values[:, -len(inputs) :])
        return replace(found, prior=prior, weights=self.weights)

    def _weigh(self, values: FloatArray) -> None:
        """Weigh the experts by the new pairs, and hand to the process what they leave together.

        Args:
            values: γ of every expert and of none, shape (experts + 1, m), whose first columns
                belong to the new pairs.
        """
        new, self._new = self._new, []
        errors, variances = [], []
        for (axis, row, gamma), value in zip(new, values.T, strict=False):
            left = gamma - value
            error, variance = self._prediction(axis, row, left)
            errors.append(error)
            variances.append(variance)
            self._left[axis] = np.vstack([self._left[axis], left])[-self._window :]
            self._process.learn(axis, row, gamma)
        self._mixture.observe(np.stack(errors, axis=1), np.array(variances), np.zeros(len(new)))
        for axis, left in enumerate(self._left):
            self._process.relearn(axis, left @ self.weights)

    def _values(self, inputs: FloatArray, axes: np.ndarray) -> FloatArray:
        """Return γ of every expert and of none as the leading layout's, shape (experts + 1, m).

        The inputs have the shape (m, inputs), and row i belongs to the axis axes[i]. An expert that
        does not apply to an axis, or whose answer is not finite, says what none says.
        """
        values = np.zeros((len(self._experts) + 1, len(inputs)))
        for used, members, stack in self._groups:
            gamma = stack(self._layout.inputs_of(used, inputs))
            values[members] = self._layout.as_leading(used, inputs, gamma)
        values[~self._applies[:, axes] | ~np.isfinite(values)] = 0.0
        return values

    def _prediction(self, axis: int, row: FloatArray, left: FloatArray) -> tuple[FloatArray, float]:
        """Return the error of every expert's prediction of a pair, and the variance of all.

        Args:
            axis: Axis of the pair.
            row: Inputs ξ of the pair, shape (inputs,).
            left: γ of the pair less what each expert says of it, shape (experts + 1,), in unit/s.

        Returns:
            The errors in unit/s, shape (experts + 1,), and their variance in its square.
        """
        fitted = self._process.hyperparameters[axis]
        noise = float(fitted.noise_variance[0])
        window = self._process.window(axis)
        if not len(window):
            return -left, float(fitted.signal_variance[0]) + noise
        query = self._layout.gp_inputs(row[np.newaxis])[0]
        weights, variance = posterior_weights(window, fitted, query)
        return weights @ self._left[axis] - left, variance + noise
