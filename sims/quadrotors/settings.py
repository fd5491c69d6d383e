"""What a fleet file says of a simulated quadrotor: vehicle, controller, sensor noise and limits."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from nufleet.shared.robots.spec import TrackingLimits
from nufleet.shared.strict import NonNegative, Positive, Strict

PHYSICS_HZ = 500
"""Integration steps per second: crazyflow's own choice for its explicit Euler integrator."""

CONTROL_HZ = 100
"""The position controllers' rate: the Crazyflie firmware runs its position loop at 100 Hz."""

SAMPLE_TIME_S = 0.02
"""One sample of the robot, common to every quadrotor so that models transfer between them.

A whole number of control periods (the paper's 15 ms is not). 50 Hz is 58 times the fastest test
frequency of 5.4 rad/s, and leaves time for two online Gaussian processes between two samples.
"""

LINK_TICKS = 32
"""Control periods that the radio link of an attitude-commanded vehicle can hold back."""


class MellingerVehicle(Strict):
    """A Crazyflie: the firmware's Mellinger controller on board, its gains absolute forces.

    The controller believes in its built-in mass whatever `mass_kg` is, as in flight. `airframe`
    names crazyflow's identified parameters; `dynamics` its model: rigid body with rotors
    (`first_principles`) or a fitted second-order attitude response (the others). The scales
    multiply the firmware's horizontal gains.
    """

    controller: Literal["mellinger"]
    airframe: Literal["cf2x_L250", "cf2x_P250", "cf2x_T350", "cf21B_500"]
    dynamics: Literal["first_principles", "so_rpy", "so_rpy_rotor", "so_rpy_rotor_drag"]
    mass_kg: Positive
    kp_scale: Positive = 1.0
    kd_scale: Positive = 1.0


class AttitudeVehicle(Strict):
    """A vehicle that takes attitude commands from a position controller on the ground.

    On board, roll and pitch φ follow their command φ_c by φ'' = a (φ_c − φ) − b φ', and the height
    is held. On the ground, a = (p_r − p)/τ² + (2ζ/τ)(v_r − v) is the wanted acceleration; the tilt
    that gives it crosses the radio link in `link_delay_s`.
    """

    controller: Literal["offboard_pd"]
    mass_kg: Positive
    attitude_stiffness_1_s2: Positive
    attitude_damping_1_s: Positive
    drag_1_s: NonNegative
    link_delay_s: NonNegative
    time_constant_s: Positive
    damping_ratio: Positive
    tilt_max_rad: Annotated[float, Field(gt=0, le=0.8)]

    @property
    def link_ticks(self) -> int:
        """The radio link's delay in control periods."""
        return round(self.link_delay_s * CONTROL_HZ)

    @model_validator(mode="after")
    def _link_holds_the_delay(self) -> AttitudeVehicle:
        whole = abs(self.link_delay_s * CONTROL_HZ - self.link_ticks) < 1e-6
        if not whole or self.link_ticks >= LINK_TICKS:
            raise ValueError(
                f"link_delay_s must be a multiple of {1 / CONTROL_HZ:g} s "
                f"below {LINK_TICKS / CONTROL_HZ:g} s"
            )
        return self


class SensorNoise(Strict):
    """Standard deviations of what is recorded in flight, white from sample to sample.

    Motion capture: 2 mm with calibration and latency jitter, 10 mm/s after filtering the difference
    quotient. Tilt: markers about 0.1 m apart, each located to about 0.3 mm. The baseline controller
    flies on its own filtered estimate and does not see this noise.
    """

    position_m: NonNegative = 0.002
    velocity_m_s: NonNegative = 0.01
    tilt_rad: NonNegative = 0.005


class ReferenceLimits(Strict):
    """How far, fast and hard a test may drive the reference of either axis.

    The defaults keep every vehicle of `fleets/paper_quadrotors.toml` linear: within them a response
    differs from the one at a tenth of the amplitude by less than 0.02 in chordal distance.
    """

    amplitude_m: Positive = 0.3
    velocity_m_s: Positive = 0.6
    acceleration_m_s2: Positive = 1.6


class QuadrotorSettings(Strict):
    """One simulated quadrotor.

    Its reference is the position; with `velocity_reference` the controller also gets the
    reference's backward difference as wanted velocity, as a trajectory follower sends it.
    """

    vehicle: Annotated[MellingerVehicle | AttitudeVehicle, Field(discriminator="controller")]
    velocity_reference: bool = True
    noise: SensorNoise = SensorNoise()
    limits: ReferenceLimits = ReferenceLimits()
    # A room of 3 m. The paper flies at up to 0.9 m/s; 2 m/s² is a tilt of 12 degrees, within what
    # every vehicle of the fleet flies. A correction as fast as two thirds of the path's own speed
    # catches up with a lag; one that jumped would throw a vehicle over.
    tracking: TrackingLimits = TrackingLimits(
        position_max=1.5,
        speed_max=1.0,
        acceleration_max=2.0,
        correction_max=0.5,
        correction_speed_max=0.6,
    )
    omega_min_rad_s: Positive = 0.1  # the paper's band, Section VI-A
    omega_max_rad_s: Positive = 5.4
    flight_time_max_s: Positive = 420.0  # the smallest vehicle's battery: seven minutes
    # Of a sinusoid's start less than 0.3 % is left, on every vehicle and frequency of the fleet.
    settling_time_s: NonNegative = 4.0
