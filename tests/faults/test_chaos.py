"""Everything fails at random, from a seed, and the invariants hold.

A share of `python -m benchmarks.faults chaos`, which does it with ten robots for ten minutes.
"""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from benchmarks.faults import chaos
from benchmarks.faults.chaos_history import HALT_MAX_S, History, Stop
from benchmarks.faults.lab import Lab
from benchmarks.faults.logbook import CONNECTED, MOVES, RESTS, TOLD_TO_REST, Entry, motions


def test_whatever_fails_every_trial_ends_and_the_ranking_stays() -> None:
    # How soon a robot halts is measured by `python -m benchmarks.faults stop`; here, that it does
    # before its stop is released.
    history, before, after = chaos.run(
        robots=4, seconds=20.0, seed=4, faults_min=8, halt_max_s=math.inf
    )
    # Enough went wrong for this to say something.
    assert len(history.faults) >= 3
    assert len(history.whole) >= 2
    more = {what: after[what] - before[what] for what in before}
    assert more["threads"] == more["children"] == 0
    assert max(more.values()) <= 4, more


def entries(*told: tuple[float, str]) -> list[Entry]:
    return [Entry(time_s, "a", 1, what) for time_s, what in told]


def test_a_logbook_tells_motions_that_ended_and_those_that_died() -> None:
    found = motions(
        entries(
            (0.0, CONNECTED),
            (1.0, MOVES),
            (2.0, TOLD_TO_REST),
            (2.5, RESTS),
            (3.0, MOVES),
            (4.0, CONNECTED),
            (5.0, MOVES),
        )
    )
    assert [(m.began_s, m.ended_s) for m in found] == [(1.0, 2.0), (3.0, None), (5.0, None)]


@pytest.mark.parametrize(
    ("began_s", "ended_s", "wrong"),
    [
        (0.0, 1.2, False),
        (0.0, 1.0 + HALT_MAX_S + 0.1, True),
        (1.5, 1.6, True),
        (5.5, 6.0, False),
    ],
)
def test_the_checker_finds_motions_after_a_stop(
    began_s: float, ended_s: float, wrong: bool, tmp_path: Path, lab: Lab
) -> None:
    history = History(lab, "a", [], [], stops=[Stop("a", 1.0, 5.0)])
    stretch = motions(entries((began_s, MOVES), (ended_s, TOLD_TO_REST)))
    assert bool(list(history._of_stops("a", stretch))) is wrong


@pytest.mark.parametrize(("ended_s", "wrong"), [(4.9, False), (5.1, False), (5.3, True)])
def test_the_checker_finds_motions_that_outlast_a_stop_however_busy_the_machine(
    ended_s: float, wrong: bool, tmp_path: Path, lab: Lab
) -> None:
    stops = [Stop("a", 1.0, 5.0, granted_s=5.2)]
    history = History(lab, "a", [], [], stops=stops, halt_max_s=math.inf)
    stretch = motions(entries((0.0, MOVES), (ended_s, TOLD_TO_REST)))
    assert bool(list(history._of_stops("a", stretch))) is wrong
