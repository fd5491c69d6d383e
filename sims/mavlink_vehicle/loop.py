"""The position loop of the simulated vehicle, and its response in closed form."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nufleet.shared.arrays import FloatArray
from nufleet.shared.strict import NonNegative, Positive, Strict

ALIASES = 60
"""Number of aliases on either side that are summed; the loop lets little of the next one pass."""

GRID = 400
"""Number of points on which a sample is integrated."""


class LoopSettings(Strict):
    """A loop of second order with a delay, the same on all axes."""

    omega_rad_s: Positive = 6.0
    """Natural frequency ω₀."""
    damping: Annotated[float, Field(gt=0, lt=1)] = 0.7
    """Damping ratio ζ."""
    delay_s: NonNegative = 0.03
    """Time from the arrival of a set-point until it acts."""


class Loop:
    """p'' = ω₀² (r − p) + 2 ζ ω₀ (r' − p'), exact for set-points that are held in between."""

    def __init__(self, settings: LoopSettings, place: FloatArray) -> None:
        self._settings = settings
        self.position = place.copy()
        """Position in m, shape (3,)."""
        self.velocity = np.zeros(3)
        """Velocity in m/s, shape (3,)."""
        self._target = place.copy()

    def put(self, place: FloatArray) -> None:
        """Place the vehicle at rest at a position in m, shape (3,)."""
        self.position, self.velocity, self._target = place.copy(), np.zeros(3), place.copy()

    def aim(self, place: FloatArray, velocity: FloatArray) -> None:
        """Follow a set-point from now on; both have shape (3,)."""
        settings = self._settings
        # The velocity shifts the place at which the held set-point has the loop rest.
        self._target = place + 2 * settings.damping / settings.omega_rad_s * velocity

    def advance(self, for_s: float) -> None:
        """Move on by some time."""
        omega, zeta = self._settings.omega_rad_s, self._settings.damping
        decay, turns = zeta * omega, omega * math.sqrt(1 - zeta**2)
        away, velocity = self.position - self._target, self.velocity
        shrunk = math.exp(-decay * for_s)
        cosine, sine = math.cos(turns * for_s), math.sin(turns * for_s)
        second = (velocity + decay * away) / turns
        moved = shrunk * (away * cosine + second * sine)
        self.velocity = shrunk * turns * (second * cosine - away * sine) - decay * moved
        self.position = self._target + moved


def frequency_response(
    settings: LoopSettings,
    omega_rad_s: FloatArray,
    sample_time_s: float,
    *,
    feed_forward: bool,
    link_delay_s: float = 0.0,
    link_jitter_s: float = 0.0,
    link_loss: float = 0.0,
) -> NDArray[np.complex128]:
    """Return the exact response from sampled references to outputs at the samples.

    Each reference is held from its arrival until that of the next newer one. With packets that
    arrive after link_delay_s and an exponential further time of mean link_jitter_s, and are lost
    with probability link_loss, it is in force at time s after it was sent with the probability that
    it has arrived and no newer one has; the mean response follows from this mean hold.

    Args:
        settings: Settings of the loop.
        omega_rad_s: Frequencies, shape (frequencies,).
        sample_time_s: Time between two references.
        feed_forward: Whether set-points hold the references' difference quotient as velocity, too.
        link_delay_s: Least time that a set-point takes to the vehicle.
        link_jitter_s: Mean of the further time.
        link_loss: Share of the set-points that never arrive.

    Returns:
        The responses, shape (frequencies,).
    """
    omega_0, zeta, step_s = settings.omega_rad_s, settings.damping, sample_time_s
    aliases = np.arange(-ALIASES, ALIASES + 1)
    s = 1j * (omega_rad_s[:, np.newaxis] + 2 * np.pi / step_s * aliases)
    plant = (omega_0**2) / (s**2 + 2 * zeta * omega_0 * s + omega_0**2)
    late = np.exp(-s * (settings.delay_s + link_delay_s))
    hold = _hold(omega_rad_s, aliases, step_s, link_jitter_s, link_loss)
    held = (plant * late * hold).sum(axis=1) / step_s
    ahead = 2 * zeta / omega_0 * (1 - np.exp(-1j * omega_rad_s * step_s)) / step_s
    response: NDArray[np.complex128] = held * (1 + ahead if feed_forward else 1)
    return response


def _hold(
    omega_rad_s: FloatArray,
    aliases: NDArray[np.int64],
    step_s: float,
    jitter_s: float,
    loss: float,
) -> NDArray[np.complex128]:
    """Return the Fourier transform of the probability that a reference is in force.

    Its shape is (frequencies, aliases); alias n of a frequency ω is ω + 2 π n / step_s.
    """
    within_s = step_s * (np.arange(GRID) + 0.5) / GRID
    steps = math.ceil(12 + 20 * jitter_s / step_s)
    since_s = within_s + step_s * np.arange(steps)[:, np.newaxis]

    def arrived(after_s: FloatArray) -> FloatArray:
        positive = np.maximum(after_s, 0.0)
        share = 1.0 - np.exp(-positive / jitter_s) if jitter_s else np.ones_like(positive)
        return np.where(after_s > 0, (1 - loss) * share, 0.0)

    in_force = arrived(since_s)
    for newer in range(1, steps):
        in_force = in_force * (1 - arrived(since_s - newer * step_s))
    # All aliases share the sample period, so whole periods are summed before the aliases are
    # separated.
    turning = np.exp(-1j * omega_rad_s[:, np.newaxis, np.newaxis] * since_s)
    folded = (in_force * turning).sum(axis=1)
    apart = np.exp(-2j * np.pi / step_s * np.outer(within_s, aliases))
    transformed: NDArray[np.complex128] = folded @ apart * (step_s / GRID)
    return transformed
