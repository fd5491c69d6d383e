"""A measured response as it is kept in a run's results."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Quality
from nufleet.shared.strict import NonNegative, Positive, Strict


class ResponseRecord(Strict):
    """A usable test of a robot; see `nufleet.shared.frequency_test.frequency_response.FrequencyResponse`.

    Tones at which nothing could be estimated are left out.
    """

    omega_rad_s: tuple[Positive, ...]
    real: tuple[float, ...]
    imag: tuple[float, ...]
    variance: tuple[NonNegative, ...]
    degrees: tuple[Positive, ...]
    segments: Annotated[int, Field(ge=3)]
    amplitude: Positive | None
    quality: Quality

    @staticmethod
    def of(response: FrequencyResponse) -> ResponseRecord:
        """Return the record of a response."""
        known = np.isfinite(response.z) & np.isfinite(response.variance)
        columns = {
            "omega_rad_s": response.omega_rad_s,
            "real": response.z.real,
            "imag": response.z.imag,
            "variance": response.variance,
            "degrees": response.degrees_of_freedom,
        }
        return ResponseRecord(
            **{name: tuple(column[known].tolist()) for name, column in columns.items()},
            segments=response.segments,
            amplitude=response.amplitude,
            quality=response.quality,
        )

    def response(self) -> FrequencyResponse:
        """Return the response that this is the record of."""
        return FrequencyResponse(
            omega_rad_s=np.array(self.omega_rad_s),
            z=np.array(self.real) + 1j * np.array(self.imag),
            variance=np.array(self.variance),
            segments=self.segments,
            quality=self.quality,
            degrees=np.array(self.degrees),
            amplitude=self.amplitude,
        )
