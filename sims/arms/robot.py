"""A simulated arm as a Robot: its joints, measured from the home pose."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.sims.arms.mechanism import Mechanism, servo_gains
from nufleet.sims.arms.settings import JOINTS, SAMPLE_TIME_S, ArmSettings
from nufleet.sims.measurement_noise import MeasurementNoise
from nufleet.sims.simulated_robot import RestRule, SimulatedRobot

STATE_NAMES = ("position", "velocity")

ERROR_MAX_RAD = 1.0
"""Distance from its reference at which a joint has lost it, because the torque limit or a stop
holds it back."""

REST_MAX_RAD = 0.005
"""Distance from its home angle within which a joint without friction counts as at rest there."""


class Arm(SimulatedRobot):
    """An arm with its joint controllers: reference angles in, measured angles out."""

    def __init__(self, name: str, settings: ArmSettings, rng: np.random.Generator) -> None:
        sigma = np.array([settings.noise.position_rad, settings.noise.velocity_rad_s])
        super().__init__(
            name,
            _spec(settings),
            STATE_NAMES,
            MeasurementNoise(np.tile(sigma, (len(JOINTS[settings.model]), 1)), rng),
            _rest_rule(settings),
        )
        self._mechanism = Mechanism(settings)

    def _start(self) -> FloatArray:
        self._mechanism.put_home()
        return self._mechanism.state

    def _play(self, references: FloatArray) -> FloatArray:
        before = self._mechanism.state[np.newaxis]
        after = self._mechanism.play(references)
        error_rad = np.abs(references - after[:, :, 0]).max(axis=1)
        lost = ~(error_rad < ERROR_MAX_RAD)  # true also for a number that is not finite
        if lost.any():
            k = int(np.argmax(lost))
            raise RobotError(
                f"{self._name} stopped following its reference {k * SAMPLE_TIME_S:.2f} s into its "
                f"motion: the error is {error_rad[k]:.2f} rad; drive it more gently"
            )
        return np.concatenate([before, after])


def _rest_rule(settings: ArmSettings) -> RestRule:
    # A proportional controller leaves a joint where friction balances the servo's spring.
    stiffness, _ = servo_gains(settings)
    stuck = np.array(settings.friction_nm) / stiffness
    return RestRule(
        speed=0.5,
        position_max=REST_MAX_RAD + float(stuck.max()),
        velocity_max=0.01,
        patience_s=30.0,
    )


def _spec(settings: ArmSettings) -> RobotSpec:
    limits = settings.limits
    axes = tuple(
        AxisSpec(
            name=name,
            unit="rad",
            amplitude_max=limits.amplitude_rad,
            velocity_max=limits.velocity_rad_s,
            acceleration_max=limits.acceleration_rad_s2,
        )
        for name in JOINTS[settings.model]
    )
    return RobotSpec(
        kind="arm",
        axes=axes,
        sample_time_s=SAMPLE_TIME_S,
        omega_min_rad_s=settings.omega_min_rad_s,
        omega_max_rad_s=settings.omega_max_rad_s,
        duration_max_s=settings.motion_time_max_s,
        settling_time_s=settings.settling_time_s,
        simulated=True,
        tracking=settings.tracking,
    )
