"""The settings of a simulated quadrotor: vehicle, controller, sensor noise and limits."""

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
    """A Crazyflie with the firmware's Mellinger controller on board, whose gains yield forces.

    As in real flight, the controller assumes its built-in mass, independently of `mass_kg`.
    """

    controller: Literal["mellinger"]
    """Discriminator of the vehicle's type."""

    airframe: Literal["cf2x_L250", "cf2x_P250", "cf2x_T350", "cf21B_500"]
    """Name of crazyflow's identified parameters."""

    dynamics: Literal["first_principles", "so_rpy", "so_rpy_rotor", "so_rpy_rotor_drag"]
    """crazyflow's model: a rigid body with rotors (`first_principles`), or a fitted second-order
    attitude response (the others)."""

    mass_kg: Positive
    """True mass of the vehicle."""

    kp_scale: Positive = 1.0
    """Factor on the firmware's horizontal position gains."""

    kd_scale: Positive = 1.0
    """Factor on the firmware's horizontal velocity gains."""


class AttitudeVehicle(Strict):
    """A vehicle that takes attitude commands from a position controller on the ground.

    On board, roll and pitch φ follow their command φ_c by φ'' = k (φ_c − φ) − d φ', and the height
    is held. The ground controller computes the wanted acceleration
    a = (p_r − p)/τ² + (2ζ/τ)(v_r − v); the tilt that yields it crosses the radio link.
    """

    controller: Literal["offboard_pd"]
    """Discriminator of the vehicle's type."""

    mass_kg: Positive
    """Mass of the vehicle."""

    attitude_stiffness_1_s2: Positive
    """Stiffness k of the on-board attitude loop."""

    attitude_damping_1_s: Positive
    """Damping d of the on-board attitude loop."""

    drag_1_s: NonNegative
    """Linear drag: deceleration per velocity."""

    link_delay_s: NonNegative
    """Delay of the radio link, a multiple of the control period."""

    time_constant_s: Positive
    """Time constant τ of the position controller."""

    damping_ratio: Positive
    """Damping ratio ζ of the position controller."""

    tilt_max_rad: Annotated[float, Field(gt=0, le=0.8)]
    """Largest tilt that the position controller commands about either axis."""

    @property
    def link_ticks(self) -> int:
        """Delay of the radio link in control periods."""
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


class Air(Strict):
    """The air that a vehicle flies through: drag that grows with the square of the airspeed, gusts.

    The force on the vehicle is −½ ρ C_D A |v − w| (v − w), with its velocity v and the wind w. The
    wind is horizontal; each of its components is a first-order Gauss-Markov process, as the
    longitudinal gusts of the Dryden model are (MIL-F-8785C).
    """

    drag_area_m2: NonNegative
    """Drag coefficient times frontal area, C_D A."""

    gust_std_m_s: NonNegative = 0.0
    """Standard deviation of either component of the wind."""

    gust_time_s: Positive = 1.0
    """Time in which the correlation of the wind with itself falls to 1/e."""


class SensorNoise(Strict):
    """Standard deviations of the states recorded in flight, white from sample to sample.

    The defaults describe a motion capture system. The baseline controller flies on its own
    filtered estimate and does not see this noise.
    """

    position_m: NonNegative = 0.002
    """Position noise, including calibration and latency jitter."""

    velocity_m_s: NonNegative = 0.01
    """Velocity noise, after filtering the difference quotient of the position."""

    tilt_rad: NonNegative = 0.005
    """Tilt noise, from markers about 0.1 m apart that are each located to about 0.3 mm."""


class ReferenceLimits(Strict):
    """Limits on the reference of a frequency test on either axis.

    The defaults keep every vehicle of `fleets/paper_quadrotors.toml` linear: within them a response
    differs from the one at a tenth of the amplitude by less than 0.02 in chordal distance.
    """

    amplitude_m: Positive = 0.3
    """Largest amplitude."""

    velocity_m_s: Positive = 0.6
    """Largest velocity."""

    acceleration_m_s2: Positive = 1.6
    """Largest acceleration."""


class HeightAndHeading(Strict):
    """Limits on the references of height and heading.

    The height of a Crazyflie is stiffer than its position, and its heading is turned by the drag of
    the rotors alone, whose torque is small.
    """

    height_amplitude_m: Positive = 0.2
    """Largest amplitude of the height, about the hovering height."""

    height_velocity_m_s: Positive = 0.4
    """Largest velocity of the height."""

    height_acceleration_m_s2: Positive = 1.2
    """Largest acceleration of the height."""

    heading_amplitude_rad: Positive = 0.4
    """Largest amplitude of the heading."""

    heading_velocity_rad_s: Positive = 0.6
    """Largest angular velocity of the heading."""

    heading_acceleration_rad_s2: Positive = 1.6
    """Largest angular acceleration of the heading."""


class QuadrotorSettings(Strict):
    """One simulated quadrotor.

    Its reference is the horizontal position, and height and heading where they have limits.
    """

    vehicle: Annotated[MellingerVehicle | AttitudeVehicle, Field(discriminator="controller")]
    """Vehicle and its baseline controller."""

    air: Air | None = None
    """Air that resists the vehicle beyond what its own dynamics contain; None for air at rest."""

    velocity_reference: bool = True
    """Whether the controller also receives the reference's backward difference as the wanted
    velocity, as a trajectory follower would send it."""

    delay_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Time by which every reference reaches the controller late, as over a radio link; between
    samples, the reference changes linearly."""

    noise: SensorNoise = SensorNoise()
    """Measurement noise of the recorded states."""

    limits: ReferenceLimits = ReferenceLimits()
    """Limits on frequency tests."""

    height_and_heading: HeightAndHeading | None = None
    """Limits on height and heading, which are axes `z` and `yaw` then; None to hold both. Only the
    Mellinger controller takes them. A vehicle with these axes, which differ in their units, takes
    frequency tests only, and no paths."""

    # The room is 3 m wide. The paper flies at up to 0.9 m/s; 2 m/s² needs a tilt of 12 degrees,
    # which every vehicle of the fleet can fly. A correction at about two thirds of the path's own
    # speed catches up with a lag; one that jumped would overturn a vehicle.
    tracking: TrackingLimits = TrackingLimits(
        position_max=1.5,
        speed_max=1.0,
        acceleration_max=2.0,
        correction_max=0.5,
        correction_speed_max=0.6,
    )
    """Limits on tracked paths and their corrections, in m and s."""

    omega_min_rad_s: Positive = 0.1  # the paper's band, Section VI-A
    """Lower edge of the band for frequency tests."""

    omega_max_rad_s: Positive = 5.4
    """Upper edge of the band for frequency tests."""

    flight_time_max_s: Positive = 420.0  # the smallest vehicle's battery: seven minutes
    """Longest motion that the robot accepts."""

    # After this time less than 0.3 % of a sinusoid's initial transient is left, on every vehicle
    # of the fleet and at every frequency.
    settling_time_s: NonNegative = 4.0
    """Time in which the vehicle settles after a change of its reference."""

    @property
    def axes(self) -> int:
        """Number of axes."""
        return 2 if self.height_and_heading is None else 4

    @model_validator(mode="after")
    def _follows_height_and_heading(self) -> QuadrotorSettings:
        if self.height_and_heading is not None and self.vehicle.controller != "mellinger":
            raise ValueError(
                "height_and_heading needs the controller 'mellinger': the other one holds the "
                "height and the heading on board"
            )
        return self
