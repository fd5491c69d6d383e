"""The figure of the error against own flying: which lines it has, and that they are drawn."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
from evaluated_flights import FIRST, LATER, summed

from nufleet.orchestrator.evaluation.error_curve import curves_of, error_curve


def test_the_best_and_the_worst_source_in_flight_are_drawn_beside_the_other_ways() -> None:
    curves = curves_of(summed([*FIRST, *LATER]))
    assert list(curves) == ["baseline", "none", "worst source", "best source", "own"]
    assert curves["best source"][0].way == "near"
    assert curves["worst source"][0].way == "far"
    assert [way.own_flight_s for way in curves["own"]] == [0.0, 15.0]


def test_it_is_drawn(tmp_path: Path) -> None:
    png = tmp_path / "curve.png"
    error_curve(png, summed([*FIRST, *LATER]).model_copy(update={"noise_rms_m": 0.01}))
    assert matplotlib.image.imread(png).std() > 0
