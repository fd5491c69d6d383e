"""The layout of the views of flights along paths. Imports Rerun."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from orchestrator.viewer.axes import HEIGHT, WIDTH
from orchestrator.viewer.draw_path_axes import PLOT
from orchestrator.viewer.palette import GROUND
from orchestrator.viewer.shown import COMPARED_S, Shown

MODEL_WINDOW_S = 30.0
"""How much of the latest flights the views of the inverse model show."""

AXES_BESIDE_MAX = 3
"""Inverse models of more axes than this are shown one at a time."""


def tracking(shown: Shown, log: rrb.View) -> rrb.Container:
    """Return the views: at the left how well it goes, at the right what the inverse model does."""
    places = [_paths()] if shown.in_plane else []
    places += [_position(shown)] if shown.on_line else []
    inverse: list[rrb.View | rrb.Container] = [_inverse(axis, shown.unit) for axis in shown.axes]
    if len(inverse) > AXES_BESIDE_MAX:
        inverse = [rrb.Tabs(*inverse)]
    return rrb.Horizontal(
        rrb.Vertical(*places, _error(shown), row_shares=[*[64 / len(places)] * len(places), 36]),
        rrb.Vertical(
            *inverse,
            _share(),
            _flights(),
            log,
            row_shares=[*[52 / len(inverse)] * len(inverse), 11, 20, 17],
        ),
        column_shares=[50, 50],
        name="Tracking",
    )


def _paths() -> rrb.View:
    return rrb.Spatial2DView(
        origin=f"/{PLOT}",
        name="Path: wanted (thin), flown now (bright) and before",
        background=GROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-16.0, WIDTH + 58.0], y_range=[-14.0, HEIGHT + 20.0]
        ),
    )


def _position(shown: Shown) -> rrb.View:
    return _series(
        f"Position [{shown.unit}]: wanted (grey) and flown",
        "/tracking",
        ["/tracking/desired/**", "/tracking/actual/**"],
    )


def _error(shown: Shown) -> rrb.View:
    return _series(
        f"Tracking error |e| [m{shown.unit}], by who gave the prior",
        "/tracking/error",
        ["/tracking/error/**", "/tracking/taken_back/error/**"],
        # Beside the paths stand the names in their colours.
        legend=not shown.in_plane,
        # All flights while they are few, then the latest: empty space says nothing.
        start=(
            rr.TimeRangeBoundary.cursor_relative(seconds=-COMPARED_S)
            if shown.long
            else rr.TimeRangeBoundary.absolute(seconds=shown.since_s)
        ),
    )


def _inverse(axis: str, unit: str) -> rrb.View:
    return _series(
        f"Inverse model, {axis} [{unit}/s]: prior (grey) and online GP ± 2σ",
        "/tracking",
        [f"/tracking/prior/{axis}/**", f"/tracking/gp/{axis}/**"],
    )


def _share() -> rrb.View:
    return _series(
        "Share of the correction that acts (× the guard took the prior back)",
        "/tracking/share",
        ["/tracking/share/**", "/tracking/taken_back/share/**"],
        axis_y=rrb.ScalarAxis(range=(-0.1, 1.1), zoom_lock=True),
    )


def _flights() -> rrb.View:
    return rrb.TextDocumentView(origin="/tracking/flights", name="Flights")


def _series(
    name: str,
    origin: str,
    contents: list[str],
    *,
    legend: bool = False,
    start: rr.TimeRangeBoundary | None = None,
    axis_y: rrb.ScalarAxis | None = None,
) -> rrb.View:
    if start is None:
        start = rr.TimeRangeBoundary.cursor_relative(seconds=-MODEL_WINDOW_S)
    end = rr.TimeRangeBoundary.cursor_relative()
    return rrb.TimeSeriesView(
        origin=origin,
        contents=contents,
        name=name,
        axis_x=rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
        axis_y=axis_y,
        plot_legend=rrb.PlotLegend(visible=legend),
        background=rrb.archetypes.PlotBackground(color=GROUND),
        time_ranges=rrb.VisibleTimeRange("t", start=start, end=end),
    )
