"""Draws the belief about every source's ψ_n(ω) over frequency. Imports Rerun.

Rerun plots against time only. The plot is therefore drawn in a plane at a fixed distance in front
of a pinhole camera, whose 2D view can be moved and magnified like a plot. Unlike 2D drawings, it
may hold translucent areas.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import rerun as rr

from nufleet.orchestrator.study.interface import Curve
from nufleet.orchestrator.viewer.draw.axes import (
    HEIGHT,
    WIDTH,
    Axes,
    axes_over,
    fitting_axes,
    spread,
)
from nufleet.orchestrator.viewer.draw.marks import labels_2d, lines_2d, lines_3d, screen_points
from nufleet.orchestrator.viewer.draw.palette import GRID, QUIET, TEXT, Colour, Palette
from nufleet.orchestrator.viewer.events import Answers, IterationEvent
from nufleet.shared.arrays import FloatArray

CAMERA = "psi/plot"
DISTANCE = 400.0
"""Distance from the camera to the plane in the plot's units, chosen for a usual angle of view."""

# Distances in front of the plane: parts nearer to the camera cover those behind.
_BAND, _LINE, _SAMPLES = 0.0, 0.5, 1.0

_OPACITY = 45
"""Opacity (of 255) of the band."""

FULL_PARTS = ("psi/samples", "psi/interval")
"""Paths of the parts that are drawn only for the leading sources."""

RUNNING = "psi/running"
"""Path of the distances that tests in progress have shown."""


class Surrogates:
    """A view of the median, the band that holds 95 %, and the samples."""

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette
        self._in_full: set[str] = set()
        self._running: set[str] = set()
        self._axes: Axes | None = None

    def begin(self) -> None:
        """Place the camera."""
        self._stream.log(
            CAMERA,
            rr.Pinhole(
                focal_length=DISTANCE,
                resolution=[WIDTH, HEIGHT],
                principal_point=[WIDTH / 2, HEIGHT / 2],
            ),
            static=True,
        )

    def draw_running(self, answers: Answers) -> None:
        """Draw the distances that tests in progress have shown, as small points on a thin line."""
        psi = {s: known for s in answers.leaders if (known := answers.psi(s))}
        self._clear_running(keep=psi)
        if not psi:
            return
        if self._axes is None:
            highest = max(max(known.values()) for known in psi.values())
            axes = axes_over(answers.omega_rad_s[0], answers.omega_rad_s[-1], highest)
            self._draw_axes(axes, answers.omega_rad_s)
        else:
            axes = self._axes
        for source, known in psi.items():
            colour = self._palette.of(source)
            omega_rad_s, distances = np.array(list(known)), np.array(list(known.values()))
            places = _place(axes, omega_rad_s, distances, _SAMPLES)
            self._stream.log(
                f"{RUNNING}/{source}",
                lines_3d([places], [colour], 0.5),
                rr.Points3D(places, colors=[colour], radii=screen_points(2.5)),
            )

    def _clear_running(self, keep: Collection[str] = ()) -> None:
        for source in self._running - set(keep):
            self._stream.log(f"{RUNNING}/{source}", rr.Clear(recursive=False))
        self._running = set(keep)

    def draw(self, event: IterationEvent) -> None:
        """Draw one round at the time that is set on the stream."""
        self._clear_running()
        curves = {curve.source: curve for curve in event.curves if len(curve.omega_rad_s)}
        if not curves:
            return
        leaders = [source for source in event.leaders if source in curves]
        axes = fitting_axes([curves[source] for source in leaders] or list(curves.values()))
        self._axes = axes
        self._draw_axes(axes, event.omega_rad_s)
        for source in self._in_full - set(leaders):
            for part in FULL_PARTS:
                self._stream.log(f"{part}/{source}", rr.Clear(recursive=False))
        self._in_full = set(leaders)
        for source, curve in curves.items():
            if source in leaders:
                self._draw_in_full(axes, curve, first=source == leaders[0])
            else:
                self._draw_median(axes, curve, QUIET, 0.6)
        self._draw_worst(axes, event, leaders)

    def _draw_in_full(self, axes: Axes, curve: Curve, *, first: bool) -> None:
        colour = self._palette.of(curve.source)
        self._draw_median(axes, curve, colour, 2.0 if first else 1.4)
        self._stream.log(f"psi/interval/{curve.source}", _band(axes, curve, (*colour, _OPACITY)))
        self._stream.log(
            f"psi/samples/{curve.source}",
            rr.Points3D(
                _place(axes, curve.sampled_omega_rad_s, curve.sampled_psi, _SAMPLES),
                colors=[colour],
                radii=screen_points(4.0),
            ),
        )

    def _draw_median(self, axes: Axes, curve: Curve, colour: Colour, width: float) -> None:
        places = _place(axes, curve.omega_rad_s, curve.median, _LINE)
        self._stream.log(f"psi/median/{curve.source}", lines_3d([places], [colour], width))

    def _draw_axes(self, axes: Axes, tested_rad_s: tuple[float, ...]) -> None:
        omega_ticks, psi_ticks = axes.omega_ticks_rad_s(), axes.psi_ticks()
        across, down = axes.x(np.array(omega_ticks)), axes.y(np.array(psi_ticks))
        lines = [[[x, 0.0], [x, HEIGHT]] for x in across]
        lines += [[[0.0, y], [WIDTH, y]] for y in down]
        frame = [[0.0, 0.0], [0.0, HEIGHT], [WIDTH, HEIGHT]]
        self._stream.log(
            f"{CAMERA}/grid", lines_2d([*lines, frame], [GRID] * len(lines) + [QUIET], 0.5)
        )
        labels = [([x, HEIGHT + 6.0], f"{t:g}") for x, t in zip(across, omega_ticks, strict=True)]
        labels += [([-9.0, y], f"{t:g}") for y, t in zip(down, psi_ticks, strict=True)]
        labels += [([WIDTH / 2, HEIGHT + 14.0], "ω [rad/s]"), ([-9.0, -7.0], "ψ")]
        self._stream.log(
            f"{CAMERA}/labels",
            labels_2d([place for place, _ in labels], [text for _, text in labels], [TEXT]),
        )
        self._stream.log(
            f"{CAMERA}/tested",
            lines_2d(
                [[[x, -2.0], [x, HEIGHT]] for x in axes.x(np.array(tested_rad_s))], [QUIET], 0.5
            ),
        )

    def _draw_worst(self, axes: Axes, event: IterationEvent, leaders: list[str]) -> None:
        """Draw a line from every leader's worst case to its name on the right of the plot."""
        rows = [row for row in event.ranking if row.robot in leaders]
        across = axes.x(np.array([row.omega_rad_s for row in rows]))
        down = axes.y(np.array([row.psi for row in rows]))
        heights = spread(down, gap=8.0, within=HEIGHT)
        colours = [self._palette.of(row.robot) for row in rows]
        self._stream.log(
            f"{CAMERA}/worst",
            lines_2d(
                [
                    [[x, y], [WIDTH, y], [WIDTH + 4.0, height]]
                    for x, y, height in zip(across, down, heights, strict=True)
                ],
                colours,
                0.5,
            ),
        )
        self._stream.log(
            f"{CAMERA}/names",
            labels_2d(
                np.column_stack([np.full(len(rows), WIDTH + 20.0), heights]),
                # The axis, which the ranking names, would reach beyond the view.
                [f"{row.robot}  {row.psi:.3f}" for row in rows],
                colours,
            ),
        )


def _band(axes: Axes, curve: Curve, colour: tuple[int, int, int, int]) -> rr.Mesh3D:
    n = len(curve.omega_rad_s)
    upper, lower = (
        _place(axes, curve.omega_rad_s, bound, _BAND) for bound in (curve.high, curve.low)
    )
    corner = np.arange(n - 1)
    return rr.Mesh3D(
        vertex_positions=np.concatenate([upper, lower]),
        triangle_indices=np.concatenate(
            [
                np.stack([corner, corner + 1, corner + n], axis=1),
                np.stack([corner + 1, corner + n + 1, corner + n], axis=1),
            ]
        ),
        albedo_factor=colour,
    )


def _place(axes: Axes, omega_rad_s: FloatArray, psi: FloatArray, front: float) -> FloatArray:
    """Return points in front of the camera that are seen at the given ω and ψ of the plot.

    Args:
        axes: Scales of the plot.
        omega_rad_s: Frequencies, shape (n,).
        psi: Chordal distances, shape (n,).
        front: Distance in front of the plane, in the plot's units. Points move along the line of
            sight, so that they are seen at the same place.

    Returns:
        Points in the camera's frame (right, down, forward), shape (n, 3).
    """
    # Pinhole projection: a point at (x, y, depth) is seen at (x, y) · DISTANCE / depth.
    depth = DISTANCE - front
    across = (axes.x(omega_rad_s) - WIDTH / 2) * depth / DISTANCE
    down = (axes.y(psi) - HEIGHT / 2) * depth / DISTANCE
    return np.column_stack([across, down, np.full(len(across), depth)])
