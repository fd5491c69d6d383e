"""The layout of all views. Imports Rerun."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from orchestrator.viewer.axes import HEIGHT, WIDTH
from orchestrator.viewer.draw_differences import RADIUS
from orchestrator.viewer.draw_sphere import EYE
from orchestrator.viewer.draw_surrogates import CAMERA, FULL_PARTS
from orchestrator.viewer.palette import GROUND
from orchestrator.viewer.shown import Kind, Shown
from orchestrator.viewer.tracking_layout import tracking

TESTS_WINDOW_S = 20.0
"""How much of the latest tests is shown; zoom out for the rest."""

EVERYTHING = rr.TimeRange(
    start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
)


def layout(shown: Shown) -> rrb.Blueprint:
    """Return the layout, for any fleet: a study, flights, or both as tabs, the latest in front."""
    parts: dict[Kind, rrb.Container] = {}
    if "ranking" in shown.kinds:
        parts["ranking"] = _study()
    if "tracking" in shown.kinds:
        parts["tracking"] = tracking(shown, _log())
    in_front = list(parts).index(shown.kinds[-1])
    return rrb.Blueprint(
        rrb.Tabs(*parts.values(), active_tab=in_front) if len(parts) > 1 else parts[shown.kinds[0]],
        rrb.TimePanel(state="collapsed", timeline="t", play_state="following"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
    )


def _study() -> rrb.Container:
    """From left to right where, how far, and what happens."""
    return rrb.Horizontal(
        rrb.Vertical(_sphere(), _differences(), row_shares=[1, 1]),
        rrb.Vertical(_surrogates(), _estimates(), row_shares=[6, 4]),
        rrb.Vertical(_ranking(), _tests(), _robots(), _log(), row_shares=[28, 26, 24, 22]),
        column_shares=[30, 42, 34],
        name="Ranking",
    )


def _sphere() -> rrb.View:
    return rrb.Spatial3DView(
        origin="/sphere",
        name="Responses on the Riemann sphere",
        background=GROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=EYE,
            look_target=[0.0, 0.0, 0.47],
            eye_up=[0.0, 0.0, 1.0],
        ),
    )


def _differences() -> rrb.View:
    return rrb.Spatial2DView(
        origin="/difference",
        name="Sources around the target, at the latest frequency",
        background=GROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-RADIUS * 1.25, RADIUS * 2.2], y_range=[-RADIUS * 1.15, RADIUS * 1.15]
        ),
    )


def _surrogates() -> rrb.View:
    return rrb.Spatial2DView(
        origin=f"/{CAMERA}",
        contents=[f"/{part}/**" for part in (CAMERA, "psi/mean", *FULL_PARTS)],
        name="Chordal distance ψ(ω) to the target: belief ± 1σ, 2σ and tests",
        background=GROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-16.0, WIDTH + 40.0], y_range=[-12.0, HEIGHT + 20.0]
        ),
    )


def _estimates() -> rrb.View:
    return rrb.TimeSeriesView(
        origin="/psi/worst",
        name="Worst ψ over the band, as believed after each round (± 1σ)",
        axis_x=rrb.TimeAxis(view_range=EVERYTHING),
        plot_legend=rrb.PlotLegend(visible=False),
        background=rrb.archetypes.PlotBackground(color=GROUND),
    )


def _ranking() -> rrb.View:
    return rrb.TextDocumentView(origin="/ranking", name="Ranking")


def _tests() -> rrb.View:
    return rrb.TimeSeriesView(
        origin="/tests",
        name="Running tests: references (grey) and responses",
        plot_legend=rrb.PlotLegend(visible=False),
        background=rrb.archetypes.PlotBackground(color=GROUND),
        time_ranges=rrb.VisibleTimeRange(
            "t",
            start=rr.TimeRangeBoundary.cursor_relative(seconds=-TESTS_WINDOW_S),
            end=rr.TimeRangeBoundary.cursor_relative(),
        ),
    )


def _robots() -> rrb.View:
    return rrb.StateTimelineView(
        origin="/state", name="Robots", time_view=rrb.TimeAxis(view_range=EVERYTHING)
    )


def _log() -> rrb.View:
    return rrb.TextLogView(
        origin="/log",
        name="Log",
        columns=rrb.TextLogColumns(
            timeline_columns=[rrb.encodings.TimelineColumn("t", visible=False)],
            text_log_columns=["LogLevel", "Body"],
        ),
    )
