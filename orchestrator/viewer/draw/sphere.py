"""Draws the responses on the Riemann sphere, with the chords whose lengths are ψ. Imports Rerun."""

from __future__ import annotations

import numpy as np
import rerun as rr

from nufleet.orchestrator.viewer.draw.marks import labels_3d, lines_3d, screen_points
from nufleet.orchestrator.viewer.draw.palette import GRID, QUIET, TEXT, Colour, Palette
from nufleet.orchestrator.viewer.draw.telling import responses_at, telling_tone
from nufleet.orchestrator.viewer.events import Answers
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance, riemann_sphere

CENTRE = np.array([0.0, 0.0, 0.5])

GAINS = (0.2, 0.5, 2.0, 5.0)
"""Gains |z| of the grid's circles of latitude, in addition to |z| = 1."""

PHASES = 12
"""Number of meridians of the grid; each joins responses of equal phase."""

EYE = (0.5, -1.25, 0.85)
"""Initial position of the viewer's eye: above the responses, whose phases are mostly lags."""

LABELS_HIGH, LABELS_LOW, LABEL_GAP = 0.32, -0.04, 0.06
"""Height of the first label of the chords, above or below the sources, and distance between two
labels."""


class Sphere:
    """A view of the Riemann sphere with the responses of the robots and the chords between them.

    The sphere has radius ½ and touches the complex plane at its south pole, z = 0 (paper, Section
    IV-A and Fig. 1). Responses are drawn at the tone where the sources are farthest from the
    target; behind them the responses of all rounds, joined in the order of frequency, show each
    robot's frequency response as far as it is known.
    """

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette
        self._points: set[str] = set()
        self._chords: set[str] = set()
        self._known: dict[str, dict[float, complex]] = {}

    def begin(self) -> None:
        """Draw the static parts: the sphere, its grid and the labels of the phases."""
        self._stream.log("sphere/grid", lines_3d(_grid(), [GRID], 0.6), static=True)
        around = np.exp(1j * np.linspace(-np.pi, np.pi, 181))
        self._stream.log(
            "sphere/unit_gain", lines_3d([riemann_sphere(around)], [QUIET], 1.0), static=True
        )
        body = _body()
        self._stream.log(
            "sphere/body",
            rr.Mesh3D(
                vertex_positions=body[0],
                triangle_indices=body[1],
                albedo_factor=[120, 140, 180, 16],
            ),
            static=True,
        )
        marks = {"0°": 1.0, "−90°": -1j, "±180°": -1.0, "90°": 1j}
        places = [CENTRE + 1.07 * (riemann_sphere(np.array(z)) - CENTRE) for z in marks.values()]
        self._stream.log(
            "sphere/phases",
            labels_3d([*places, [0, 0, -0.04], [0, 0, 1.04]], [*marks, "z = 0", "z = ∞"], [TEXT]),
            static=True,
        )

    def draw(self, answers: Answers) -> None:
        """Draw responses at the time that is set on the stream."""
        for robot, tones in answers.responses.items():
            self._known.setdefault(robot, {}).update(tones)
        leaders = answers.leaders
        now = {r: np.array(z) for r, z in responses_at(answers, telling_tone(answers)).items()}
        for robot, z in now.items():
            in_full = robot == answers.target or robot in leaders
            self._draw_robot(robot, z, self._palette.of(robot) if in_full else QUIET)
        self._clear("points", self._points - now.keys())
        self._points = set(now)
        chords = [s for s in leaders if s in now] if answers.target in now else []
        if chords:
            self._draw_chords(chords, np.array([now[s] for s in chords]), now[answers.target])
        self._clear("chords", self._chords - set(chords))
        self._chords = set(chords)

    def _draw_robot(self, robot: str, z: ComplexArray, colour: Colour) -> None:
        self._stream.log(
            f"sphere/points/{robot}",
            rr.Points3D(
                [riemann_sphere(z)],
                colors=[colour],
                radii=screen_points(4.0 if colour != QUIET else 2.5),
                labels=[robot],
                show_labels=False,
            ),
        )
        known = self._known[robot]
        path = np.array([known[omega] for omega in sorted(known)])
        self._stream.log(
            f"sphere/response/{robot}", lines_3d([riemann_sphere(_refined(path))], [colour], 0.8)
        )

    def _draw_chords(self, sources: list[str], z: ComplexArray, target: ComplexArray) -> None:
        start, ends = riemann_sphere(target), riemann_sphere(z)
        labels = _label_column(ends)
        for source, end, label, psi in zip(
            sources, ends, labels, chordal_distance(z, target), strict=True
        ):
            colour = self._palette.of(source)
            self._stream.log(
                f"sphere/chords/{source}",
                lines_3d([[start, end], [end, label]], [colour], 2.0, 0.5),
                labels_3d([label], [f"{source}  ψ = {psi:.3f}"], [colour]),
            )

    def _clear(self, what: str, robots: set[str]) -> None:
        for robot in robots:
            self._stream.log(f"sphere/{what}/{robot}", rr.Clear(recursive=False))


def _label_column(sources: FloatArray) -> FloatArray:
    """Return positions for labels in front of the sphere, in a column as seen from `EYE`.

    The labels are sorted by the height of their sources. Labels at the chords themselves would
    cover one another and the chords that they name.

    Args:
        sources: Positions of the sources on the sphere, shape (n, 3).

    Returns:
        Positions of the labels in the order of the sources, shape (n, 3).
    """
    # Unit vectors of the view: from the centre towards the eye, to its right, and up.
    forward = (np.array(EYE) - CENTRE) / np.linalg.norm(np.array(EYE) - CENTRE)
    right = np.cross([0.0, 0.0, 1.0], forward) / np.hypot(*forward[:2])
    up = np.cross(forward, right)
    height = (sources - CENTRE) @ up
    rank = np.argsort(np.argsort(-height, kind="stable"))
    top = LABELS_HIGH if height.mean() < 0 else LABELS_LOW
    return np.asarray(
        CENTRE + 0.5 * forward - 0.12 * right + (top - LABEL_GAP * rank[:, None]) * up
    )


def _refined(path: ComplexArray) -> ComplexArray:
    """Return a path with interpolated points, so that it follows the sphere instead of cutting it.

    Args:
        path: Responses, shape (n,).

    Returns:
        Responses with 11 more points in each interval, shape (12 (n − 1) + 1,).
    """
    places = np.linspace(0, len(path) - 1, 12 * (len(path) - 1) + 1)
    return np.asarray(np.interp(places, np.arange(len(path)), path), dtype=np.complex128)


def _grid() -> list[FloatArray]:
    around = np.linspace(-np.pi, np.pi, 97)
    latitudes = [riemann_sphere(gain * np.exp(1j * around)) for gain in GAINS]
    # A gain tan(a) lies at the polar angle 2a from the south pole, so that equal steps of a give
    # equal steps along a meridian.
    gains = np.tan(np.linspace(0, np.pi / 2, 49)[:-1])
    phases = np.arange(PHASES) * 2 * np.pi / PHASES
    return latitudes + [riemann_sphere(gains * np.exp(1j * phase)) for phase in phases]


def _body() -> tuple[FloatArray, FloatArray]:
    """Return the vertices (n, 3) and the triangles (m, 3) of a sphere slightly inside the grid."""
    rows, columns = 24, 48
    height = np.linspace(0, np.pi, rows + 1)[:, None]
    turn = np.linspace(0, 2 * np.pi, columns + 1)[None, :]
    unit = np.stack(
        [np.sin(height) * np.cos(turn), np.sin(height) * np.sin(turn), np.cos(height) + 0 * turn],
        axis=-1,
    )
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    below = corner + columns + 1
    triangles = np.concatenate(
        [np.stack([corner, corner + 1, below], 1), np.stack([corner + 1, below + 1, below], 1)]
    )
    return CENTRE + 0.497 * unit.reshape(-1, 3), triangles
