"""What the axes of a robot do to each other, as motions of several axes at once show it.

The motion of one axis adds to the error of another what its own response leaves unexplained there.
It is believed of as the response of an error is, but it begins at 0, since no output has answered
anything before a reference acts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.error_belief import ErrorBelief, believe_across, fitted, fitted_across
from nufleet.shared.models.error_response import ErrorBasis
from nufleet.shared.models.evidence import Evidence
from nufleet.shared.models.unexplained import correlation_samples

MATTERS = 0.02
"""Share of the motion of one axis that another one makes of it, below which it is left out."""

_SURE = 3.0  # standard deviations of what noise explains of itself by chance
_ROUNDS = 2  # an axis's own response and the answers to others are fitted in turn

Crosses = Mapping[str, Evidence]
"""Evidence of what other axes do to one, by their names."""


@dataclass(frozen=True, eq=False)
class Cross:
    """What one axis of a robot adds to the error of another."""

    output: int
    """Place of the axis that answers."""
    reference: int
    """Place of the axis that moves."""
    belief: ErrorBelief
    """Belief about the response of the error, in units of the one axis over those of the other."""

    def error(self, references: FloatArray) -> FloatArray:
        """Return the likeliest error along references, shape (samples,).

        Args:
            references: References, shape (samples, axes), in the axes' units; the robot rested at
                the first one.
        """
        moving = references[:, self.reference]
        return self.belief.error(moving, float(moving[0]))

    def drawn(
        self,
        references: FloatArray,
        desired: FloatArray,
        count: int,
        rng: np.random.Generator,
    ) -> FloatArray:
        """Draw errors along references, shape (count, samples).

        Args:
            references: References, shape (samples, axes), in the axes' units.
            desired: Path that they are for, in the same shape, where the robot rested at first.
            count: Number of draws.
            rng: Generator of the draws.
        """
        moving, wanted = references[:, self.reference], desired[:, self.reference]
        draws = self.belief.draws(count, rng, float(np.std(wanted)))
        blocks = self.belief.basis.blocks(moving, float(wanted[0]))
        return np.concatenate([(columns @ draws).T for columns in blocks], axis=1)


def crosses_in(
    basis: ErrorBasis, names: Sequence[str], references: FloatArray, outputs: FloatArray
) -> tuple[Mapping[str, Crosses], FloatArray]:
    """Return what a motion shows of what each axis that it moved does to the others.

    Args:
        basis: Parameters of the responses.
        names: Names of the axes.
        references: References sent, shape (samples, axes), in the axes' units; the robot rested at
            the first one, and the axes move independently of each other.
        outputs: Outputs measured before each reference acted, in the same shape.

    Returns:
        The evidence, by the axis that answers, and the outputs as they would be if axes did nothing
        to each other, as far as the motion tells the difference.

    Raises:
        InvalidInputError: The record is too short, or holds numbers that cannot be right.
    """
    moved = [i for i in range(len(names)) if len(references) and np.ptp(references[:, i]) > 0]
    if len(moved) < 2:
        return {}, outputs
    found: dict[str, dict[str, Evidence]] = {names[i]: {} for i in moved}
    alone = outputs.copy()
    for i in moved:
        reference, error = references[:, i], references[:, i] - outputs[:, i]
        across = dict.fromkeys([j for j in moved if j != i], np.zeros(len(error)))
        for _ in range(_ROUNDS):
            seen = reference - error + sum(across.values())
            own = fitted(basis, Evidence.of(basis, reference, seen, float(reference[0])))
            left = error - own.error(reference, float(reference[0]))
            for j in across:
                others = sum(each for k, each in across.items() if k != j)
                moving, before = references[:, j], float(references[0, j])
                evidence = Evidence.of(basis, moving, moving - (left - others), before)
                belief = fitted_across(basis, evidence)
                answer = belief.error(moving, before)
                beyond = left - others - answer
                lasting = correlation_samples(beyond - beyond.mean())
                found[names[i]][names[j]] = evidence.thinned(lasting)
                across[j] = answer if _matters(evidence, belief) else np.zeros(len(error))
        alone[:, i] += sum(across.values())
    return found, alone


def _matters(evidence: Evidence, belief: ErrorBelief) -> bool:
    """Return whether an answer exceeds what noise explains by chance, and is large enough."""
    size = len(evidence.right)
    chance = (size + _SURE * np.sqrt(2 * size)) * belief.noise_std**2
    normal = np.array(evidence.normal).reshape(size, size)
    square = float(belief.mean @ normal @ belief.mean)
    return bool(square > max(MATTERS**2 * evidence.moved, chance))


def added(before: Crosses, new: Crosses) -> dict[str, Evidence]:
    """Return the evidence of both, by the names of the axes that move."""
    return {
        axis: before[axis] + new[axis] if axis in before and axis in new else one
        for axis, one in {**before, **new}.items()
    }


def crosses_of(
    basis: ErrorBasis, names: Sequence[str], evidence: Mapping[str, Crosses]
) -> tuple[Cross, ...]:
    """Return what axes do to each other where it exceeds the noise and matters.

    Args:
        basis: Parameters of the responses.
        names: Names of the axes.
        evidence: Evidence of what other axes do to one, by the name of that one.
    """
    found = []
    for i, output in enumerate(names):
        for j, reference in enumerate(names):
            one = evidence.get(output, {}).get(reference)
            if one is None or len(one.right) != basis.size:
                continue
            belief = believe_across(basis, one)
            if _matters(one, belief):
                found.append(Cross(i, j, belief))
    return tuple(found)
