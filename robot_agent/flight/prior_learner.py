"""Puts transferred experiences in front of the robot as the prior of each axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nufleet.robot_agent.flight.inverse_model import InverseModel
from nufleet.robot_agent.flight.memory import Kept, Memory
from nufleet.robot_agent.flight.online_gp import OnlineGp
from nufleet.robot_agent.flight.tracking import Learner
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.experience.combined_layout import CombinedLayout
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.wire.motions import Tracking


def prior_learner(motion: Tracking, axes: tuple[str, ...], memory: Memory, window: int) -> Learner:
    """Return the priors that a flight asks for, ready to fly.

    An axis on which its prior was not learned begins with a zero prior.

    Args:
        motion: Flight requested, with the prior of all axes and those of single ones.
        axes: Names of the robot's axes, in their order.
        memory: Memory of the robot, with its priors.
        window: Number of pairs that the online process is fitted to; 0 learns nothing.

    Raises:
        RobotError: The robot no longer has a prior that the flight asks for.
        InvalidInputError: The priors cannot be combined.
    """
    held = {prior.sha256: prior for prior in memory.priors}
    try:
        priors = {sha256: held[sha256] for sha256 in motion.asked}
    except KeyError as error:
        raise RobotError("the robot no longer has a prior") from error
    leading, *others = priors.values()
    layout: InverseLayout | CombinedLayout = leading.manifest.layout
    if others:
        layout = CombinedLayout([prior.manifest.layout for prior in priors.values()])

    by_axis = {one.axis: priors[one.sha256] for one in motion.prior_by_axis}

    def on(axis: str) -> InverseModel | None:
        prior = by_axis.get(axis, leading)
        if axis not in prior.manifest.axes:
            return None
        return prior.inverse if isinstance(layout, InverseLayout) else _Part(layout, prior)

    return Learner(layout, OnlineGp(layout, tuple(map(on, axes)), window=window))


@dataclass(frozen=True, eq=False)
class _Part:
    """An inverse model whose layout is one of several, answering as the leading one."""

    layout: CombinedLayout
    """Layouts of all priors of the flight."""
    prior: Kept
    """The experience."""

    def __call__(self, inputs: FloatArray) -> FloatArray:
        own = self.prior.manifest.layout
        gamma = self.prior.inverse(self.layout.inputs_of(own, inputs))
        return np.asarray(self.layout.as_leading(own, inputs, gamma))
