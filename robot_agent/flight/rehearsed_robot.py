"""A robot that exists as a model alone: one of those that a robot, as it knows itself, may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.error_response import ErrorBasis
from nufleet.shared.robots.spec import RobotSpec


@dataclass(frozen=True, eq=False)
class LoopDraw:
    """A loop, drawn from what is believed of the real one."""

    basis: ErrorBasis
    """Parameters of the error response."""
    responses: FloatArray
    """Parameters x of the error response of every axis, shape (size, axes)."""
    across: FloatArray
    """Parameters of what each axis adds to the errors of the others, shape (size, axes, axes): by
    the axis that moves and the one that answers."""
    unexplained: FloatArray
    """What the response does not explain of the measured output, noise included, sample by sample,
    shape (samples, axes), in the axes' units; it begins again when it is over."""
    state_gains: FloatArray
    """Every measured state as a multiple of the output's velocity and acceleration, shape (axes,
    states, 2). The first state is the output itself, whose gains are not used."""
    state_noise_std: FloatArray
    """Standard deviation of the noise of every state, shape (axes, states)."""


class RehearsedRobot(Robot):
    """Follows references as the drawn loop does; nothing real moves."""

    def __init__(
        self,
        spec: RobotSpec,
        state_names: tuple[str, ...],
        draw: LoopDraw,
        rng: np.random.Generator,
    ) -> None:
        """Begin at rest at reference 0.

        Args:
            spec: Description of the real robot.
            state_names: Names of the states that the real robot measures.
            draw: The loop that it has here.
            rng: Generator of the noise of its states.
        """
        self._spec, self._state_names, self._draw, self._rng = spec, state_names, draw, rng
        self._coupled = bool(draw.across.any())
        self._nodes = draw.basis.nodes
        self._widths = np.diff(self._nodes)[:, np.newaxis]
        self._memory = int(self._nodes[-1]) + 1
        self._sample = 0
        axes = len(spec.axes)
        # Row i is the sum of the first i references: sums over any lags are differences of rows.
        self._total = np.zeros((2 * self._memory + 1024, axes))
        self._end = self._memory + 1
        self._before = np.zeros(axes)
        self._observed: FloatArray | None = None

    @property
    def spec(self) -> RobotSpec:
        """Description of the real robot."""
        return self._spec

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states that the real robot measures."""
        return self._state_names

    def connect(self) -> None:
        """Do nothing: there is nothing to connect to."""

    def measure_output(self) -> FloatArray:
        """Return the output at rest, shape (axes,)."""
        return self._output(0) + self._unexplained()

    def observe(self) -> FloatArray:
        """Return the states of this sample, shape (axes, states), however often it is called."""
        return self._measured()[:, : len(self._state_names)]

    def _measured(self) -> FloatArray:
        if self._observed is None:
            step_s, draw = self._spec.sample_time_s, self._draw
            # The next output hardly depends on a reference that has not been chosen yet.
            before, now, after = self._before, self._output(0), self._output(1)
            velocity, acceleration = (after - before) / 2, after - 2 * now + before
            moved = np.stack([velocity / step_s, acceleration / step_s**2], axis=-1)
            states = np.einsum("asd,ad->as", draw.state_gains, moved)
            states += draw.state_noise_std * self._rng.standard_normal(states.shape)
            states[:, 0] = now + self._unexplained()
            self._before, self._observed = now, states
        return self._observed

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample; return the output at its start; shape (axes,)."""
        output, self._observed = self._measured()[:, 0], None
        if self._end + 2 >= len(self._total):
            self._total = np.concatenate([self._total, np.zeros_like(self._total)])
        self._total[self._end + 1] = self._total[self._end] + reference
        self._end += 1
        self._sample += 1
        return output

    def rest(self) -> None:
        """Be at rest at reference 0."""
        self._total[:] = 0.0
        self._end = self._memory + 1
        self._before = np.zeros(len(self._spec.axes))
        self._observed = None

    def disconnect(self) -> None:
        """Do nothing: nothing moves."""

    def _output(self, ahead: int) -> FloatArray:
        """Return the output some samples ahead if the last reference is held, shape (axes,)."""
        end, total = self._end, self._total
        held = total[end] - total[end - 1]
        for i in range(ahead):
            total[end + 1 + i] = total[end + i] + held
        row = end + ahead
        sums = total[row - self._nodes]
        between = (sums[:-1] - sums[1:]) / self._widths
        oldest = total[row - self._memory + 1] - total[row - self._memory]
        boxes = np.concatenate([held[np.newaxis], between, oldest[np.newaxis]])
        columns = np.concatenate([boxes[:-1] - boxes[1:], boxes[-1:]])
        draw = self._draw
        error = np.sum(columns * draw.responses, axis=0)
        if self._coupled:
            error = error + np.einsum("pj,pji->i", columns, draw.across)
        return np.asarray(held - error)

    def _unexplained(self) -> FloatArray:
        rows = self._draw.unexplained
        return np.asarray(rows[self._sample % len(rows)])
