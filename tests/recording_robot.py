"""A robot that notes what its driver sees, motions of every kind for it, and robots at random."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from hypothesis import HealthCheck, reject, settings
from hypothesis import strategies as st
from learned_things import flown_before

from nufleet.robot_agent.flight.flights import performance_of
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.plan import plan_flight
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.robot_agent.motion.pace import HaltSwitch
from nufleet.robot_agent.motion.perform import AxisMotion, Performance, Played, perform
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.robots.spec import AxisSpec, RobotSpec, TrackingLimits
from nufleet.shared.wire.motions import Flight, RichFlight, StepTest, Tracking

Sensor = Callable[[int, FloatArray], FloatArray]
"""Makes what is read of an output (axes,) at a sample of the motion."""


class RecordingRobot(Robot):
    """Follows its references with a lag of first order, and notes them; rests at reference 0."""

    def __init__(
        self, spec: RobotSpec, *, noise: float = 0.0, rests_at: float = 0.0, seed: int = 0
    ) -> None:
        self._spec = spec
        self._rests_at = rests_at
        self._noise, self._rng = noise, np.random.default_rng(seed)
        self._share = 1 - np.exp(-6 * spec.sample_time_s / max(spec.settling_time_s, 1e-9))
        self._output = np.full(len(spec.axes), rests_at)
        self._measured: FloatArray | None = None
        self.sensor: Sensor = lambda k, output: output
        self.references: list[FloatArray] = []
        self.outputs: list[FloatArray] = []
        self.rests = 0

    @property
    def spec(self) -> RobotSpec:
        return self._spec

    @property
    def state_names(self) -> tuple[str, ...]:
        return ("position",)

    def connect(self) -> None:
        pass

    def measure_output(self) -> FloatArray:
        return self._output + self._noise * self._rng.standard_normal(len(self._output))

    def observe(self) -> FloatArray:
        if self._measured is None:
            noise = self._noise * self._rng.standard_normal(len(self._output))
            self._measured = self.sensor(len(self.references), self._output + noise)
        return self._measured[:, np.newaxis].copy()

    def step(self, reference: FloatArray) -> FloatArray:
        measured = self.observe()[:, 0]
        self._measured = None
        self.references.append(reference.copy())
        self.outputs.append(measured)
        self._output = self._output + self._share * (reference - self._output)
        return measured

    def rest(self) -> None:
        self.rests += 1
        self._output = np.full(len(self._spec.axes), self._rests_at)
        self._measured = None

    def disconnect(self) -> None:
        pass

    @property
    def seen(self) -> FloatArray:
        """The references that the driver saw, shape (samples, axes)."""
        return np.array(self.references).reshape(-1, len(self._spec.axes))


@st.composite
def specs(draw: st.DrawFn, *, tracks: bool | None = None) -> RobotSpec:
    """Robots of 1 ms to 1 s samples, slow and fast, of one to six axes, that track or do not."""
    sample_time_s = draw(st.sampled_from([0.001, 0.005, 0.02, 0.1, 1.0]))
    # Three decades around a second, as far as the samples resolve it; a test of few thousand.
    slowness_s = sample_time_s * draw(st.sampled_from([5.0, 20.0, 100.0]))
    omega_max = draw(st.floats(0.05, 0.6)) / slowness_s * 5
    velocity = draw(st.floats(0.05, 5.0))
    acceleration = draw(st.floats(0.2, 5.0)) * velocity / slowness_s
    axes = tuple(
        AxisSpec(
            name=name,
            unit="m",
            amplitude_max=draw(st.floats(0.5, 20.0)) * velocity * slowness_s,
            velocity_max=velocity,
            acceleration_max=acceleration,
        )
        # Six axes at 1 kHz take a test a minute.
        for name in "abcdef"[: draw(st.integers(1, 6 if sample_time_s > 0.001 else 1))]
    )
    limits = TrackingLimits(
        position_max=draw(st.floats(2.0, 20.0)) * velocity * slowness_s,
        speed_max=velocity,
        acceleration_max=acceleration,
        correction_max=draw(st.floats(0.05, 1.0)) * velocity * slowness_s,
        correction_speed_max=draw(st.floats(0.1, 1.0)) * velocity,
    )
    return RobotSpec(
        kind="recording",
        axes=axes,
        sample_time_s=sample_time_s,
        omega_min_rad_s=omega_max / draw(st.sampled_from([3.0, 30.0])),
        omega_max_rad_s=min(omega_max, 3.0 / sample_time_s),
        duration_max_s=1e9,
        settling_time_s=draw(st.sampled_from([0.0, 0.3, 1.0])) * slowness_s,
        simulated=True,
        tracking=limits if (draw(st.booleans()) if tracks is None else tracks) else None,
    )


def layout_of(spec: RobotSpec) -> InverseLayout:
    return InverseLayout(
        architecture="state",
        states=("position",),
        sample_time_s=spec.sample_time_s,
        horizon_samples=5,
    )


def baselines(spec: RobotSpec) -> Memory:
    memory = Memory(None)
    memory.learn(flown_before(spec))
    return memory


def performed(
    robot: Robot,
    motion: Flight | Excitation,
    memory: Memory | None = None,
    *,
    realtime: float | None = None,
) -> Played:
    """Plan and perform a motion as an agent does; a refusal is the caller's.

    Motions of more samples than a test has time for are rejected where hypothesis chose them.
    """
    memory, switch, spec = memory or Memory(None), HaltSwitch(), robot.spec
    if isinstance(motion, Excitation):
        plan = plan_excitation(motion, spec, "robot")
        if plan.samples > 100_000:
            reject()
        performance: Performance = AxisMotion(
            robot,
            [played.axis for played in plan.played],
            reference_of(plan),
            realtime=realtime,
            switch=switch,
            on_samples=lambda *_: None,
        )
    else:
        flight = plan_flight(motion, spec, robot.state_names, memory, "robot", allow_unguarded=True)
        if flight.duration_s / spec.sample_time_s > 100_000:
            reject()
        performance = performance_of(
            motion,
            robot,
            memory,
            realtime=realtime,
            switch=switch,
            on_played=lambda samples: None,
            watch=lambda *_: None,
        )
    return perform(robot, performance, switch, on_resting=lambda: None)


MOTIONS: dict[str, Callable[[RobotSpec], Flight | Excitation]] = {
    "excitation": lambda spec: Excitation(
        axis=spec.axes[-1].name, tones=(Tone(omega_rad_s=1.5),), settle_s=4.0
    ),
    "step test": lambda spec: StepTest(axis=spec.axes[-1].name),
    "rich flight": lambda spec: RichFlight(duration_s=60.0, seed=3),
    "path": lambda spec: Tracking(desired=PATH, inverse="baseline"),
    "path, guarded": lambda spec: Tracking(
        desired=PATH, inverse="zero-prior", layout=layout_of(spec)
    ),
}

SPEC = RobotSpec(
    kind="recording",
    axes=tuple(
        AxisSpec(name=name, unit="m", amplitude_max=1.0, velocity_max=1.0, acceleration_max=2.0)
        for name in ("x", "y")
    ),
    sample_time_s=0.02,
    omega_min_rad_s=0.1,
    omega_max_rad_s=6.0,
    duration_max_s=500.0,
    settling_time_s=0.5,
    simulated=True,
    tracking=TrackingLimits(
        position_max=1.5,
        speed_max=1.0,
        acceleration_max=2.0,
        correction_max=0.5,
        correction_speed_max=0.6,
    ),
)

PATH = travel(np.array([[-0.9, 0.7], [0.8, -0.8], [0.9, 0.9], [-0.9, 0.6]]), 0.8, 1.2, 0.02)
"""Its start is 1.1 m from where the robot rests."""


PROPERTY = settings(
    max_examples=20,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
