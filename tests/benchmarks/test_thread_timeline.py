"""Every moment of a late sample has the one cause that the states of the threads show."""

from __future__ import annotations

import pytest

from benchmarks.crazyflie_period import (
    EARLY,
    HOST,
    LOOKED,
    OTHER_RAN,
    OTHER_WAITED,
    RAN,
    UNKNOWN,
    WAITED,
    Late,
    Pauses,
    Spent,
    causes,
)
from benchmarks.thread_timeline import Change, State, Timeline

MOVES, OTHER = 1, 2


def timeline(*changes: tuple[float, int, State | None]) -> Timeline:
    one = Timeline()
    one.take(Change(*change) for change in changes)
    return one


def test_a_thread_that_is_woken_is_ready_only_if_it_was_blocked() -> None:
    one = timeline((3.0, OTHER, None), (1.0, MOVES, None), (2.0, OTHER, State.RUNNING))
    assert list(one.read(0.0, 4.0)) == [(0.0, 1.0), (1.0, 2.0), (2.0, 3.0), (3.0, 4.0)]
    assert one.states == {MOVES: State.READY, OTHER: State.RUNNING}


def test_each_moment_of_a_sample_has_one_cause() -> None:
    one = timeline(
        (0.0, MOVES, State.RUNNING),
        (1.0, MOVES, State.BLOCKED),  # asleep until 3, and then nothing is seen until 4
        (2.0, OTHER, State.RUNNING),
        (2.5, OTHER, State.BLOCKED),
        (4.0, OTHER, None),
        (6.0, OTHER, State.RUNNING),
        (9.0, OTHER, State.BLOCKED),  # it looks for a measurement until 10
        (10.0, MOVES, None),
        (14.0, MOVES, State.RUNNING),
    )
    found = causes(one, MOVES, 0.0, 15.0, Pauses(asleep=(1.0, 3.0), looks=(9.0, 10.0)))
    assert found == pytest.approx(
        {RAN: 2.0, EARLY: 2.0, UNKNOWN: 1.0, OTHER_WAITED: 2.0, OTHER_RAN: 3.0, LOOKED: 1.0}
        | {WAITED: 4.0}
    )


def test_a_sample_begins_with_what_the_threads_did_before_it() -> None:
    one = timeline((0.0, OTHER, State.READY), (7.0, OTHER, State.RUNNING))
    assert causes(one, MOVES, 1.0, 6.0, Pauses()) == {OTHER_WAITED: 5.0}
    assert causes(one, MOVES, 6.0, 8.0, Pauses()) == {OTHER_WAITED: 1.0, OTHER_RAN: 1.0}


@pytest.mark.parametrize(("stolen_s", "unknown_s"), [((0.01, 0.02), 0.03), ((0.03, 0.03), 0.0)])
def test_what_linux_does_not_charge_is_explained_by_what_the_host_took_of_one_processor(
    stolen_s: tuple[float, float], unknown_s: float
) -> None:
    def spent(stolen_s: tuple[float, float]) -> Spent:
        return Spent(stolen_s, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0)

    late = Late(0.05, {RAN: 0.03, UNKNOWN: 0.03}, spent(stolen_s))
    late.ends(spent((0.0, 0.0)) if unknown_s else spent((0.0, 0.03)))
    assert late.causes_s[RAN] == pytest.approx(0.01)
    assert late.causes_s[UNKNOWN] == pytest.approx(unknown_s)
    assert late.causes_s[HOST] == pytest.approx(0.05 - unknown_s)
