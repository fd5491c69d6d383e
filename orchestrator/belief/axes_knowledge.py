"""Knowledge of one robot's response on several axes, each by itself and across."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.belief.cross_response import CrossModel
from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.orchestrator.belief.noise_pooling import pooled_variance
from nufleet.orchestrator.belief.response_belief import ResponseModel
from nufleet.orchestrator.belief.robot_knowledge import VARIANCE_MIN, RobotKnowledge
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.matrix_response import MatrixResponse
from nufleet.shared.robots.spec import RobotSpec

COUPLED_SIGNIFICANCE = 1e-3
"""Probability that noise on axes which are not coupled is reported as coupling."""

COUPLED_MIN = 0.02
"""Share of its own response by which an axis moves another, below which nothing is reported."""


@dataclass(frozen=True)
class Coupling:
    """The strongest answer of one axis to the reference of another."""

    robot: str
    """Name of the robot."""
    output: str
    """Axis that answers."""
    reference: str
    """Axis that was asked."""
    share: float
    """Magnitude |z_ij|; between axes in different units, the motion of each counts as a share of
    its largest amplitude."""
    omega_rad_s: float
    """Frequency in rad/s of the largest share."""

    def __str__(self) -> str:
        return (
            f"{self.robot}: {self.output} answers to {self.reference} with "
            f"{100 * self.share:.2g} % at {self.omega_rad_s:.3g} rad/s"
        )


class AxesKnowledge:
    """The knowledge of one robot that tests of several axes have provided."""

    def __init__(
        self, robot: str, spec: RobotSpec, omega_max_rad_s: float, axes: Sequence[str]
    ) -> None:
        """Begin without tests.

        Args:
            robot: Name of the robot.
            spec: Spec of the robot.
            omega_max_rad_s: Upper end of the band.
            axes: Names of the axes that are compared.
        """
        self.robot, self.spec = robot, spec
        self._omega_max_rad_s = omega_max_rad_s
        self.axes = {
            axis: RobotKnowledge(
                f"{robot}, axis {axis}",
                spec.model_copy(update={"axes": (spec.axis(axis),)}),
                omega_max_rad_s,
            )
            for axis in axes
        }
        """Knowledge of each axis's response to its own reference, by axis."""
        self.responses: list[FrequencyResponse] = []

    def learn(
        self, test: Excitation, response: FrequencyResponse, rng: np.random.Generator
    ) -> None:
        """Learn a test's usable estimates on all axes that it played.

        Args:
            test: Excitation that was requested.
            response: Response that it measured.
            rng: Generator that draws the responses expected from the earlier tests.
        """
        self.responses.append(response)
        for place, played in enumerate(test.played):
            matrix = response.matrix
            own = response if matrix is None else matrix.entry(place, place)
            self.axes[played.axis].learn(own, rng)

    @property
    def tests(self) -> int:
        """Number of tests of the robot."""
        return len(self.responses)

    @property
    def unseen(self) -> tuple[str, ...]:
        """Axes that no test has played."""
        return tuple(axis for axis, known in self.axes.items() if not known.tests)

    @property
    def model(self) -> tuple[ResponseModel, ...]:
        """The belief about every axis that was tested, in the order of the axes."""
        return tuple(known.model for known in self.axes.values() if known.tests)

    @property
    def settling_time_s(self) -> float:
        """Settling time in s of the axis that settles most slowly."""
        return max(known.settling_time_s for known in self.axes.values())

    @property
    def lowest_rad_s(self) -> float:
        """Frequency in rad/s from which on every axis was tested."""
        return max(known.lowest_rad_s for known in self.axes.values())

    @property
    def doubted(self) -> bool:
        """Whether something makes its tests uncertain that further tests do not tell."""
        return any(known.doubted for known in self.axes.values())

    @property
    def findings(self) -> tuple[str, ...]:
        """What weakens what is believed of the robot, and how its axes are coupled, in words."""
        found = [finding for known in self.axes.values() for finding in known.findings]
        return (*found, *map(str, self.couplings))

    def cross(self, output: str, reference: str) -> CrossModel | None:
        """Return the belief about how one axis answers to another; None if no test played both.

        Args:
            output: Axis that answers.
            reference: Axis that is asked.
        """
        omegas, z, variances = [], [], []
        for response in self.responses:
            matrix = response.matrix
            if matrix is None or output not in matrix.axes or reference not in matrix.axes:
                continue
            i, tones = matrix.axes.index(output), matrix.played_by == matrix.axes.index(reference)
            variance = _pooled(matrix, i)[tones]
            known = np.isfinite(matrix.rows[i].z[tones]) & np.isfinite(variance)
            omegas.append(matrix.rows[i].omega_rad_s[tones][known])
            z.append(matrix.rows[i].z[tones][known])
            variances.append(np.maximum(variance[known], VARIANCE_MIN))
        if not omegas or not sum(map(len, omegas)):
            return None
        measured = Tones(np.concatenate(omegas), np.concatenate(z), np.concatenate(variances))
        return CrossModel(measured, self._omega_max_rad_s)

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        """The strongest significant answer of each axis to each other one, in any test."""
        strongest: dict[tuple[str, str], Coupling] = {}
        for response in self.responses:
            for found in _couplings(self.robot, self.spec, response):
                pair = found.output, found.reference
                if pair not in strongest or strongest[pair].share < found.share:
                    strongest[pair] = found
        return tuple(strongest.values())


def _couplings(robot: str, spec: RobotSpec, response: FrequencyResponse) -> list[Coupling]:
    matrix = response.matrix
    if matrix is None:
        return []
    found = []
    for i, row in enumerate(matrix.rows):
        omega, variance = row.omega_rad_s, _pooled(matrix, i)
        if not (np.isfinite(row.z).all() and np.isfinite(variance).all()):
            continue
        # |ẑ|² of noise alone is exponentially distributed about its variance. Bonferroni: the
        # significance is shared out among all tones.
        limit = variance * math.log(len(omega) / COUPLED_SIGNIFICANCE)
        units = unit_ratios(spec, matrix.axes[i], matrix.axes)
        share = np.abs(row.z) * units[matrix.played_by]
        share = np.where(np.abs(row.z) ** 2 > limit, share, 0.0)
        for j, reference in enumerate(matrix.axes):
            across = np.where(matrix.played_by == j, share, 0.0)
            at = int(np.argmax(across))
            if i != j and across[at] >= COUPLED_MIN:
                largest, where = float(across[at]), float(omega[at])
                found.append(Coupling(robot, matrix.axes[i], reference, largest, where))
    return found


def unit_ratios(spec: RobotSpec, output: str, references: Sequence[str]) -> FloatArray:
    """Return factors that turn responses of an axis to others into numbers without a unit.

    Args:
        spec: Spec of the robot.
        output: Axis that answers.
        references: Axes that are asked.

    Returns:
        1 for an axis in the same unit, else the ratio of both largest amplitudes, shape
        (references,).
    """
    own = spec.axis(output)
    others = [spec.axis(axis) for axis in references]
    return np.array(
        [1.0 if o.unit == own.unit else o.amplitude_max / own.amplitude_max for o in others]
    )


def _pooled(matrix: MatrixResponse, output: int) -> FloatArray:
    """Return the variances of one output's responses, pooled over the tones of all axes."""
    row = matrix.rows[output]
    # In units of the amplitudes that were played, all tones have the noise of one output.
    peaks = np.array([one.amplitude or 1.0 for one in matrix.rows])
    unit = peaks[matrix.played_by] / peaks[output]
    known = np.isfinite(row.variance)
    variance = np.full(len(unit), np.inf)
    variance[known] = (
        pooled_variance(
            row.omega_rad_s[known],
            row.variance[known] * unit[known] ** 2,
            row.degrees_of_freedom[known],
        )
        / unit[known] ** 2
    )
    return variance
