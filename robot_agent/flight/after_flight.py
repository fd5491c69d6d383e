"""What a robot's model of itself will be worth once it has flown some more.

A rich flight has not been flown when this is asked, so what it will show is unknown; but how much
it will show is known, since its reference is (preposterior analysis: Raiffa and Schlaifer, Applied
Statistical Decision Theory, 1961, part 2).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nufleet.robot_agent.flight.own_model import OwnModel
from nufleet.robot_agent.flight.own_way import own_way
from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.error_belief import ErrorBelief
from nufleet.shared.models.evidence import Evidence
from nufleet.shared.paths.references import rich_references
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.motions import PredictedError

_SEED = 0


def own_error_after(
    model: OwnModel, spec: RobotSpec, desired: FloatArray, flight_s: float
) -> PredictedError:
    """Return the error along a path with the model that a rich flight will leave, as measured.

    Args:
        model: The robot's model of itself now.
        spec: Description of the robot, which has tracking limits.
        desired: Path, shape (samples, axes), in the axes' units.
        flight_s: Duration of the flight in s; a robot flies whole pieces, see `rich_references`.
    """
    references = rich_references(spec, flight_s, np.random.default_rng(_SEED))
    known = tuple(_after(belief, references[:, i]) for i, belief in enumerate(model.axes))
    baseline = model.left(desired, np.zeros_like(desired))
    square = float(np.mean(np.sum(baseline**2, axis=2)))
    return own_way(replace(model, axes=known), desired, square).predicted


def _after(belief: ErrorBelief, reference: FloatArray) -> ErrorBelief:
    """Return the belief with what a flight leaves uncertain.

    With the covariance F Fᵀ now and the flight's rows A, FᵀAᵀA F = V Λ Vᵀ tells the directions that
    it shows, and it leaves F V (1 + Λ/σ²)^(−½) as a factor of the covariance.

    Args:
        belief: Belief about an axis now.
        reference: Reference of the flight on that axis, shape (samples,), in the axis's unit.
    """
    # The outputs do not matter here: what a flight shows depends on its references alone.
    whole = Evidence.of(belief.basis, reference, reference, float(reference[0]))
    evidence = whole.thinned(belief.lasting)
    size = len(belief.mean)
    normal = np.array(evidence.normal).reshape(size, size)
    power, turn = np.linalg.eigh(belief.factor.T @ normal @ belief.factor)
    shown = np.maximum(power, 0.0) / belief.noise_std**2
    directions = belief.factor @ turn
    left = directions / np.sqrt(1 + shown)
    return replace(
        belief,
        factor=left,
        flown_s=belief.flown_s + evidence.flown_s,
        largest=max(belief.largest, evidence.largest),
    )
