"""Flies a path on models of the robot, so that the error of a flight is known before it is flown.

What is rehearsed is what flies: the same control loop, inverse models, online process and guard act
on robots that are drawn from what the robot knows of itself. Nothing real moves. It takes about as
long as the flight itself, so it has no place in a control loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nufleet.robot_agent.flight.after_flight import own_error_after
from nufleet.robot_agent.flight.equipment import equipment_for
from nufleet.robot_agent.flight.forecast import Forecast, forecast_of
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.own_model import HIGH, OwnModel
from nufleet.robot_agent.flight.own_way import own_way
from nufleet.robot_agent.flight.rehearsed_robot import LoopDraw, RehearsedRobot
from nufleet.robot_agent.flight.state_model import StateModel
from nufleet.robot_agent.flight.tracking import track
from nufleet.robot_agent.flight.tracking_record import TrackingRecord
from nufleet.robot_agent.flight.unseen import unseen
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.paths.references import approach
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import ForeseenWay
from nufleet.shared.wire.motions import PredictedError, Tracking

DRAWS = 4
"""Number of robots that a flight is rehearsed on; the bounds allow for so few."""

ROUGH = 0.01
"""Least standard deviation of the logarithm of a rehearsed error. Without disturbances all
rehearsals end alike, and yet no model answers exactly as its robot does."""

LIKELIEST = 1.28
"""Factor by which an error may be smaller or larger than on the likeliest robot, with a probability
of 5 % each, if the logarithm of what such a model leaves has a standard deviation of 0.15."""

GUARDED = 1.1
"""Most error that a guard promises to leave, as a multiple of the error of the baseline."""

_TINY = float(np.finfo(np.float64).tiny)
_SEED = 0  # every way of flying meets the same robots and the same noise, so that they compare


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """A robot as it knows itself, on which flights along one path are tried."""

    spec: RobotSpec
    """Description of the robot."""
    memory: Memory
    """Memory of the robot, with its priors."""
    model: OwnModel
    """The robot's model of itself."""
    states: StateModel
    """How the states that it measures follow from its output."""
    desired: FloatArray
    """Path, shape (samples, axes), in the axes' units."""
    forecast: Forecast
    """What the model says of the path."""

    @staticmethod
    def of(
        spec: RobotSpec, state_names: tuple[str, ...], memory: Memory, desired: FloatArray
    ) -> Rehearsal:
        """Return the rehearsal of a path; the first one after a motion takes a while.

        Args:
            spec: Description of the robot.
            state_names: Names of the states that it measures.
            memory: Memory of the robot.
            desired: Path, shape (samples, axes), in the axes' units.

        Raises:
            RobotError: The robot knows nothing of itself yet.
        """
        model = memory.own_model(spec).model
        forecast = forecast_of(model, desired)
        if model is None or forecast is None:
            raise RobotError("the robot has no model of itself yet")
        states = memory.states(spec, state_names)
        return Rehearsal(spec, memory, model, states, desired, forecast)

    @property
    def unseen(self) -> str:
        """What of the path is unlike all motions that the robot knows itself from; may be empty."""
        return unseen(self.model, self.spec.axes, self.desired)

    def predicted(self, way: ForeseenWay, *, draws: int = DRAWS) -> PredictedError:
        """Return the error that is to be measured in a flight along the path.

        Args:
            way: Way to fly; one that the robot could fly, or could after the rich flight before it.
            draws: Number of robots to rehearse it on, at least two.

        Raises:
            RobotError: It cannot be rehearsed.
            InvalidInputError: It needs a state of which the robot has observed nothing yet.
        """
        if way.after_rich_flight_s:
            return own_error_after(self.model, self.spec, self.desired, way.after_rich_flight_s)
        # These two are known for many more robots than could be rehearsed on.
        if way.inverse == "baseline":
            return self.forecast.baseline
        if way.inverse == "own":
            return self._own()
        motion, seeds = way.along(self.desired), np.random.SeedSequence(_SEED).spawn(draws)
        flown = [self._flown(motion, seed) for seed in seeds]
        found = predicted_from([record.rms_error for record in flown])
        likeliest = self._flown(motion, seeds[0], likeliest=True)
        kept = 0.0
        if any(record.taken_back is not None for record in (*flown, likeliest)):
            free = way.model_copy(update={"guarded": False}).along(self.desired)
            most = GUARDED * self.forecast.baseline.high
            kept = min(most, self._flown(free, seeds[0], likeliest=True).rms_error)
        return widened(found, likeliest.rms_error, kept, self._may_leave())

    def _own(self) -> PredictedError:
        """Return the error with the robot's model of itself, which may prove to be right."""
        square = float(self.forecast.baseline_squares.mean())
        right = own_way(self.model.if_right(), self.desired, square).predicted
        found = self.forecast.own
        return found.model_copy(update={"low": min(found.low, right.low)})

    def _may_leave(self) -> float:
        """Return the share of an error that is left if what may not grow with a motion does not."""
        sizes = np.std(self.desired, axis=0)
        pairs = zip(self.model.axes, sizes.tolist(), strict=True)
        left = np.array([1 - axis.open(size) for axis, size in pairs])
        return float(np.linalg.norm(left * sizes) / max(float(np.linalg.norm(sizes)), _TINY))

    def _flown(
        self, motion: Tracking, seed: np.random.SeedSequence, *, likeliest: bool = False
    ) -> TrackingRecord:
        """Return the record of a flight on one robot.

        Args:
            motion: Flight.
            seed: Seed of the robot and of its noise.
            likeliest: Whether the robot is the likeliest one, and the noise alone is drawn.
        """
        limits = self.spec.tracking
        if limits is None:
            raise RobotError("the robot does not track")
        rng = np.random.default_rng(seed)
        samples = len(self.desired) + len(approach(self.spec, self.desired, limits))
        draw = self._draw(samples, rng)
        if likeliest:
            across = np.zeros_like(draw.across)
            for cross in self.model.crosses:
                across[:, cross.reference, cross.output] = cross.belief.mean
            responses = np.stack([b.mean for b in self.model.axes], axis=1)
            draw = replace(draw, responses=responses, across=across)
        robot = RehearsedRobot(self.spec, self.states.names, draw, rng)
        equipment = equipment_for(motion, robot, self.memory, self.forecast)
        record = track(
            robot,
            self.desired,
            limits,
            equipment.learner,
            equipment.guard,
            fallback=equipment.fallback,
        )
        if record.failure is not None:
            raise RobotError(f"its rehearsal ended early: {record.failure}")
        return record

    def _draw(self, samples: int, rng: np.random.Generator) -> LoopDraw:
        axes = self.model.axes
        sizes = np.std(self.desired, axis=0)
        drawn = [b.draws(1, rng, float(size)) for b, size in zip(axes, sizes, strict=True)]
        responses = np.concatenate(drawn, axis=1)
        # An output that is measured before its reference acts has not answered it, in any draw.
        responses[0] = 1.0
        across = np.zeros((len(responses), len(axes), len(axes)))
        for cross in self.model.crosses:
            (drawn_across,) = cross.belief.draws(1, rng, float(sizes[cross.reference])).T
            across[1:, cross.reference, cross.output] = drawn_across[1:]
        return LoopDraw(
            basis=axes[0].basis,
            responses=responses,
            across=across,
            unexplained=self.model.disturbed(samples, rng),
            state_gains=self.states.gains,
            state_noise_std=self.states.noise_std,
        )


def widened(
    found: PredictedError, likeliest: float, kept: float, left: float = 1.0
) -> PredictedError:
    """Return what is expected with bounds that cover what hardly any drawn robot shows.

    A drawn robot deviates from the likeliest one at all frequencies at once, also where neither
    tests nor paths have power, and nearly every deviation makes an inverse worse. So a real one may
    fly better than all that are drawn, as well as the likeliest one does. And what the guard
    withdraws on them it may just keep on the real one.

    Args:
        found: Error that is expected from the drawn robots.
        likeliest: Error on the likeliest robot.
        kept: Error on it with what a guard would withdraw; 0 if it withdrew nothing.
        left: Share of an error that is left if what may not grow with a motion does not.
    """
    low = left * min(found.low, likeliest / LIKELIEST)
    high = max(found.high, kept * LIKELIEST)
    return found.model_copy(update={"low": low, "high": high})


def predicted_from(errors: Sequence[float]) -> PredictedError:
    """Return the error to be expected after a few that were drawn alike.

    The logarithms of errors are taken as normal with a mean and a variance that the few show. The
    next one is then distributed as Student's t around their mean, wider by what that mean may be
    off (Gelman et al., Bayesian Data Analysis, 3rd ed., sec. 3.2).

    Args:
        errors: Root mean square errors, at least two, above 0.
    """
    # Agents only write the task of a rehearsal, and do without a third of a second of loading.
    from scipy.special import stdtrit

    logarithms, count = np.log(errors), len(errors)
    spread = np.hypot(float(np.std(logarithms, ddof=1)), ROUGH) * np.sqrt(1 + 1 / count)
    reach = float(stdtrit(count - 1, HIGH)) * spread
    middle = float(np.mean(logarithms))
    low, rms, high = np.exp([middle - reach, middle, middle + reach])
    return PredictedError(rms=float(rms), low=float(low), high=float(high))
