"""A robot's model of itself: what its motions show about its loop, and what follows for a path.

Every completed motion adds to it: frequency tests, rich flights and tracked paths. It serves the
guard, which must know what the baseline would do, and it can be inverted along a whole path.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nufleet.robot_agent.flight.cross_axes import Cross, Crosses, added, crosses_of
from nufleet.robot_agent.flight.state_model import StateEvidence
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.models.error_belief import MODEL_ERROR, ErrorBelief, believe, fitted, like
from nufleet.shared.models.error_response import ErrorBasis
from nufleet.shared.models.evidence import Evidence
from nufleet.shared.models.path_inverse import inverted
from nufleet.shared.models.unexplained import LAGS_MAX, Unexplained, correlation_samples
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.shared.strict import Name, Strict
from nufleet.shared.wire.motions import PredictedError

STALE = 2.0
"""Root mean square error of new motions, as a multiple of the expected one, from which on the model
counts as that of another robot: one with another payload, say."""

LOW, HIGH = 0.05, 0.95
"""Quantiles that bound what is predicted."""

DRAWS = 32
"""Number of robots that are drawn from what is known, to see what they would do."""

_SEED = 0  # the same knowledge and path give the same guard
_UNEXPLAINED_MAX = 0.15  # share of the reference that friction and other nonlinearities may leave
_AGREES = 1.5  # root mean square error of a path, as a multiple of the expected one
_PATHS_DIFFER = 1.5  # ratio of the shares that are not linear on different paths
_UNSEEN = 0.1  # share of an error that may not be linear where only tests of one axis were flown
_TINY = 1e-300
_NO_ANSWER = 0.5  # share of the reference's power: a motion with less explained says nothing
_NOISE_RATIO = 4.0  # multiple of the noise at rest: a moving robot's sensor is noisier


class AxisRecord(Strict):
    """The evidence about one axis."""

    settled: Evidence | None = None
    """Evidence that agrees with itself."""
    new: Evidence | None = None
    """Evidence of the motions since, which has not been compared with it yet."""
    unexplained: Unexplained | None = None
    """What the flights along paths, and the rich flights, left unexplained."""
    states: StateEvidence | None = None
    """Observations of its states beside the output."""
    crosses: dict[Name, Evidence] = {}  # noqa: RUF012 (pydantic copies it)
    """What other axes do to it, by their names, from the motions of `settled`."""
    new_crosses: dict[Name, Evidence] = {}  # noqa: RUF012
    """The same from those of `new`."""

    def with_new(
        self,
        evidence: Evidence,
        states: StateEvidence | None = None,
        crosses: Crosses | None = None,
    ) -> AxisRecord:
        """Return the record after one more motion."""
        new = evidence if self.new is None else self.new + evidence
        seen = [each for each in (self.states, states) if each is not None]
        together = seen[0] + seen[1] if len(seen) > 1 else next(iter(seen), None)
        across = added(self.new_crosses, crosses or {})
        return self.model_copy(update={"new": new, "states": together, "new_crosses": across})

    def with_unexplained(self, unexplained: Unexplained) -> AxisRecord:
        """Return the record after a flight whose evidence is settled."""
        before = self.unexplained
        if before is not None and len(before.products) == len(unexplained.products):
            unexplained = before + unexplained
        return self.model_copy(update={"unexplained": unexplained})


@dataclass(frozen=True, eq=False)
class OwnModel:
    """The beliefs about all axes of a robot, in the order of its spec."""

    axes: tuple[ErrorBelief, ...]
    """Belief about each axis; an axis that was never excited is believed to be like the others."""
    unexplained: tuple[Unexplained | None, ...]
    """What flights left unexplained on each axis; None before any."""
    acceleration_max: float
    """Largest acceleration of a path, in unit/s²; infinite for a robot that flies none."""
    unit: str
    """Unit of the axes, "m" or "rad"."""
    crosses: tuple[Cross, ...] = ()
    """What axes do to each other, where it matters."""

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

    def left(self, desired: FloatArray, correction: FloatArray) -> FloatArray:
        """Return where a robot may be beside a path with a correction, without noise.

        Args:
            desired: Path, shape (samples, axes), in the axes' units.
            correction: Correction of the reference, in the same shape; zero for the baseline.

        Returns:
            Distances y − y_d for draws from the belief, shape (draws, samples, axes).
        """
        rng, alone = np.random.default_rng(_SEED), len(self.axes) == 1
        found = np.empty((DRAWS, *desired.shape))
        for i, (belief, seen) in enumerate(zip(self.axes, self.unexplained, strict=True)):
            reference, wanted = desired[:, i] + correction[:, i], desired[:, i]
            size, flown = float(np.std(wanted)), seen is not None
            draws = belief.draws(DRAWS, rng, size, flown=flown, alone=alone)
            done = 0
            for columns in belief.basis.blocks(reference, float(wanted[0])):
                rows = slice(done, done + len(columns))
                found[:, rows, i] = correction[rows, i] - (columns @ draws).T
                done += len(columns)
        for cross in self.crosses:
            found[:, :, cross.output] -= cross.drawn(desired + correction, desired, DRAWS, rng)
        return found

    def if_right(self) -> OwnModel:
        """Return the model as if its likeliest responses were known to be right."""
        crosses = tuple(replace(one, belief=one.belief.if_right()) for one in self.crosses)
        axes = tuple(axis.if_right() for axis in self.axes)
        return replace(self, axes=axes, crosses=crosses)

    def across(self, references: FloatArray) -> FloatArray:
        """Return the errors that axes are believed to leave on each other, without noise.

        Args:
            references: References, shape (samples, axes), in the axes' units.

        Returns:
            What they add to references − outputs, in the same shape and units.
        """
        found = np.zeros_like(references)
        for cross in self.crosses:
            found[:, cross.output] += cross.error(references)
        return found

    def disturbed(self, samples: int, rng: np.random.Generator) -> FloatArray:
        """Draw what no linear response explains of a measured output, shape (samples, axes)."""
        columns = [
            belief.noise_std * rng.standard_normal(samples)
            if seen is None
            else seen.drawn(samples, rng)
            for belief, seen in zip(self.axes, self.unexplained, strict=True)
        ]
        return np.stack(columns, axis=1)

    def predicted(self, squares: FloatArray) -> PredictedError:
        """Return the root mean square error that is to be measured.

        Args:
            squares: Squared distance to the path without noise, shape (draws, samples), in unit².
        """
        return predicted_error(squares.mean(axis=1) + self.noise_variance)


def predicted_error(squares: FloatArray) -> PredictedError:
    """Return what mean squared errors, shape (draws,), say of the error that is to be measured."""
    low, median, high = np.quantile(np.sqrt(squares), [LOW, 0.5, HIGH])
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
        axis.name: _evidence(basis, references[:, i], outputs[:, i])
        for i, axis in enumerate(spec.axes)
        if len(references) and np.ptp(references[:, i]) > 0
    }


def _evidence(basis: ErrorBasis, reference: FloatArray, output: FloatArray) -> Evidence:
    """Return the evidence of one axis, which counts for less where gusts or friction last."""
    before = float(reference[0])
    evidence = Evidence.of(basis, reference, output, before)
    left = fitted(basis, evidence).error(reference, before) - (reference - output)
    return evidence.thinned(correlation_samples(left - left.mean()))


def telling(
    model: OwnModel, spec: RobotSpec, evidence: Mapping[str, Evidence]
) -> dict[str, Evidence]:
    """Return the part of a path's evidence, by the axes' names, that a linear response may learn.

    Along a path all axes move together, so what one does to another looks like an answer to its own
    reference, and would be expected of every other path. Evidence that contradicts the model is
    therefore left to the feedback, unless it does so by more than anything but another robot would.

    Args:
        model: The robot's model of itself before the flight.
        spec: Description of the robot.
        evidence: Evidence of the flight.
    """
    found = {}
    for axis, belief, seen in zip(spec.axes, model.axes, model.unexplained, strict=True):
        new = evidence.get(axis.name)
        if new is None:
            continue
        agrees = belief.flown_s == 0 or belief.surprise(new) <= _AGREES
        if agrees or _surprise(belief, new, seen) > STALE:
            found[axis.name] = new
    return found


def unexplained_in(
    model: OwnModel,
    spec: RobotSpec,
    references: FloatArray,
    outputs: FloatArray,
    rest_std: FloatArray,
) -> dict[str, Unexplained]:
    """Return what a flight of all axes leaves unexplained on each.

    Args:
        model: The robot's model of itself, which knows of the flight already.
        spec: Description of the robot.
        references: References sent, shape (samples, axes), in the axes' units; the robot rested at
            the first one.
        outputs: Outputs measured before each reference acted, in the same shape.
        rest_std: Standard deviation of the output at rest, shape (axes,), in the axes' units.
    """
    errors = references - outputs
    errors = errors - errors.mean(axis=0)
    square = float(np.mean(np.sum(errors**2, axis=1)))
    across, found = model.across(references), {}
    for i, (axis, belief) in enumerate(zip(spec.axes, model.axes, strict=True)):
        reference = references[:, i]
        left = belief.error(reference, float(reference[0])) + across[:, i] - errors[:, i]
        lags = min(max(3, int(belief.basis.nodes[-1])), LAGS_MAX)
        found[axis.name] = Unexplained.of(left, lags, square, float(rest_std[i]))
    return found


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
        unexplained = record.unexplained
        old, new = (_fitting(evidence, basis) for evidence in (record.settled, record.new))
        if new is not None and not _answers(believe(basis, new), new):
            findings.append(
                f"axis {axis.name}: the references of its last motions do not explain what it did, "
                "so these motions are left out: check its sensor"
            )
            new = None
        if old is not None and new is not None:
            surprise = _surprise(believe(basis, old), new, unexplained)
            if surprise > STALE:
                findings.append(
                    f"axis {axis.name}: its last motions differ from the earlier ones by "
                    f"{surprise:.1f} times what was expected, so what {old.flown_s:.0f} s of "
                    "flight had shown of it is no longer used: it carries something else, or its "
                    "controller has changed"
                )
                old = unexplained = None
        both = old + new if old is not None and new is not None else old or new
        if both is not None:
            seen = added(
                record.crosses if old is not None else {},
                record.new_crosses if new is not None else {},
            )
            kept[axis.name] = AxisRecord(
                settled=both, unexplained=unexplained, states=record.states, crosses=seen
            )
            beliefs[axis.name] = believe(basis, both)
    if not beliefs:
        return Settled(kept, None, tuple(findings))
    axes = tuple(beliefs.get(a.name) or _alike(a, spec, beliefs) for a in spec.axes)
    every = {name: record.crosses for name, record in kept.items()}
    crosses = crosses_of(basis, [axis.name for axis in spec.axes], every)
    return Settled(kept, _model(axes, crosses, kept, spec), tuple(findings))


def _model(
    axes: tuple[ErrorBelief, ...],
    crosses: tuple[Cross, ...],
    records: Mapping[str, AxisRecord],
    spec: RobotSpec,
) -> OwnModel:
    left = tuple(records.get(axis.name, AxisRecord()).unexplained for axis in spec.axes)
    acceleration_max = spec.tracking.acceleration_max if spec.tracking else np.inf
    return OwnModel(axes, left, acceleration_max, spec.axes[0].unit, crosses)


def with_unexplained(
    settled: Settled, unexplained: Mapping[str, Unexplained], spec: RobotSpec
) -> Settled:
    """Return what records come to after a flight that they know already.

    Args:
        settled: What the records come to.
        unexplained: What the flight left unexplained on each axis, by its name.
        spec: Description of the robot.
    """
    records = dict(settled.records)
    for axis, left in unexplained.items():
        if axis in records:
            records[axis] = records[axis].with_unexplained(left)
    model = settled.model
    known = None if model is None else _model(model.axes, model.crosses, records, spec)
    return Settled(records, known, settled.findings)


def _not_linear(unexplained: Unexplained | None) -> float:
    """Return the share of an error that is not linear, as far as flights have shown it."""
    if unexplained is None:
        return _UNSEEN
    lasting = float(unexplained.parts()[0][0])
    share = float(np.sqrt(lasting / max(unexplained.error_square, _TINY)))
    return max(MODEL_ERROR, _PATHS_DIFFER * share)


def _surprise(belief: ErrorBelief, new: Evidence, unexplained: Unexplained | None) -> float:
    """Return how much new motions contradict a belief: what no linear loop explains does not."""
    alone = believe(belief.basis, new).noise_std
    return belief.surprise(new, _not_linear(unexplained), alone)


def _answers(belief: ErrorBelief, evidence: Evidence) -> bool:
    return belief.noise_std**2 <= _NO_ANSWER * evidence.moved / evidence.rows


def _fitting(evidence: Evidence | None, basis: ErrorBasis) -> Evidence | None:
    return evidence if evidence is not None and len(evidence.right) == basis.size else None


def _alike(axis: AxisSpec, spec: RobotSpec, beliefs: Mapping[str, ErrorBelief]) -> ErrorBelief:
    # An error response has no unit, but its noise does.
    known = [a for a in spec.axes if a.name in beliefs]
    same = [a for a in known if a.unit == axis.unit]
    return like([beliefs[a.name] for a in same or known])
