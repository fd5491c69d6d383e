"""Which settings of a simulator make its response agree with a robot's measured one.

The fit minimises Σ |d|²/σ² over the tones, where d leads from the robot's response to the
simulator's on the Riemann sphere, so that |d| is the chordal distance ψ, and σ is the standard
deviation of d in one direction. Positive settings are varied on a logarithmic scale.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from nufleet.orchestrator.study.simulator_match import Difference, Tones, pooled
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance, riemann_sphere
from nufleet.shared.errors import InvalidInputError, RobotError, StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import BoolArray
from nufleet.shared.strict import NonNegative, Strict

ROUNDS_MAX = 12
"""Largest number of times that all settings are improved."""

STEP = 5e-3
"""Change of each setting from which the slope of the response follows, relative to its scale."""

FACTOR_MAX = 5.0
"""Largest factor between a positive setting and its start."""

ZERO_SCALE = 0.01
"""Scale of a setting that starts at zero, such as a delay in s."""

SCALES_MAX = 20.0
"""Largest distance of any other setting from its start, in multiples of its scale."""

PSI_FLOOR = 2e-4
"""Distance that simulation and estimation may be off without noise."""

SHARE_MIN = 1e-2
"""Smallest singular value of the slopes, each scaled to length 1, at which settings are told
apart; slopes from finite differences are a fourth of this off."""

STD_MAX = 0.5
"""Largest standard error, relative to its scale, at which a setting counts as told."""

Simulate = Callable[[Mapping[str, float]], Sequence[FrequencyResponse]]
"""Plays all tests with these settings; raises RobotError or InvalidInputError if it cannot."""


@dataclass(frozen=True)
class Setting:
    """A setting that is varied."""

    start: float
    """Its value in the fleet file."""
    negative: bool = False
    """Whether it may be negative."""

    @property
    def _scale(self) -> float:
        return abs(self.start) or ZERO_SCALE

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest coordinate; the start has the coordinate 0."""
        if self.start > 0:
            return -math.log(FACTOR_MAX), math.log(FACTOR_MAX)
        return (-SCALES_MAX if self.negative else 0.0), SCALES_MAX

    def value(self, x: float) -> float:
        """Return its value at a coordinate."""
        if self.start > 0:
            return self.start * math.exp(x)
        return self.start + self._scale * x

    def slope(self, x: float) -> float:
        """Return the change of its value with the coordinate."""
        return self.value(x) if self.start > 0 else self._scale


class SettingsFit(Strict):
    """The settings at which a simulator agrees best with a robot."""

    settings: dict[str, Difference]
    """Value and standard error of each setting, by name; none where `untold` names some."""
    untold: tuple[str, ...] = ()
    """Settings that the tests do not tell."""
    alike: bool = False
    """Whether each of these has an effect, and only their effects cannot be told apart."""
    at_bound: tuple[str, ...] = ()
    """Settings that are as far from their start as they may be."""
    psi: NonNegative
    """Largest distance over the tones before the fit."""
    psi_left: NonNegative
    """Largest distance over the tones with these settings."""
    simulations: int
    """Number of times that the tests were simulated."""

    def words(self, robot: str, simulator: str) -> str:
        """Return the result in a sentence."""
        if self.untold:
            names = " and ".join(self.untold)
            apart, which = (" apart", "one of them") if self.alike else ("", names)
            return (
                f"the tests do not tell {names} of {simulator}{apart}, so nothing is fitted; leave "
                f"{which} out of --fit"
            )
        listed = ", ".join(
            f"{name} {one.value:.4g} ± {one.std:.1g}" for name, one in self.settings.items()
        )
        said = (
            f"{simulator} agrees best with {robot} at {listed}: ψ {self.psi:.4f} before, "
            f"{self.psi_left:.4f} left after {self.simulations} simulations"
        )
        if self.at_bound:
            said += f"; {' and '.join(self.at_bound)} went as far as the fit may go"
        return said


def fit_settings(
    robot_tests: Sequence[FrequencyResponse],
    simulate: Simulate,
    settings: Mapping[str, Setting],
    on_simulation: Callable[[int, int], None],
) -> SettingsFit:
    """Vary settings of a simulator until it agrees with a robot.

    Args:
        robot_tests: Usable tests of the robot.
        simulate: Plays the tests on the simulator. Its noise has to be the same each time.
        settings: Settings to vary, by name.
        on_simulation: Callback before each simulation, with its number and the largest number.

    Raises:
        StudyError: No tone is known of both, or too few for this number of settings.
        RobotError, InvalidInputError: The simulator cannot play the tests with its own settings.
    """
    from scipy.optimize import least_squares

    names = tuple(settings)
    search = _Search(pooled(robot_tests), simulate, settings, on_simulation)
    search.begin()
    start = np.zeros(len(names))
    psi = search.psi(start)
    untold = _untold(search.slopes(start), names, psi, search)
    if untold is not None:
        return untold
    low, high = np.array([one.bounds for one in settings.values()]).T
    best = least_squares(
        search.residual,
        start,
        jac=search.slopes,
        bounds=(low, high),
        method="dogbox",
        xtol=1e-5,
        ftol=1e-4,
        max_nfev=ROUNDS_MAX,
    )
    x, slopes = np.asarray(best.x), np.asarray(best.jac)
    # A setting that told at first may have lost its effect, as a limit that is no longer reached.
    untold = _untold(slopes, names, psi, search)
    if untold is not None:
        return untold
    # What these settings cannot explain makes them less certain than the noise does.
    excess = max(1.0, 2 * float(best.cost) / (2 * search.tones - len(names)))
    stds = np.sqrt(np.diag(np.linalg.pinv(slopes.T @ slopes)) * excess)
    at_bound = ((x <= low + STEP) & (low < 0)) | (x >= high - STEP)
    found = zip(settings.items(), x.tolist(), stds.tolist(), strict=True)
    return SettingsFit(
        settings={
            name: Difference(value=one.value(at), std=abs(one.slope(at)) * std)
            for (name, one), at, std in found
        },
        at_bound=tuple(name for name, out in zip(names, at_bound, strict=True) if out),
        psi=psi,
        psi_left=search.psi(x),
        simulations=search.simulations,
    )


def _untold(
    slopes: FloatArray, names: Sequence[str], psi: float, search: _Search
) -> SettingsFit | None:
    """Return a fit of nothing that names the settings that the tests do not tell, if there are."""

    def naming(which: BoolArray, *, alike: bool) -> SettingsFit:
        untold = tuple(name for name, one in zip(names, which, strict=True) if one)
        done = search.simulations
        return SettingsFit(
            settings={}, untold=untold, alike=alike, psi=psi, psi_left=psi, simulations=done
        )

    lengths = np.linalg.norm(slopes, axis=0)
    weak = lengths * STD_MAX < 1
    if weak.any():
        return naming(weak, alike=False)
    _, shares, directions = np.linalg.svd(slopes / lengths, full_matrices=False)
    if shares[-1] < SHARE_MIN:
        return naming(np.abs(directions[-1]) > 0.1, alike=True)
    return None


@dataclass
class _Search:
    """Simulations of one fit; each point is simulated once."""

    robot: Tones
    simulate: Simulate
    settings: Mapping[str, Setting]
    on_simulation: Callable[[int, int], None]
    simulations: int = 0
    _known: dict[bytes, ComplexArray | None] = field(default_factory=dict)
    _slopes: dict[bytes, FloatArray] = field(default_factory=dict)

    @property
    def tones(self) -> int:
        return len(self.robot.omega_rad_s)

    def begin(self) -> None:
        """Simulate the start, keep the tones that both played, and weigh them by their noise."""
        x = np.zeros(len(self.settings))
        model = pooled(self._simulated(x))
        omega, ours, theirs = np.intersect1d(
            self.robot.omega_rad_s, model.omega_rad_s, return_indices=True
        )
        if 2 * len(omega) <= len(self.settings):
            raise StudyError(
                f"robot and simulator have {len(omega)} tones in common, and {len(self.settings)} "
                "settings cannot be fitted to these"
            )
        z, variance = self.robot.z[ours], self.robot.variance[ours]
        self.robot = Tones(omega, z, variance)
        modelled = model.z[theirs]
        spread = variance / (1 + np.abs(z) ** 2) ** 2
        spread = spread + model.variance[theirs] / (1 + np.abs(modelled) ** 2) ** 2
        self._deviation = np.sqrt(spread / 2 + PSI_FLOOR**2)
        self._known[x.tobytes()] = modelled

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the distances from the robot, over their deviations, shape (3 tones,)."""
        z = self._response(x)
        off = np.ones((self.tones, 3))
        if z is not None:
            off = riemann_sphere(z) - riemann_sphere(self.robot.z)
        return np.asarray((off / self._deviation[:, None]).ravel())

    def slopes(self, x: FloatArray) -> FloatArray:
        """Return the change of the residual with each coordinate, shape (3 tones, settings)."""
        key = x.tobytes()
        if key not in self._slopes:
            self._slopes[key] = np.stack(
                [self._slope(x, place, one) for place, one in enumerate(self.settings.values())],
                axis=1,
            )
        return self._slopes[key]

    def psi(self, x: FloatArray) -> float:
        """Return the largest distance over the tones."""
        z = self._response(x)
        return 1.0 if z is None else float(chordal_distance(z, self.robot.z).max())

    def _slope(self, x: FloatArray, place: int, setting: Setting) -> FloatArray:
        low, high = setting.bounds
        for step in (STEP, -STEP):
            at = x.copy()
            at[place] += step
            if low <= at[place] <= high and self._response(at) is not None:
                return np.asarray((self.residual(at) - self.residual(x)) / step)
        value = setting.value(float(x[place]))
        name = list(self.settings)[place]
        raise StudyError(f"the simulator cannot play the tests with {name} near {value:g}")

    def _response(self, x: FloatArray) -> ComplexArray | None:
        """Return the simulator's response at the common tones; None if it cannot play them."""
        key = x.tobytes()
        if key not in self._known:
            try:
                model = pooled(self._simulated(x))
            except (RobotError, InvalidInputError):
                self._known[key] = None
            else:
                omega = self.robot.omega_rad_s
                place = {w: k for k, w in enumerate(model.omega_rad_s.tolist())}
                known = all(w in place for w in omega.tolist())
                self._known[key] = model.z[[place[w] for w in omega.tolist()]] if known else None
        return self._known[key]

    def _simulated(self, x: FloatArray) -> Sequence[FrequencyResponse]:
        self.simulations += 1
        most = ROUNDS_MAX * (1 + 2 * len(self.settings))  # both steps, if the first one fails
        self.on_simulation(self.simulations, most)
        pairs = zip(self.settings.items(), x.tolist(), strict=True)
        return self.simulate({name: one.value(at) for (name, one), at in pairs})
