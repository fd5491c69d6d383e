"""The recording of a flight that a robot learns from, and the training pairs in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.layout import InverseLayout


@dataclass(frozen=True, eq=False)
class LearningRecord:
    """The references and states of a flight that an experience is learned from."""

    references: FloatArray
    """References in the unit of the axes, shape (samples, axes)."""
    states: FloatArray
    """States measured before each reference acted, shape (samples, axes, states)."""
    state_names: tuple[str, ...]
    """Names of the states, in the order of the last dimension of `states`."""


def pooled_pairs(
    layout: InverseLayout, record: LearningRecord, columns: tuple[int, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return the training pairs of several axes of a record, one axis after another.

    Args:
        layout: Layout of the inverse model, which defines its inputs ξ and output γ.
        record: Flight to take the pairs from.
        columns: Columns of the record's axes to use.

    Returns:
        Inputs ξ, shape (m, inputs), and outputs γ in the axes' unit per second, shape (m,).
    """
    width = len(layout.states)
    pairs = [layout.pairs(record.references[:, i], record.states[:, i, :width]) for i in columns]
    return np.concatenate([x for x, _ in pairs]), np.concatenate([g for _, g in pairs])
