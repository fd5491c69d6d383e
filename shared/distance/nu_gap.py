"""Vinnicombe's ν-gap between two linear models, exact rather than sampled.

G. Vinnicombe, "Frequency domain uncertainty and the graph topology", IEEE Transactions on Automatic
Control 38 (1993) 1371–1383; "Uncertainty and Feedback", Imperial College Press 2001.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from nufleet.shared.arrays import ComplexArray
from nufleet.shared.distance.frequency_peak import Peak, find_peak
from nufleet.shared.distance.graph_angles import model_distance
from nufleet.shared.distance.level_crossings import level_crossings, mixed_zeros
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.models.half_plane import HalfPlane, Image, common_half_plane
from nufleet.shared.models.transfer_models import ModelError, StateSpace, require_same_shape

ACCURACY = 1e-9
"""Largest amount by which the supremum may exceed the value returned, apart from rounding."""

ComputedFrom = Literal["polynomials", "matrices"]


@dataclass(frozen=True)
class NuGap:
    """The ν-gap of two models, and the quantities that it follows from."""

    value: float
    """δ_ν in [0, 1]: the chordal peak if the winding condition holds, otherwise 1."""
    chordal_peak: float
    """sup ψ over all frequencies."""
    omega_peak_rad_s: float
    """Frequency that attains the peak; inf for the limit ω → ∞."""
    winding_ok: bool
    """True if the winding condition holds."""
    winding_number: int | None
    """wno det(I + P₂*P₁), clockwise, on the imaginary axis indented around the poles of P₁ and P₂;
    None if the determinant vanishes somewhere on it."""
    poles_unstable: tuple[int, int]
    """Numbers of unstable poles, η(P₁) and η(P₂)."""
    poles_on_axis: tuple[int, int]
    """Numbers of poles on the axis, η₀(P₁) and η₀(P₂)."""
    reason: str
    """Explanation in words, for people."""
    computed_from: ComputedFrom
    """Representation of the models that the ν-gap was computed from."""

    @property
    def guarantee(self) -> str:
        """The guarantee that δ_ν gives for every controller, in words."""
        if self.value >= 1.0:
            return "none: no stability margin is larger than 1"
        return (
            "every controller that stabilises the first model with a margin above"
            f" {math.ceil(self.value * 1e4) / 1e4:.4f} also stabilises the second"
        )


def nu_gap(first: StateSpace, second: StateSpace) -> NuGap:
    """Return the ν-gap between two models of the same signals, to 1e-9 apart from rounding.

    δ_ν = sup ψ(ω) if det(I + P₂*P₁)(jω) ≠ 0 for all ω and
    wno det(I + P₂*P₁) + η(P₁) − η(P₂) − η₀(P₂) = 0, and 1 otherwise (Vinnicombe 1993; in
    the first case it is the paper's eq. (3)). Models may be unstable, have poles on the
    axis, and have any number of inputs and outputs.

    Args:
        first: Model P₁.
        second: Model P₂ with the same inputs, outputs and sample time.

    Raises:
        ModelError: signals or sample times differ, or a model has a hidden unstable mode.
        PeakSearchError: the models are too badly scaled for the search.

    Examples:
        Twice the gain is a small step, an unstable pole is the largest possible one:

        >>> from nufleet.shared.models.realization import transfer_function
        >>> slow = transfer_function([1.0], [1.0, 1.0])
        >>> gap = nu_gap(slow, transfer_function([2.0], [1.0, 1.0]))
        >>> round(gap.value, 4), gap.winding_ok
        (0.3333, True)
        >>> nu_gap(slow, transfer_function([1.0], [1.0, -1.0])).value
        1.0
    """
    require_same_shape(first, second)
    for position, model in (("first", first), ("second", second)):
        mode = model.hidden_unstable_mode()
        if mode is not None:
            raise ModelError(
                f"the {position} model has a hidden unstable mode at {mode:.6g}: its inputs do not"
                " reach it or its outputs do not show it, so no controller can stabilise it;"
                " cancel it if it is not real"
            )
    plane = common_half_plane(first, second)
    images = plane.image(first), plane.image(second)
    at_infinity = 1.0 - _distance_at_infinity(first, second, plane) > ACCURACY
    zeros = mixed_zeros(*images) if at_infinity else np.empty(0, complex)
    peak = _chordal_peak(first, second, plane, images, zeros, (0.0, plane.omega_max_rad_s))
    excess = int(np.count_nonzero(zeros.real > 0)) - second.states
    return verdict(
        peak,
        excess,
        (first.poles_unstable, second.poles_unstable),
        (first.poles_on_axis, second.poles_on_axis),
        "matrices",
    )


def verdict(
    peak: Peak,
    excess: int,
    poles_unstable: tuple[int, int],
    poles_on_axis: tuple[int, int],
    computed_from: ComputedFrom,
) -> NuGap:
    """Return the ν-gap that follows from sup ψ and from the sum in the winding condition.

    Args:
        peak: sup ψ and the frequency that attains it.
        excess: Sum wno det(I + P₂*P₁) + η(P₁) − η(P₂) − η₀(P₂); meaningless if sup ψ is 1.
        poles_unstable: Numbers of unstable poles, η(P₁) and η(P₂).
        poles_on_axis: Numbers of poles on the axis, η₀(P₁) and η₀(P₂).
        computed_from: Representation of the models that these numbers were computed from.
    """
    orthogonal = peak.value >= 1.0 - ACCURACY
    ok = excess == 0 and not orthogonal
    beyond, before, on_axis = poles_unstable[0], poles_unstable[1], poles_on_axis[1]
    number = excess - beyond + before + on_axis
    if orthogonal:
        reason = f"det(I + P2*P1) = 0 at ω = {peak.omega_rad_s:.6g} rad/s"
    else:
        terms = f"wno {number} + η(P1) {beyond} − η(P2) {before} − η0(P2) {on_axis} = {excess}"
        reason = f"the winding condition {'holds' if ok else 'fails'}: {terms}"
    return NuGap(
        value=peak.value if ok else 1.0,
        chordal_peak=peak.value,
        omega_peak_rad_s=peak.omega_rad_s,
        winding_ok=ok,
        winding_number=None if orthogonal else number,
        poles_unstable=poles_unstable,
        poles_on_axis=poles_on_axis,
        reason=reason,
        computed_from=computed_from,
    )


def chordal_peak_in_band(
    first: StateSpace, second: StateSpace, band_rad_s: tuple[float, float]
) -> Peak:
    """Return max ψ over a band, the paper's eq. (6): a lower bound of the ν-gap, without winding.

    Args:
        first: A model.
        second: A model with the same inputs, outputs and sample time.
        band_rad_s: Lowest and highest frequency; in discrete time at most the Nyquist frequency.

    Raises:
        ModelError: signals or sample times differ.
        InvalidInputError: the band is empty or exceeds the Nyquist frequency.
        PeakSearchError: the models are too badly scaled for the search.
    """
    require_same_shape(first, second)
    plane = common_half_plane(first, second)
    low, high = band_rad_s
    if not 0 <= low < high < math.inf:
        raise InvalidInputError(
            f"a band needs 0 ≤ low < high < ∞ in rad/s, got {low:g} and {high:g}"
        )
    if high > plane.omega_max_rad_s * (1 + 1e-12):
        raise InvalidInputError(
            f"the band ends at {high:g} rad/s, above the Nyquist frequency"
            f" {plane.omega_max_rad_s:g} rad/s of the models"
        )
    images = plane.image(first), plane.image(second)
    return _chordal_peak(first, second, plane, images, np.empty(0, complex), (low, high))


def _chordal_peak(
    first: StateSpace,
    second: StateSpace,
    plane: HalfPlane,
    images: tuple[Image, Image],
    zeros: ComplexArray,
    band_rad_s: tuple[float, float],
) -> Peak:
    poles = np.concatenate([np.linalg.eigvals(image.a) for image in images])
    marks = np.concatenate([poles, zeros])
    return find_peak(
        lambda omega: model_distance(first, second, omega),
        lambda level: plane.omega_rad_s(level_crossings(*images, level)),
        lambda value: value + ACCURACY,
        plane.omega_rad_s(np.concatenate([marks, 1j * np.abs(marks)])),
        band_rad_s,
    )


def _distance_at_infinity(first: StateSpace, second: StateSpace, plane: HalfPlane) -> float:
    omega = math.inf if plane.dt_s == 0 else plane.angle_at_infinity / plane.dt_s
    return float(model_distance(first, second, np.array([omega]))[0])
