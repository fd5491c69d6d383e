"""What goes into an inverse model and what comes out of it, the same in training and in flight.

The core of inverse learning is y(k + h) = F(x(k), u(k)) with the reference u: learn u(k) from x(k)
and the output wanted h samples ahead. Two architectures:

- `state`, the paper's: fed with the robot's own measured state, so it closes a feedback loop. The
  baseline controllers act on the reference's velocity too, which makes u(k − 1) part of the state
  and the reference's speed what is chosen: γ = (u(k) − u(k − 1))/T − (y(k + h) − u(k − 1))/(hT).
  γ = 0 is then the reference that heads for the point to be reached in h samples.
- `preview`: fed with the wanted path alone, a filter in front of the robot, so that the error it
  leaves is the one that the frequency responses predict: γ = (u(k) − y(k))/(hT).

Everything is relative to the output, because the dynamics do not depend on where the robot is
(difference learning). γ is a speed in both.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from nufleet.shared.arrays import FloatArray
from nufleet.shared.strict import Name, Positive, Strict

Architecture = Literal["state", "preview"]

HORIZON_SAMPLES_MAX = 500

_PREVIEW_SHAPE = (-10.0, -7.0, -5.0, -3.5, -2.5, -1.6, -1.0, -0.6, -0.3, 0.3, 0.6, 1.0)
"""Where a preview looks, in horizons: far back, because an inverse remembers for as long as the
baseline controller's zero is slow, and no further ahead than the robot's delay."""


class InverseLayout(Strict):
    """Inputs and output of the inverse model of one axis.

    `states` are the names that `Robot.observe` gives, the axis's output first. `horizon_samples` is
    h: how far ahead the output aimed at is (`state`), or how far the preview reaches.
    """

    architecture: Architecture
    states: Annotated[tuple[Name, ...], Field(min_length=1, max_length=8)]
    sample_time_s: Positive
    horizon_samples: Annotated[int, Field(ge=1, le=HORIZON_SAMPLES_MAX)]

    @model_validator(mode="after")
    def _preview_is_resolved(self) -> InverseLayout:
        if self.architecture == "preview" and self.horizon_samples < 4:
            raise ValueError("a preview needs a horizon of at least 4 samples")
        return self

    @property
    def horizon_s(self) -> float:
        """The horizon in seconds."""
        return self.horizon_samples * self.sample_time_s

    @property
    def input_names(self) -> tuple[str, ...]:
        """One name per input, in order."""
        if self.architecture == "preview":
            return tuple(f"output-ahead-{offset}" for offset in self.offsets)
        velocity = ("velocity-ahead",) if self._velocity is not None else ()
        return (*self.states[1:], "output-ahead", *velocity, "previous-reference")

    @property
    def offsets(self) -> tuple[int, ...]:
        """Where a preview looks, in samples from now."""
        return tuple(round(share * self.horizon_samples) for share in _PREVIEW_SHAPE)

    @property
    def back_samples(self) -> int:
        """How many samples before now the inputs need of the path."""
        return -self.offsets[0] if self.architecture == "preview" else 0

    @property
    def span_samples(self) -> int:
        """The shortest record that holds one training pair."""
        if self.architecture == "state":
            return self.horizon_samples + 2
        return self.back_samples + self.horizon_samples + 2 * self._smoothing + 1

    @property
    def _smoothing(self) -> int:
        """Half the width of the window that measured paths are smoothed with; a preview only.

        It meets noise-free paths in flight, so noise in its training inputs would bias it; inputs
        and output pass the same window, which leaves a linear relation between them as it is.
        """
        return max(1, self.horizon_samples // 2)

    @property
    def gp_ease_samples(self) -> int:
        """Over how many samples a new mean of the GP takes effect.

        A preview moves nothing fast, so its correction need not be; one that jumps from refit to
        refit would excite the robot beyond its band and teach the process that.
        """
        return self.horizon_samples // 2 if self.architecture == "preview" else 0

    @property
    def _velocity(self) -> int | None:
        return self.states.index("velocity") if "velocity" in self.states else None

    def pairs(self, references: FloatArray, states: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the training pairs that a record of one axis holds, oldest first.

        Args:
            references: u, shape (n,). A reference not sent yet may stand last; it is not used.
            states: shape (n, states), measured before each reference acted.

        Returns:
            Inputs, shape (m, inputs), and γ, shape (m,), m = max(0, n − span + 1).
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
        # The newest reference lies beyond every window that is used; it may not be known yet.
        sent = np.convolve(references[:-1], window, mode="valid")
        centre = np.arange(self.back_samples, len(path) - self.horizon_samples)
        inputs = path[centre[:, np.newaxis] + np.array(self.offsets)] - path[centre, np.newaxis]
        return inputs, (sent[centre] - path[centre]) / self.horizon_s

    def query(
        self, states: FloatArray, previous: FloatArray, path: FloatArray, velocity: FloatArray
    ) -> FloatArray:
        """Return the inputs at which the inverse is asked now, shape (axes, inputs).

        Args:
            states: measured now, shape (axes, states).
            previous: the reference sent last, shape (axes,).
            path: the wanted path from `back_samples` before now to `horizon_samples` ahead, shape
                (back + horizon + 1, axes).
            velocity: of the wanted path at the horizon, shape (axes,).
        """
        if self.architecture == "state":
            return self._state_inputs(states, path[-1], velocity, previous)
        now = self.back_samples
        return np.asarray((path[now + np.array(self.offsets)] - path[now]).T)

    def reference(self, gamma: FloatArray, previous: FloatArray, path: FloatArray) -> FloatArray:
        """Return the reference to send now for γ, shape (axes,); arguments as for `query`."""
        if self.architecture == "state":
            speed = gamma + (path[-1] - previous) / self.horizon_s
            return np.asarray(previous + self.sample_time_s * speed)
        return np.asarray(path[self.back_samples] + self.horizon_s * gamma)

    def gp_inputs(self, inputs: FloatArray) -> FloatArray:
        """Return what the online GP sees of the inputs, shape (m, inputs of the GP).

        All of a state. Of a preview the local speed and acceleration only: its many values would
        need more points than a window of fifty holds.
        """
        if self.architecture == "state":
            return inputs
        after = _PREVIEW_SHAPE.index(0.6)
        before = _PREVIEW_SHAPE.index(-0.6)
        reach_s = self.offsets[after] * self.sample_time_s
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
