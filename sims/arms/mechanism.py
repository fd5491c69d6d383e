"""An arm of two or three joints with its joint controllers as one MuJoCo model."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from nufleet.shared.arrays import FloatArray
from nufleet.sims.arms.settings import SAMPLE_TIME_S, SERVO_HZ, ArmSettings

STEPS_PER_SAMPLE = round(SAMPLE_TIME_S * SERVO_HZ)

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _ShippedModel:
    """An arm that gymnasium ships, with the joints that move."""

    file: str
    """Name of the model's file."""

    joints: tuple[str, ...]
    """Names of the joints that move, from the base on."""

    tip: str
    """Name of the body at the tip, which carries the payload."""

    scenery: tuple[str, ...]
    """Names of the bodies that are removed."""

    home: tuple[float, ...]
    """Home pose: angle of each of these joints in rad."""


_MODELS = {
    "pusher": _ShippedModel(
        file="pusher_v5.xml",
        joints=("r_shoulder_pan_joint", "r_elbow_flex_joint"),
        tip="tips_arm",
        scenery=("object", "goal"),
        home=(0.0, -1.16),  # the middle of the elbow's range
    ),
    "pusher_pitch": _ShippedModel(
        file="pusher_v5.xml",
        joints=("r_shoulder_lift_joint", "r_elbow_flex_joint", "r_wrist_flex_joint"),
        tip="tips_arm",
        scenery=("object", "goal"),
        home=(0.44, -1.16, -0.55),  # the middle of each range
    ),
    "reacher": _ShippedModel(
        file="reacher.xml",
        joints=("joint0", "joint1"),
        tip="fingertip",
        scenery=("target",),
        home=(0.0, 1.5),  # bent by as much as the other arm can be, within ±3
    ),
}


class Mechanism:
    """The arm, its controllers and its state; plays whole reference signals in compiled code."""

    def __init__(self, settings: ArmSettings) -> None:
        """Build the model; raises InvalidInputError if gymnasium's files are missing."""
        # Otherwise MuJoCo would write its warnings to a file in the working directory.
        mujoco.set_mju_user_warning(lambda message: log.warning("mujoco: %s", message))
        self._home = np.array(_MODELS[settings.model].home)
        self._model = _controlled_arm(settings).compile()
        self._data = mujoco.MjData(self._model)
        self._velocity_gain = 1.0 if settings.velocity_reference else 0.0
        self._rollout = Rollout(nthread=0)
        self.put_home()

    def put_home(self) -> None:
        """Put the arm at rest in its home pose."""
        size = mujoco.mj_stateSize(self._model, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
        self._state = np.zeros(size)
        # After the time come the positions, then the velocities.
        self._state[1 : 1 + len(self._home)] = self._home
        self._reference = np.zeros(len(self._home))

    @property
    def state(self) -> FloatArray:
        """Angle from home [rad] and angular velocity [rad/s] of each joint, shape (joints, 2)."""
        return np.asarray(self._joints(self._state[np.newaxis])[0])

    def play(self, references: FloatArray) -> FloatArray:
        """Move along references.

        Args:
            references: Joint angles from home in rad, shape (samples, joints).

        Returns:
            Angle from home [rad] and angular velocity [rad/s] of each joint after each reference
            has acted, shape (samples, joints, 2).
        """
        before = np.concatenate([self._reference[np.newaxis], references[:-1]])
        velocity = self._velocity_gain * (references - before) / SAMPLE_TIME_S
        control = np.concatenate([references + self._home, velocity], axis=1)
        states, _ = self._rollout.rollout(
            self._model,
            self._data,
            self._state[np.newaxis],
            np.repeat(control, STEPS_PER_SAMPLE, axis=0)[np.newaxis],
        )
        ends = states[0, STEPS_PER_SAMPLE - 1 :: STEPS_PER_SAMPLE]
        self._state = ends[-1]
        self._reference = references[-1]
        return self._joints(ends)

    def _joints(self, states: FloatArray) -> FloatArray:
        joints = len(self._home)
        angles, velocities = states[:, 1 : 1 + joints], states[:, 1 + joints : 1 + 2 * joints]
        return np.stack([angles - self._home, velocities], axis=2)


def nominal_inertia_kg_m2(settings: ArmSettings) -> FloatArray:
    """Return the inertia that the controller assumes for each joint, shape (joints,), in kg m².

    It is the diagonal of the mass matrix in the home pose, without payload.
    """
    shipped = _MODELS[settings.model]
    model = _bare_arm(shipped, settings.rotor_inertia_kg_m2).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = shipped.home
    mujoco.mj_forward(model, data)
    joints = len(shipped.joints)
    diagonal, column = np.empty(joints), np.empty(joints)
    # MuJoCo multiplies by the mass matrix; column i is its product with the i-th unit vector.
    for i, unit in enumerate(np.eye(joints)):
        mujoco.mj_mulM(model, data, column, unit)
        diagonal[i] = column[i]
    return diagonal


def servo_gains(settings: ArmSettings) -> tuple[FloatArray, FloatArray]:
    """Return stiffness [N m/rad] and damping [N m s/rad] of each joint's controller, (joints,).

    The gains k = J ω_n² and d = 2 ζ J ω_n give a joint of the nominal inertia J the natural
    frequency ω_n and the damping ratio ζ.
    """
    inertia, omega = nominal_inertia_kg_m2(settings), settings.natural_frequency_rad_s
    return inertia * omega**2, inertia * 2 * settings.damping_ratio * omega


def _bare_arm(shipped: _ShippedModel, rotor_inertia_kg_m2: float) -> Any:
    """Return the shipped arm with its moving joints, and without scenery, motors or contacts."""
    # Found without importing gymnasium, of which nothing else is needed.
    assets = Path(str(distribution("gymnasium").locate_file("gymnasium/envs/mujoco/assets")))
    spec = mujoco.MjSpec.from_file(str(assets / shipped.file))
    for body in shipped.scenery:
        spec.delete(spec.body(body))
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for joint in list(spec.joints):
        if joint.name not in shipped.joints:
            spec.delete(joint)
        else:
            joint.armature = rotor_inertia_kg_m2
    spec.option.timestep = 1 / SERVO_HZ
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return spec


def _controlled_arm(settings: ArmSettings) -> Any:
    """Return the arm with payload, damping, friction and a PD controller on each joint."""
    shipped = _MODELS[settings.model]
    stiffness, damping = servo_gains(settings)
    spec = _bare_arm(shipped, settings.rotor_inertia_kg_m2)
    if settings.payload_kg > 0:
        spec.body(shipped.tip).add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0], mass=settings.payload_kg
        )
    names = shipped.joints
    for name, friction_nm in zip(names, settings.friction_nm, strict=True):
        joint = spec.joint(name)
        joint.damping = joint.damping * settings.joint_damping_scale
        joint.frictionloss = friction_nm
        joint.actfrclimited = True
        joint.actfrcrange = [-settings.torque_max_nm, settings.torque_max_nm]
    for name, gain in zip(names, stiffness, strict=True):
        _add_servo(spec, name, gain, bias=[0, -gain, 0])
    for name, gain in zip(names, damping, strict=True):
        _add_servo(spec, name, gain, bias=[0, 0, -gain])
    return spec


def _add_servo(spec: Any, joint: str, gain: float, bias: list[float]) -> None:
    """Add torque = gain × control + bias · (1, angle, angular velocity)."""
    spec.add_actuator(
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        gainprm=[gain] + [0] * 9,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        biasprm=bias + [0] * 7,
    )
