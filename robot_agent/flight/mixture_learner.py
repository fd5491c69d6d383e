"""Puts the priors that a flight names in front of the robot as one mixture."""

from __future__ import annotations

from nufleet.robot_agent.flight.memory import Kept, Memory
from nufleet.robot_agent.flight.mixture_process import Expert, MixtureProcess
from nufleet.robot_agent.flight.tracking import Learner
from nufleet.shared.errors import RobotError
from nufleet.shared.experience.combined_layout import CombinedLayout
from nufleet.shared.experience.manifest import without_experience
from nufleet.shared.wire.motions import Motion, Tracking


def mixture_learner(
    motion: Tracking, axes: tuple[str, ...], memory: Memory, window: int
) -> Learner:
    """Return the mixture that a flight asks for, ready to fly.

    Args:
        motion: Flight requested, with the experiences and their weights at the start.
        axes: Names of the robot's axes, in their order.
        memory: Memory of the robot, with its priors.
        window: Number of pairs that the online process is fitted to; 0 learns nothing.

    Raises:
        RobotError: The robot no longer has a prior that the flight asks for.
        InvalidInputError: The priors cannot be combined.
    """
    priors = _priors(motion, memory)
    manifests = [prior.manifest for prior in priors]
    # What none says, γ = 0, is meant in the leading layout: a slow source must not lead.
    none = without_experience(manifests)
    layout = CombinedLayout([none, *(manifest.layout for manifest in manifests)])
    experts = [
        Expert(
            name=prior.manifest.robot,
            layout=prior.manifest.layout,
            inverse=prior.inverse,
            weight=wanted.weight,
            axes=tuple(axis in prior.manifest.axes for axis in axes),
        )
        for prior, wanted in zip(priors, motion.mixture, strict=True)
    ]
    return Learner(layout, MixtureProcess(layout, experts, window=window))


def experts_of(motion: Motion, memory: Memory) -> tuple[str, ...]:
    """Return the sources of the experiences in a flight's mixture; empty without a mixture.

    Raises:
        RobotError: The robot no longer has a prior that the flight asks for.
    """
    if not isinstance(motion, Tracking):
        return ()
    return tuple(prior.manifest.robot for prior in _priors(motion, memory))


def _priors(motion: Tracking, memory: Memory) -> list[Kept]:
    held = {prior.sha256: prior for prior in memory.priors}
    try:
        return [held[wanted.sha256] for wanted in motion.mixture]
    except KeyError as error:
        raise RobotError("the robot no longer has a prior of the mixture") from error
