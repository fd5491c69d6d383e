"""Turns a requested motion into a plan within the robot's limits, or refuses it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.plan import plan_flight
from nufleet.robot_agent.motion.excitation import plan_excitation
from nufleet.shared.errors import RefusedError
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.codec import MAX_BODY_BYTES, MAX_MESSAGE_BYTES
from nufleet.shared.wire.motions import Motion, MotionPlan

MAX_RESULT_NUMBERS = (MAX_MESSAGE_BYTES - 2 * MAX_BODY_BYTES) // 8
"""Largest number of values that a motion may measure; a longer result would not fit into one
message."""

_NUMBERS_PER_AXIS = 16
"""Upper bound on the values that a flight measures per sample and axis, over all its signals."""


@dataclass(frozen=True)
class Planner:
    """Plans the motions of one robot."""

    robot: str
    """Name of the robot."""

    spec: RobotSpec
    """Description of the robot."""

    state_names: tuple[str, ...]
    """Names of the states that the robot's `observe` measures."""

    memory: Memory
    """Learned models of the robot."""

    realtime: float | None
    """Multiple of real time at which a simulated robot plays; None for as fast as it can. A real
    robot keeps its own time."""

    allow_unguarded: bool = False
    """Whether the robot may fly with a learned inverse and without a guard; a setting of the robot
    in its fleet file (see `nufleet.shared.robots.fleet_file`)."""

    def plan(self, motion: Motion) -> MotionPlan:
        """Return the plan of a motion; it stays the same until the robot learns something.

        Raises:
            RefusedError: The motion is outside the robot's limits, or its result too large.
        """
        if isinstance(motion, Excitation):
            plan: MotionPlan = plan_excitation(motion, self.spec, robot=self.robot)
            per_sample = 2 * len(motion.played)
        else:
            plan = plan_flight(
                motion,
                self.spec,
                self.state_names,
                self.memory,
                self.robot,
                allow_unguarded=self.allow_unguarded,
            )
            per_sample = _NUMBERS_PER_AXIS * len(self.spec.axes)
        most = MAX_RESULT_NUMBERS // per_sample
        if plan.samples > most:
            too_long = f"the motion has {plan.samples} samples; at most {most} are possible"
            raise RefusedError("duration", too_long, self.robot)
        return plan

    def wall_duration_s(self, plan: MotionPlan) -> float:
        """Return a plan's duration on the wall clock in seconds; 0 for an unpaced simulation."""
        if not self.spec.simulated:
            return plan.duration_s
        return 0.0 if self.realtime is None else plan.duration_s / self.realtime


def digest(motion: Motion) -> str:
    """Return the sha256 of a requested motion in hexadecimal, its arrays included."""
    arrays: list[np.ndarray] = []
    body = motion.model_dump_json(context=arrays)
    hashed = hashlib.sha256(body.encode())
    for array in arrays:
        hashed.update(f"{array.shape}".encode())
        hashed.update(np.ascontiguousarray(array).tobytes())
    return hashed.hexdigest()
