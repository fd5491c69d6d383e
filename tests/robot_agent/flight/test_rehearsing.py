"""A rehearsal gets all that it needs through one pipe, and answers every way for itself."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from learned_things import experience, flown_before
from robots_that_learn import double_integrator

from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.rehearsal import Rehearsal
from nufleet.robot_agent.flight.rehearsing import RehearsalTask, foreseen, read_task, write_task
from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.experience.file import digest
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.wire.messages import ForeseenWay

PATH = travel(np.array([[0.0], [0.3], [0.0]]), 0.5, 1.0, 0.015)
BASELINE = ForeseenWay(inverse="baseline")


def a_robot() -> Memory:
    """One that has flown, and holds two priors."""
    memory = Memory(None)
    memory.learn(flown_before(double_integrator().spec))
    for seed, source in enumerate(("source-1", "source-2")):
        payload = experience(source, seed=seed)
        memory.keep_prior(payload, digest(payload), beside=True)
    return memory


def a_task(memory: Memory, *ways: ForeseenWay) -> bytes:
    records, priors = memory.exported()
    robot, stream = double_integrator(), BytesIO()
    task = RehearsalTask(
        spec=robot.spec,
        state_names=robot.state_names,
        records=records,
        priors=len(priors),
        desired=PATH,
        ways=ways or (BASELINE,),
    )
    write_task(stream, task, priors)
    return stream.getvalue()


def test_the_robot_there_knows_of_itself_and_holds_what_it_does_here() -> None:
    memory = a_robot()
    task, there = read_task(BytesIO(a_task(memory)))
    assert [prior.sha256 for prior in there.priors] == [prior.sha256 for prior in memory.priors]
    assert dict(there.flown_s) == dict(memory.flown_s)
    here = Rehearsal.of(task.spec, task.state_names, memory, PATH).predicted(BASELINE)
    again = Rehearsal.of(task.spec, task.state_names, there, PATH).predicted(BASELINE)
    assert again == here


def test_a_way_that_fails_is_answered_and_the_next_one_is_rehearsed() -> None:
    gone = ForeseenWay(inverse="prior", prior_sha256="0" * 64)
    task, memory = read_task(BytesIO(a_task(a_robot(), gone, BASELINE)))
    rehearsal = Rehearsal.of(task.spec, task.state_names, memory, task.desired)
    first, second = (foreseen(way, rehearsal) for way in task.ways)
    assert (first.predicted, first.code) == (None, "rehearsal")
    assert "no longer has a prior" in first.reason
    assert second.predicted is not None
    assert second.reason == rehearsal.unseen == ""


def test_what_of_the_path_was_never_seen_comes_with_the_error_of_the_baseline() -> None:
    task, memory = read_task(BytesIO(a_task(a_robot())))
    known = Rehearsal.of(task.spec, task.state_names, memory, task.desired)
    axes = tuple(replace(axis, largest=0.01) for axis in known.model.axes)
    found = foreseen(BASELINE, replace(known, model=replace(known.model, axes=axes)))
    assert "its motions until now were smaller than this path" in found.reason
    assert found.predicted is not None


@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 0.99])
def test_a_task_that_ends_early_is_refused(share: float) -> None:
    whole = a_task(a_robot())
    with pytest.raises(MalformedMessageError):
        read_task(BytesIO(whole[: int(share * len(whole))]))
