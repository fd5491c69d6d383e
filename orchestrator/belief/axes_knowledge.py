"""Knowledge of one robot's response on several axes, each by itself and across."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.belief.response_belief import ResponseModel
from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import f_quantile
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
    """Magnitude |z_ij|, as each axis's motion is to the amplitude that it was tested with."""
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
    def settle_s(self) -> float | None:
        """Time in s for which a test has to wait; None for what the robot itself waits."""
        waits = [known.settle_s for known in self.axes.values()]
        return max((one for one in waits if one is not None), default=None)

    @property
    def findings(self) -> tuple[str, ...]:
        """What weakens what is believed of the robot, and how its axes are coupled, in words."""
        found = [finding for known in self.axes.values() for finding in known.findings]
        return (*found, *map(str, self.couplings))

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        """The strongest significant answer of each axis to each other one, in any test."""
        strongest: dict[tuple[str, str], Coupling] = {}
        for response in self.responses:
            for found in _couplings(self.robot, response):
                pair = found.output, found.reference
                if pair not in strongest or strongest[pair].share < found.share:
                    strongest[pair] = found
        return tuple(strongest.values())


def _couplings(robot: str, response: FrequencyResponse) -> list[Coupling]:
    matrix = response.matrix
    if matrix is None:
        return []
    found = []
    axes = range(len(matrix.axes))
    count = max(1, sum(len(matrix.played_by) - int(np.sum(matrix.played_by == i)) for i in axes))
    for i in axes:
        for j in axes:
            entry = matrix.entry(i, j)
            if i == j or not np.isfinite(entry.z).all():
                continue
            # Bonferroni: the significance is shared out among all entries and tones.
            limit = f_quantile(COUPLED_SIGNIFICANCE / count, entry.degrees_of_freedom / 2)
            # In units of the amplitudes that both axes are tested with, so that metres and
            # radians can be compared.
            unit = (matrix.rows[j].amplitude or 1.0) / (matrix.rows[i].amplitude or 1.0)
            share: FloatArray = np.abs(entry.z) * unit
            share = np.where(np.abs(entry.z) ** 2 > limit * entry.variance, share, 0.0)
            if share.max() >= COUPLED_MIN:
                at = int(np.argmax(share))
                omega = float(entry.omega_rad_s[at])
                found.append(
                    Coupling(robot, matrix.axes[i], matrix.axes[j], float(share[at]), omega)
                )
    return found
