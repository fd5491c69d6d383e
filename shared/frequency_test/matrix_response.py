"""Every entry of a robot's response, from one test that played on several axes at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nufleet.shared.arrays import ComplexArray
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
    """Correlation of the errors of the rows at each tone, shape (tones, axes, axes), as the
    segments scatter together: what disturbs one axis often disturbs the others."""

    def entry(self, output: int, reference: int) -> FrequencyResponse:
        """Return z_ij at the tones of axis j, by the places of both axes."""
        row, tones = self.rows[output], self.played_by == reference
        return replace(
            row,
            omega_rad_s=row.omega_rad_s[tones],
            z=row.z[tones],
            variance=row.variance[tones],
            degrees=None if row.degrees is None else row.degrees[tones],
        )

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


def error_correlation(segment_z: ComplexArray) -> ComplexArray:
    """Return the correlation of the errors of all outputs at each tone.

    Args:
        segment_z: Estimates from each segment, shape (axes, segments, tones).

    Returns:
        Correlations, shape (tones, axes, axes), Hermitian, with ones on the diagonal.
    """
    spread = segment_z - segment_z.mean(axis=1, keepdims=True)
    # Divided by the largest deviation first, whose square might overflow.
    largest = np.max(np.abs(spread), axis=1, keepdims=True)
    spread = np.divide(spread, largest, out=np.zeros_like(spread), where=largest > 0)
    product = np.einsum("ipt,lpt->til", spread, spread.conj())
    size = np.sqrt(np.einsum("tii->ti", product).real)
    scale = size[:, :, None] * size[:, None, :]
    correlation = np.divide(product, scale, out=np.zeros_like(product), where=scale > 0)
    places = np.arange(len(segment_z))
    correlation[:, places, places] = 1.0
    return correlation
