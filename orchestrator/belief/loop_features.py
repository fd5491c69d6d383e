"""The parts of a stable loop's response: a second-order loop with delay, modes, and a residual.

z(ω) = e^{−jωτ} [loop(ω) + Σ modes(ω)] + residual(ω), with x = ω/ω₀ and D = 1 + 2jζx − x².
The loop is (b₀ + j b₁x)/D. A mode is 2ζ(c₀ + j c₁x)/D, so that |c₀ + j c₁| is the height of its
resonance. The residual Σ h_k e^{−jωkΔ} is a causal impulse response whose prior variance decays
(the diagonal kernel of Chen, Ohlsson and Ljung, Automatica 48, 2012).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray

LOOP_PARAMETERS = 5
"""Number of the loop's parameters: b₀, b₁, ln ω₀, ln ζ, τ."""

MODE_PARAMETERS = 4
"""Number of each mode's parameters: c₀, c₁, ln ω₀, ln ζ."""

TAPS = 24
TAPS_BANDWIDTH = 1.2
"""Number of taps in the residual's impulse response, and half the period of the residual in ω as a
multiple of the band's upper end; beyond it, the residual repeats."""

MODE_DAMPINGS = (0.02, 0.045, 0.1, 0.22, 0.5)
"""Damping ratios ζ of the candidate modes."""

MEASURED = 0.5
"""Prior probability that a mode of a robot in which something was measured to decay slowly is what
decays, within a factor e of the rate that was measured."""

SLOWER_EXPONENT = 8
"""Exponent of the prior probability of modes that decay k times slower than the robot settles, k to
the power of minus this. Tests show whether it settles as it says, so that it may be large."""

MODE_LOWEST = 0.015
MODE_HIGHEST = 1.3
"""Frequencies between which modes are sought, as multiples of the band's upper end."""


@dataclass(frozen=True)
class ResponsePrior:
    """The belief about any robot's loop before its first test.

    Feedback loops that follow a reference have a gain near 1 at low frequency, a bandwidth near the
    band they are operated in, and a delay that does not turn the phase much more than once.
    """

    omega_max_rad_s: float
    """Upper end of the tested band in rad/s."""
    decay_min_1_s: float
    """Decay rate σ = ζω₀ in 1/s, from the robot's settling time, below which a mode is the less
    probable the slower it is. It excludes nothing: a stated settling time may be wrong."""
    measured: bool = False
    """Whether tests showed that something in the robot decays as slowly as that, though its stated
    settling time does not say so."""
    gain_std: float = 0.5
    """Standard deviation of the gain b₀ about 1."""
    lead_std: float = 1.5
    """Standard deviation of the lead b₁ about 0."""
    log_bandwidth_std: float = 0.8
    """Standard deviation of ln ω₀ about each of the two bandwidths that are expected, and of all
    that lies between them."""
    log_damping_std: float = 1.0
    """Standard deviation of ln ζ about ln 0.5."""
    mode_height_std: float = 0.3
    """Standard deviation of a mode's c₀ and c₁ about 0."""

    def loop(self) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation of the loop's parameters, each of shape (5,)."""
        fast, slow = self.bandwidths_rad_s
        mean = [1.0, 0.0, 0.5 * np.log(fast * slow), np.log(0.5), 0.0]
        std = [
            self.gain_std,
            self.lead_std,
            self.log_bandwidth_std + 0.5 * np.log(fast / slow),
            self.log_damping_std,
            2.0 / self.omega_max_rad_s,
        ]
        return np.array(mean), np.array(std)

    @property
    def bandwidths_rad_s(self) -> tuple[float, float]:
        """Bandwidths ω₀ in rad/s that band and settling time suggest, the latter with ζ = 0.5.

        The latter is never the larger one, since something else in the robot may settle last.
        """
        fast = 0.7 * self.omega_max_rad_s
        return fast, min(fast, 2.0 * self.decay_min_1_s)

    def mode(self, omega_rad_s: float, damping: float) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation of a mode's parameters, each of shape (4,).

        Args:
            omega_rad_s: Frequency ω₀ of the grid point that the mode lies near, in rad/s.
            damping: Damping ratio ζ of that grid point.
        """
        mean = np.array([0.0, 0.0, np.log(omega_rad_s), np.log(damping)])
        return mean, np.array([self.mode_height_std, self.mode_height_std, 0.2, 0.7])

    def mode_grid(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return ω₀ (rad/s), ζ and log prior weight of all candidate modes, each of shape (modes,).

        For each ζ, the candidates are spaced by ζω₀, half the width of the resonance.
        """
        top = MODE_HIGHEST * self.omega_max_rad_s
        range_ = np.log(MODE_HIGHEST / MODE_LOWEST)
        counts = np.array([int(range_ / np.log1p(damping)) + 1 for damping in MODE_DAMPINGS])
        omega = np.concatenate([top * np.exp(-range_ * np.arange(n) / n) for n in counts])
        damping = np.repeat(MODE_DAMPINGS, counts)
        # Uniform over the dampings and, for each, between uniform over ω₀ and over ln ω₀.
        believed = np.minimum(damping * omega / self.decay_min_1_s, 1.0) ** SLOWER_EXPONENT
        weight = believed * np.sqrt(omega) / np.repeat(counts, counts)
        weight /= weight.sum()
        if self.measured:
            log_near = np.log(weight) - 0.5 * np.log(damping * omega / self.decay_min_1_s) ** 2
            near = np.exp(log_near - log_near.max())
            weight = MEASURED * near / near.sum() + (1 - MEASURED) * weight
        return omega, damping, np.log(weight)


def response(theta: FloatArray, omega_rad_s: FloatArray) -> ComplexArray:
    """Return the response of a loop and its modes, without the residual.

    Args:
        theta: Parameters θ of the loop and of m modes, shape (..., 5 + 4m).
        omega_rad_s: Frequencies in rad/s, shape (frequencies,).

    Returns:
        Response z, shape (..., frequencies).
    """
    return response_and_slope(theta, omega_rad_s)[0]


def response_and_slope(
    theta: FloatArray, omega_rad_s: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Return the response of a loop and its modes, and its derivative.

    Args:
        theta: Parameters θ of the loop and of m modes, shape (..., 5 + 4m).
        omega_rad_s: Frequencies in rad/s, shape (frequencies,).

    Returns:
        Response z, shape (..., frequencies), and ∂z/∂θ, shape (..., frequencies, 5 + 4m).
    """
    delay = np.exp(-1j * omega_rad_s * theta[..., 4:5])
    total = np.zeros(delay.shape, dtype=np.complex128)
    slope = np.empty((*delay.shape, theta.shape[-1]), dtype=np.complex128)
    for first in (0, *range(LOOP_PARAMETERS, theta.shape[-1], MODE_PARAMETERS)):
        n_0, n_1, log_omega, log_damping = (theta[..., first + i, None] for i in range(4))
        x = omega_rad_s * np.exp(-log_omega)
        damping = np.exp(log_damping)
        square, jx = x**2, 1j * x
        damped = 2 * damping * jx
        bare = 1 / (1 - square + damped)
        inverse = (delay if first == 0 else delay * (2 * damping)) * bare
        by_lead = jx * inverse
        led = n_1 * by_lead
        part = n_0 * inverse + led
        total += part
        # ∂D/∂ln ζ = 2jζx, and since ∂x/∂ln ω₀ = −x, ∂D/∂ln ω₀ = −(2jζx − 2x²). The height 2ζ of a
        # mode adds the mode itself to its derivative in ln ζ.
        shrunk = part * bare
        slope[..., first] = inverse
        slope[..., first + 1] = by_lead
        slope[..., first + 2] = shrunk * (damped - 2 * square) - led
        slope[..., first + 3] = (0.0 if first == 0 else part) - shrunk * damped
    slope[..., LOOP_PARAMETERS - 1] = -1j * omega_rad_s * total
    return total, slope


def mode_columns(
    omega_0_rad_s: FloatArray, damping: FloatArray, delay_s: float, omega_rad_s: FloatArray
) -> ComplexArray:
    """Return the response of each mode to unit coefficients c₀ and c₁.

    Args:
        omega_0_rad_s: Frequency ω₀ of each mode in rad/s, shape (modes,).
        damping: Damping ratio ζ of each mode, shape (modes,).
        delay_s: Delay τ of the loop in s.
        omega_rad_s: Frequencies in rad/s, shape (frequencies,).

    Returns:
        Responses for c₀ = 1 and for c₁ = 1, shape (modes, frequencies, 2).
    """
    x = omega_rad_s / omega_0_rad_s[:, None]
    bare = 2 * damping[:, None] / (1 + 2j * damping[:, None] * x - x**2)
    late = bare * np.exp(-1j * omega_rad_s * delay_s)
    return np.stack([late, 1j * x * late], axis=-1)


def tap_columns(omega_max_rad_s: float, omega_rad_s: FloatArray) -> ComplexArray:
    """Return e^{−jωkΔ} at each frequency (rad/s) for each tap k, shape (frequencies, taps)."""
    times_s = np.arange(TAPS) * tap_spacing_s(omega_max_rad_s)
    return np.exp(-1j * np.outer(omega_rad_s, times_s))


def tap_spacing_s(omega_max_rad_s: float) -> float:
    """Return Δ, the time between the residual's taps, in s."""
    return float(np.pi / (TAPS_BANDWIDTH * omega_max_rad_s))


def tap_std(size: float, memory_s: float, omega_max_rad_s: float) -> FloatArray:
    """Return the prior standard deviations of the residual's taps.

    Args:
        size: Root mean square of the residual: E|residual(ω)|² = `size`².
        memory_s: Time in s over which the deviations decay by a factor e.
        omega_max_rad_s: Upper end of the tested band in rad/s.

    Returns:
        Standard deviations, shape (taps,).
    """
    share = np.exp(-np.arange(TAPS) * tap_spacing_s(omega_max_rad_s) / memory_s)
    return np.asarray(size * share / np.linalg.norm(share))
