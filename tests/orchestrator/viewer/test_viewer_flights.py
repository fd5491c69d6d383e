"""Flights as plain values: who gave the prior, how well it went, and where they are drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tracking_events import SAMPLE_TIME_S, flight, parts

from nufleet.orchestrator.viewer.draw.axes import HEIGHT, WIDTH
from nufleet.orchestrator.viewer.draw.outline import thinned
from nufleet.orchestrator.viewer.draw.palette import GROUND, TARGET, Palette, subdued
from nufleet.orchestrator.viewer.draw.path_frame import axes_around
from nufleet.orchestrator.viewer.flights import PAUSE_S, Flight, Outcomes


def test_a_label_tells_who_gave_the_prior_and_what_was_flown() -> None:
    known = Flight.begun_by(flight("source-1", path="clover · 0.6 m/s"))
    assert (known.prior, known.path) == ("source-1", "clover · 0.6 m/s")
    assert Flight.begun_by(replace(flight(), flight="hover")).prior == "hover"


def test_parts_are_put_together() -> None:
    event = flight()
    first, *others = parts(event, 70)
    known = Flight.begun_by(first)
    for part in others:
        assert known.continued_by(part)
        known.add(part)
    np.testing.assert_array_equal(known.actual, event.actual)
    np.testing.assert_allclose(np.diff(known.time_s), SAMPLE_TIME_S)
    error = np.linalg.norm(event.actual - event.desired, axis=1)
    assert known.rms_error == pytest.approx(float(np.sqrt(np.mean(error**2))))


def test_another_label_or_a_pause_begins_another_flight() -> None:
    known = Flight.begun_by(flight(samples=100))
    assert known.continued_by(flight(t_s=2.0))
    assert not known.continued_by(flight("s2", t_s=2.0))
    assert not known.continued_by(flight(t_s=2.0 + 1.5 * PAUSE_S))
    assert not known.continued_by(flight(t_s=0.0))


def test_a_sample_is_found_by_its_time() -> None:
    known = Flight.begun_by(flight(t_s=5.0))
    assert [known.at(t_s) for t_s in (0.0, 5.0, 5.0 + 7 * SAMPLE_TIME_S, 99.0)] == [0, 0, 7, 499]


def test_of_a_repeated_flight_the_table_holds_the_latest() -> None:
    outcomes = Outcomes()
    for late_s in (0.2, 0.1):
        outcomes.note(Flight.begun_by(flight(late_s=late_s)))
    (row,) = outcomes.table().splitlines()[4:]
    assert row == f"| circle · 0.6 m/s | {2e3 * np.sin(np.pi * 0.01):.1f} |"


def test_robots_are_told_apart_when_several_fly() -> None:
    outcomes = Outcomes()
    for robot in ("a", "b"):
        outcomes.note(Flight.begun_by(flight(robot=robot)))
    assert [row.split("|")[1].strip() for row in outcomes.table().splitlines()[4:]] == [
        "a: circle · 0.6 m/s",
        "b: circle · 0.6 m/s",
    ]


def test_what_was_taken_back_is_starred() -> None:
    known = Flight.begun_by(flight())
    known.taken_back_s = 1.0
    outcomes = Outcomes()
    outcomes.note(known)
    assert outcomes.table().splitlines()[-1].endswith("\\* |")


def test_flights_without_a_source_have_colours_that_no_source_has() -> None:
    palette = Palette()
    sources = [palette.of_prior(f"s{k}") for k in range(12)]
    alone = [palette.of_prior("baseline"), palette.of_prior("none")]
    assert len({*sources, *alone}) == 14
    assert palette.of("s3") == palette.of_prior("s3") == sources[3]


def test_subdued_colours_lie_between_the_colour_and_the_ground() -> None:
    assert subdued(TARGET, 1.0) == TARGET
    assert subdued(TARGET, 0.0) == GROUND


points = st.lists(
    st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)), min_size=1, max_size=300
).map(np.array)


@given(points, st.integers(6, 60))
def test_a_thinned_path_keeps_its_ends_and_extremes(path: np.ndarray, points_max: int) -> None:
    kept = thinned(path, points_max)
    assert len(kept) <= points_max
    np.testing.assert_array_equal(kept[[0, -1]], path[[0, -1]])
    np.testing.assert_array_equal(kept.max(axis=0), path.max(axis=0))
    np.testing.assert_array_equal(kept.min(axis=0), path.min(axis=0))


@given(points)
def test_a_path_fits_into_its_plot_at_one_scale_with_up_above(path: np.ndarray) -> None:
    axes = axes_around(path)
    places = axes.place(path)
    assert places.min() >= -1e-6
    assert places[:, 0].max() <= WIDTH + 1e-6
    assert places[:, 1].max() <= HEIGHT + 1e-6
    moved = axes.place(path + np.array([0.0, 1.0])) - places
    np.testing.assert_allclose(moved, np.tile([0.0, -axes.scale], (len(path), 1)), atol=1e-6)
    for axis in (0, 1):
        ticks = axes.ticks(axis)
        assert 2 <= len(ticks) <= 12
        assert ticks[0] <= path[:, axis].min() <= path[:, axis].max() <= ticks[-1] + 1e-9
