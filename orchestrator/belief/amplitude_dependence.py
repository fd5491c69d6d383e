"""What the amplitude of a test does to a robot's response, and how much that makes uncertain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.frequency_response import Flight
from nufleet.shared.frequency_test.nonlinearity import Nonlinearity

FORM_HALVINGS = 0.75
HELD_BACK_HALVINGS = 0.5
"""What the form of a motion does to a nonlinear robot, in halvings of the amplitude, and what it
does to one of which small motions are held back. From a test of few tones to many motions of many
tones, the responses of 48 loops of a kind change by 0.3 of what half the amplitude does to them
with a dead zone (median), 0.4 with backlash or friction, 0.5 with two kinds at once, and 0.9 with a
hardening spring. Where an actuator saturates, half the amplitude often does nothing; it is its
distortion that tells."""

HELD_BACK = (Nonlinearity.DEAD_ZONE, Nonlinearity.BACKLASH, Nonlinearity.FRICTION)

AMPLITUDES_DIFFER = 1.25
"""Ratio of two amplitudes from which a change of the response is laid to them."""


def differ(one: float | None, other: float | None) -> bool:
    """Whether two amplitudes are known and clearly different."""
    if one is None or other is None:
        return False
    return max(one, other) > AMPLITUDES_DIFFER * min(one, other)


def change_in_words(
    flights: Sequence[Flight | None], unit: str, change: float, omega_rad_s: float
) -> str:
    """Return in words that a new response contradicts the earlier ones.

    Args:
        flights: Flight of each response, the new one last; None for a test.
        unit: Unit of the robot's axis.
        change: Distance of the new response from what the earlier ones predict.
        omega_rad_s: Frequency of that distance in rad/s.
    """
    new, earlier = flights[-1], [flight for flight in flights[:-1] if flight is not None]
    depends = "on the amplitude or on time"
    if new is None and not earlier:
        motions = "tests"
        depends = "on time or on the tones; if it has changed, test again without --reuse"
    elif new is None:
        motions = "its flights and its test"
    elif not earlier:
        motions = "its tests and a flight"
    else:
        speeds = sorted({f"{one.speed:.2g}" for one in (*earlier, new)})
        motions = f"flights at up to {' and '.join(speeds)} {unit}/s"
    return (
        f"its response changed between {motions}, by {change:.3g} at {omega_rad_s:.4g} rad/s: it "
        f"depends {depends}"
    )


@dataclass(frozen=True, eq=False)
class AmplitudeDependence:
    """How far the responses at an amplitude and at half of it lie apart."""

    omega_rad_s: FloatArray
    """Frequencies in rad/s, rising, shape (frequencies,)."""
    squared: FloatArray
    """Squared distance of the two responses at each, shape (frequencies,)."""
    form_halvings: float = FORM_HALVINGS
    """What the form of a motion does to the response, in halvings of the amplitude."""

    @staticmethod
    def of(
        omega_rad_s: FloatArray, squared: FloatArray, kind: Nonlinearity | None
    ) -> AmplitudeDependence:
        """Return what a nonlinearity does to a robot.

        Args:
            omega_rad_s: Frequencies in rad/s, rising, shape (frequencies,).
            squared: Squared distance of the responses at an amplitude and at half of it.
            kind: What makes the robot nonlinear; None if that is not known.
        """
        halvings = HELD_BACK_HALVINGS if kind in HELD_BACK else FORM_HALVINGS
        return AmplitudeDependence(omega_rad_s, squared, halvings)

    def variance(
        self, omega_rad_s: FloatArray, amplitude: float | None, largest: float | None
    ) -> FloatArray:
        """Return by how much it makes the estimates of a test uncertain.

        What is believed of a robot is its response at the largest amplitude that it played, in a
        motion of any form.

        Args:
            omega_rad_s: Frequencies of the test's tones in rad/s, shape (tones,).
            amplitude: Amplitude of the test; None if unknown.
            largest: Largest amplitude of the robot's tests, in the same unit; None if unknown.

        Returns:
            Variances, shape (tones,).
        """
        halvings = math.log2(largest / amplitude) if amplitude and largest else 0.0
        squared = np.interp(omega_rad_s, self.omega_rad_s, self.squared)
        return np.asarray(squared * (self.form_halvings + max(halvings, 0.0)) ** 2)

    def equals(self, other: AmplitudeDependence | None) -> bool:
        """Whether another one says the same."""
        return (
            other is not None
            and np.array_equal(self.omega_rad_s, other.omega_rad_s)
            and np.array_equal(self.squared, other.squared)
            and self.form_halvings == other.form_halvings
        )

    @staticmethod
    def of_fleet(found: Sequence[AmplitudeDependence | None]) -> AmplitudeDependence | None:
        """Return what may be expected of a robot of the same kind that was not compared.

        Args:
            found: What was found of each robot that was tested at two amplitudes; None for one
                whose responses agreed.
        """
        known = [one for one in found if one is not None]
        if not known:
            return None
        omega = known[0].omega_rad_s
        total = sum(np.interp(omega, one.omega_rad_s, one.squared) for one in known)
        halvings = max(one.form_halvings for one in known)
        return AmplitudeDependence(omega, np.asarray(total / len(found)), halvings)
