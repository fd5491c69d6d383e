"""The figures of an evaluation, and the numbers that stand in them."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import matplotlib.colors
import matplotlib.image
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.orchestrator.evaluation.plots import fig4, fig7, paths, scatter
from nufleet.orchestrator.evaluation.results import StudyEstimates
from nufleet.orchestrator.evaluation.summaries import (
    by_source,
    mean_kendall_tau,
    pooled_kendall_tau,
    reduction,
)
from nufleet.orchestrator.evaluation.values import (
    FlightError,
    FlownPath,
    TransferPair,
)
from nufleet.orchestrator.flights.labels import flight_label, path_label, prior_and_path
from nufleet.orchestrator.runs.figures import label_places, prior_colours
from nufleet.shared.errors import InvalidInputError

SOURCES = ("source-1", "source-2", "source-3")
PRIORS = ("baseline", "none", *SOURCES)
ERROR_M = dict(zip(PRIORS, (0.27, 0.30, 0.09, 0.10, math.inf), strict=True))


def estimates(study: int, iteration: int) -> dict[str, float]:
    return {source: 0.1 * n + 0.01 * study / iteration for n, source in enumerate(SOURCES, start=1)}


def studies() -> list[StudyEstimates]:
    return [
        StudyEstimates(
            seed=study,
            iterations=5 + study % 2,
            second=estimates(study, 2),
            last=estimates(study, 5 + study % 2),
        )
        for study in range(12)
    ]


def errors() -> list[FlightError]:
    return [
        FlightError(prior, drawing, speed, ERROR_M[prior] * (1 + speed) * scale, prior == "none")
        for drawing, scale in (("clover", 1.0), ("pear", 1.3))
        for speed in (0.3, 0.6, 0.9)
        for prior in PRIORS
    ]


def flown() -> list[FlownPath]:
    turn = np.linspace(0, 2 * np.pi, 200)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    return [
        FlownPath(error, circle, circle * (1 + min(error.rms_error_m, 0.3)))
        for error in errors()
        if error.speed_m_s == 0.3
    ]


def pairs() -> list[TransferPair]:
    robots = ("a", "b", "c", "d", "e", "f")
    return [
        TransferPair(target, source, 0.1 * abs(n - m), 0.02 * abs(n - m) ** 1.5 + 0.003 * n)
        for (n, target), (m, source) in itertools.permutations(enumerate(robots), 2)
    ]


def colours_in(png: Path) -> set[tuple[int, ...]]:
    """Return the colours of the opaque lines and texts that a picture holds."""
    picture = np.round(matplotlib.image.imread(png)[:, :, :3] * 255).astype(int)
    return {tuple(map(int, c)) for c in np.unique(picture.reshape(-1, 3), axis=0)}


def as_bytes(colour: str) -> tuple[int, ...]:
    return tuple(round(255 * c) for c in matplotlib.colors.to_rgb(colour))


def test_estimates_of_every_source_are_drawn(tmp_path: Path) -> None:
    png = tmp_path / "fig4.png"
    fig4(png, studies())
    expected = prior_colours(SOURCES)
    assert {as_bytes(expected[source]) for source in SOURCES} <= colours_in(png)


def test_errors_of_everyone_who_gave_a_prior_are_drawn(tmp_path: Path) -> None:
    png = tmp_path / "fig7.png"
    fig7(png, errors())
    expected = prior_colours(PRIORS)
    assert {as_bytes(expected[prior]) for prior in PRIORS} <= colours_in(png)


def test_paths_fill_a_row_for_each_drawing_and_a_column_for_each_prior(tmp_path: Path) -> None:
    small, wide, tall = (tmp_path / f"{n}.png" for n in range(3))
    few = [f for f in flown() if f.error.prior in ("baseline", "none")]
    paths(small, [f for f in few if f.error.drawing == "pear"])
    paths(wide, [f for f in flown() if f.error.drawing == "pear"])
    paths(tall, few)
    size = {png: matplotlib.image.imread(png).shape[:2] for png in (small, wide, tall)}
    assert size[wide][1] > 2 * size[small][1]
    assert size[wide][0] == size[small][0]
    assert size[tall][0] > 1.5 * size[small][0]
    assert size[tall][1] == size[small][1]
    assert as_bytes(prior_colours(PRIORS)["source-3"]) in colours_in(wide)


def test_pairs_are_drawn_even_where_a_flight_was_not_finished(tmp_path: Path) -> None:
    png = tmp_path / "scatter.png"
    scatter(png, [*pairs(), TransferPair("a", "g", 0.9, math.inf)])
    expected = prior_colours("abcdef")
    assert {as_bytes(expected[target]) for target in "abcdef"} <= colours_in(png)


def test_nothing_to_draw_is_said(tmp_path: Path) -> None:
    png = tmp_path / "none.png"
    for draw in (
        lambda: fig4(png, []),
        lambda: fig7(png, []),
        lambda: paths(png, []),
        lambda: scatter(png, pairs()[:1]),
    ):
        with pytest.raises(InvalidInputError):
            draw()
    assert not png.exists()


def test_every_study_contributes_one_estimate_of_each_source_that_it_kept() -> None:
    found = by_source(study.last for study in studies())
    assert {source: len(values) for source, values in found.items()} == dict.fromkeys(SOURCES, 12)
    assert found["source-2"] == [0.2 + 0.01 * study / (5 + study % 2) for study in range(12)]
    assert by_source([{"a": 0.1, "b": 0.2}, {"b": 0.3}]) == {"a": [0.1], "b": [0.2, 0.3]}


def test_the_reduction_is_averaged_over_paths_as_in_table_i() -> None:
    """Not the reduction of the averages: source 1's 0.09 m and 67.2 % there are both averages."""
    some = [
        FlightError("baseline", "clover", 0.3, 0.1),
        FlightError("baseline", "clover", 0.9, 0.4),
        FlightError("source-1", "clover", 0.3, 0.05),
        FlightError("source-1", "clover", 0.9, 0.1),
        FlightError("source-2", "clover", 0.3, math.inf),
        FlightError("source-3", "pear", 0.3, 0.1),
    ]
    assert reduction(some, "source-1") == pytest.approx((0.5 + 0.75) / 2)
    assert reduction(some, "baseline") == pytest.approx(0.0)
    assert reduction(some, "source-2") is None
    assert reduction(some, "source-3") is None


@given(
    st.lists(
        st.tuples(st.integers(0, 6), st.one_of(st.integers(0, 6), st.just(math.inf))),
        min_size=2,
        max_size=12,
    )
)
def test_kendalls_tau_is_that_of_counted_pairs(values: list[tuple[float, float]]) -> None:
    """Kendall (1945): concordant minus discordant pairs, over the pairs not tied in each."""
    some = [TransferPair("t", f"s{k}", psi, error) for k, (psi, error) in enumerate(values)]
    signs = [
        ((p[0] > q[0]) - (p[0] < q[0]), (p[1] > q[1]) - (p[1] < q[1]))
        for p, q in itertools.combinations(values, 2)
    ]
    untied = [sum(abs(sign[k]) for sign in signs) for k in (0, 1)]
    if 0 in untied:
        assert pooled_kendall_tau(some) is None
        return
    counted = sum(a * b for a, b in signs) / math.sqrt(untied[0] * untied[1])
    assert pooled_kendall_tau(some) == pytest.approx(counted)
    assert mean_kendall_tau(some) == pytest.approx(counted)


def test_targets_are_compared_each_by_itself() -> None:
    """A harder target has the closer sources: within targets similar is better, overall not."""
    easy = [TransferPair("easy", s, psi, psi) for s, psi in (("a", 0.5), ("b", 0.6))]
    hard = [TransferPair("hard", s, psi, 1 + psi) for s, psi in (("a", 0.1), ("b", 0.2))]
    assert mean_kendall_tau([*easy, *hard]) == pytest.approx(1.0)
    assert pooled_kendall_tau([*easy, *hard]) == pytest.approx((2 - 4) / 6)


def test_a_source_has_one_colour_in_all_figures_of_a_fleet() -> None:
    assert prior_colours(["baseline", "b", "a"]) == prior_colours(["a", "b", "none"])
    colours = prior_colours(PRIORS)
    assert len({colours[prior] for prior in PRIORS}) == len(PRIORS)
    assert len(set(colours.values())) == len(colours)


def test_a_label_is_taken_apart_as_it_was_put_together() -> None:
    path = path_label("clover", 0.6)
    assert flight_label("source-1", path) == "source-1 · clover · 0.6 m/s"
    assert prior_and_path(flight_label("source-1", path)) == ("source-1", path)
    assert prior_and_path("hover") == ("hover", "")


AREA = (900.0, 600.0)
places = st.tuples(st.floats(100, AREA[0] - 100), st.floats(60, AREA[1] - 60))


@given(st.lists(places, min_size=1, max_size=5))
def test_labels_of_a_few_points_cover_nothing_and_stay_inside(
    some: list[tuple[float, float]],
) -> None:
    points = np.array(some)
    sizes = np.tile([80.0, 10.0], (len(points), 1))
    low = label_places(points, sizes, AREA)
    high = low + sizes
    assert low.min() >= 0
    assert (high <= np.array(AREA)).all()
    for a, b in itertools.combinations(range(len(points)), 2):
        shared = np.minimum(high[a], high[b]) - np.maximum(low[a], low[b])
        assert shared.min() <= 0
    for corner, end in zip(low, high, strict=True):
        inside = ((points > corner) & (points < end)).all(axis=1)
        assert not inside.any()
