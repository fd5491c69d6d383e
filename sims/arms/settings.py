"""What a fleet file says of a simulated arm: its model, what differs from it, its controller."""

from __future__ import annotations

from typing import Literal

from nufleet.shared.robots.spec import TrackingLimits
from nufleet.shared.strict import NonNegative, Positive, Strict

SAMPLE_TIME_S = 0.02
"""One sample of the robot, common to every arm so that models transfer between them."""

SERVO_HZ = 500
"""Integration steps per second; the joint controllers run at this rate."""


class EncoderNoise(Strict):
    """Standard deviations: half a step of a 14-bit encoder, and its filtered difference."""

    position_rad: NonNegative = 0.0002
    velocity_rad_s: NonNegative = 0.005


class ReferenceLimits(Strict):
    """How far, fast and hard a test may drive the reference of either joint."""

    amplitude_rad: Positive = 0.3
    velocity_rad_s: Positive = 0.6
    acceleration_rad_s2: Positive = 2.0


class ArmSettings(Strict):
    """One simulated arm: shoulder and elbow move, the other joints are locked.

    `model` is one of the arms that gymnasium ships. What may differ from it: a payload at the tip,
    the joints' viscous damping, the inertia of the motors' rotors. The controller knows the model
    as shipped with the given rotors, not the payload or the damping: on each joint it is a PD
    whose gains give that nominal inertia the natural frequency and damping ratio.
    """

    model: Literal["pusher", "reacher"]
    natural_frequency_rad_s: Positive
    damping_ratio: Positive
    torque_max_nm: Positive
    rotor_inertia_kg_m2: Positive
    payload_kg: NonNegative = 0.0
    joint_damping_scale: Positive = 1.0
    velocity_reference: bool = True
    noise: EncoderNoise = EncoderNoise()
    limits: ReferenceLimits = ReferenceLimits()
    # Within the joints' stops; twice the speed and acceleration of a test, which the torque limit
    # leaves room for.
    tracking: TrackingLimits = TrackingLimits(
        position_max=0.6,
        speed_max=1.2,
        acceleration_max=4.0,
        correction_max=0.2,
        correction_speed_max=0.8,
    )
    omega_min_rad_s: Positive = 0.2
    omega_max_rad_s: Positive = 12.0
    motion_time_max_s: Positive = 600.0
    settling_time_s: NonNegative = 3.0
