"""What a robot expects of a path, asked over the network: nothing moves, and nobody waits."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from child_processes import rehearsals
from fleet_lab import Lab, Orchestrator, refusal
from learned_things import experience
from polling import PATIENCE_S, wait_until
from robots_that_learn import LaggedRobot

from nufleet.orchestrator.experience.prior_custody import install
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.goal_runner import Interrupted
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.robot_agent import forecast_service
from nufleet.shared.experience.file import digest
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.wire.messages import ForeseenWay, RobotStatus
from nufleet.shared.wire.motions import Way

PATH = travel(np.array([[0.0, 0.0], [0.3, 0.2], [0.0, 0.0]]), 0.5, 1.0, 0.02)
LONG = travel(np.array([[0.0, 0.0], [0.3, 0.2], [0.0, 0.0]]), 0.01, 1.0, 0.02)
"""A path that takes minutes, and so does its rehearsal."""
LAYOUT = InverseLayout(
    architecture="state", states=("position",), sample_time_s=0.02, horizon_samples=5
)
BASELINE, OWN = ForeseenWay(inverse="baseline"), ForeseenWay(inverse="own")
NONE = ForeseenWay(inverse="zero-prior", layout=LAYOUT)
LATER = ForeseenWay(inverse="own", after_rich_flight_s=30.0)


@pytest.fixture
def orchestrator(lab: Lab) -> Orchestrator:
    """One whose robot has flown a path, and so knows itself."""
    lab.agent("a", LaggedRobot(noise_std_m=1e-3))
    orchestrator = lab.orchestrator()
    Pilot(orchestrator.fleet, "run").along("a", Way(inverse="baseline"), PATH, "first")
    return orchestrator


def motions(fleet: Fleet) -> tuple[str | None, str | None, float]:
    """What moved the robot last, and for how long it has moved."""
    state = fleet.watch("a").state
    assert state is not None
    return state.goal_id, state.last_goal_id, state.robot_time_s


def test_every_way_is_predicted_and_flown_as_predicted(orchestrator: Orchestrator) -> None:
    fleet, pilot = orchestrator.fleet, Pilot(orchestrator.fleet, "run-2")
    before = motions(fleet)
    found = [one.predicted for one in fleet.forecast("a", PATH, (BASELINE, NONE, OWN, LATER))]
    baseline, none, own, later = (one for one in found if one is not None)
    assert later.high <= 1.1 * own.high
    assert motions(fleet) == before
    flight = pilot.along("a", Way(inverse="zero-prior", layout=LAYOUT), PATH, "none")
    assert flight.details.predicted == none
    assert none.low <= flight.rms_error <= none.high < baseline.low


def test_a_way_that_cannot_be_flown_is_refused_as_its_flight_would_be(
    orchestrator: Orchestrator,
) -> None:
    absent = ForeseenWay(inverse="prior", prior_sha256="0" * 64)
    (found,) = orchestrator.fleet.forecast("a", PATH, (absent,))
    assert (found.predicted, found.code) == (None, "no-prior")
    assert "nufleet transfer" in found.reason
    (found,) = orchestrator.fleet.forecast("a", PATH * 100, (BASELINE,))
    assert found.code == "trajectory"


def test_a_held_prior_is_rehearsed(orchestrator: Orchestrator) -> None:
    fit = {"axes": ("x", "y"), "robot_kind": "lagged", "layout": LAYOUT}
    payload = experience("source", **fit)
    install(orchestrator.fleet, "a", "prior", payload)
    prior = ForeseenWay(inverse="prior", prior_sha256=digest(payload))
    (found,) = orchestrator.fleet.forecast("a", PATH, (prior,))
    flight = Pilot(orchestrator.fleet, "run-2").along("a", prior, PATH, "p")
    assert found.predicted is not None
    assert found.predicted.low <= flight.rms_error <= found.predicted.high


def test_a_robot_that_knows_nothing_of_itself_says_so(lab: Lab) -> None:
    lab.agent("a", LaggedRobot())
    (found,) = lab.orchestrator().fleet.forecast("a", PATH, (BASELINE,))
    assert found.code == "no-own-model"


def test_a_robot_that_moves_does_not_rehearse(lab: Lab) -> None:
    lab.agent("a", LaggedRobot(), realtime=1.0)
    orchestrator = lab.orchestrator()
    pilot = Pilot(orchestrator.fleet, "run")
    flying = threading.Thread(target=lambda: _flown(pilot))
    flying.start()
    orchestrator.state("a", lambda state: state.status is RobotStatus.RUNNING)
    assert refusal(lambda: orchestrator.fleet.forecast("a", PATH, (BASELINE,))) == "busy"
    pilot.interrupt()
    flying.join()
    assert rehearsals() == []


def test_a_motion_ends_a_forecast(lab: Lab) -> None:
    # In real time, so that the motion still lasts when the forecast is asked for again.
    lab.agent("a", LaggedRobot(noise_std_m=1e-3), realtime=1.0)
    orchestrator, ended = lab.orchestrator(), threading.Event()
    Pilot(orchestrator.fleet, "run").along("a", Way(inverse="baseline"), PATH, "first")

    def ask() -> None:
        assert refusal(lambda: orchestrator.fleet.forecast("a", LONG, (NONE,))) == "busy"
        ended.set()

    asking = threading.Thread(target=ask)
    asking.start()
    wait_until(lambda: len(rehearsals()) == 1)
    pilot = Pilot(orchestrator.fleet, "run-2")
    flying = threading.Thread(target=lambda: _flown(pilot))
    flying.start()
    assert ended.wait(PATIENCE_S)
    wait_until(lambda: rehearsals() == [])  # it was killed, and dies when its turn comes
    pilot.interrupt()
    flying.join()
    asking.join()


def test_a_forecast_ends_when_nobody_asks_for_it_any_more(
    orchestrator: Orchestrator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(forecast_service, "PATIENCE_S", 0.2)

    def leave(done: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        orchestrator.fleet.forecast("a", LONG, (NONE,), on_foreseen=leave)
    wait_until(lambda: rehearsals() == [])


def test_a_robot_rehearses_for_one_at_a_time(
    orchestrator: Orchestrator, lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(forecast_service, "PATIENCE_S", PATIENCE_S)
    other = lab.orchestrator("orchestrator-2").fleet

    def ask_as_well(done: int) -> None:
        assert refusal(lambda: other.forecast("a", PATH, (NONE,))) == "busy"
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        orchestrator.fleet.forecast("a", LONG, (NONE,), on_foreseen=ask_as_well)


def test_an_agent_that_ends_leaves_no_rehearsal(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forecast_service, "PATIENCE_S", PATIENCE_S)
    agent = lab.agent("a", LaggedRobot(noise_std_m=1e-3))
    fleet = lab.orchestrator().fleet
    Pilot(fleet, "run").along("a", Way(inverse="baseline"), PATH, "first")

    def leave(done: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fleet.forecast("a", LONG, (NONE,), on_foreseen=leave)
    assert len(rehearsals()) == 1
    agent.close()
    assert rehearsals() == []


def _flown(pilot: Pilot) -> None:
    with pytest.raises(Interrupted):
        pilot.rich("a", duration_s=60.0, seed=0)
