"""Turns a motion that is asked for into a plan within the robot's limits, or refuses it."""

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
"""A motion that measures more is refused: its result would not fit into one message."""

_NUMBERS_PER_AXIS = 16
"""No flight measures more per sample and axis, all its signals together."""


@dataclass(frozen=True)
class Planner:
    """Plans for one robot, whose samples are taken `realtime` times as fast as its clock says.

    `realtime` None plays a simulated robot as fast as it can; a real robot keeps its own time.
    `allow_unguarded` is the robot's own setting, see `nufleet.shared.robots.fleet_file`.
    """

    robot: str
    spec: RobotSpec
    state_names: tuple[str, ...]
    memory: Memory
    realtime: float | None
    allow_unguarded: bool = False

    def plan(self, motion: Motion) -> MotionPlan:
        """Return the plan; the same motion gives the same until the robot learns something.

        Raises:
            RefusedError: the motion is outside the robot's limits, or measures too much.
        """
        per_sample = 2
        if isinstance(motion, Excitation):
            plan: MotionPlan = plan_excitation(motion, self.spec, robot=self.robot)
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
            too_long = f"{plan.samples} samples are too many; at most {most}"
            raise RefusedError("duration", too_long, self.robot)
        return plan

    def wall_duration_s(self, plan: MotionPlan) -> float:
        """Return how long a plan takes on the wall clock."""
        if not self.spec.simulated:
            return plan.duration_s
        return 0.0 if self.realtime is None else plan.duration_s / self.realtime


def digest(motion: Motion) -> str:
    """Return a hash of all that a motion asks for."""
    arrays: list[np.ndarray] = []
    body = motion.model_dump_json(context=arrays)
    hashed = hashlib.sha256(body.encode())
    for array in arrays:
        hashed.update(f"{array.shape}".encode())
        hashed.update(np.ascontiguousarray(array).tobytes())
    return hashed.hexdigest()
