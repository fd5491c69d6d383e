"""Records to store: one study of two robots, and what its tests gave."""

from __future__ import annotations

import numpy as np

from nufleet.orchestrator.repository.records import StudyRecord, TrialEnd, TrialIntent, TrialStatus
from nufleet.orchestrator.study.interface import DesiredMotion, StudyPlan
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan, Tone
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Finding, Quality
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.shared.wire.messages import GoalAccepted, GoalResult, Outcome

FLEET = "lab"
SPEC = RobotSpec(
    kind="puppet",
    axes=(AxisSpec(name="x", unit="m", amplitude_max=1.0, velocity_max=1.0, acceleration_max=9.0),),
    sample_time_s=0.01,
    omega_min_rad_s=0.1,
    omega_max_rad_s=20.0,
    duration_max_s=60.0,
    settling_time_s=1.0,
    simulated=True,
)
STUDY = StudyRecord(
    study_id="run-1",
    fleet=FLEET,
    algorithm="paper",
    plan=StudyPlan(
        *("target", ("source",), (0.1, 1 / 3), 3, "x"),
        motion=DesiredMotion("pear", (0.1, np.nextafter(1.0, 2.0)), (1 / 3, 1e-300)),
    ),
    seed=2**80 + 1,
    parameters={"earlier": {"source": ["run-0.1.source.1"]}, "ξ": 0.1},
)
TEST = Excitation(axis="x", tones=(Tone(omega_rad_s=0.1 + 0.2),))
LONGER = TEST.model_copy(update={"settle_s": 4.0})
PLAN = ExcitationPlan(
    axis="x",
    tones=TEST.tones,
    amplitude=0.1,
    sample_time_s=0.01,
    ramp_samples=2,
    settle_samples=1,
    segments=3,
    segment_samples=4,
)


def intent(robot: str = "target", *, attempt: int = 1, epoch: int = 1) -> TrialIntent:
    goal_id = f"run-1.1.{robot}.{attempt}"
    return TrialIntent(goal_id, "run-1", 1, robot, attempt, TEST, epoch)


def accepted(trial: TrialIntent, boot_id: str = "boot-1") -> GoalAccepted:
    return GoalAccepted(goal_id=trial.goal_id, boot_id=boot_id, plan=PLAN, wall_duration_s=0.1)


def result(trial: TrialIntent, outcome: Outcome = Outcome.COMPLETED) -> GoalResult:
    rng = np.random.default_rng(4)
    samples = PLAN.samples if outcome is Outcome.COMPLETED else 5
    return GoalResult(
        goal_id=trial.goal_id,
        boot_id="boot-1",
        outcome=outcome,
        reason="",
        plan=PLAN,
        reference=rng.standard_normal(samples),
        response=rng.standard_normal(samples),
    )


def response(*reasons: Finding) -> FrequencyResponse:
    return FrequencyResponse(
        omega_rad_s=np.array([0.1 + 0.2, np.nextafter(1.0, 2.0)]),
        z=np.array([complex(1 / 3, -1e-300), complex(np.nan, -0.0)]),
        variance=np.array([5e-324, np.inf]),
        segments=4,
        quality=Quality(
            reasons=reasons, warnings=(Finding(code="noisy", text="ψ is \x00 uncertain"),)
        ),
    )


def measurement(trial: TrialIntent, measured: FrequencyResponse | None = None) -> TrialEnd:
    return TrialEnd(TrialStatus.MEASURED, result=result(trial), response=measured or response())


def identical(a: FrequencyResponse, b: FrequencyResponse) -> bool:
    """Whether two responses agree in every bit."""
    arrays = ((a.omega_rad_s, b.omega_rad_s), (a.z, b.z), (a.variance, b.variance))
    bits = all(x.dtype == y.dtype and x.tobytes() == y.tobytes() for x, y in arrays)
    same_degrees = a.degrees_of_freedom.tobytes() == b.degrees_of_freedom.tobytes()
    facts = [(r.segments, r.quality, r.amplitude, r.degrees is None) for r in (a, b)]
    hidden = [None if r.hidden_variance is None else r.hidden_variance.tobytes() for r in (a, b)]
    bits = bits and hidden[0] == hidden[1]
    return bits and same_degrees and facts[0] == facts[1]
