"""The plots of a ranking: a source has one colour, wherever it stands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from run_records import a_record

from nufleet.orchestrator.runs.figures import prior_colours
from nufleet.orchestrator.runs.report import CURVES_DRAWN, _plain_numbers, drawn_colours


def test_a_source_keeps_its_colour_when_it_changes_places(tmp_path: Path) -> None:
    result = a_record(tmp_path).result
    near, far = (replace(result.ranking[0], robot=robot) for robot in ("b", "a"))
    forth, back = (
        drawn_colours(result.model_copy(update={"ranking": order}))
        for order in ((near, far), (far, near))
    )
    assert forth == back
    assert forth["a"] == prior_colours(["a", "b"])["a"]


def test_only_the_closest_sources_are_drawn(tmp_path: Path) -> None:
    result = a_record(tmp_path).result
    many = tuple(replace(result.ranking[0], robot=f"s{k:02}") for k in range(CURVES_DRAWN + 3))
    drawn = drawn_colours(result.model_copy(update={"ranking": many}))
    assert list(drawn) == [f"s{k:02}" for k in range(CURVES_DRAWN)]


@pytest.mark.parametrize("band_rad_s", [(0.1, 5.4), (2.0, 10.0), (0.03, 0.9)], ids=str)
def test_frequencies_between_decades_are_labelled_by_plain_numbers(
    band_rad_s: tuple[float, float],
) -> None:
    axes = Figure(figsize=(8, 4)).add_subplot()
    axes.set_xscale("log")
    axes.xaxis.set_minor_formatter(_plain_numbers())
    axes.set_xlim(*band_rad_s)
    labels = [label.get_text() for label in axes.get_xticklabels(minor=True)]
    said = [label for label in labels if label]
    assert said
    assert all(set(label) <= set("0123456789.") for label in said)
