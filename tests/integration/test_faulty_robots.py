"""A robot that fails gives a failed test with a reason, never a wrong number, and is at rest."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fleet_lab import Gate, Lab, Orchestrator, refusal
from kept_study import trial_log
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot, puppet_spec

from nufleet.orchestrator.conduct.attempts import ATTEMPTS
from nufleet.orchestrator.conduct.dispatcher import Dispatcher
from nufleet.orchestrator.conduct.replay import round_of
from nufleet.orchestrator.study.interface import Question
from nufleet.orchestrator.study.outcomes import Failed, Measured, TestOutcome
from nufleet.robot_agent.motion.pace import BATCH_S
from nufleet.shared.errors import RefusedError, RobotError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.messages import Outcome, RobotStatus
from nufleet.sims.double_integrator import DoubleIntegrator
from nufleet.sims.faulty_robot import FAULTY, FaultyRobot, FaultyRobotSettings

OMEGA_RAD_S = 4.0
TEST = Excitation(axis="x", tones=(Tone(omega_rad_s=OMEGA_RAD_S),), settle_s=4.0)


def faulty(*faults: dict[str, Any]) -> FaultyRobot:
    document = {
        "driver": "double_integrator",
        "settings": {"alpha": 1.0, "beta": 0.003, "noise_std_m": 0.001},
        "faults": faults,
    }
    settings = FaultyRobotSettings.model_validate_json(json.dumps(document))
    return FAULTY.build({"a": settings}, np.random.default_rng(0))["a"]


def inside(robot: FaultyRobot) -> DoubleIntegrator:
    assert isinstance(robot._robot, DoubleIntegrator)
    return robot._robot


def outcome_of(orchestrator: Orchestrator, folder: Path, study_id: str) -> TestOutcome:
    with trial_log(folder, study_id, {"a": 0}) as log:
        specs = {"a": orchestrator.fleet.describe("a").spec}
        dispatcher = Dispatcher(orchestrator.fleet, log, specs, on_attempt_failed=lambda *_: None)
        return dispatcher.run(round_of(study_id, Question(1, {"a": TEST})).tests)["a"]


# Sensors. Faults that are everywhere last for the three motions of three attempts.

SENSOR_FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "NaN once": ({"kind": "not-a-number", "from_sample": 700, "samples": 1}, "not finite"),
    "NaN now and then": ({"kind": "not-a-number", "probability": 0.01}, "not finite"),
    "NaN from the first": ({"kind": "not-a-number"}, "not finite at sample 0"),
    "infinite": ({"kind": "infinite", "from_sample": 650}, "not finite at sample 650"),
    "frozen": ({"kind": "frozen", "from_sample": 500}, "stays at exactly"),
    "frozen, noisily": (
        {"kind": "frozen", "from_sample": 500, "noise": 0.001},
        "no response|disturbed|did something else|changed|stopped following",
    ),
    "frozen throughout": ({"kind": "frozen"}, "stays at exactly"),
    "saturated": ({"kind": "saturated", "low": -0.02, "high": 0.02}, "cut off at -0.02 and 0.02"),
    "saturated on one side": (
        {"kind": "saturated", "low": -9.0, "high": 0.02},
        "cut off at 0.02",
    ),
    "very noisy": ({"kind": "noisy", "std": 30.0}, "noise|did not follow the test"),
    "full of spikes": ({"kind": "spikes", "probability": 0.3, "height": 0.8}, "spikes"),
    "huge spikes": ({"kind": "spikes", "probability": 0.01, "height": 1e6}, "something else|noise"),
    "very late": ({"kind": "late", "late_max": 60}, "noise"),
    "losing samples": ({"kind": "held", "probability": 0.1, "run": 30}, "stays at exactly"),
}


@pytest.mark.parametrize("name", SENSOR_FAULTS)
def test_a_faulty_sensor_gives_no_response_but_a_reason(
    name: str, lab: Lab, tmp_path: Path
) -> None:
    fault, said = SENSOR_FAULTS[name]
    during = [{**fault, "motion": motion} for motion in range(1, ATTEMPTS + 1)]
    robot = faulty(*during)
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    outcome = outcome_of(orchestrator, tmp_path, "round")
    assert isinstance(outcome, Failed)
    assert outcome.attempts == ATTEMPTS
    assert re.search(said, outcome.reason), outcome.reason
    orchestrator.state("a", lambda s: s.status is RobotStatus.IDLE)
    assert inside(robot)._at_rest()
    # Nothing of it stays: with the sensor repaired the robot is as good as ever.
    assert isinstance(outcome_of(orchestrator, tmp_path, "repaired"), Measured)


def test_a_sensor_that_saturates_is_measured_at_a_smaller_amplitude(
    lab: Lab, tmp_path: Path
) -> None:
    limits = {"kind": "saturated", "low": -0.2, "high": 0.2}
    lab.agent("a", faulty(*({**limits, "motion": motion} for motion in range(1, ATTEMPTS + 1))))
    outcome = outcome_of(lab.orchestrator(), tmp_path, "round")
    assert isinstance(outcome, Measured)
    assert outcome.attempts > 1
    assert outcome.response.amplitude is not None
    assert outcome.response.amplitude < 0.3


def test_a_sensor_that_fails_once_costs_one_attempt(lab: Lab, tmp_path: Path) -> None:
    lab.agent("a", faulty({"kind": "frozen", "from_sample": 500, "motion": 1}))
    outcome = outcome_of(lab.orchestrator(), tmp_path, "round")
    assert isinstance(outcome, Measured)
    assert outcome.attempts == 2


# Drivers.


def test_a_driver_that_loses_a_sample_fails_the_test_with_the_samples_before(
    lab: Lab, tmp_path: Path
) -> None:
    robot = faulty({"kind": "drop-out", "from_sample": 60, "motion": 1})
    lab.agent("a", robot, realtime=1.0)
    orchestrator = lab.orchestrator()
    # Samples that a program watches are played in shorter batches, of which the last one is lost.
    orchestrator.fleet.observe_telemetry(lambda robot, samples: None)
    result = orchestrator.run("a", "g1")
    assert (result.outcome, result.reason) == (Outcome.FAILED, "the driver received no sample 60")
    batch = math.ceil(BATCH_S / robot.spec.sample_time_s)
    assert 60 - batch <= len(result.response) <= 60
    assert inside(robot)._at_rest()
    assert isinstance(outcome_of(orchestrator, tmp_path, "round"), Measured)


def test_a_driver_that_breaks_is_a_fault_until_it_is_connected_anew(
    lab: Lab, tmp_path: Path
) -> None:
    robot = faulty({"kind": "crash", "way": "raises", "from_sample": 60, "motion": 1})
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    outcome = outcome_of(orchestrator, tmp_path, "round")
    assert isinstance(outcome, Failed)
    assert "inspect the robot, then release it" in outcome.reason
    assert "the driver failed at sample 60" in outcome.reason
    orchestrator.state("a", lambda s: s.status is RobotStatus.FAULT)
    assert inside(robot)._at_rest()
    orchestrator.fleet.release("a")
    assert isinstance(outcome_of(orchestrator, tmp_path, "again"), Measured)


def hung(lab: Lab) -> tuple[Orchestrator, PuppetRobot, Gate]:
    """A robot whose driver does not return from a sample until its gate is opened."""
    robot = PuppetRobot(puppet_spec(simulated=False))
    gate = Gate(robot, at_sample=30)
    lab.agent("a", robot)
    return lab.orchestrator(), robot, gate


def released(orchestrator: Orchestrator) -> bool:
    try:
        orchestrator.fleet.release("a")
    except RefusedError:
        return False
    return True


def test_a_driver_that_hangs_is_a_fault_until_it_returns(lab: Lab, tmp_path: Path) -> None:
    orchestrator, robot, gate = hung(lab)
    # While it hangs still.
    outcome = outcome_of(orchestrator, tmp_path, "round")
    assert isinstance(outcome, Failed)
    assert "has not returned from 'step'" in outcome.reason
    state = orchestrator.state("a", lambda s: s.status is RobotStatus.FAULT)
    assert "cannot be brought to rest from here" in state.reason
    assert state.goal_id is None
    with pytest.raises(RefusedError, match="its driver hangs"):
        orchestrator.fleet.release("a")
    orchestrator.fleet.stop("a", "smoke")
    assert not robot.at_rest
    gate.opened.set()
    # It returned after all; then the robot was brought to rest and may be reconnected.
    wait_until(lambda: released(orchestrator))
    assert robot.at_rest
    assert orchestrator.run("a", "g2", settle_s=0.0).outcome is Outcome.COMPLETED


def test_samples_before_a_hang_are_kept(lab: Lab) -> None:
    orchestrator, _, gate = hung(lab)
    result = orchestrator.run("a", "g1")
    assert result.outcome is Outcome.FAILED
    assert len(result.response) == 30
    assert refusal(lambda: orchestrator.submit("a", "g2")) == "fault"
    gate.opened.set()
    wait_until(lambda: released(orchestrator))


def test_an_agent_whose_driver_hangs_ends_and_says_that_the_robot_may_move(lab: Lab) -> None:
    robot = PuppetRobot()
    gate = Gate(robot, at_sample=30)
    agent = lab.agent("a", robot, realtime=1.0)
    orchestrator = lab.orchestrator()
    orchestrator.submit("a", "g1")
    orchestrator.state("a", lambda s: s.status is RobotStatus.FAULT)
    with pytest.raises(RobotError, match="the robot may not be at rest"):
        agent.close()
    watch = orchestrator.fleet.watch("a")
    assert watch.wait_until(lambda w: not w.alive, timeout_s=PATIENCE_S)
    gate.opened.set()


def test_a_hang_shorter_than_the_patience_ends_the_motion_at_rest(lab: Lab) -> None:
    robot = faulty({"kind": "hang", "from_sample": 30, "samples": 1, "hang_s": 0.3})
    lab.agent("a", robot, realtime=1.0)
    orchestrator = lab.orchestrator()
    assert orchestrator.run("a", "g1", settle_s=0.0).outcome is Outcome.COMPLETED
    assert inside(robot)._at_rest()
