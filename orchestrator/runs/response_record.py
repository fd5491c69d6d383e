"""A measured response as it is stored in a run's results."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from nufleet.shared.frequency_test.quality import Quality
from nufleet.shared.strict import Name, NonNegative, Positive, Strict

if TYPE_CHECKING:
    from nufleet.shared.frequency_test.frequency_response import FrequencyResponse


class FlightRecord(Strict):
    """The motion of a response that no test measured, as JSON."""

    speed: NonNegative
    """Largest speed of the reference, in the axis's unit per second."""
    noise_std: NonNegative
    """Standard deviation of the noise of one sample, in the axis's unit."""


class ResponseRecord(Strict):
    """A usable test of a robot, as JSON: what its `FrequencyResponse` says of each tone.

    Tones at which nothing could be estimated are left out.
    """

    omega_rad_s: tuple[Positive, ...]
    """Frequencies of the tones in rad/s."""
    real: tuple[float, ...]
    """Real part of ẑ at each tone."""
    imag: tuple[float, ...]
    """Imaginary part of ẑ at each tone."""
    variance: tuple[NonNegative, ...]
    """Variance E|ẑ − z|² at each tone."""
    degrees: tuple[Positive, ...]
    """Degrees of freedom of each variance."""
    hidden_variance: tuple[NonNegative, ...] | None = None
    """Part of each variance that is due to a transient which the tones may hide; None if nothing is
    known of it."""
    segments: Annotated[int, Field(ge=3)]
    """Number of measuring segments."""
    amplitude: Positive | None
    """Amplitude that was played, in the axis's unit; None if it is not known."""
    quality: Quality
    """Assessment of the test."""
    flight: FlightRecord | None = None
    """The flight that measured it; None for a test."""
    axis: Name | None = None
    """Name of the axis; None in records of earlier versions. A test of several axes has a record of
    each, of its response to its own reference."""

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
            hidden_variance=(
                None
                if response.hidden_variance is None
                else tuple(response.hidden_variance[known].tolist())
            ),
            segments=response.segments,
            amplitude=response.amplitude,
            quality=response.quality,
            flight=None
            if response.flight is None
            else FlightRecord(speed=response.flight.speed, noise_std=response.flight.noise_std),
            axis=response.axis,
        )

    def response(self) -> FrequencyResponse:
        """Return the response that this record holds."""
        from nufleet.shared.frequency_test.frequency_response import Flight, FrequencyResponse

        return FrequencyResponse(
            omega_rad_s=np.array(self.omega_rad_s),
            z=np.array(self.real) + 1j * np.array(self.imag),
            variance=np.array(self.variance),
            segments=self.segments,
            quality=self.quality,
            degrees=np.array(self.degrees),
            hidden_variance=(
                None if self.hidden_variance is None else np.array(self.hidden_variance)
            ),
            amplitude=self.amplitude,
            flight=None
            if self.flight is None
            else Flight(self.flight.speed, self.flight.noise_std),
            axis=self.axis,
        )
