"""The stability margin of a loop, and the guarantee that a small ν-gap gives about it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.frequency_peak import find_peak
from nufleet.shared.distance.graph_angles import sines
from nufleet.shared.models.half_plane import Image, common_half_plane
from nufleet.shared.models.transfer_models import ModelError, StateSpace, require_same_time


@dataclass(frozen=True)
class StabilityMargin:
    """The generalised stability margin of a loop."""

    value: float
    """b_{P,C} in [0, 1]; 0 if the loop is unstable."""
    omega_worst_rad_s: float
    """Frequency at which the loop tolerates least; NaN if the loop is unstable."""


@dataclass(frozen=True)
class StabilityGuarantee:
    """The guarantee about C with P₂ that follows from δ_ν(P₁, P₂) and b_{P₁,C}."""

    holds: bool
    """True if C is guaranteed to stabilise P₂; otherwise nothing is known."""
    margin_at_least: float
    """Lower bound on b_{P₂,C}: sin(arcsin b − arcsin δ_ν), which is at least b − δ_ν; 0 without a
    guarantee."""


def stability_margin(plant: StateSpace, controller: StateSpace) -> StabilityMargin:
    """Return b_{P,C} of the loop u = −C y, to a relative accuracy of 1e-9 apart from rounding.

    b_{P,C} = 1/‖[P; I](I + CP)⁻¹[C, I]‖∞ if C stabilises P internally, and 0 otherwise. It is the
    sine of the smallest angle between the graphs of P and of the controller (Vinnicombe 2001, with
    the sign of his C reversed). A loop that is not well posed counts as unstable.

    Args:
        plant: Model P.
        controller: Model C, whose inputs are the outputs of P and vice versa.

    Raises:
        ModelError: the controller's signals or sample time do not fit the plant.
        PeakSearchError: the models are too badly scaled for the search.
    """
    require_same_time(plant, controller)
    if (controller.inputs, controller.outputs) != (plant.outputs, plant.inputs):
        raise ModelError(
            f"the controller has {controller.outputs} outputs and {controller.inputs} inputs;"
            f" to close the loop it needs {plant.inputs} and {plant.outputs}"
        )
    plane = common_half_plane(plant, controller)
    try:
        loop = _closed_loop(plane.image(plant), plane.image(controller))
    except np.linalg.LinAlgError:
        return StabilityMargin(0.0, math.nan)
    poles = np.linalg.eigvals(loop.a)
    if (poles.real >= 0).any():
        return StabilityMargin(0.0, math.nan)

    def amplification(omega_rad_s: FloatArray) -> FloatArray:
        graph = controller.graph(omega_rad_s)
        measured, commanded = graph[:, : plant.outputs], graph[:, plant.outputs :]
        inverse_graph = np.concatenate([-commanded, measured], axis=1)
        return np.asarray(1.0 / sines(plant.graph(omega_rad_s), inverse_graph)[:, -1])

    peak = find_peak(
        amplification,
        lambda level: plane.omega_rad_s(_gain_crossings(loop, level)),
        lambda value: value * (1 + 1e-9),
        plane.omega_rad_s(np.concatenate([poles, 1j * np.abs(poles)])),
        (0.0, plane.omega_max_rad_s),
    )
    return StabilityMargin(1.0 / peak.value, peak.omega_rad_s)


def stability_guarantee(margin: float, nu_gap: float) -> StabilityGuarantee:
    """Return the guarantee for P₂ with C that follows from a margin and a ν-gap (Vinnicombe 2001).

    Args:
        margin: Stability margin b_{P₁,C} in [0, 1].
        nu_gap: The ν-gap δ_ν(P₁, P₂) in [0, 1].
    """
    if nu_gap >= margin:
        return StabilityGuarantee(holds=False, margin_at_least=0.0)
    return StabilityGuarantee(
        holds=True, margin_at_least=math.sin(math.asin(margin) - math.asin(nu_gap))
    )


def _closed_loop(plant: Image, controller: Image) -> Image:
    """Return the closed loop from (w₁, w₂) to (y, u), where u = w₂ + C(w₁ − y) and y = P u.

    Raises LinAlgError if the loop is not well posed.
    """
    outputs, inputs = plant.d.shape
    states, memory = len(plant.a), len(controller.a)
    kind = np.result_type(plant.a, controller.a)
    c_states = np.zeros((inputs, states + memory), kind)
    c_states[:, :states] = -controller.d @ plant.c
    c_states[:, states:] = controller.c
    solved = np.linalg.solve(
        np.eye(inputs) + controller.d @ plant.d,
        np.hstack([c_states, controller.d, np.eye(inputs)]),
    )
    u_x, u_w = solved[:, : states + memory], solved[:, states + memory :]
    y_x, y_w = plant.d @ u_x, plant.d @ u_w
    y_x[:, :states] += plant.c
    e_w = -y_w
    e_w[:, :outputs] += np.eye(outputs)
    a = np.vstack([plant.b @ u_x, -controller.b @ y_x])
    a[:states, :states] += plant.a
    a[states:, states:] += controller.a
    b = np.vstack([plant.b @ u_w, controller.b @ e_w])
    return Image(a, b, np.vstack([y_x, u_x]), np.vstack([y_w, u_w]))


def _gain_crossings(loop: Image, level: float) -> ComplexArray:
    """Return points that include every jω at which a singular value of the loop equals the level.

    They are the eigenvalues of the Hamiltonian matrix of the bounded real lemma.
    """
    a, b, c, d = loop.a, loop.b, loop.c, loop.d
    dh = d.conj().T
    weight = level**2 * np.eye(d.shape[1]) - dh @ d
    solved = np.linalg.solve(weight, np.hstack([dh @ c, b.conj().T]))
    drift, spread = np.hsplit(solved, [len(a)])
    inner = a + b @ drift
    outer = c.conj().T @ (c + d @ drift)
    matrix = np.block([[inner, b @ spread], [-outer, -inner.conj().T]])
    return np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
