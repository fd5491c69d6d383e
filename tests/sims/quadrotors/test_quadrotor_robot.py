"""A simulated quadrotor measures, rests, crashes and repeats itself as a robot in a lab would."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError, RobotError
from nufleet.shared.robots.drivers import RobotDriver
from nufleet.sims.quadrotors.driver import DRIVER
from nufleet.sims.quadrotors.environment import environment
from nufleet.sims.quadrotors.flight import CHUNK_SAMPLES
from nufleet.sims.quadrotors.robot import Quadrotor
from nufleet.sims.quadrotors.settings import QuadrotorSettings, SensorNoise

Respond = Callable[[Robot, float, int], complex]
Chordal = Callable[[complex, complex], float]

SILENCE = SensorNoise(position_m=0.0, velocity_m_s=0.0, tilt_rad=0.0)

FLEET = ["target", "source-1", "source-2", "source-3", "source-4", "source-5"]

# ψ to the target at some frequencies [rad/s], measured when the fleet was fixed (see its file).
MEASURED = {
    "source-1": {1.0: 0.007, 3.0: 0.047, 4.3: 0.084, 5.4: 0.115},
    "source-2": {1.0: 0.016, 3.0: 0.024, 4.3: 0.105, 5.4: 0.188},
    "source-3": {1.0: 0.072, 3.0: 0.176, 4.3: 0.235, 5.4: 0.313},
    "source-4": {1.0: 0.047, 3.0: 0.146, 4.3: 0.164, 5.4: 0.162},
    "source-5": {1.0: 0.089, 3.0: 0.369, 4.3: 0.610, 5.4: 0.697},
}


def sinusoid(seconds: float, omega_rad_s: float, amplitude_m: float) -> FloatArray:
    times_s = np.arange(0, seconds, 0.02)
    references = np.zeros((len(times_s), 2))
    references[:, 0] = amplitude_m * np.sin(omega_rad_s * times_s)
    return references


def test_the_driver_is_one(paper_settings: dict[str, QuadrotorSettings]) -> None:
    driver: RobotDriver = DRIVER
    assert driver.shares_process
    assert all(isinstance(entry, driver.settings) for entry in paper_settings.values())


@pytest.mark.parametrize("name", FLEET)
def test_a_quadrotor_describes_itself_as_the_papers_setup_does(
    name: str, built: Mapping[str, Robot]
) -> None:
    spec = built[name].spec
    assert [(axis.name, axis.unit) for axis in spec.axes] == [("x", "m"), ("y", "m")]
    assert (spec.omega_min_rad_s, spec.omega_max_rad_s) == (0.1, 5.4)
    assert spec.sample_time_s == 0.02
    assert spec.simulated
    assert built[name].state_names == ("position", "velocity", "tilt")


@pytest.mark.parametrize("name", FLEET)
def test_a_minute_of_flight_is_a_few_calls_of_a_compiled_program(
    name: str, fresh: Callable[[str], Robot], monkeypatch: pytest.MonkeyPatch
) -> None:
    """How long they take is measured by `python -m benchmarks.simulators`."""
    robot = fresh(name)
    assert isinstance(robot, Quadrotor)
    calls: list[int] = []
    advance = robot._flight._advance

    def counted(plant: object, references: object, count: int) -> object:
        calls.append(int(count))
        return advance(plant, references, count)

    monkeypatch.setattr(robot._flight, "_advance", counted)
    robot.run(sinusoid(60.0, 2.0, 0.2))
    assert sum(calls) == 3000
    assert len(calls) == math.ceil(3000 / CHUNK_SAMPLES)


@pytest.mark.parametrize("source", list(MEASURED))
def test_the_distances_to_the_target_are_what_they_were_when_the_fleet_was_fixed(
    source: str, fresh: Callable[[str], Robot], respond: Respond, chordal: Chordal
) -> None:
    for omega, expected in MEASURED[source].items():
        z_target = respond(fresh("quiet-target"), omega, 0)
        z_source = respond(fresh(f"quiet-{source}"), omega, 0)
        assert chordal(z_target, z_source) == pytest.approx(expected, abs=0.003), omega


@pytest.mark.parametrize("name", FLEET)
def test_both_axes_respond_alike_as_the_paper_assumes(
    name: str, fresh: Callable[[str], Robot], respond: Respond, chordal: Chordal
) -> None:
    robot = fresh(f"quiet-{name}")
    for omega in (0.5, 3.0, 5.4):
        assert chordal(respond(robot, omega, 0), respond(robot, omega, 1)) < 0.01


@pytest.mark.parametrize("name", FLEET)
def test_within_the_limits_of_a_test_the_response_is_linear(
    name: str, fresh: Callable[[str], Robot], chordal: Chordal
) -> None:
    robot = fresh(f"quiet-{name}")
    limits = robot.spec.axes[0]
    for omega in (2.0, 3.5, 5.4):
        amplitude_m = min(limits.velocity_max / omega, limits.acceleration_max / omega**2)
        phasors = []
        for share in (1.0, 0.1):
            references = sinusoid(16.0, omega, share * amplitude_m)
            outputs = robot.run(references)[500:, 0]
            robot.rest()
            carrier = np.exp(-1j * omega * np.arange(500, 800) * 0.02)
            columns = np.stack([carrier.real, carrier.imag, np.ones(300)], axis=1)
            c, s, _ = np.linalg.lstsq(columns, outputs, rcond=None)[0]
            phasors.append((c + 1j * s) / (share * amplitude_m))
        assert chordal(complex(phasors[0]), complex(phasors[1])) < 0.02, omega


@pytest.mark.parametrize("name", FLEET)
def test_a_transient_is_gone_after_the_settling_time(
    name: str, fresh: Callable[[str], Robot]
) -> None:
    robot = fresh(f"quiet-{name}")
    for omega in (1.0, 3.5, 5.4):
        amplitude_m = 1.0 / omega**2 if omega > 2 else 0.2
        references = sinusoid(60.0, omega, amplitude_m)
        references[:100] *= (0.5 - 0.5 * np.cos(np.pi * np.arange(100) / 100))[:, np.newaxis]
        outputs = robot.run(references)[:, 0]
        robot.rest()
        phase = omega * np.arange(3000) * 0.02
        columns = np.stack([np.cos(phase), np.sin(phase), np.ones(3000)], axis=1)
        late = slice(2000, 3000)
        steady = columns @ np.linalg.lstsq(columns[late], outputs[late], rcond=None)[0]
        settled = 100 + round(robot.spec.settling_time_s / 0.02)
        left = np.abs(outputs - steady)[settled : settled + 50].max() / amplitude_m
        rounding = np.abs(outputs - steady)[late].max() / amplitude_m
        assert left < 0.003 + rounding, omega


def test_robots_of_one_process_fly_at_the_same_time_without_touching_each_other(
    fresh: Callable[[str], Robot],
) -> None:
    references = sinusoid(10.0, 2.0, 0.2)
    names = [f"quiet-{name}" for name in FLEET]
    alone = [fresh(name).run(references) for name in names]
    robots = [fresh(name) for name in names]
    with ThreadPoolExecutor(len(robots)) as pool:
        together = list(pool.map(lambda robot: robot.run(references), robots))
    np.testing.assert_array_equal(together, alone)


def test_what_is_observed_is_a_noisy_state_and_the_next_output(
    fresh: Callable[[str], Robot],
) -> None:
    noisy, quiet = fresh("target"), fresh("quiet-target")
    errors = []
    for reference in sinusoid(20.0, 2.0, 0.2):
        seen, true = noisy.observe(), quiet.observe()
        errors.append(seen - true)
        np.testing.assert_array_equal(noisy.step(reference), seen[:, 0])
        np.testing.assert_array_equal(quiet.step(reference), true[:, 0])
    spread = np.std(errors, axis=0)
    np.testing.assert_allclose(spread, np.tile([0.002, 0.01, 0.005], (2, 1)), rtol=0.1)


@pytest.mark.parametrize("name", FLEET)
def test_the_velocity_is_that_of_the_position_and_tilt_accelerates(
    name: str, fresh: Callable[[str], Robot]
) -> None:
    robot = fresh(f"quiet-{name}")
    references = sinusoid(10.0, 2.0, 0.2)
    references[:, 1] = np.roll(references[:, 0], 40)
    states = []
    for reference in references:
        states.append(robot.observe())
        robot.step(reference)
    position, velocity, tilt = np.moveaxis(np.array(states)[100:], 2, 0)
    change = (position[2:] - position[:-2]) / 0.04
    np.testing.assert_allclose(change, velocity[1:-1], atol=0.01)
    acceleration = (velocity[2:] - velocity[:-2]) / 0.04
    for axis in (0, 1):
        slope = np.polyfit(tilt[1:-1, axis], acceleration[:, axis], 1)[0]
        assert slope == pytest.approx(9.81, rel=0.25)


def test_the_same_seed_measures_the_same_and_another_something_else(
    paper_settings: dict[str, QuadrotorSettings], built: Mapping[str, Robot]
) -> None:
    original = built["source-3"]
    assert isinstance(original, Quadrotor)

    def outputs(seed: int) -> FloatArray:
        twin = Quadrotor(
            "twin",
            paper_settings["source-3"],
            original._flight,
            original._fresh_plant,
            np.random.default_rng(seed),
        )
        twin.connect()
        return twin.run(sinusoid(2.0, 2.0, 0.1))

    np.testing.assert_array_equal(outputs(11), outputs(11))
    assert np.abs(outputs(11) - outputs(12)).max() > 0.001


@pytest.mark.parametrize("late", [2.0, 2.5])
def test_references_arrive_late_by_the_delay_however_they_are_split(
    late: float, paper_settings: dict[str, QuadrotorSettings], fresh: Callable[[str], Robot]
) -> None:
    quiet = paper_settings["target"].model_copy(update={"noise": SILENCE, "delay_s": late * 0.02})
    delayed = DRIVER.build({"late": quiet}, np.random.default_rng(0))["late"]
    delayed.connect()
    references = sinusoid(2.0, 3.0, 0.1)
    samples = np.arange(len(references))
    arriving = np.zeros_like(references)
    arriving[:, 0] = np.interp(samples - late, samples, references[:, 0])
    pieces = [delayed.step(references[0])[np.newaxis], delayed.run(references[1:40])]
    measured = np.concatenate([*pieces, delayed.run(references[40:])])
    np.testing.assert_allclose(measured, fresh("quiet-target").run(arriving), atol=1e-6)


@pytest.mark.parametrize("name", FLEET)
def test_resting_brings_a_vehicle_back_to_hover_at_the_origin(
    name: str, fresh: Callable[[str], Robot]
) -> None:
    robot = fresh(f"quiet-{name}")
    robot.run(sinusoid(8.5, 1.3, 0.3))
    assert np.abs(robot.observe()[:, 0]).max() > 0.02
    robot.rest()
    assert np.abs(robot.observe()[:, :2]).max() < 0.02


@pytest.mark.parametrize("name", ["target", "source-2"])
def test_a_crash_is_found_told_and_ended_by_connecting_anew(
    name: str, fresh: Callable[[str], Robot]
) -> None:
    robot = fresh(name)
    with pytest.raises(RobotError, match=rf"{name} crashed .* s into its motion: height"):
        robot.run(sinusoid(60.0, 5.4, 1.0))
    with pytest.raises(RobotError, match="reconnected"):
        robot.rest()
    robot.connect()
    assert np.abs(robot.observe()[:, 0]).max() < 0.02
    robot.rest()


def test_without_velocity_reference_a_vehicle_follows_later(
    fresh: Callable[[str], Robot], respond: Respond
) -> None:
    lag = respond(fresh("position-source-3"), 1.0, 0) / respond(fresh("quiet-source-3"), 1.0, 0)
    # The loop's numerator is kp instead of kd s + kp: arctan(kd ω / kp) = 45° for kd = kp = 4.
    assert np.degrees(np.angle(lag)) == pytest.approx(-45, abs=3)


def test_the_environment_of_the_process_is_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/cache")
    declared = DRIVER.environment
    assert declared == environment()
    assert declared["SCIPY_ARRAY_API"] == "1"
    assert declared["JAX_COMPILATION_CACHE_DIR"].startswith("/cache/nufleet/jax-")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr("pathlib.Path.home", _homeless)
    assert "JAX_COMPILATION_CACHE_DIR" not in DRIVER.environment


def _homeless() -> None:
    raise RuntimeError("Could not determine home directory.")


def test_a_scipy_without_its_array_interface_is_refused_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from scipy.spatial.transform import Rotation

    # What SciPy does when it was imported before the variable was set: it answers with NumPy.
    class NumpyRotation:
        @staticmethod
        def from_quat(quaternion: object) -> Rotation:
            return Rotation.from_quat(np.asarray(quaternion))

    monkeypatch.setattr("scipy.spatial.transform.Rotation", NumpyRotation)
    with pytest.raises(InvalidInputError, match="SCIPY_ARRAY_API=1"):
        DRIVER.build({}, np.random.default_rng(0))
