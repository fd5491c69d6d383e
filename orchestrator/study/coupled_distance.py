"""The distance between robots whose axes answer to each other: that of the matrices Z(ω)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge, unit_ratios
from nufleet.orchestrator.study.selection_belief import SelectionBelief
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import matrix_chordal_distance

SAMPLES = 200
"""Largest number of samples of matrices, whose distance takes much longer than that of numbers."""


def matters(robots: Mapping[str, AxesKnowledge]) -> bool:
    """Return whether an axis of any robot answers significantly to another one."""
    return any(robot.couplings for robot in robots.values())


def matrix_draws(
    robot: AxesKnowledge,
    drawn: Mapping[str, ComplexArray],
    omega_rad_s: FloatArray,
    rng: np.random.Generator,
) -> ComplexArray | None:
    """Return samples of a robot's Z(ω) without units; None where an entry was never measured.

    Args:
        robot: Knowledge of the robot.
        drawn: Samples of each axis's own response by axis, shape (samples, grid or more).
        omega_rad_s: Frequencies in rad/s, shape (grid,).
        rng: Generator that draws the other entries.

    Returns:
        Samples, shape (samples, grid, axes, axes).
    """
    names, grid = list(robot.axes), len(omega_rad_s)
    if any(name not in drawn for name in names):
        return None
    count = min(SAMPLES, *(len(z) for z in drawn.values()))
    z = np.empty((count, grid, len(names), len(names)), dtype=np.complex128)
    units = {output: unit_ratios(robot.spec, output, names) for output in names}
    for j, reference in enumerate(names):
        column = robot.draw_column(reference, omega_rad_s, drawn[reference][:count, :grid], rng)
        if column is None:
            return None
        for i, output in enumerate(names):
            z[:, :, i, j] = units[output][j] * column[output]
    return z


def coupled_belief(
    omega_rad_s: FloatArray, target: ComplexArray, sources: Mapping[str, ComplexArray]
) -> SelectionBelief:
    """Compare samples of the target's matrices with those of each source.

    Args:
        omega_rad_s: Frequencies in rad/s, shape (grid,).
        target: Samples of the target's Z(ω), shape (samples, grid, axes, axes).
        sources: Samples of each source, by source, in the same shape.
    """
    psi = np.stack([matrix_chordal_distance(target, z) for z in sources.values()])
    means = np.stack([z.mean(axis=0) for z in sources.values()])
    likeliest = matrix_chordal_distance(np.broadcast_to(target.mean(axis=0), means.shape), means)
    return SelectionBelief(tuple(sources), omega_rad_s, psi, likeliest)
