"""A faulty robot fails in the way its settings say, at the samples they say, repeatably."""

from __future__ import annotations

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from polling import PATIENCE_S
from pydantic import ValidationError

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import FleetFileError, RobotError
from nufleet.shared.robots.fleet_file import validated_settings
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings
from nufleet.sims.faulty_robot import EXIT_CODE, FAULTY, FaultyRobot, FaultyRobotSettings

INNER = {"alpha": 1.0, "beta": 0.003, "noise_std_m": 0.001}
REFERENCES = np.sin(0.1 * np.arange(300))[:, np.newaxis]

SENSOR_FAULTS: dict[str, dict[str, Any]] = {
    "not-a-number": {"probability": 0.1},
    "infinite": {"probability": 0.1},
    "frozen": {"from_sample": 40, "samples": 30},
    "frozen, noisily": {"kind": "frozen", "from_s": 0.6, "noise": 0.01},
    "saturated": {"low": -0.4, "high": 0.3},
    "noisy": {"std": 0.1, "from_sample": 17},
    "spikes": {"probability": 0.05, "height": 3.0},
    "spikes to one level": {
        "kind": "spikes",
        "probability": 0.05,
        "height": 9.0,
        "replace": True,
    },
    "late": {"late_max": 4},
    "late by a constant": {"kind": "late", "late_min": 3, "late_max": 3},
    "held": {"probability": 0.1, "run": 5},
}
kinds = pytest.mark.parametrize("kind", SENSOR_FAULTS)


def faulty(*faults: dict[str, Any], seed: int = 0) -> FaultyRobot:
    document = {"driver": "double_integrator", "settings": INNER, "faults": faults}
    settings = FaultyRobotSettings.model_validate_json(json.dumps(document))
    robot = FAULTY.build({"a": settings}, np.random.default_rng(seed))["a"]
    robot.connect()
    return robot


def sensor_fault(kind: str) -> dict[str, Any]:
    return {"kind": kind, **SENSOR_FAULTS[kind]}


def healthy(seed: int = 0) -> Robot:
    (rng,) = np.random.default_rng(seed).spawn(1)
    robot = DoubleIntegrator(DoubleIntegratorSettings.model_validate(INNER), rng)
    robot.connect()
    return robot


def test_without_faults_it_measures_what_the_robot_inside_does() -> None:
    assert np.array_equal(faulty().run(REFERENCES), healthy().run(REFERENCES))
    assert faulty().spec == healthy().spec


@kinds
def test_the_same_generator_gives_the_same_faults_and_another_one_others(kind: str) -> None:
    one, again = (faulty(sensor_fault(kind), seed=3).run(REFERENCES) for _ in range(2))
    assert np.array_equal(one, again, equal_nan=True)
    assert not np.array_equal(one, healthy(seed=3).run(REFERENCES), equal_nan=True)


@given(
    st.sampled_from(sorted(SENSOR_FAULTS)),
    st.lists(st.integers(0, 299), max_size=5),
    st.sets(st.integers(0, 299)),
)
def test_samples_one_by_one_are_those_of_a_batch_looked_at_or_not(
    kind: str, cuts: list[int], looked_at: set[int]
) -> None:
    at_once = faulty(sensor_fault(kind)).run(REFERENCES)
    robot = faulty(sensor_fault(kind))
    parts: list[FloatArray] = []
    edges = sorted({0, 300, *cuts})
    for start, end in pairwise(edges):
        if start in looked_at:
            seen = robot.observe()[:, 0]
            assert np.array_equal(seen, at_once[start], equal_nan=True)
        parts.append(robot.run(REFERENCES[start:end]))
    assert np.array_equal(np.concatenate(parts), at_once, equal_nan=True)


def test_a_fault_acts_in_its_motion_and_window_only() -> None:
    robot = faulty({"kind": "not-a-number", "motion": 2, "from_sample": 100, "samples": 7})
    for motion in (1, 2, 3):
        bad = np.isnan(robot.run(REFERENCES)[:, 0])
        expected = range(100, 107) if motion == 2 else range(0)
        assert np.flatnonzero(bad).tolist() == list(expected)
        robot.rest()


def test_faults_on_the_clock_begin_and_end_by_the_robots_time() -> None:
    robot = faulty({"kind": "infinite", "from_s": 1.5, "for_s": 0.3})
    assert np.flatnonzero(np.isinf(robot.run(REFERENCES)[:, 0])).tolist() == list(range(100, 120))


def test_each_sensor_fault_does_what_it_is_called() -> None:
    y = healthy().run(REFERENCES)[:, 0]

    def measured(**fault: Any) -> FloatArray:
        out: FloatArray = faulty(fault).run(REFERENCES)[:, 0]
        return out

    assert np.array_equal(measured(kind="saturated", low=-0.2, high=0.1), np.clip(y, -0.2, 0.1))
    frozen = measured(kind="frozen", from_sample=50)
    assert np.array_equal(frozen[:50], y[:50])
    assert (frozen[50:] == y[49]).all()
    trembling = measured(kind="frozen", from_sample=50, noise=0.01)[50:] - y[49]
    assert 0.005 < np.std(trembling) < 0.02
    off = measured(kind="spikes", probability=0.1, height=5.0) - y
    assert set(np.round(off, 9)) == {-5.0, 0.0, 5.0}
    assert 10 < np.count_nonzero(off) < 60
    level = measured(kind="spikes", probability=0.1, height=5.0, replace=True)
    assert 10 < np.count_nonzero(level == 5.0) < 60
    late = measured(kind="late", late_min=3, late_max=3)
    assert np.array_equal(late[3:], y[:-3])
    jittering = measured(kind="late", late_max=4)[4:]
    drawn = np.array([np.flatnonzero(y[k : k + 5] == v)[0] for k, v in enumerate(jittering)])
    assert set(drawn) == {0, 1, 2, 3, 4}
    held = measured(kind="held", probability=0.05, run=4)
    missing = held != y
    assert 10 < missing.sum() < 150
    repeats = np.flatnonzero(missing)
    assert (held[repeats] == held[repeats - 1]).all()


def test_a_driver_that_gets_no_sample_says_so_after_those_before() -> None:
    robot = faulty({"kind": "drop-out", "from_sample": 120})
    with pytest.raises(RobotError, match="no sample 120"):
        robot.run(REFERENCES)
    # The robot inside moved up to there and no further.
    twin = healthy()
    twin.run(REFERENCES[:120])
    robot.rest()
    twin.rest()
    assert np.array_equal(robot.run(REFERENCES[:120]), twin.run(REFERENCES[:120]))


def test_a_driver_that_breaks_raises_what_no_driver_should() -> None:
    with pytest.raises(OSError, match="failed at sample 7"):
        faulty({"kind": "crash", "way": "raises", "from_sample": 7}).run(REFERENCES)


def in_a_process_of_its_own(fault: dict[str, Any]) -> subprocess.Popen[str]:
    """A process whose robot fails at its sixth sample."""
    document = {"driver": "double_integrator", "settings": INNER, "faults": [fault]}
    program = f"""
import numpy as np
from nufleet.sims.faulty_robot import FAULTY, FaultyRobotSettings
settings = FaultyRobotSettings.model_validate_json({json.dumps(document)!r})
robot = FAULTY.build({{"a": settings}}, np.random.default_rng(0))["a"]
robot.connect()
robot.run(np.zeros((5, 1)))
print("five samples", flush=True)
robot.step(np.zeros(1))
print("six")
"""
    return subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)


def test_a_driver_that_crashes_takes_its_process_along() -> None:
    with in_a_process_of_its_own({"kind": "crash", "way": "exits", "from_sample": 5}) as process:
        said, _ = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, said) == (EXIT_CODE, "five samples\n")


def test_a_driver_that_hangs_returns_late_or_never() -> None:
    late = faulty({"kind": "hang", "from_sample": 5, "samples": 1, "hang_s": 0.05})
    assert np.array_equal(late.run(REFERENCES), healthy().run(REFERENCES))
    with in_a_process_of_its_own({"kind": "hang", "from_sample": 5}) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "five samples\n"
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(0.2)
        finally:
            process.kill()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"driver": "no_such"}, "unknown driver 'no_such'"),
        ({"driver": "quadrotor"}, "can be made faulty"),
        ({"settings": {"alpha": -1.0, "beta": 0.0}}, "alpha"),
        ({"faults": [{"kind": "gremlins"}]}, "gremlins"),
        ({"faults": [{"kind": "saturated", "low": 1.0, "high": 0.0}]}, "low must be below high"),
        ({"faults": [{"kind": "late", "late_min": 3, "late_max": 2}]}, "late_min 3 exceeds"),
        ({"faults": [{"kind": "frozen", "from_s": 1.0, "from_sample": 4}]}, "not both"),
        ({"faults": [{"kind": "frozen", "for_s": 1.0, "samples": 4}]}, "not both"),
    ],
)
def test_settings_that_cannot_be_are_refused_in_words(change: dict[str, Any], said: str) -> None:
    document = {"driver": "double_integrator", "settings": INNER, "faults": []}
    with pytest.raises(ValidationError, match=said):
        FaultyRobotSettings.model_validate_json(json.dumps({**document, **change}))
    with pytest.raises(FleetFileError, match=r"fleet\.toml: robots\.a\.settings"):
        validated_settings(FaultyRobotSettings, Path("fleet.toml"), "a", {**document, **change})
