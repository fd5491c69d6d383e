"""Crazyflies that rotorpy simulates: same controller, another mass, other gains."""

import numpy as np
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.trajectories.hover_traj import HoverTraj
from rotorpy.vehicles.crazyflie_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

from nufleet import AxisSpec, Robot, RobotError, RobotSpec, SeparateRobots, Settings, TrackingLimits

SAMPLE_TIME_S, CONTROLS = 0.02, 2  # the controller runs at 100 Hz
INTEGRATOR = {"method": "RK23", "first_step": SAMPLE_TIME_S / CONTROLS}  # enough, and faster
LIMITS = {"amplitude_max": 0.3, "velocity_max": 0.6, "acceleration_max": 2.0}
CORRECTIONS = {"correction_max": 0.5, "correction_speed_max": 0.6}
SPEC = RobotSpec(
    kind="rotorpy_drone",
    axes=tuple(AxisSpec(name=name, unit="m", **LIMITS) for name in ("x", "y")),
    sample_time_s=SAMPLE_TIME_S,
    omega_min_rad_s=0.2,
    omega_max_rad_s=12.0,
    duration_max_s=300.0,
    settling_time_s=4.0,
    simulated=True,
    tracking=TrackingLimits(position_max=2.0, speed_max=1.0, acceleration_max=2.0, **CORRECTIONS),
)


class DroneSettings(Settings):
    mass: float = 1.0  # relative to the mass that the controller was designed for
    stiffness: float = 1.0  # of its position loop, relative to rotorpy's


class Drone(Robot):
    spec, state_names = SPEC, ("position", "velocity")

    def __init__(self, settings, rng):
        self.rng, self.state = rng, None
        mass = settings.mass * quad_params["mass"]
        self.vehicle = Multirotor(quad_params | {"mass": mass}, integrator_kwargs=INTEGRATOR)
        self.controller = SE3Control(quad_params)
        self.controller.kp_pos = settings.stiffness * self.controller.kp_pos

    def connect(self):
        still = {name: np.zeros(3) for name in ("x", "v", "w", "wind")}
        speeds = np.full(4, np.sqrt(self.vehicle.mass * 9.81 / 4 / self.vehicle.k_eta))
        self.state = still | {"q": np.array([0.0, 0.0, 0.0, 1.0]), "rotor_speeds": speeds}
        self.rest()

    def measure_output(self):
        if self.state is None:
            raise RobotError("the drone is not connected")
        self.measured = self.state["x"][:2] + 5e-4 * self.rng.standard_normal(2)
        return self.measured

    def observe(self):
        return np.column_stack([self.measured, self.state["v"][:2]])

    def step(self, reference):
        measured = self.measured if self.state else self.measure_output()
        wanted = HoverTraj(np.append(reference, 0.0)).update(0.0)
        for _ in range(CONTROLS):
            command = self.controller.update(0.0, self.state, wanted)
            self.state = self.vehicle.step(self.state, command, SAMPLE_TIME_S / CONTROLS)
        self.measure_output()
        return measured

    def rest(self):
        for share in np.linspace(1.0, 0.0, 50):
            self.measure_output()
            self.step(share * self.state["x"][:2])
        while np.abs(self.state["x"][:2]).max() + np.abs(self.state["v"]).max() > 2e-3:
            self.step(np.zeros(2))

    def disconnect(self):
        self.state = None


DRIVER = SeparateRobots(DroneSettings, Drone)
