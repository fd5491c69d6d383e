"""Which runs exceed limits on age, number and size."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path

import pytest
from run_records import NOON

from nufleet.orchestrator.history.pruning import Limits, RunOnDisk, beyond
from nufleet.shared.errors import InvalidInputError

DAY = timedelta(days=1)
UNFINISHED = 1
RUNS = [
    RunOnDisk(Path(f"run-{number}"), NOON + number * DAY, number != UNFINISHED, 10, 10)
    for number in range(5)
]


@pytest.mark.parametrize(
    ("limits", "pruned"),
    [
        (Limits(age=3 * DAY), [0]),
        (Limits(age=timedelta(days=2.5)), [0]),
        (Limits(age=timedelta(days=1.5)), [0, 2]),
        (Limits(number=5), []),
        (Limits(number=3), [0, 2]),
        (Limits(number=0), [0, 2, 3, 4]),
        (Limits(size_bytes=50), []),
        (Limits(size_bytes=49), [0]),
        (Limits(size_bytes=25), [0, 2, 3]),
        (Limits(age=3 * DAY, size_bytes=30), [0, 2]),
        (Limits(age=3 * DAY, number=2), [0, 2, 3]),
    ],
    ids=str,
)
def test_the_oldest_finished_runs_go_until_the_rest_is_within_all_limits(
    limits: Limits, pruned: list[int]
) -> None:
    assert beyond(limits, RUNS, NOON + 4 * DAY) == [RUNS[number] for number in pruned]


def test_a_run_of_unknown_age_is_not_old() -> None:
    (found,) = [RunOnDisk(Path("run"), None, True, 10, 10)]
    assert beyond(Limits(age=DAY), [found], NOON) == []
    assert beyond(Limits(number=0), [found], NOON) == [found]


def test_pruning_without_a_limit_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="--days, --most or --megabytes"):
        Limits()


def test_runs_that_lose_their_pictures_alone_free_no_more_than_these_and_only_once() -> None:
    small, large = (RunOnDisk(Path("run"), NOON, True, 10, freed) for freed in (0, 6))
    assert beyond(Limits(number=1), [small, large, large], NOON) == [large]
    assert beyond(Limits(size_bytes=20), [small, large, large], NOON) == [large, large]
