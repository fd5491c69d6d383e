"""A robot's model of itself: what its motions show about its loop, and what follows for a path.

Every completed motion adds to it: frequency tests, rich flights and tracked paths. It serves the
guard, which must know what the baseline would do, and it can be inverted along a whole path.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nufleet.robot_agent.flight.state_model import StateEvidence
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.models.error_belief import ErrorBelief, Evidence, believe, like
from nufleet.shared.models.error_response import ErrorBasis
from nufleet.shared.models.path_inverse import inverted
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.shared.strict import Strict
from nufleet.shared.wire.motions import PredictedError

STALE = 2.0
"""Root mean square error of new motions, as a multiple of the expected one, from which on the model
counts as that of another robot: one with another payload, say."""

LOW, HIGH = 0.05, 0.95
"""Quantiles that bound what is predicted."""

_DRAWS = 32
_SEED = 0  # the same knowledge and path give the same guard
_UNEXPLAINED_MAX = 0.15  # share of the reference that friction and other nonlinearities may leave
_NO_ANSWER = 0.5  # share of the reference's power: a motion with less explained says nothing
_NOISE_RATIO = 4.0  # multiple of the noise at rest: a moving robot's sensor is noisier


class AxisRecord(Strict):
    """The evidence about one axis."""

    settled: Evidence | None = None
    """Evidence that agrees with itself."""
    new: Evidence | None = None
    """Evidence of the motions since, which has not been compared with it yet."""
    states: StateEvidence | None = None
    """Observations of its states beside the output."""

    def with_new(self, evidence: Evidence, states: StateEvidence | None = None) -> AxisRecord:
        """Return the record after one more motion."""
        new = evidence if self.new is None else self.new + evidence
        seen = [each for each in (self.states, states) if each is not None]
        together = seen[0] + seen[1] if len(seen) > 1 else next(iter(seen), None)
        return AxisRecord(settled=self.settled, new=new, states=together)


@dataclass(frozen=True, eq=False)
class OwnModel:
    """The beliefs about all axes of a robot, in the order of its spec."""

    axes: tuple[ErrorBelief, ...]
    """Belief about each axis; an axis that was never excited is believed to be like the others."""

    @property
    def noise_variance(self) -> float:
        """Variance of what no linear response explains, summed over the axes, in unit²."""
        return sum(belief.noise_std**2 for belief in self.axes)

    def correction(self, desired: FloatArray) -> FloatArray:
        """Return the correction of the reference that puts the robot on a path as well as is known.

        Args:
            desired: Path, shape (samples, axes), in the axes' units.

        Returns:
            The correction, in the same shape and units.
        """
        columns = [inverted(b, desired[:, i]) for i, b in enumerate(self.axes)]
        return np.asarray(np.stack(columns, axis=1) - desired)

    def squares(self, desired: FloatArray, correction: FloatArray) -> FloatArray:
        """Return what the squared distance to a path may be with a correction, without noise.

        Args:
            desired: Path, shape (samples, axes), in the axes' units.
            correction: Correction of the reference, in the same shape; zero for the baseline.

        Returns:
            Squares in unit² for draws from the belief, shape (draws, samples).
        """
        rng = np.random.default_rng(_SEED)
        total = np.zeros((_DRAWS, len(desired)))
        for i, belief in enumerate(self.axes):
            reference, wanted = desired[:, i] + correction[:, i], desired[:, i]
            draws = belief.draws(_DRAWS, rng)
            done = 0
            for columns in belief.basis.blocks(reference, float(wanted[0])):
                rows = slice(done, done + len(columns))
                left = (columns @ draws).T - correction[rows, i]
                total[:, rows] += left**2
                done += len(columns)
        return total

    def predicted(self, squares: FloatArray) -> PredictedError:
        """Return the root mean square error that is to be measured, given `squares` of a flight."""
        rms = np.sqrt(squares.mean(axis=1) + self.noise_variance)
        low, median, high = np.quantile(rms, [LOW, 0.5, HIGH])
        return PredictedError(rms=float(median), low=float(low), high=float(high))


def basis_of(spec: RobotSpec) -> ErrorBasis:
    """Return the parameters by which a robot's axes are described."""
    return ErrorBasis(spec.sample_time_s, spec.settling_time_s)


def evidence_in(
    spec: RobotSpec, references: FloatArray, outputs: FloatArray
) -> dict[str, Evidence]:
    """Return the evidence of a motion about every axis that it moved.

    Args:
        spec: Description of the robot.
        references: References sent, shape (samples, axes), in the axes' units; the robot rested at
            the first one.
        outputs: Outputs measured before each reference acted, in the same shape.

    Raises:
        InvalidInputError: The record is too short, or holds numbers that cannot be right.
    """
    basis = basis_of(spec)
    return {
        axis.name: Evidence.of(basis, references[:, i], outputs[:, i], float(references[0, i]))
        for i, axis in enumerate(spec.axes)
        if len(references) and np.ptp(references[:, i]) > 0
    }


def check_explained(evidence: Evidence, spec: RobotSpec, axis: AxisSpec, noise_std: float) -> None:
    """Refuse a motion that shows no answer to its reference, apart from noise.

    A guard would mistake what is unexplained for the baseline's own error. It is large for a sensor
    that was late by more than the settling time, lost its place during the motion, or measured
    something else.

    Args:
        evidence: Evidence of the motion.
        spec: Description of the robot.
        axis: Axis that moved.
        noise_std: Standard deviation of the output at rest, in the axis's unit.

    Raises:
        InvalidInputError: Too much is left unexplained.
    """
    moved = float(np.sqrt(evidence.moved / evidence.rows))
    left = believe(basis_of(spec), evidence).noise_std
    if left > max(_UNEXPLAINED_MAX * moved, _NOISE_RATIO * noise_std):
        raise InvalidInputError(
            f"axis {axis.name} moved by {left:.3g} {axis.unit} RMS that its reference of "
            f"{moved:.3g} {axis.unit} RMS within the settling time does not explain: check its "
            "sensor, or state a longer settling time"
        )


@dataclass(frozen=True, eq=False)
class Settled:
    """What a robot's records come to."""

    records: Mapping[str, AxisRecord]
    """Record of each axis, by its name, with nothing new in it any more."""
    model: OwnModel | None
    """The robot's model of itself; None if nothing is known of any axis."""
    findings: tuple[str, ...]
    """What was left out, and why."""


def settle(records: Mapping[str, AxisRecord], spec: RobotSpec) -> Settled:
    """Compare what is new with what was known, and return the model that follows.

    New evidence that contradicts the old replaces it: the robot has changed.

    Args:
        records: Evidence about each axis, by its name.
        spec: Description of the robot; evidence of an axis that it does not have, or on another
            basis, is left out.
    """
    basis, findings = basis_of(spec), list[str]()
    kept: dict[str, AxisRecord] = {}
    beliefs: dict[str, ErrorBelief] = {}
    for axis in spec.axes:
        record = records.get(axis.name, AxisRecord())
        old, new = (_fitting(evidence, basis) for evidence in (record.settled, record.new))
        if new is not None and not _answers(believe(basis, new), new):
            findings.append(
                f"axis {axis.name}: the references of its last motions do not explain what it did, "
                "so these motions are left out: check its sensor"
            )
            new = None
        if old is not None and new is not None:
            surprise = believe(basis, old).surprise(new)
            if surprise > STALE:
                findings.append(
                    f"axis {axis.name}: its last motions differ from the earlier ones by "
                    f"{surprise:.1f} times what was expected, so what {old.flown_s:.0f} s of "
                    "flight had shown of it is no longer used: it carries something else, or its "
                    "controller has changed"
                )
                old = None
        both = old + new if old is not None and new is not None else old or new
        if both is not None:
            kept[axis.name] = AxisRecord(settled=both, states=record.states)
            beliefs[axis.name] = believe(basis, both)
    if not beliefs:
        return Settled(kept, None, tuple(findings))
    model = OwnModel(tuple(beliefs.get(a.name) or _alike(a, spec, beliefs) for a in spec.axes))
    return Settled(kept, model, tuple(findings))


def _answers(belief: ErrorBelief, evidence: Evidence) -> bool:
    return belief.noise_std**2 <= _NO_ANSWER * evidence.moved / evidence.rows


def _fitting(evidence: Evidence | None, basis: ErrorBasis) -> Evidence | None:
    return evidence if evidence is not None and len(evidence.right) == basis.size else None


def _alike(axis: AxisSpec, spec: RobotSpec, beliefs: Mapping[str, ErrorBelief]) -> ErrorBelief:
    # An error response has no unit, but its noise does.
    known = [a for a in spec.axes if a.name in beliefs]
    same = [a for a in known if a.unit == axis.unit]
    return like([beliefs[a.name] for a in same or known])
