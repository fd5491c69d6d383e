"""Knowledge of one robot's response on all tested axes, each by itself and across."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from nufleet.orchestrator.belief.cross_response import CrossModel, ForeseenErrors
from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.orchestrator.belief.noise_pooling import pooled_variance
from nufleet.orchestrator.belief.robot_knowledge import VARIANCE_MIN, RobotKnowledge
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.matrix_response import MatrixResponse
from nufleet.shared.frequency_test.quality import BoolArray
from nufleet.shared.robots.spec import RobotSpec

COUPLED_SIGNIFICANCE = 1e-3
"""Probability that noise on axes which are not coupled is reported as coupling."""

COUPLED_MIN = 0.02
"""Share of its own response by which an axis moves another, below which nothing is reported."""


RIDGE = 1e-6
"""Share of the variance of noise that is new on every axis, where all of it seems to be the same.
"""

TOLD_MAX = 0.99
"""Largest share of the variance of an estimate's error that errors of others are believed to tell:
the correlation is itself an estimate."""


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
    """Largest magnitude |z_ij| at a tone; between axes in different units, the motion of each
    counts as a share of its largest amplitude."""
    omega_rad_s: float
    """Frequency in rad/s of the largest share."""

    def __str__(self) -> str:
        return (
            f"{self.robot}: {self.output} answers to {self.reference} with "
            f"{100 * self.share:.2g} % at {self.omega_rad_s:.3g} rad/s"
        )


@dataclass(frozen=True)
class _Cross:
    """What tests say of the answer of one axis to another."""

    model: CrossModel | None
    """Belief about it; None if no test played both axes."""
    coupling: Coupling | None
    """Its largest value; None if it does not exceed the noise, or does not matter."""


class AxesKnowledge:
    """The knowledge of one robot that tests of one or several axes have provided."""

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
                robot if len(axes) == 1 else f"{robot}, axis {axis}",
                spec.model_copy(update={"axes": (spec.axis(axis),)}),
                omega_max_rad_s,
            )
            for axis in axes
        }
        """Knowledge of each axis's response to its own reference, by axis."""
        self.responses: list[FrequencyResponse] = []
        self._crosses: dict[tuple[str, str], _Cross] = {}

    def learn(
        self,
        response: FrequencyResponse,
        rng: np.random.Generator,
        *,
        asked: Excitation | None = None,
        check: bool = True,
    ) -> None:
        """Learn the usable estimates of a test or flight on all compared axes that it played.

        Args:
            response: Response that it measured; where it does not name its axis, there is only
                one.
            rng: Generator that draws the responses expected from the earlier tests.
            asked: Test that was asked for; None if that is not known.
            check: Whether to look for contradictions; see `RobotKnowledge.learn`.

        Raises:
            InvalidInputError: The test has no usable estimate.
        """
        self.responses.append(response)
        self._crosses.clear()
        wanted = {
            one.axis: np.array([tone.omega_rad_s for tone in one.tones])
            for one in (asked.played if asked else ())
        }
        for axis, known in self.axes.items():
            own = self.own(response, axis)
            if own is None:
                continue
            known.learn(own, rng, check=check)
            if axis in wanted:
                known.compare_to_asked(own.omega_rad_s, wanted[axis])

    def own(self, response: FrequencyResponse, axis: str) -> FrequencyResponse | None:
        """Return what a response of the robot says of one axis; None if it does not play it."""
        if response.axis is None and response.matrix is None:
            return response if len(self.axes) == 1 else None
        return response.own_entries.get(axis)

    @property
    def tests(self) -> int:
        """Number of tests and flights of the robot."""
        return len(self.responses)

    @property
    def flown_only(self) -> bool:
        """Whether all that is known of one of its axes comes from flights."""
        return any(known.flown_only for known in self.axes.values())

    @property
    def flight_doubt(self) -> float:
        """Largest variance by which flights missed tests on an axis."""
        return max(known.flight_doubt for known in self.axes.values())

    @property
    def unseen(self) -> tuple[str, ...]:
        """Axes that no test has played."""
        return tuple(axis for axis, known in self.axes.items() if not known.tests)

    @property
    def settling_time_s(self) -> float:
        """Settling time in s of the axis that settles most slowly."""
        return max(known.settling_time_s for known in self.axes.values())

    @property
    def misstated(self) -> bool:
        """Whether tests showed that it settles more slowly than it states."""
        return any(known.misstated for known in self.axes.values())

    @property
    def lowest_rad_s(self) -> float:
        """Frequency in rad/s from which on every axis was tested."""
        return max(known.lowest_rad_s for known in self.axes.values())

    @property
    def silent(self) -> tuple[str, ...]:
        """Axes that were tested, and every test is certain that they do not respond."""
        return tuple(axis for axis, known in self.axes.items() if known.silent)

    def forget(self) -> None:
        """Forget all tests."""
        for known in self.axes.values():
            known.forget()
        self.responses = []
        self._crosses.clear()

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
        return self._cross(output, reference).model

    def draw_column(
        self,
        reference: str,
        omega_rad_s: FloatArray,
        own: ComplexArray,
        rng: np.random.Generator,
    ) -> dict[str, ComplexArray] | None:
        """Draw how all axes answer to one, given samples of how that axis answers itself.

        A sample of one response says what the errors of its measurements were, and hence something
        of those of the next, by the covariance that the tests measured.

        Args:
            reference: Axis that is asked.
            omega_rad_s: Frequencies in rad/s, rising, shape (frequencies,).
            own: Samples of its response to itself, shape (samples, frequencies).
            rng: Generator that draws the others.

        Returns:
            Samples by axis, in the shape of `own`; None if some axis was never tested with it.
        """
        drawn, order = {reference: own}, [reference]
        # Where not only noise makes tests uncertain, samples do not say what the noise was.
        noisy = not self.axes[reference].doubted
        tests = [one for one in self.responses if one.matrix and reference in one.matrix.axes]
        for output in self.axes:
            if output == reference:
                continue
            model = self.cross(output, reference)
            if model is None:
                return None
            foreseen = self._foreseen(tests, output, order, drawn, omega_rad_s) if noisy else None
            drawn[output] = model.draw(omega_rad_s, len(own), rng, foreseen)
            order.append(output)
        return drawn

    def _foreseen(
        self,
        tests: Sequence[FrequencyResponse],
        output: str,
        before: Sequence[str],
        drawn: Mapping[str, ComplexArray],
        omega_rad_s: FloatArray,
    ) -> ForeseenErrors:
        """Return what samples of other axes' answers to the first of them say of another's errors.

        With the covariance C of the errors at a tone, those of the others have the share
        C_io C_oo⁻¹ in it, and leave C_ii − C_io C_oo⁻¹ C_oi (the Gaussian conditional).
        """
        errors, left = [], []
        for response in tests:
            matrix = response.matrix
            if matrix is None or output not in matrix.axes:
                continue
            at = self._known_at(matrix, output, before[0])
            omega = matrix.rows[0].omega_rad_s[at]
            others = [axis for axis in before if axis in matrix.axes]
            places = [matrix.axes.index(axis) for axis in others]
            i, c = matrix.axes.index(output), matrix.correlation
            among = c[np.ix_(places, places)] + RIDGE * np.eye(len(places))
            share = np.linalg.solve(among.T, c[i, places])
            std = np.sqrt(np.stack([_pooled(matrix, place) for place in (i, *places)])[:, at])
            expected = np.zeros((len(drawn[before[0]]), len(omega)), dtype=np.complex128)
            for axis, place, part, own in zip(others, places, share, std[1:], strict=True):
                error = matrix.rows[place].z[at] - _at(omega, omega_rad_s, drawn[axis])
                scale = np.where(np.isfinite(own), std[0] / own, 0.0)
                expected += part * scale * np.where(np.isfinite(error), error, 0.0)
            errors.append(expected)
            told = float(np.clip((share @ c[places, i]).real, 0.0, TOLD_MAX))
            left.append(np.full(len(omega), 1.0 - told))
        return ForeseenErrors(np.concatenate(errors, axis=1), np.concatenate(left))

    def _known_at(self, matrix: MatrixResponse, output: str, reference: str) -> BoolArray:
        """Return at which tones a test knows how an axis answers to another, shape (tones,)."""
        i, j = matrix.axes.index(output), matrix.axes.index(reference)
        known = np.isfinite(matrix.rows[i].z) & np.isfinite(_pooled(matrix, i))
        return np.asarray((matrix.played_by == j) & known)

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        """The strongest answer of each axis to each other one, where it exceeds the noise."""
        crosses = [self._cross(*pair) for pair in permutations(self.axes, 2)]
        return tuple(one.coupling for one in crosses if one.coupling is not None)

    def _cross(self, output: str, reference: str) -> _Cross:
        pair = output, reference
        if pair not in self._crosses:
            self._crosses[pair] = self._crossed(*pair)
        return self._crosses[pair]

    def _crossed(self, output: str, reference: str) -> _Cross:
        tones, significant = [], False
        for response in self.responses:
            matrix = response.matrix
            if matrix is None or output not in matrix.axes or reference not in matrix.axes:
                continue
            i, at = matrix.axes.index(output), self._known_at(matrix, output, reference)
            row, variance = matrix.rows[i], np.maximum(_pooled(matrix, i), VARIANCE_MIN)
            # |ẑ|² of noise alone is exponentially distributed about its variance. Bonferroni: the
            # significance is shared out among all tones.
            limit = variance * math.log(len(variance) / COUPLED_SIGNIFICANCE)
            significant |= bool(np.any(np.abs(row.z[at]) ** 2 > limit[at]))
            tones.append(Tones(row.omega_rad_s[at], row.z[at], variance[at]))
        if not sum(len(one.z) for one in tones):
            return _Cross(None, None)
        measured = Tones(
            np.concatenate([one.omega_rad_s for one in tones]),
            np.concatenate([one.z for one in tones]),
            np.concatenate([one.variance for one in tones]),
        )
        answering, moving = self.axes[output].model, self.axes[reference].model
        model = CrossModel(
            measured,
            self._omega_max_rad_s,
            lambda omega: answering.likeliest_fit(omega) * moving.likeliest_fit(omega),
        )
        (unit,) = unit_ratios(self.spec, output, [reference])
        omega = np.unique(measured.omega_rad_s)
        share = unit * np.abs(model.mean(omega))
        most = int(np.argmax(share))
        if not significant or share[most] < COUPLED_MIN:
            return _Cross(model, None)
        found = Coupling(self.robot, output, reference, float(share[most]), float(omega[most]))
        return _Cross(model, found)


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
    noise = row.noise_variance[known]
    pooled = pooled_variance(
        row.omega_rad_s[known], noise * unit[known] ** 2, row.degrees_of_freedom[known]
    )
    variance[known] = pooled / unit[known] ** 2 + (row.variance[known] - noise)
    return variance


def _at(omega_rad_s: FloatArray, grid_rad_s: FloatArray, z: ComplexArray) -> ComplexArray:
    """Return responses between the frequencies of a grid, shape (samples, frequencies)."""
    place = np.interp(omega_rad_s, grid_rad_s, np.arange(len(grid_rad_s)))
    below = np.minimum(place.astype(int), len(grid_rad_s) - 2)
    above = place - below
    return np.asarray((1 - above) * z[:, below] + above * z[:, below + 1])
