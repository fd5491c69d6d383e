"""Every entry of a robot's response, from one test that played on several axes at once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.quality import Finding, Quality

if TYPE_CHECKING:
    from nufleet.shared.frequency_test.frequency_response import FrequencyResponse


@dataclass(frozen=True)
class MatrixResponse:
    """Estimates of every entry z_ij(ω), output of axis i over reference of axis j, of one test."""

    axes: tuple[str, ...]
    """Names of the axes that played."""
    played_by: NDArray[np.intp]
    """Place of the axis j that played each tone, shape (tones,)."""
    rows: tuple[FrequencyResponse, ...]
    """Response of each output i to the tones of all axes, in the unit of axis i over that of the
    axis that played the tone; with the verdict on this output."""
    correlation: ComplexArray
    """Correlation of the errors of the rows at a tone, shape (axes, axes), about the same at all of
    them: what disturbs one axis often disturbs the others."""

    def entry(self, output: int, reference: int) -> FrequencyResponse:
        """Return z_ij at the tones of axis j, by the places of both axes."""
        return self.rows[output].at(self.played_by == reference)

    @property
    def hidden_variances(self) -> FloatArray | None:
        """Part of the variances that is due to transients which the tones may hide, shape (axes,
        tones); None if nothing is known of any."""
        parts = [row.hidden_variance for row in self.rows]
        if all(part is None for part in parts):
            return None
        tones = len(self.played_by)
        return np.stack([np.zeros(tones) if part is None else part for part in parts])

    @property
    def covariance(self) -> ComplexArray:
        """Covariance E[(ẑ_i − z_i)(ẑ_l − z_l)*] at each tone, shape (tones, axes, axes)."""
        deviation = np.sqrt(np.stack([row.variance for row in self.rows], axis=1))
        return np.asarray(self.correlation * deviation[:, :, None] * deviation[:, None, :])

    @property
    def quality(self) -> Quality:
        """Verdict on the test: what was found on any output, with the name of its axis."""

        def named(kind: str) -> tuple[Finding, ...]:
            found: dict[Finding, None] = {}
            for axis, row in zip(self.axes, self.rows, strict=True):
                for finding in getattr(row.quality, kind):
                    text = f"axis {axis}: {finding.text}"
                    found[finding.model_copy(update={"text": text})] = None
            return tuple(found)

        return Quality(reasons=named("reasons"), warnings=named("warnings"))


def error_correlation(
    left: FloatArray, omega_max_rad_s: float, sample_time_s: float
) -> ComplexArray:
    """Return the correlation of the outputs' errors, pooled over the whole band.

    It is taken from the Fourier lines of what the tones do not explain, up to one and a half times
    the highest tone. A tone by itself has too few segments to tell a correlation from chance.

    Args:
        left: What the fit leaves of each output in the measuring part, shape (axes, samples).
        omega_max_rad_s: Frequency of the highest tone.
        sample_time_s: Time between samples.

    Returns:
        Correlations, shape (axes, axes), Hermitian, with ones on the diagonal.
    """
    if len(left) == 1:
        return np.ones((1, 1), dtype=np.complex128)
    samples = left.shape[1]
    highest = math.ceil(1.5 * omega_max_rad_s * samples * sample_time_s / (2 * math.pi))
    lines = np.fft.rfft(left, axis=1)[:, 1 : 1 + highest]
    size = np.linalg.norm(lines, axis=1)
    lines = lines / np.where(size > 0, size, 1.0)[:, None]
    correlation = np.asarray(lines @ lines.conj().T)
    np.fill_diagonal(correlation, 1.0)
    return correlation
