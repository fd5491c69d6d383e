"""What a completed motion adds to a robot's model of itself."""

from __future__ import annotations

import logging
from collections.abc import Mapping

from nufleet.robot_agent.flight.cross_axes import Crosses, crosses_in
from nufleet.robot_agent.flight.memory import Memory, MemoryFolderError
from nufleet.robot_agent.flight.own_model import (
    OwnModel,
    basis_of,
    evidence_in,
    telling,
    unexplained_in,
)
from nufleet.robot_agent.flight.state_model import StateEvidence, state_evidence
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.models.evidence import Evidence
from nufleet.shared.paths.references import top_rad_s
from nufleet.shared.robots.spec import RobotSpec

_log = logging.getLogger(__name__)


def states_in(robot: Robot, states: FloatArray) -> dict[str, StateEvidence]:
    """Return what a rich flight shows of the states of every axis beside its output.

    Args:
        robot: The robot, for its description and the names of its states.
        states: States, shape (samples, axes, states); NaN where they were not observed.
    """
    step_s, names, top = robot.spec.sample_time_s, robot.state_names, top_rad_s(robot.spec)
    found = {
        axis.name: state_evidence(names, states[:, i, 0], states[:, i], step_s, top)
        for i, axis in enumerate(robot.spec.axes)
    }
    return {axis: evidence for axis, evidence in found.items() if evidence is not None}


def learned_from(
    spec: RobotSpec, references: FloatArray, outputs: FloatArray
) -> tuple[Mapping[str, Evidence], Mapping[str, Crosses]]:
    """Return what a motion of axes that move independently shows of each, and of others on it.

    Args:
        spec: Description of the robot.
        references: References sent, shape (samples, axes), in the axes' units.
        outputs: Outputs measured before each reference acted, in the same shape.

    Raises:
        InvalidInputError: The record is too short, or holds numbers that cannot be right.
    """
    names = [axis.name for axis in spec.axes]
    crosses, alone = crosses_in(basis_of(spec), names, references, outputs)
    return evidence_in(spec, references, alone), crosses


def learn(
    memory: Memory,
    spec: RobotSpec,
    references: FloatArray,
    outputs: FloatArray,
    states: Mapping[str, StateEvidence] | None = None,
    before: OwnModel | None = None,
) -> None:
    """Add a completed motion to a robot's model of itself; a failure is no fault of the motion.

    Args:
        memory: Memory of the robot.
        spec: Description of the robot; one without tracking limits needs no such model.
        references: References sent, shape (samples, axes), in the axes' units.
        outputs: Outputs measured before each reference acted, in the same shape.
        states: What it shows of the states of an axis beside its output, by the axis's name.
        before: The robot's model of itself, for a path, along which the axes do not move
            independently of each other; see `telling`.
    """
    if spec.tracking is None:
        return
    try:
        if before is None:
            evidence, crosses = learned_from(spec, references, outputs)
            memory.learn(evidence, states, crosses)
        else:
            memory.learn(telling(before, spec, evidence_in(spec, references, outputs)), states)
    except (InvalidInputError, MemoryFolderError) as error:
        _log.warning("a motion taught nothing: %s", error)


def learn_unexplained(
    memory: Memory,
    spec: RobotSpec,
    references: FloatArray,
    outputs: FloatArray,
    rest_std: FloatArray,
) -> tuple[str, ...]:
    """Add what a flight of all axes leaves unexplained to a robot's model of itself.

    Args:
        memory: Memory of the robot, which has learned from the flight already.
        spec: Description of the robot.
        references: References sent, shape (samples, axes), in the axes' units.
        outputs: Outputs measured before each reference acted, in the same shape.
        rest_std: Standard deviation of the output at rest, shape (axes,), in the axes' units.

    Returns:
        What the flight shows of the model, for people.

    Raises:
        MemoryFolderError: It cannot be stored.
    """
    settled = memory.own_model(spec)
    if settled.model is not None:
        left = unexplained_in(settled.model, spec, references, outputs, rest_std)
        memory.learn_unexplained(left, spec)
    return settled.findings
