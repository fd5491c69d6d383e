"""The measurements of an evaluation as plain values: errors of flights and of transfers."""

from __future__ import annotations

from dataclasses import dataclass

from nufleet.shared.arrays import FloatArray


@dataclass(frozen=True)
class FlightError:
    """The tracking error of one flight of a target."""

    prior: str
    """Source of the prior, or one of the names in `flights.labels` for a flight without one."""
    drawing: str
    """Name of the drawing that was flown."""
    speed_m_s: float
    """Largest speed on the path."""
    rms_error_m: float
    """RMS distance to the path; infinite when the flight was not finished."""
    taken_back: bool = False
    """Whether the guard withdrew the prior during the flight."""


@dataclass(frozen=True, eq=False)
class FlownPath:
    """The desired and the actual path of one flight, in the first two axes."""

    error: FlightError
    """Error of the flight, which also says what was flown and with which prior."""
    desired_m: FloatArray
    """Desired positions, shape (samples, 2)."""
    actual_m: FloatArray
    """Measured positions, shape (samples, 2)."""


@dataclass(frozen=True)
class TransferPair:
    """An ordered pair of robots: the estimated distance, and the effect of the transfer."""

    target: str
    """Name of the robot that received the experience."""
    source: str
    """Name of the robot that the experience came from."""
    psi: float
    """Estimate ψ̂* of the worst-case chordal distance, in [0, 1]."""
    ratio: float
    """RMS error with the source's experience over the error with the target's baseline; infinite
    when a flight was not finished."""
