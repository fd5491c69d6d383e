"""Has robots fly everything except frequency tests, under goal ids that begin with the run's id."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.goal_runner import GoalRunner, Interrupted
from nufleet.orchestrator.flights.labels import NO_PRIOR
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import MalformedMessageError, RobotError, RobotLostError
from nufleet.shared.wire.messages import GoalResult, Outcome
from nufleet.shared.wire.motions import (
    Flight,
    RichFlight,
    RichFlightDetails,
    StepTest,
    TrackingDetails,
    Way,
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class PathFlight:
    """One flight along a path, with positions in the unit of the robot's axes."""

    robot: str
    """Name of the robot that flew."""
    label: str
    """Name of the flight; see `flight_label`."""
    sample_time_s: float
    """Time between two samples."""
    reference: FloatArray
    """References sent to the baseline controller, shape (samples, axes)."""
    actual: FloatArray
    """Measured positions, shape (samples, axes)."""
    details: TrackingDetails
    """Desired path and signals of the inverse model, one row per sample."""
    failure: str | None
    """Why the path was not finished; None when it was."""

    @property
    def rms_error(self) -> float:
        """Root mean square of the distance to the path, in the unit of the axes; infinite when the
        path was not finished."""
        if self.failure is not None:
            return math.inf
        away = self.actual - self.details.desired
        return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))

    @property
    def weights(self) -> dict[str, FloatArray]:
        """Weight of every source in a mixture and of `none`, each of shape (samples,); empty
        without a mixture."""
        if self.details.weights is None:
            return {}
        names = (*self.details.experts, NO_PRIOR)
        return dict(zip(names, self.details.weights.T, strict=True))

    @property
    def mean_weights(self) -> dict[str, float] | None:
        """Mean of each of the weights over the flight; None without a mixture or samples."""
        if not self.weights or not len(self.actual):
            return None
        return {name: float(weight.mean()) for name, weight in self.weights.items()}

    @property
    def deadline_misses(self) -> int:
        """Number of references that took longer to choose than a sample lasts."""
        return int((self.details.step_time_s > self.sample_time_s).sum())


class Pilot:
    """Has the robots of a fleet fly, one flight per robot at a time.

    `interrupt`, called from another thread, ends all flights and leaves the robots at rest.
    """

    def __init__(self, fleet: Fleet, run_id: str) -> None:
        self._fleet = fleet
        self._goals = GoalRunner(fleet)
        self._run_id = run_id
        self._flights: dict[str, int] = {}

    def interrupt(self) -> None:
        """Bring all flying robots to rest; flights in progress and new ones raise `Interrupted`."""
        self._goals.interrupt()

    def acknowledge_all(self) -> None:
        """Acknowledge the last results of every robot, so that it need not keep them."""
        self._goals.acknowledge_all()

    def steps(self, robot: str, axis: str) -> GoalResult:
        """Fly the step test of one axis; raises RobotError when it did not complete."""
        return self._completed(robot, StepTest(axis=axis))

    def rich(
        self, robot: str, *, duration_s: float, seed: int
    ) -> tuple[GoalResult, RichFlightDetails]:
        """Fly a persistently exciting reference, from which the robot learns its own baseline.

        Args:
            robot: Name of the robot that flies.
            duration_s: Duration of the flight.
            seed: Seed of the reference.

        Returns:
            The result of the flight, and the states that were measured in it.

        Raises:
            RobotError: The flight did not complete.
            MalformedMessageError: The robot returned no states.
        """
        result = self._completed(robot, RichFlight(duration_s=duration_s, seed=seed))
        if not isinstance(result.details, RichFlightDetails):
            raise MalformedMessageError(f"robot {robot} returned a rich flight without its states")
        return result, result.details

    def along(self, robot: str, way: Way, desired: FloatArray, label: str) -> PathFlight:
        """Fly a path.

        Args:
            robot: Name of the robot that flies.
            way: Way of following the path.
            desired: Desired positions in the unit of the robot's axes, shape (samples, axes).
            label: Name of the flight; see `flight_label`.
        """
        result = self._fly(robot, way.along(desired))
        details = result.details
        if details is None and result.outcome is Outcome.FAILED:
            nothing, none = np.empty((0, desired.shape[1])), np.empty(0)
            details = TrackingDetails(
                desired=nothing,
                prior=nothing,
                mean=nothing,
                variance=nothing,
                share=none,
                limited=none,
                step_time_s=none,
                dropped_pairs=0,
                taken_back=None,
            )
        if not isinstance(details, TrackingDetails):
            raise MalformedMessageError(
                f"robot {robot} returned the flight of a path without its details"
            )
        return PathFlight(
            robot=robot,
            label=label,
            sample_time_s=result.plan.sample_time_s,
            reference=result.reference,
            actual=result.response,
            details=details,
            failure=None if result.outcome is Outcome.COMPLETED else result.reason,
        )

    def _completed(self, robot: str, motion: Flight) -> GoalResult:
        result = self._fly(robot, motion)
        if result.outcome is not Outcome.COMPLETED:
            raise RobotError(f"robot {robot} did not finish its {motion.kind}: {result.reason}")
        return result

    def _fly(self, robot: str, motion: Flight) -> GoalResult:
        flight = self._flights[robot] = self._flights.get(robot, 0) + 1
        result = self._goals.run(robot, f"{self._run_id}.{robot}.f{flight}", motion)
        if self._goals.interrupted:
            raise Interrupted
        if result.outcome in (Outcome.ABORTED, Outcome.CANCELLED, Outcome.LOST):
            raise RobotLostError(f"robot {robot} ended {motion.kind} early: {result.reason}")
        if result.outcome is Outcome.FAILED:
            _log.info("%s of %s failed: %s", motion.kind, robot, result.reason)
        return result
