"""The windows of the online process's benchmark and what it says of a fit, against scikit-learn."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.online_gp import blocks
from benchmarks.online_gp_columns import (
    EQUAL,
    Column,
    best_known,
    compare,
    likelihoods,
    run,
    run_product,
)
from benchmarks.online_gp_ours import OURS
from benchmarks.online_gp_peers import PEERS
from benchmarks.online_gp_windows import Windows, fly, joined, random_windows, read
from nufleet.robot_agent.flight.online_gp import BOUNDS, START
from nufleet.robot_agent.flight.tracking_record import TrackingRecord
from nufleet.shared.gaussian_process.exact import fit
from nufleet.shared.gaussian_process.problem import Batch
from nufleet.sims import drawings

POINTS = 50


@lru_cache
def flown() -> tuple[Windows, TrackingRecord]:
    return fly("double-integrator", drawings.RIBBON, pair_spacing_s=0.0)


@lru_cache
def some() -> tuple[Windows, Column]:
    windows = flown()[0].part(np.arange(100, 140))
    return windows, run_product(windows)


def test_windows_slide_by_one_pair_and_end_with_the_flight() -> None:
    windows, flight = flown()
    assert windows.inputs.shape == (len(flight.actual) - POINTS, 2, POINTS, 4)
    np.testing.assert_array_equal(windows.inputs[1:, :, :-1], windows.inputs[:-1, :, 1:])
    np.testing.assert_array_equal(windows.targets[1:, :, :-1], windows.targets[:-1, :, 1:])
    assert windows.new.tolist() == [POINTS] + [1] * (len(windows) - 1)


def test_pairs_that_are_apart_give_a_window_each() -> None:
    windows, flight = fly("double-integrator", drawings.RIBBON)
    pairs = (len(flight.actual) - 1) // 8
    assert len(windows) == pairs - POINTS + 1
    np.testing.assert_array_equal(windows.inputs[1:, :, :-1], windows.inputs[:-1, :, 1:])


def test_the_product_answers_to_recorded_windows_as_it_did_in_flight() -> None:
    windows, flight = flown()
    column = run_product(windows)
    np.testing.assert_array_equal(flight.prior, 0.0)
    # The first windows may have found another maximum; in flight the search began warm.
    np.testing.assert_allclose(column.mean[20:], flight.mean[POINTS + 20 :], atol=1e-5)


def test_stored_windows_are_read_as_they_were(tmp_path: Path) -> None:
    windows, file = some()[0], tmp_path / "windows.npz"
    np.savez(file, **vars(windows))
    for name, values in vars(read(file)).items():
        np.testing.assert_array_equal(values, getattr(windows, name))


def test_a_part_begins_with_a_whole_window_wherever_steps_are_left_out() -> None:
    part = flown()[0].part(np.array([3, 4, 9, 10, 11]))
    assert part.new.tolist() == [POINTS, 1, POINTS, 1, 1]
    assert len(joined([part, part])) == 10


def test_blocks_are_five_runs_over_all_steps() -> None:
    chosen = blocks(1000, 100)
    assert (len(chosen), chosen[0], chosen[-1]) == (100, 0, 999)
    assert (np.diff(chosen) != 1).sum() == 4
    assert blocks(3, 100).tolist() == [0, 1, 2]


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
def test_the_product_is_nowhere_below_scikit_learn_which_agrees_on_likelihood_and_mean() -> None:
    windows, product = some()
    peer = run("scikit-learn", PEERS["scikit-learn"], windows, np.arange(0, 40, 4))
    part, same = windows.part(peer.steps), product.at(peer.steps)
    found = compare(peer, same, part, best_known(part, []))
    assert (found.fits, found.higher) == (20, 0)
    assert found.formula_difference < 1e-9
    equal = np.abs(likelihoods(part, peer.theta) - likelihoods(part, same.theta)) < EQUAL
    assert equal.sum() >= 10
    np.testing.assert_allclose(peer.mean[equal], same.mean[equal], atol=1e-3)


def test_two_starts_are_nowhere_below_one() -> None:
    windows, product = some()
    column = run("two", OURS["nufleet, two starts"], windows, np.arange(len(windows)))
    best = best_known(windows, [product, column])
    assert compare(column, product, windows, best).lower == 0
    assert compare(product, product, windows, best).highest == 0.0


def test_a_search_that_stopped_short_is_told_from_one_that_found_another_maximum() -> None:
    windows = random_windows(60, 2, np.random.default_rng(0))
    low, high = BOUNDS.log()
    batch = Batch.stacked(
        windows.inputs.reshape(-1, POINTS, 5), windows.targets.reshape(-1, POINTS)
    )
    corners = [fit(batch, [start], BOUNDS) for start in BOUNDS.starts(START, 4)]
    values = np.array([c.log_marginal_likelihood for c in corners]).reshape(-1, 60, 2)
    thetas = np.array([c.hyperparameters.log(120) for c in corners]).reshape(-1, 60, 2, 3)
    steps = np.arange(60)
    where = np.ix_(steps, np.arange(2))
    nothing = np.zeros(60)
    high_theta = thetas[values.argmax(axis=0), where[0], where[1]]
    low_theta = thetas[values.argmin(axis=0), where[0], where[1]]
    best = Column("best", "", steps, high_theta, np.zeros((60, 2)), 0.0, nothing, nothing)
    lower = values.max(axis=0) - values.min(axis=0) > EQUAL
    assert lower.sum() >= 3
    found = compare(replace(best, theta=low_theta), best, windows, values.max(axis=0))
    assert found.another_maximum == found.lower == found.below_best == lower.sum()
    assert (found.stopped_short, found.higher) == (0, 0)
    near = np.clip(high_theta + 0.05, low, high)
    found = compare(replace(best, theta=near), best, windows, values.max(axis=0))
    assert found.lower > 60
    assert found.stopped_short == found.lower
    found = compare(best, replace(best, theta=low_theta), windows, values.max(axis=0))
    assert (found.higher, found.below_best) == (lower.sum(), 0)
