"""The layout of a study's views. Imports Rerun."""

from __future__ import annotations

import rerun.blueprint as rrb


def layout() -> rrb.Blueprint:
    """Return the layout, for any fleet."""
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(origin="/sphere", name="Riemann sphere"),
                rrb.TextDocumentView(origin="/ranking", name="Ranking"),
            ),
            rrb.Vertical(
                rrb.BarChartView(origin="/psi/mean", name="ψ(ω)"),
                rrb.TimeSeriesView(origin="/psi/worst", name="worst ψ"),
                rrb.TimeSeriesView(origin="/tests", name="Tests"),
            ),
            rrb.Vertical(
                rrb.StateTimelineView(origin="/robots/state", name="Robots"),
                rrb.TextLogView(origin="/log", name="Log"),
            ),
        ),
        collapse_panels=True,
    )
