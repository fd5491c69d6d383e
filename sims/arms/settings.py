"""The settings of a simulated arm: its model, deviations from that model, and its controller."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from nufleet.shared.robots.spec import TrackingLimits
from nufleet.shared.strict import NonNegative, Positive, Strict

SAMPLE_TIME_S = 0.02
"""One sample of the robot, common to every arm so that models transfer between them."""

SERVO_HZ = 500
"""Integration steps per second; the joint controllers run at this rate."""


JOINTS = {
    "pusher": ("shoulder", "elbow"),
    "pusher_pitch": ("shoulder", "elbow", "wrist"),
    "reacher": ("shoulder", "elbow"),
}
"""Names of the joints that move, by model."""


class EncoderNoise(Strict):
    """Standard deviations of the measured joint states."""

    position_rad: NonNegative = 0.0002
    """Angle noise: half a step of a 14-bit encoder."""

    velocity_rad_s: NonNegative = 0.005
    """Angular velocity noise: filtered difference quotient of the encoder's angle."""


class ReferenceLimits(Strict):
    """Limits on the reference of a frequency test on each joint."""

    amplitude_rad: Positive = 0.3
    """Largest amplitude."""

    velocity_rad_s: Positive = 0.6
    """Largest angular velocity."""

    acceleration_rad_s2: Positive = 2.0
    """Largest angular acceleration."""


class ArmSettings(Strict):
    """One simulated arm, whose `JOINTS` move and whose other joints are locked.

    The shoulder of `pusher` turns about the vertical and its elbow about a horizontal axis, so that
    neither moves the other. The joints of `pusher_pitch`, the same arm, turn about parallel axes.

    The arm may differ from the shipped model in a payload at the tip, the joints' viscous damping
    and Coulomb friction, and the inertia of the motors' rotors. The controller knows the shipped
    model with the given rotors, but neither payload nor damping nor friction. On each joint it is a
    PD controller whose gains give that nominal inertia the natural frequency and the damping ratio.
    """

    model: Literal["pusher", "pusher_pitch", "reacher"]
    """Name of the arm: one that gymnasium ships, and which of its joints move."""

    natural_frequency_rad_s: Positive
    """Natural frequency of each joint's loop with the nominal inertia."""

    damping_ratio: Positive
    """Damping ratio of each joint's loop with the nominal inertia."""

    torque_max_nm: Positive
    """Largest torque of each joint's motor, in N m."""

    rotor_inertia_kg_m2: Positive
    """Inertia of each motor's rotor, as seen at the joint."""

    payload_kg: NonNegative = 0.0
    """Mass of the payload at the tip."""

    joint_damping_scale: Positive = 1.0
    """Factor on the viscous damping of the shipped joints."""

    joint_friction_nm: tuple[NonNegative, ...] = ()
    """Coulomb friction: the torque that each joint opposes to any motion; none for none."""

    velocity_reference: bool = True
    """Whether the controller also receives the reference's backward difference as velocity."""

    noise: EncoderNoise = EncoderNoise()
    """Measurement noise of the joint states."""

    limits: ReferenceLimits = ReferenceLimits()
    """Limits on frequency tests."""

    # Paths stay within the joints' stops; they may have twice the speed and acceleration of a
    # test, which the torque limit leaves room for.
    tracking: TrackingLimits = TrackingLimits(
        position_max=0.6,
        speed_max=1.2,
        acceleration_max=4.0,
        correction_max=0.2,
        correction_speed_max=0.8,
    )
    """Limits on tracked paths and their corrections, in rad and s."""

    omega_min_rad_s: Positive = 0.2
    """Lower edge of the band for frequency tests."""

    omega_max_rad_s: Positive = 12.0
    """Upper edge of the band for frequency tests."""

    motion_time_max_s: Positive = 600.0
    """Longest motion that the robot accepts."""

    settling_time_s: NonNegative = 3.0
    """Time in which the arm settles after a change of its reference."""

    @model_validator(mode="after")
    def _friction_of_each_joint(self) -> ArmSettings:
        joints = JOINTS[self.model]
        if len(self.joint_friction_nm) not in (0, len(joints)):
            raise ValueError(f"joint_friction_nm needs a value for each of {', '.join(joints)}")
        return self

    @property
    def friction_nm(self) -> tuple[float, ...]:
        """Coulomb friction of every joint."""
        return self.joint_friction_nm or (0.0,) * len(JOINTS[self.model])
