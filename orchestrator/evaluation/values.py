"""What an evaluation measures, as plain values: estimates over studies, errors over flights."""

from __future__ import annotations

from dataclasses import dataclass

from nufleet.shared.arrays import FloatArray


@dataclass(frozen=True)
class StudyEstimate:
    """ψ̂*_n of one source after one iteration of one of several repeated studies."""

    study: int
    iteration: int
    source: str
    psi: float


@dataclass(frozen=True)
class FlightError:
    """How far a target was from a path; `prior` is a source, or see `flight_labels`.

    An error of a flight that was not finished is infinite.
    """

    prior: str
    drawing: str
    speed_m_s: float
    rms_error_m: float
    taken_back: bool = False


@dataclass(frozen=True, eq=False)
class FlownPath:
    """A flight's desired and actual path, shape (samples, 2) each, in m."""

    error: FlightError
    desired_m: FloatArray
    actual_m: FloatArray


@dataclass(frozen=True)
class TransferPair:
    """An ordered pair of robots: what was estimated, and what the transfer then gave.

    `ratio` is the target's RMS error with the source's experience over that with its baseline;
    infinite where a flight was not finished.
    """

    target: str
    source: str
    psi: float
    ratio: float
