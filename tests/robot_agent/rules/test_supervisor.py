"""Whether a robot may move: checked in every state that can be reached, for every event."""

from __future__ import annotations

from collections import deque

import pytest

from nufleet.robot_agent.rules.supervisor import (
    STOPS_REMEMBERED,
    Event,
    FaultFound,
    Halt,
    HealthReported,
    MotionBegan,
    MotionEnded,
    OwnerLost,
    Reconnected,
    ReleaseOrdered,
    StopOrder,
    StopOrdered,
    Supervision,
    refusal_to_start,
    supervise,
)
from nufleet.shared.wire.messages import Outcome

ME, OTHER = "orchestrator-1", "orchestrator-2"
EVENTS: tuple[Event, ...] = (
    StopOrdered(StopOrder("alice", "smoke")),
    StopOrdered(StopOrder("bob", "fire")),
    ReleaseOrdered("alice"),
    ReleaseOrdered("eve"),
    OwnerLost(ME),
    OwnerLost(OTHER),
    MotionBegan(ME),
    MotionBegan(OTHER),
    MotionEnded(),
    MotionEnded("would not rest"),
    Reconnected(),
    Reconnected("no such port"),
    FaultFound("its motors were cut"),
    HealthReported("battery empty"),
    HealthReported(None),
)


def may_begin(state: Supervision) -> bool:
    return refusal_to_start(state, owner=ME, owner_alive=True) is None


def can_happen(state: Supervision, event: Event) -> bool:
    """What the agent does itself it does in order: a motion begins when it may, and ends once."""
    match event:
        case MotionBegan():
            return state.motion_owner is None and may_begin(state)
        case MotionEnded():
            return state.motion_owner is not None
        case Reconnected():
            return state.motion_owner is None and state.fault is not None
        case _:
            return True


def reachable() -> list[Supervision]:
    found = [Supervision()]
    queue = deque(found)
    while queue:
        state = queue.popleft()
        for event in EVENTS:
            if can_happen(state, event):
                after, _ = supervise(state, event)
                if after not in found:
                    found.append(after)
                    queue.append(after)
    return found


STATES = reachable()
STEPS = [(state, event) for state in STATES for event in EVENTS if can_happen(state, event)]


def test_all_states_are_looked_at() -> None:
    # Not stopped, or by alice or bob; fit or not; at rest with no fault or one of three, or moving
    # for one of two owners, and then with no fault but one that was found meanwhile.
    assert len(STATES) == 3 * 2 * (4 + 2 * 2)


@pytest.mark.parametrize("state", STATES, ids=str)
def test_a_motion_may_begin_only_unstopped_and_without_fault(state: Supervision) -> None:
    free = state.stop is None and state.fault is None and state.unfit is None
    assert may_begin(state) == free
    assert refusal_to_start(state, owner=ME, owner_alive=False) is not None


def test_nothing_but_a_release_leads_from_stopped_to_motion() -> None:
    seen = {state for state in STATES if state.stop is not None}
    queue = deque(seen)
    while queue:
        state = queue.popleft()
        for event in EVENTS:
            if can_happen(state, event) and not isinstance(event, ReleaseOrdered):
                after, _ = supervise(state, event)
                assert not may_begin(after)
                if after not in seen:
                    seen.add(after)
                    queue.append(after)


def test_nothing_but_connecting_anew_leads_from_a_fault_to_motion() -> None:
    seen = {state for state in STATES if state.fault is not None}
    queue = deque(seen)
    while queue:
        state = queue.popleft()
        for event in EVENTS:
            if can_happen(state, event) and event != Reconnected():
                after, _ = supervise(state, event)
                assert not may_begin(after)
                if after not in seen:
                    seen.add(after)
                    queue.append(after)


def test_a_fault_and_a_stop_are_each_undone_by_their_own_act_alone() -> None:
    for state, event in STEPS:
        after, _ = supervise(state, event)
        if state.stop is not None and not isinstance(event, ReleaseOrdered):
            assert after.stop == state.stop  # the first order stays the one that is shown
        if state.fault is not None and not isinstance(event, Reconnected):
            assert after.fault == state.fault


def test_a_stop_is_accepted_in_every_state() -> None:
    for state in STATES:
        for order in (StopOrder("alice", "smoke"), StopOrder("bob", "fire")):
            after, halt = supervise(state, StopOrdered(order))
            assert after.stop == (state.stop or order)
            assert (halt is not None) == (state.motion_owner is not None)
            if halt is not None:
                assert halt == Halt(Outcome.ABORTED, f"stopped by {order.sender}: {order.reason}")


def test_a_copy_of_a_stop_that_was_released_stops_nothing() -> None:
    order = StopOrdered(StopOrder("alice", "smoke", "1"))
    for state in STATES:
        stopped, _ = supervise(state, order)
        again, _ = supervise(stopped, order)
        assert again == stopped
        moving, _ = supervise(stopped, ReleaseOrdered("alice"))
        moving, _ = supervise(moving, MotionBegan(ME))
        assert supervise(moving, order) == (moving, None)


@pytest.mark.parametrize(
    "order",
    [
        StopOrder("alice", "smoke", "2"),
        StopOrder("bob", "smoke", "1"),
        StopOrder("alice", "smoke"),
    ],
)
def test_any_other_stop_after_a_release_is_obeyed(order: StopOrder) -> None:
    state = Supervision()
    for event in (
        StopOrdered(StopOrder("alice", "smoke", "1")),
        StopOrdered(StopOrder("alice", "smoke")),
        ReleaseOrdered("alice"),
    ):
        state, _ = supervise(state, event)
    assert supervise(state, StopOrdered(order))[0].stop == order


def test_a_flood_of_stops_takes_no_more_memory_than_the_last_of_them() -> None:
    state = Supervision()
    for number in range(2 * STOPS_REMEMBERED):
        state, _ = supervise(state, StopOrdered(StopOrder("alice", "smoke", str(number))))
    assert len(state.obeyed) == STOPS_REMEMBERED
    state, _ = supervise(state, ReleaseOrdered("alice"))
    forgotten, last = (StopOrder("alice", "smoke", str(n)) for n in (0, 2 * STOPS_REMEMBERED - 1))
    assert supervise(state, StopOrdered(last))[0].stop is None
    assert supervise(state, StopOrdered(forgotten))[0].stop == forgotten


def test_a_motion_is_halted_by_stop_lost_owner_fault_or_bad_health_and_by_nothing_else() -> None:
    for state, event in STEPS:
        _, halt = supervise(state, event)
        expected = state.motion_owner is not None and (
            isinstance(event, StopOrdered | FaultFound)
            or event == OwnerLost(state.motion_owner)
            or event == HealthReported("battery empty")
        )
        assert (halt is not None) == expected
        if halt is not None:
            assert halt.outcome is Outcome.ABORTED
            assert halt.reason


def test_only_beginning_and_ending_change_who_commands_the_motion() -> None:
    for state, event in STEPS:
        after, _ = supervise(state, event)
        match event:
            case MotionBegan(owner):
                assert after.motion_owner == owner
            case MotionEnded():
                assert after.motion_owner is None
            case _:
                assert after.motion_owner == state.motion_owner


def test_a_refusal_says_what_to_do() -> None:
    stopped, _ = supervise(Supervision(), StopOrdered(StopOrder("alice", "smoke")))
    refusal = refusal_to_start(stopped, owner=ME, owner_alive=True)
    assert refusal is not None
    assert refusal.code == "stopped"
    assert refusal.reason == (
        "release it first with `nufleet release`: it was stopped by alice: smoke"
    )
    broken, _ = supervise(Supervision(), Reconnected("no such port"))
    refusal = refusal_to_start(broken, owner=ME, owner_alive=True)
    assert refusal is not None
    assert refusal.code == "fault"
    assert "no such port" in refusal.reason
    refusal = refusal_to_start(Supervision(), owner=ME, owner_alive=False)
    assert refusal is not None
    assert refusal.code == "owner-not-alive"
    assert ME in refusal.reason


def test_reasons_of_any_length_still_make_a_refusal() -> None:
    long = "x" * 2000 + "\udcff"
    for state in (Supervision(stop=StopOrder("a" * 200, long)), Supervision(fault=long * 3)):
        assert refusal_to_start(state, owner="o" * 200, owner_alive=True) is not None
