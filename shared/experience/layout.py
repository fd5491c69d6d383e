"""Inputs and output of an inverse model, computed alike in training and in flight.

Inverse learning rests on y(k + h) = F(x(k), u(k)), where u is the reference: the model learns u(k)
as a function of the state x(k) and of the desired output h samples ahead. Inputs are ξ and the
output γ, as in the paper's section III. There are two architectures:

- `state`, the paper's: the inputs contain the robot's own measured state, so the model closes a
  feedback loop. Since the baseline controllers also act on the velocity of the reference, u(k − 1)
  is part of the state, and the model chooses the speed of the reference:
  γ = (u(k) − u(k − 1))/T − (y(k + h) − u(k − 1))/(hT). With γ = 0 the reference heads straight for
  the point to be reached in h samples.
- `preview`: the inputs come from the desired path alone. The model is then a filter in front of the
  robot, and the error that remains is the one that the frequency responses predict:
  γ = (u(k) − y(k))/(hT).

All inputs are relative to the output, because the dynamics do not depend on the robot's position
(difference learning). In both architectures γ is a speed.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from nufleet.shared.arrays import FloatArray
from nufleet.shared.strict import Name, Positive, Strict

Architecture = Literal["state", "preview"]

HORIZON_SAMPLES_MAX = 500
"""Longest accepted horizon h."""

_PREVIEW_SHAPE = (-10.0, -7.0, -5.0, -3.5, -2.5, -1.6, -1.0, -0.6, -0.3, 0.3, 0.6, 1.0)
"""Points of the path that a preview uses, in horizons from now. They reach far back, because the
memory of an inverse lasts as long as the slow zero of the baseline controller, and no further ahead
than the robot's delay."""


class InverseLayout(Strict):
    """Inputs and output of the inverse model of one axis."""

    architecture: Architecture
    """Kind of inputs, see the module's description."""
    states: Annotated[tuple[Name, ...], Field(min_length=1, max_length=8)]
    """Names of the states that `Robot.observe` measures, the axis's output first. A preview has the
    output alone, which every robot measures."""
    sample_time_s: Positive
    """Time T between samples."""
    horizon_samples: Annotated[int, Field(ge=1, le=HORIZON_SAMPLES_MAX)]
    """Horizon h: distance to the output aimed at (`state`), or to the end of the preview."""

    @model_validator(mode="after")
    def _preview_is_resolved(self) -> InverseLayout:
        if self.architecture == "preview" and self.horizon_samples < 4:
            raise ValueError("a preview needs a horizon of at least 4 samples")
        return self

    @property
    def measured_states(self) -> tuple[str, ...]:
        """Names of the states that a robot must measure to use the model; none for a preview."""
        return self.states if self.architecture == "state" else ()

    @property
    def horizon_s(self) -> float:
        """The horizon h in seconds."""
        return self.horizon_samples * self.sample_time_s

    @property
    def input_names(self) -> tuple[str, ...]:
        """Name of each input, in order."""
        if self.architecture == "preview":
            return tuple(f"output-ahead-{offset}" for offset in self.offsets)
        velocity = ("velocity-ahead",) if self._velocity is not None else ()
        return (*self.states[1:], "output-ahead", *velocity, "previous-reference")

    @property
    def offsets(self) -> tuple[int, ...]:
        """Points of the path that a preview uses, in samples from now, ascending."""
        return _preview_offsets(self.horizon_samples)

    @property
    def back_samples(self) -> int:
        """Number of past samples of the path that the inputs need."""
        return -self.offsets[0] if self.architecture == "preview" else 0

    @property
    def span_samples(self) -> int:
        """Number of samples of the shortest record that contains a training pair."""
        if self.architecture == "state":
            return self.horizon_samples + 2
        return self.back_samples + self.horizon_samples + 2 * self._smoothing + 1

    @property
    def _smoothing(self) -> int:
        """Half the width, in samples, of the window that smooths measured paths; preview only.

        A preview is queried with noise-free paths in flight, so noise in its training inputs would
        bias it. Inputs and output are smoothed by the same window, which preserves any linear
        relation between them.
        """
        return max(1, self.horizon_samples // 2)

    @property
    def gp_ease_samples(self) -> int:
        """Number of samples over which a new mean of the online GP takes effect.

        The corrections of a preview vary slowly, so they need not act at once. A correction that
        jumps from refit to refit would excite the robot outside its band, and the process would
        learn from that.
        """
        return self.horizon_samples // 2 if self.architecture == "preview" else 0

    @property
    def _velocity(self) -> int | None:
        return self.states.index("velocity") if "velocity" in self.states else None

    def pairs(self, references: FloatArray, states: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the training pairs (ξ, γ) contained in a record of one axis, oldest first.

        Args:
            references: References u in the axis's unit, shape (n,). The last one is not used and
                need not have been sent yet.
            states: States, shape (n, states), each row measured before its reference acted.

        Returns:
            Inputs ξ, shape (m, inputs), and γ in unit/s, shape (m,), with
            m = max(0, n − `span_samples` + 1).
        """
        if len(references) < self.span_samples:
            return np.empty((0, len(self.input_names))), np.empty(0)
        if self.architecture == "state":
            return self._state_pairs(references, states)
        return self._preview_pairs(references, states[:, 0])

    def _state_pairs(
        self, references: FloatArray, states: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        h = self.horizon_samples
        now, ahead = states[1:-h], states[1 + h :]
        previous, chosen = references[: -h - 1], references[1:-h]
        inputs = self._state_inputs(now, ahead[:, 0], self._velocities(ahead), previous)
        heading = (ahead[:, 0] - previous) / self.horizon_s
        return inputs, (chosen - previous) / self.sample_time_s - heading

    def _preview_pairs(
        self, references: FloatArray, outputs: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        window = np.hanning(2 * self._smoothing + 3)[1:-1]
        window /= window.sum()
        path = np.convolve(outputs, window, mode="valid")
        # The newest reference is beyond every window that is used, and may not be known yet.
        sent = np.convolve(references[:-1], window, mode="valid")
        centre = np.arange(self.back_samples, len(path) - self.horizon_samples)
        inputs = path[centre[:, np.newaxis] + np.array(self.offsets)] - path[centre, np.newaxis]
        return inputs, (sent[centre] - path[centre]) / self.horizon_s

    def query(
        self, states: FloatArray, previous: FloatArray, path: FloatArray, velocity: FloatArray
    ) -> FloatArray:
        """Return the inputs ξ at which the inverse is to be evaluated now.

        Args:
            states: Current states, shape (axes, states).
            previous: Last reference sent, in the axes' unit, shape (axes,).
            path: Desired path from `back_samples` before now to `horizon_samples` ahead, in the
                axes' unit, shape (back + horizon + 1, axes).
            velocity: Velocity of the desired path at the horizon, in unit/s, shape (axes,).

        Returns:
            Inputs of each axis, shape (axes, inputs).
        """
        if self.architecture == "state":
            return self._state_inputs(states, path[-1], velocity, previous)
        now = self.back_samples
        return np.asarray((path[now + np.array(self.offsets)] - path[now]).T)

    def reference(self, gamma: FloatArray, previous: FloatArray, path: FloatArray) -> FloatArray:
        """Return the reference to send now, by solving the definition of γ for u(k).

        Args:
            gamma: Output γ of the inverse, in unit/s, shape (axes,).
            previous: Last reference sent, in the axes' unit, shape (axes,).
            path: Desired path, as for `query`.

        Returns:
            Reference in the axes' unit, shape (axes,).
        """
        if self.architecture == "state":
            speed = gamma + (path[-1] - previous) / self.horizon_s
            return np.asarray(previous + self.sample_time_s * speed)
        return np.asarray(path[self.back_samples] + self.horizon_s * gamma)

    def gp_inputs(self, inputs: FloatArray) -> FloatArray:
        """Return the inputs of the online GP.

        With `state` they are the inverse's own inputs. With `preview` they are only the local speed
        and acceleration of the path: the many values of a preview would need more points than a
        window of fifty holds.

        Args:
            inputs: Inputs ξ of the inverse, shape (m, inputs).

        Returns:
            Inputs of the GP, shape (m, inputs) or (m, 2), the latter in unit/s and unit/s².
        """
        if self.architecture == "state":
            return inputs
        after = _PREVIEW_SHAPE.index(0.6)
        before = _PREVIEW_SHAPE.index(-0.6)
        reach_s = self.offsets[after] * self.sample_time_s
        # Central differences of the path; the inputs are relative to its value now.
        speed = (inputs[:, after] - inputs[:, before]) / (2 * reach_s)
        acceleration = (inputs[:, after] + inputs[:, before]) / reach_s**2
        return np.stack([speed, acceleration], axis=1)

    def _state_inputs(
        self, now: FloatArray, ahead: FloatArray, velocity_ahead: FloatArray, previous: FloatArray
    ) -> FloatArray:
        columns = [now[:, i] for i in range(1, len(self.states))]
        columns.append(ahead - now[:, 0])
        if self._velocity is not None:
            columns.append(velocity_ahead - now[:, self._velocity])
        columns.append(previous - now[:, 0])
        return np.stack(columns, axis=1)

    def _velocities(self, states: FloatArray) -> FloatArray:
        return states[:, self._velocity if self._velocity is not None else 0]


@lru_cache(maxsize=64)
def _preview_offsets(horizon_samples: int) -> tuple[int, ...]:
    # Kept, since every sample of a flight asks for them several times.
    return tuple(round(share * horizon_samples) for share in _PREVIEW_SHAPE)
