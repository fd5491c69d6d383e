"""What the motion of one axis of a target leaves as errors on another one that answers to it.

An inverse answers for its own axis. With the inverse of source S the error on a trajectory y_d is
therefore e = (I − Z_T D_S⁻¹) y_d, with the target's matrix Z_T and the diagonal matrix D_S of the
source's own responses; without one it is (I − Z_T) y_d. The motion of axis j leaves
−z_T,ij y_d,j / z_S,jj on axis i. What several axes do at one frequency is assumed to have no phase
in common, so that the squares of these errors add up.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge, unit_ratios
from nufleet.orchestrator.study.trajectory_spectrum import Spectrum
from nufleet.orchestrator.study.verdict import GAIN_MIN
from nufleet.shared.arrays import ComplexArray


@dataclass(frozen=True)
class ErrorsAcross:
    """Samples of how axes of the target answer to others, at the frequencies of a motion."""

    robot: str
    """Name of the target."""
    z: Mapping[tuple[str, str], ComplexArray]
    """Samples by the axis that answers and the one that moves, without units, shape
    (samples, frequencies); only where an axis answers significantly."""
    spectra: Mapping[str, Spectrum]
    """Spectrum of the motion on each axis, by axis."""
    samples: int
    """Number of samples."""

    @staticmethod
    def of(
        target: AxesKnowledge,
        spectra: Mapping[str, Spectrum],
        count: int,
        rng: np.random.Generator,
    ) -> ErrorsAcross:
        """Draw samples.

        Args:
            target: Knowledge of the target.
            spectra: Spectrum of the motion on each axis, by axis.
            count: Number of samples.
            rng: Generator that draws them.
        """
        drawn = {}
        for one in target.couplings:
            model = target.cross(one.output, one.reference)
            if model is not None and {one.output, one.reference} <= spectra.keys():
                (unit,) = unit_ratios(target.spec, one.output, [one.reference])
                omega = spectra[one.reference].omega_rad_s
                drawn[one.output, one.reference] = unit * model.draw(omega, count, rng)
        return ErrorsAcross(target.robot, drawn, spectra, count)

    def on(
        self,
        outputs: Collection[str],
        motion: Spectrum,
        source: Mapping[str, ComplexArray] | None = None,
    ) -> ComplexArray:
        """Return the errors that the motions of other axes leave on some.

        Args:
            outputs: Names of the axes that answer.
            motion: Spectrum of the motion that the errors are relative to, in root mean square.
            source: Samples of the source's own responses at the frequencies of the motion, by axis,
                shape (as many samples or more, frequencies); None without a transfer.

        Returns:
            Components whose squares add up to the mean square error, shape (samples, components),
            with the frequencies of one pair of axes after those of the other.
        """
        mean_square = float(motion.power.sum())
        parts = [np.zeros((self.samples, 0), dtype=np.complex128)]
        for (answering, moving), z in self.z.items():
            if answering in outputs and (source is None or moving in source):
                gain = z if source is None else z / _invertible(source[moving][: self.samples])
                parts.append(-gain * np.sqrt(self.spectra[moving].power / mean_square))
        return np.concatenate(parts, axis=1)

    @property
    def finding(self) -> str:
        """What is included in errors, in words."""
        return (
            f"errors include what one axis of {self.robot} does to another, as if the motions of "
            "axes had no phase in common"
        )


def _invertible(z: ComplexArray) -> ComplexArray:
    return np.asarray(np.where(np.abs(z) > GAIN_MIN, z, GAIN_MIN))
