"""Draws the sources around the target on the sphere, seen from above it. Imports Rerun."""

from __future__ import annotations

import numpy as np
import rerun as rr

from nufleet.orchestrator.viewer.draw.axes import round_up, spread
from nufleet.orchestrator.viewer.draw.marks import labels_2d, lines_2d, screen_points
from nufleet.orchestrator.viewer.draw.palette import GRID, QUIET, TARGET, TEXT, Palette
from nufleet.orchestrator.viewer.draw.telling import responses_at, telling_tone
from nufleet.orchestrator.viewer.events import Answers
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance, riemann_sphere

RADIUS = 100.0
"""Radius of the outermost ring, in the units of the plot."""


class Differences:
    """A view with the target in the middle and each source at its chordal distance ψ from it.

    Up means more gain than the target, left more phase lag.
    """

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette
        self._drawn: set[str] = set()

    def draw(self, answers: Answers) -> None:
        """Draw responses at the tone where the sources are farthest, at the time set on the stream.

        See `telling_tone` for the choice of the tone. While nothing can be compared, as when the
        target is tested alone, the latest comparison stays.
        """
        tone = telling_tone(answers)
        now = responses_at(answers, tone)
        sources = [s for s in now if s != answers.target] if answers.target in now else []
        if not sources:
            return
        for gone in self._drawn - set(sources):
            self._stream.log(f"difference/sources/{gone}", rr.Clear(recursive=False))
        self._drawn = set(sources)
        target = np.array(now[answers.target])
        z = np.array([now[source] for source in sources])
        psi = chordal_distance(z, target)
        leaders = answers.leaders
        shown = [p for s, p in zip(sources, psi, strict=True) if s in leaders] or list(psi)
        step = round_up(max(float(max(shown)), 1e-6) / 4)
        scale = RADIUS / (step * int(np.ceil(max(float(max(shown)) / step, 1.0))))
        self._draw_rings(tone, step, scale)
        places = _within(around(complex(target), z) * scale)
        for source, place in zip(sources, places, strict=True):
            self._draw_source(source, place, in_full=source in leaders)
        chosen = [n for n, source in enumerate(sources) if source in leaders]
        self._name([sources[n] for n in chosen], places[chosen], psi[chosen])

    def _draw_source(self, source: str, place: FloatArray, *, in_full: bool) -> None:
        colour = self._palette.of(source) if in_full else QUIET
        self._stream.log(
            f"difference/sources/{source}",
            rr.Points2D([place], colors=[colour], radii=screen_points(6.0 if in_full else 3.0)),
            lines_2d([[[0.0, 0.0], place]], [colour], 2.0 if in_full else 0.5),
        )

    def _name(self, sources: list[str], places: FloatArray, psi: FloatArray) -> None:
        """List the sources in a column on the right, each near its own height."""
        heights = spread(places[:, 1], gap=15.0, within=RADIUS)
        colours = [self._palette.of(source) for source in sources]
        self._stream.log(
            "difference/names",
            labels_2d(
                np.column_stack([np.full(len(sources), RADIUS * 1.6), heights]),
                [f"{s}  ψ = {p:.3f}" for s, p in zip(sources, psi, strict=True)],
                colours,
            ),
            lines_2d(
                [
                    [place, [RADIUS * 1.1, height], [RADIUS * 1.2, height]]
                    for place, height in zip(places, heights, strict=True)
                ],
                colours,
                0.5,
            ),
        )

    def _draw_rings(self, omega_rad_s: float, step: float, scale: float) -> None:
        radii = np.arange(1, round(RADIUS / (step * scale)) + 1) * step * scale
        angle = np.linspace(0, 2 * np.pi, 97)
        circle = np.column_stack([np.cos(angle), np.sin(angle)])
        cross = np.array([[[-RADIUS, 0], [RADIUS, 0]], [[0, -RADIUS], [0, RADIUS]]], dtype=float)
        self._stream.log(
            "difference/rings",
            lines_2d([*(radius * circle for radius in radii), *cross], [GRID], 0.6),
        )
        texts = {f"{r / scale:g}": [0.72 * r, 0.72 * r] for r in radii}
        texts |= {
            "more gain": [0.0, -RADIUS - 7],
            "less gain": [0.0, RADIUS + 7],
            "more lag": [-RADIUS, 9.0],
            "less lag": [RADIUS, 9.0],
            f"ω = {omega_rad_s:.3g} rad/s": [RADIUS * 1.6, -RADIUS - 7],
        }
        self._stream.log("difference/labels", labels_2d(list(texts.values()), list(texts), [TEXT]))
        self._stream.log(
            "difference/target",
            rr.Points2D([[0.0, 0.0]], colors=[TARGET], radii=screen_points(7.0)),
        )


def _within(places: FloatArray) -> FloatArray:
    """Return positions (n, 2), with those beyond the outermost ring moved onto it."""
    beyond = np.maximum(np.hypot(places[:, 0], places[:, 1]) / RADIUS, 1.0)
    return places / beyond[:, None]


def around(centre: complex, z: ComplexArray) -> FloatArray:
    """Return the positions of responses around another one, seen from above the sphere.

    The chords from `centre` are projected onto the tangent plane at its point of the sphere, and
    then stretched to the chordal distance ψ (paper, eq. 4). Up points along growing gain, left
    along growing phase lag.

    Args:
        centre: Response in the middle, not 0.
        z: Responses around it, shape (n,).

    Returns:
        Positions (right, down), shape (n, 2), with norms ψ(z, centre).
    """
    middle = np.asarray(centre)
    outward = middle / abs(middle)
    north, east = _tangent(middle, outward), _tangent(middle, 1j * outward)
    towards = riemann_sphere(z) - riemann_sphere(middle)
    flat = np.column_stack([towards @ east, -(towards @ north)])
    # The projection onto the tangent plane shortens each chord; its direction is kept, and its
    # length is set to ψ.
    length = np.hypot(flat[:, 0], flat[:, 1])
    psi = chordal_distance(z, middle)
    return flat * np.divide(psi, length, out=np.zeros_like(psi), where=length > 0)[:, None]


def _tangent(z: ComplexArray, direction: ComplexArray) -> FloatArray:
    """Return the unit tangent vector along which the point of z on the sphere moves, shape (3,).

    It is the central difference for a small step of z in a direction of the complex plane.
    """
    # The step grows with |z|, since the sphere compresses the plane far from the origin.
    step = 1e-5 * (1 + abs(z)) * direction
    moved = riemann_sphere(z + step) - riemann_sphere(z - step)
    return np.asarray(moved / np.linalg.norm(moved))
