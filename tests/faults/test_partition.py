"""Robots and orchestrators that are cut off: networks of their own, and a cable that is pulled."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from fleet_lab import submitted

from benchmarks.faults.lab import Lab
from benchmarks.faults.namespaces import Network, star
from benchmarks.faults.program import PATIENCE_S, wait_until
from nufleet.orchestrator.fleet import goal_pursuit
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.goal_runner import GoalRunner
from nufleet.shared.errors import NoReplyError, RefusedError, RobotLostError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.messages import GoalRequest, Outcome

SHORT = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),), settle_s=0.5)
LONG = Excitation(axis="x", tones=(Tone(omega_rad_s=1.0),), settle_s=60.0)


@pytest.fixture
def network(lab: Lab) -> Iterator[Network]:
    """A robot on a cable of its own; orchestrators reach the router beside it."""
    lab.describe_section_v({"a": 0.9})
    with star("a") as network:
        lab.router("tcp/0.0.0.0:7447", namespace=network.hub)
        yield network


def start_agent(lab: Lab, network: Network) -> None:
    endpoint = f"tcp/{network.hub_address('a')}:7447"
    lab.agent("a", connect=endpoint, realtime=1.0, namespace=network.cables["a"].far)


def goal(fleet: Fleet, goal_id: str, motion: Excitation, epoch: int = 0) -> GoalRequest:
    return GoalRequest(goal_id=goal_id, owner=fleet.orchestrator_id, motion=motion, epoch=epoch)


def test_both_sides_of_a_partition_notice_it_and_the_robot_rests(
    lab: Lab, network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(goal_pursuit, "RETURN_PATIENCE_S", 2.0)
    start_agent(lab, network)
    fleet = lab.orchestrator("a")
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(GoalRunner(fleet).run, "a", "g", LONG)
        wait_until(lambda: len(lab.motions("a")) == 1)
        lab.wait_for_state(fleet, "a", lambda state: state.goal_id == "g")
        network.cables["a"].pull()
        # How soon is measured by `python -m benchmarks.faults detection`.
        assert fleet.watch("a").wait_until(lambda w: not w.alive, timeout_s=PATIENCE_S)
        with pytest.raises((RobotLostError, NoReplyError), match=r"robot a .* g\b"):
            running.result(PATIENCE_S)
    wait_until(lambda: lab.motions("a")[0].ended_s is not None)
    assert len(lab.motions("a")) == 1
    network.cables["a"].plug_in()
    fleet.wait_for(("a",), timeout_s=PATIENCE_S)
    result = fleet.result("a", "g")
    assert (result.outcome, result.reason) == (Outcome.ABORTED, "its owner orchestrator-1 is gone")
    assert GoalRunner(fleet).run("a", "g2", SHORT).outcome is Outcome.COMPLETED
    assert len(lab.motions("a")) == 2


def test_an_owner_that_was_cut_off_and_replaced_is_refused_when_it_returns(
    lab: Lab, network: Network
) -> None:
    # The robot is beside the router; the owner is a process at the end of the cable.
    lab.agent("a", realtime=1.0)
    endpoint = f"tcp/{network.hub_address('a')}:7447"
    owner = lab.owner("a", "first", 5, connect=endpoint, namespace=network.cables["a"].far)
    wait_until(lambda: len(lab.motions("a")) == 1)
    network.cables["a"].pull()
    fleet = lab.orchestrator("a", name="successor")
    lab.wait_for_state(fleet, "a", lambda state: state.last_goal_id == "first.1")
    submitted(fleet, "a", goal(fleet, "g2", LONG, epoch=6))
    wait_until(lambda: len(lab.motions("a")) == 2)
    network.cables["a"].plug_in()
    owner.wait_for("refused")
    assert "stale-epoch: successor commands it under epoch 6; epoch 5 is over" in owner.said
    with pytest.raises(RefusedError, match=r"running goal g2"):
        submitted(fleet, "a", goal(fleet, "g3", SHORT, epoch=6))
    assert lab.motions("a")[1].ended_s is None
    fleet.hold({"a": 6})
    fleet.cancel("a", "g2")
    wait_until(lambda: lab.motions("a")[1].ended_s is not None)
    assert len(lab.motions("a")) == 2
