"""What a ranking leaves: its record, and a test that a simulated robot flew."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from nufleet.orchestrator.runs.rank_result import ClosedForm, IterationRecord, RankResult, RunRecord
from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.orchestrator.study.outcomes import Measured
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import estimate_frequency_response
from nufleet.shared.wire.messages import GoalResult, Outcome
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings

NOON = datetime(2026, 1, 2, 12, 0, 0, tzinfo=UTC)


def a_record(run: Path) -> RunRecord:
    estimate = SourceEstimate("source-1", 0.07, 0.068, 0.073, 4.5, 2, 0.0689, 4.5)
    return RunRecord(
        result=RankResult(
            target="target",
            band_rad_s=(0.1, 10.0),
            selected="source-1",
            ranking=(estimate,),
            iterations=1,
            robot_time_s=12.5,
            run=str(run),
        ),
        axis="x",
        seed=3,
        history=(
            IterationRecord(
                iteration=1,
                omega_rad_s=(4.5,),
                sampled_psi={"source-1": 0.07},
                ranking=(estimate,),
            ),
        ),
        dropped={"source-2": "lost"},
        closed_form={"source-1": ClosedForm(psi=0.0694, omega_rad_s=4.49)},
        wall_time_s=1.5,
    )


def a_test(robot_name: str) -> Measured:
    robot = DoubleIntegrator(
        DoubleIntegratorSettings(alpha=1.0, beta=0.003), np.random.default_rng(0)
    )
    plan = plan_excitation(
        Excitation(axis="x", tones=(Tone(omega_rad_s=5.0),)), robot.spec, robot_name
    )
    reference = reference_of(plan)
    robot.connect()
    response = robot.run(reference[:, None])[:, 0]
    result = GoalResult(
        goal_id=f"g.{robot_name}",
        boot_id="b",
        outcome=Outcome.COMPLETED,
        reason="",
        plan=plan,
        reference=reference,
        response=response,
    )
    z = estimate_frequency_response(reference, response, plan)
    return Measured(robot_name, z, result, attempts=1, robot_time_s=plan.duration_s)
