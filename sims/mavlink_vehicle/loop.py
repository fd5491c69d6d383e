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
        """Put it somewhere at rest."""
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
        settings: The loop.
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
    shift = 2 * np.pi / step_s * np.arange(-ALIASES, ALIASES + 1)
    all_omega = omega_rad_s[:, np.newaxis] + shift
    s = 1j * all_omega
    plant = (omega_0**2) / (s**2 + 2 * zeta * omega_0 * s + omega_0**2)
    late = np.exp(-s * (settings.delay_s + link_delay_s))
    held = (plant * late * _held(all_omega, step_s, link_jitter_s, link_loss)).sum(axis=1) / step_s
    ahead = 2 * zeta / omega_0 * (1 - np.exp(-1j * omega_rad_s * step_s)) / step_s
    response: NDArray[np.complex128] = held * (1 + ahead if feed_forward else 1)
    return response


def _held(omega: FloatArray, step_s: float, jitter_s: float, loss: float) -> NDArray[np.complex128]:
    """Return the Fourier transform of the probability that a reference is in force."""
    if jitter_s == 0 and loss == 0:
        s = 1j * omega
        exact: NDArray[np.complex128] = (1 - np.exp(-s * step_s)) / s
        return exact
    lasts_s = step_s * 12 + 20 * jitter_s
    grid_s = 1e-4 * step_s + np.arange(0.0, lasts_s, step_s / 400)

    def arrived(since_s: FloatArray) -> FloatArray:
        positive = np.maximum(since_s, 0.0)
        share = 1.0 - np.exp(-positive / jitter_s) if jitter_s else np.ones_like(positive)
        return np.where(since_s > 0, (1 - loss) * share, 0.0)

    in_force = arrived(grid_s)
    for newer in range(1, math.ceil(lasts_s / step_s) + 1):
        in_force = in_force * (1 - arrived(grid_s - newer * step_s))
    spacing_s = grid_s[1] - grid_s[0]
    out = np.empty(omega.shape, dtype=np.complex128)
    for row, frequencies in zip(out, omega, strict=True):
        row[:] = np.exp(-1j * np.outer(frequencies, grid_s)) @ in_force * spacing_s
    return out
