"""Studies that an archive keeps, with responses to their tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from puppet_robot import puppet_spec

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.leases import hold_leases
from nufleet.orchestrator.conduct.replay import OpenTest
from nufleet.orchestrator.repository.records import StudyRecord, TrialEnd, TrialStatus
from nufleet.orchestrator.repository.repository import open_repository
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.shared.frequency_test.excitation import ExcitationPlan
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Quality
from nufleet.shared.models.linear_model import LinearModel
from nufleet.shared.wire.messages import Description, GoalResult, Outcome

MODEL = LinearModel(a=((0.1 + 0.2,),), b=(1 / 3,), c=(1.0,), sample_time_s=0.01)
SPEC = puppet_spec()
SPEC = SPEC.model_copy(
    update={"axes": (SPEC.axes[0].model_copy(update={"model": MODEL}), SPEC.axes[1])}
)
PLAN = StudyPlan("target", ("near", "far"), (0.1 + 0.2, 10.0), 5, "x")
DESCRIPTIONS = {
    robot: Description(robot=robot, boot_id="boot-1", spec=SPEC)
    for robot in ("target", "near", "far")
}


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    with (
        open_repository(f"{tmp_path}/nufleet.sqlite") as repository,
        hold_leases(repository.leases, "lab", DESCRIPTIONS, owner="o") as leases,
    ):
        yield Archive(repository, "lab", leases)


def begin(
    archive: Archive, algorithm: str, stored: dict[str, tuple[str, ...]] | None = None
) -> StudyRecord:
    return archive.begin(f"run-{algorithm}", algorithm, PLAN, 2**70, DESCRIPTIONS, stored)


def measure(archive: Archive, test: OpenTest) -> FrequencyResponse:
    """Store a response to a test."""
    log = archive.log(test.goal_id.split(".")[0])
    omega = np.array([tone.omega_rad_s for tone in test.excitation.tones])
    z = 1 / (1 + 0.1j * omega)
    response = FrequencyResponse(omega, z, np.full(len(omega), 1e-6), 3, Quality())
    plan = ExcitationPlan(
        axis="x",
        tones=test.excitation.tones,
        amplitude=0.1,
        sample_time_s=0.01,
        ramp_samples=1,
        settle_samples=0,
        segments=3,
        segment_samples=4,
    )
    result = GoalResult(
        goal_id=test.goal_id,
        boot_id="boot-1",
        outcome=Outcome.COMPLETED,
        reason="",
        plan=plan,
        reference=np.zeros(plan.samples),
        response=np.zeros(plan.samples),
    )
    log.intend([test])
    log.ended(test, TrialEnd(TrialStatus.MEASURED, result=result, response=response))
    return response
