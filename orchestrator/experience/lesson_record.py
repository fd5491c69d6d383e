"""What a robot flew for its experience, and the training pairs in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.layout import InverseLayout


@dataclass(frozen=True, eq=False)
class LearningRecord:
    """References (samples, axes) and the states before each acted, (samples, axes, states)."""

    references: FloatArray
    states: FloatArray
    state_names: tuple[str, ...]


def pooled_pairs(
    layout: InverseLayout, record: LearningRecord, columns: tuple[int, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return the training pairs of several axes of a record, one axis after another.

    Inputs of shape (m, inputs) and γ of shape (m,); `columns` are the axes' places in the record.
    """
    width = len(layout.states)
    pairs = [layout.pairs(record.references[:, i], record.states[:, i, :width]) for i in columns]
    return np.concatenate([x for x, _ in pairs]), np.concatenate([g for _, g in pairs])
