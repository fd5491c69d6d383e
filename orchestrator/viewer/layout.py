"""The views that a recording opens with, for studies and for flights along paths."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from nufleet.orchestrator.viewer.draw.axes import HEIGHT, WIDTH
from nufleet.orchestrator.viewer.draw.differences import RADIUS
from nufleet.orchestrator.viewer.draw.errors import HEIGHT as ERRORS_HEIGHT
from nufleet.orchestrator.viewer.draw.errors import PLOT as COMPARED
from nufleet.orchestrator.viewer.draw.errors import WIDTH as ERRORS_WIDTH
from nufleet.orchestrator.viewer.draw.palette import GROUND
from nufleet.orchestrator.viewer.draw.path_axes import PLOT
from nufleet.orchestrator.viewer.draw.sphere import EYE
from nufleet.orchestrator.viewer.draw.surrogates import CAMERA, FULL_PARTS, RUNNING
from nufleet.orchestrator.viewer.shown import COMPARED_S, Kind, Shown

MODEL_WINDOW_S = 30.0
"""Span of the latest flights that the views of the inverse model show."""

AXES_BESIDE_MAX = 3
"""Largest number of axes whose inverse models are shown side by side; more are put into tabs."""

TESTS_WINDOW_S = 20.0
"""Span of the latest tests that is shown; zoom out for the rest."""

EVERYTHING = rr.TimeRange(
    start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
)


def tracking(shown: Shown, log: rrb.View) -> rrb.Container:
    """Return the views of flights: tracking on the left, the inverse model on the right.

    Args:
        shown: Present content of the recording.
        log: View of the log, placed in the lower right.
    """
    places = [_paths()] if shown.in_plane else []
    places += [_position(shown)] if shown.on_line else []
    inverse: list[rrb.View | rrb.Container] = [_inverse(axis, shown.unit) for axis in shown.axes]
    if len(inverse) > AXES_BESIDE_MAX:
        inverse = [rrb.Tabs(*inverse)]
    return rrb.Horizontal(
        rrb.Vertical(
            *places,
            rrb.Tabs(_compared(shown), _error(shown)),
            row_shares=[*[64 / len(places)] * len(places), 36],
        ),
        rrb.Vertical(
            *inverse,
            rrb.Tabs(_weights(), _share()) if shown.mixed else _share(),
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
        name="Path: desired (thin), current flight (bright), earlier flights",
        background=GROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-16.0, WIDTH + 58.0], y_range=[-14.0, HEIGHT + 20.0]
        ),
    )


def _compared(shown: Shown) -> rrb.View:
    return rrb.Spatial2DView(
        origin=f"/{COMPARED}",
        name=f"Tracking error |e| [m{shown.unit}] of all flights along the path, each from 0 s",
        background=GROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-18.0, ERRORS_WIDTH + 74.0], y_range=[-14.0, ERRORS_HEIGHT + 17.0]
        ),
    )


def _position(shown: Shown) -> rrb.View:
    return _series(
        f"Position [{shown.unit}]: desired (grey) and actual",
        "/tracking",
        ["/tracking/desired/**", "/tracking/actual/**"],
    )


def _error(shown: Shown) -> rrb.View:
    return _series(
        f"Tracking error |e| [m{shown.unit}], by source of the prior",
        "/tracking/error",
        ["/tracking/error/**", "/tracking/taken_back/error/**"],
        # The view of the paths already lists the names in their colours.
        legend=not shown.in_plane,
        # Show all flights while they are few, then the latest: empty space carries no information.
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
        "Share of the correction that acts (× the guard withdrew the prior)",
        "/tracking/share",
        ["/tracking/share/**", "/tracking/taken_back/share/**"],
        axis_y=rrb.ScalarAxis(range=(-0.1, 1.1), zoom_lock=True),
    )


def _weights() -> rrb.View:
    return _series(
        "Weights of the mixture, by source",
        "/tracking/weights",
        ["/tracking/weights/**"],
        legend=True,
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


def layout(shown: Shown) -> rrb.Blueprint:
    """Return the layout for a study, for flights, or for both as tabs with the latest in front."""
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
    """Return the views of a study: responses, distances, and on the right what happens now."""
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
        contents=[f"/{part}/**" for part in (CAMERA, "psi/median", *FULL_PARTS, RUNNING)],
        name="Chordal distance ψ(ω) to the target: median, 95 % interval and tests",
        background=GROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-16.0, WIDTH + 40.0], y_range=[-12.0, HEIGHT + 20.0]
        ),
    )


def _estimates() -> rrb.View:
    return rrb.TimeSeriesView(
        origin="/psi/worst",
        name="Worst ψ: largest in running tests (thin), estimated after each round (95 % interval)",
        axis_x=rrb.TimeAxis(view_range=EVERYTHING),
        plot_legend=rrb.PlotLegend(visible=False),
        background=rrb.archetypes.PlotBackground(color=GROUND),
    )


def _ranking() -> rrb.View:
    return rrb.TextDocumentView(origin="/ranking", name="Ranking")


def _tests() -> rrb.View:
    return rrb.TimeSeriesView(
        origin="/tests",
        name="Tests in progress: references (grey) and responses",
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
