"""Families of random robots for experience selection: loops, bands, sensors, what drivers state.

The first six are well behaved: linear or mildly nonlinear loops that state how slowly they settle.
Each of the others spoils something: a mode below the lowest tones, a settling time that is stated
wrong, loops far slower than their band, actuators that are not linear, few samples per period,
near ties, responses hardly larger than the noise, transients that creep, fleets of several kinds,
and measurements that gusts, dropped samples, a sagging battery, coarse steps, outliers or a
swinging load disturb.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from benchmarks.nonlinear_loop import NonlinearLoop
from nufleet.shared.arrays import ComplexArray, FloatArray

BAND_RAD_S = (0.1, 5.4)
SAMPLE_TIME_S = 0.02

SETTLED = 1e-3
"""A transient is negligible when the slowest mode has decayed to this share."""


@dataclass(frozen=True)
class Mode:
    """A second-order mode with (1 + lead s) in its numerator, and its share of the response."""

    omega_rad_s: float
    damping: float
    lead_s: float = 0.0
    gain: float = 1.0

    @property
    def decay_1_s(self) -> float:
        """The decay rate of its slowest pole."""
        if self.damping <= 1:
            return self.damping * self.omega_rad_s
        return self.omega_rad_s * (self.damping - math.sqrt(self.damping**2 - 1))


@dataclass(frozen=True)
class LinearLoop:
    """z(s) = e^{−delay s} Σ of modes."""

    modes: tuple[Mode, ...]
    delay_s: float

    def response(self, omega_rad_s: FloatArray) -> ComplexArray:
        """Return z at these frequencies."""
        s = 1j * np.asarray(omega_rad_s)
        total = np.zeros(s.shape, dtype=np.complex128)
        for mode in self.modes:
            x = s / mode.omega_rad_s
            total += mode.gain * (1 + mode.lead_s * s) / (1 + 2 * mode.damping * x + x**2)
        return np.asarray(total * np.exp(-self.delay_s * s))

    @property
    def slowest_decay_1_s(self) -> float:
        """The real part of the slowest pole, without its sign."""
        return min(mode.decay_1_s for mode in self.modes)


Loop = LinearLoop | NonlinearLoop
Spoil = Callable[[np.random.Generator, FloatArray], FloatArray]


def honest(_rng: np.random.Generator, settling_time_s: float) -> float:
    """Return the settling time itself."""
    return settling_time_s


@dataclass(frozen=True)
class Family:
    """Robots of one kind."""

    draw: Callable[[np.random.Generator], Loop]
    """Draws a loop."""
    band_rad_s: tuple[float, float] = BAND_RAD_S
    """Band over which sources are compared."""
    sample_time_s: float = SAMPLE_TIME_S
    """Time between samples."""
    stated: Callable[[np.random.Generator, float], float] = honest
    """Returns what the driver states for a settling time."""
    spoil: Spoil | None = None
    """Returns what becomes of the measured positions."""


def second_order(rng: np.random.Generator) -> LinearLoop:
    """A well-damped loop with lead and delay."""
    omega, damping = rng.uniform(1.5, 5.0), rng.uniform(0.4, 1.0)
    lead_s = rng.uniform(0.0, 2.0) * damping / omega
    return LinearLoop((Mode(omega, damping, lead_s),), rng.uniform(0.0, 0.15))


def lightly_damped(rng: np.random.Generator) -> LinearLoop:
    """A loop whose own mode is lightly damped: a resonance of up to 20 dB."""
    omega, damping = rng.uniform(1.5, 5.0), rng.uniform(0.05, 0.15)
    return LinearLoop((Mode(omega, damping, rng.uniform(0.0, 0.1)),), rng.uniform(0.0, 0.1))


def flexible(rng: np.random.Generator) -> LinearLoop:
    """A well-damped loop that also shakes something: a narrow mode of little weight."""
    return _shaken(second_order(rng), rng, (1.5, 5.0), (0.03, 0.1))


def twice_flexible(rng: np.random.Generator) -> LinearLoop:
    """A well-damped loop that shakes two things, which may resonate near each other."""
    return _shaken(flexible(rng), rng, (1.5, 5.0), (0.03, 0.1))


def low_resonance(rng: np.random.Generator) -> LinearLoop:
    """The same, with the narrow mode in the lowest part of the band."""
    return _shaken(second_order(rng), rng, (0.2, 1.4), (0.05, 0.2))


def narrow_resonance(rng: np.random.Generator) -> LinearLoop:
    """The same, with a mode so narrow that it lies between the tones, and rings for minutes."""
    return _shaken(second_order(rng), rng, (0.3, 5.0), (0.005, 0.02))


def among_products(rng: np.random.Generator) -> LinearLoop:
    """The same, with the mode just below twice the lowest tone, as distortion is."""
    return _shaken(second_order(rng), rng, (0.972, 0.992), (0.01, 0.04))


def _shaken(
    base: LinearLoop,
    rng: np.random.Generator,
    omega_rad_s: tuple[float, float],
    dampings: tuple[float, float],
) -> LinearLoop:
    damping = rng.uniform(*dampings)
    height = rng.uniform(0.1, 0.5) * rng.choice([-1.0, 1.0])
    shaken = Mode(rng.uniform(*omega_rad_s), damping, gain=2 * damping * height)
    return LinearLoop((*base.modes, shaken), base.delay_s)


def gain_and_delay(rng: np.random.Generator) -> LinearLoop:
    """A well-damped loop whose gain is not 1 and whose delay is long."""
    omega, damping, gain = rng.uniform(2.0, 6.0), rng.uniform(0.5, 1.0), rng.uniform(0.7, 1.3)
    return LinearLoop((Mode(omega, damping, gain=gain),), rng.uniform(0.0, 0.4))


def alike(rng: np.random.Generator) -> LinearLoop:
    """A well-damped loop that hardly differs from the others of its family."""
    omega, damping = 3.0 * math.exp(0.05 * rng.normal()), 0.6 * math.exp(0.1 * rng.normal())
    return LinearLoop((Mode(omega, damping, 0.1),), rng.uniform(0.04, 0.07))


def faint(rng: np.random.Generator) -> LinearLoop:
    """A well-damped loop that moves by a small share of its reference."""
    base = second_order(rng)
    return LinearLoop((replace(base.modes[0], gain=rng.uniform(0.02, 0.2)),), base.delay_s)


def creeping(rng: np.random.Generator) -> LinearLoop:
    """A well-damped loop that creeps for the last of its way, as with an integral controller."""
    base, share = second_order(rng), rng.uniform(0.03, 0.1) * rng.choice([-1.0, 1.0])
    creeps = Mode(rng.uniform(0.05, 0.3), rng.uniform(1.0, 1.5), gain=share)
    return LinearLoop((replace(base.modes[0], gain=1.0 - share), creeps), base.delay_s)


def of_any_kind(rng: np.random.Generator) -> LinearLoop:
    """A loop of one of the linear kinds before, so that a fleet holds several."""
    kinds = (second_order, lightly_damped, flexible, gain_and_delay, creeping)
    return kinds[rng.integers(len(kinds))](rng)


def slow(rng: np.random.Generator) -> LinearLoop:
    """A loop far slower than its band."""
    omega, damping = rng.uniform(0.6, 1.6), rng.uniform(0.4, 1.0)
    return LinearLoop((Mode(omega, damping, rng.uniform(0.0, 0.5)),), rng.uniform(0.0, 0.1))


def very_slow(rng: np.random.Generator) -> LinearLoop:
    """A loop whose band hardly begins in the one over which it is compared."""
    omega, damping = rng.uniform(0.1, 0.5), rng.uniform(0.6, 1.2)
    return LinearLoop((Mode(omega, damping, rng.uniform(0.0, 0.5)),), rng.uniform(0.0, 0.1))


def quick(rng: np.random.Generator) -> LinearLoop:
    """A loop with half of its band near the Nyquist frequency of coarse samples."""
    omega, damping = rng.uniform(5.0, 15.0), rng.uniform(0.4, 1.0)
    return LinearLoop((Mode(omega, damping),), rng.uniform(0.0, 0.05))


def _bent(**limits: tuple[float, float]) -> Callable[[np.random.Generator], NonlinearLoop]:
    """Return what draws a well-damped loop with nonlinearities between these limits."""

    def draw(rng: np.random.Generator) -> NonlinearLoop:
        linear = second_order(rng)
        mode = linear.modes[0]
        return NonlinearLoop(
            omega_rad_s=mode.omega_rad_s,
            damping=mode.damping,
            lead_s=mode.lead_s,
            delay_s=linear.delay_s,
            **{name: rng.uniform(*between) for name, between in limits.items()},
        )

    return draw


def _one_of(
    *draws: Callable[[np.random.Generator], NonlinearLoop],
) -> Callable[[np.random.Generator], NonlinearLoop]:
    return lambda rng: draws[rng.integers(len(draws))](rng)


def _mixed(rng: np.random.Generator) -> NonlinearLoop:
    """A loop with two of the nonlinearities."""
    first, second = rng.choice(list(NONLINEAR), 2, replace=False)
    one, other = NONLINEAR[first](rng), NONLINEAR[second](rng)
    field = _FIELDS[second]
    return replace(one, **{field: getattr(other, field)})


_FIELDS = {
    "saturating": "force_max_m_s2",
    "dead-zone": "dead_zone_m_s2",
    "backlash": "backlash_m",
    "friction": "friction_m_s2",
    "rate-limited": "rate_max_m_s3",
    "hardening": "hardening_1_m2",
}
NONLINEAR: dict[str, Callable[[np.random.Generator], NonlinearLoop]] = {
    "saturating": _bent(force_max_m_s2=(0.8, 3.0)),
    "dead-zone": _bent(dead_zone_m_s2=(0.05, 0.3)),
    "backlash": _bent(backlash_m=(0.005, 0.03)),
    "friction": _bent(friction_m_s2=(0.05, 0.3)),
    "rate-limited": _bent(rate_max_m_s3=(8.0, 25.0)),
    "hardening": _bent(hardening_1_m2=(0.5, 3.0)),
}


def misstated(rng: np.random.Generator, settling_time_s: float) -> float:
    """Return what a driver states that is wrong by a factor between 0.1 and 3."""
    return settling_time_s * math.exp(rng.uniform(math.log(0.1), math.log(3.0)))


def gusts(rng: np.random.Generator, output: FloatArray) -> FloatArray:
    """Add positions that wander with a memory of about a second."""
    memory = math.exp(-SAMPLE_TIME_S / rng.uniform(0.5, 2.0))
    blown = lfilter([1.0], [1.0, -memory], rng.standard_normal(len(output) + 500))[500:]
    return np.asarray(output + 0.01 * blown / float(np.std(blown)))


def drops(rng: np.random.Generator, output: FloatArray) -> FloatArray:
    """Lose one sample in ten, and repeat the last one in its place."""
    kept = np.where(rng.random(len(output)) < 0.1, 0, np.arange(len(output)))
    return output[np.maximum.accumulate(kept)]


def sag(rng: np.random.Generator, output: FloatArray) -> FloatArray:
    """Lose gain along the test, as with a battery, by up to 2 %."""
    return output * np.linspace(1.0, 1.0 - rng.uniform(0.0, 0.02), len(output))


def quantised(rng: np.random.Generator, output: FloatArray) -> FloatArray:
    """Round positions to steps of 5 to 20 mm."""
    step_m = rng.uniform(0.005, 0.02)
    return np.asarray(step_m * np.round(output / step_m))


def outliers(rng: np.random.Generator, output: FloatArray) -> FloatArray:
    """Throw one sample in a hundred off by 0.3 m."""
    wrong = rng.random(len(output)) < 0.01
    return output + wrong * 0.3 * rng.standard_normal(len(output))


def swinging(rng: np.random.Generator, output: FloatArray) -> FloatArray:
    """Swing by 10 mm at a frequency of its own, as with a load on a rope."""
    angle = rng.uniform(0.5, 4.0) * SAMPLE_TIME_S * np.arange(len(output))
    return np.asarray(output + 0.01 * np.sin(angle + rng.uniform(0, 2 * math.pi)))


FAMILIES: dict[str, Family] = {
    "second-order": Family(second_order),
    "lightly-damped": Family(lightly_damped),
    "flexible": Family(flexible),
    "twice-flexible": Family(twice_flexible),
    "gain-and-delay": Family(gain_and_delay),
    "mildly-nonlinear": Family(
        _one_of(_bent(dead_zone_m_s2=(0.01, 0.05)), _bent(rate_max_m_s3=(25.0, 50.0)))
    ),
    "strongly-nonlinear": Family(
        _one_of(_bent(dead_zone_m_s2=(0.1, 0.3)), _bent(rate_max_m_s3=(12.0, 25.0)))
    ),
    "low-resonance": Family(low_resonance),
    "low-resonance-10-s": Family(low_resonance, stated=lambda _rng, _time_s: 10.0),
    "narrow-resonance-10-s": Family(narrow_resonance, stated=lambda _rng, _time_s: 10.0),
    "among-products-10-s": Family(among_products, stated=lambda _rng, _time_s: 10.0),
    "misstated": Family(second_order, stated=misstated),
    "misstated-light": Family(lightly_damped, stated=misstated),
    "misstated-flexible": Family(flexible, stated=misstated),
    "slow-in-wide-band": Family(slow, band_rad_s=(0.1, 20.0)),
    "very-slow-in-wide-band": Family(very_slow, band_rad_s=(0.1, 20.0)),
    **{name: Family(draw) for name, draw in NONLINEAR.items()},
    "mixed-nonlinear": Family(_mixed),
    "coarse-samples": Family(quick, band_rad_s=(0.3, 20.0), sample_time_s=0.1),
    "gusts": Family(second_order, spoil=gusts),
    "drops": Family(second_order, spoil=drops),
    "sag": Family(second_order, spoil=sag),
    "near-ties": Family(alike),
    "faint": Family(faint),
    "creeping": Family(creeping),
    "of-any-kind": Family(of_any_kind),
    "quantised": Family(second_order, spoil=quantised),
    "outliers": Family(second_order, spoil=outliers),
    "swinging": Family(second_order, spoil=swinging),
}
