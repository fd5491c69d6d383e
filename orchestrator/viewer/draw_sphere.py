"""Draws the responses on the Riemann sphere, with the chords whose lengths are ψ. Imports Rerun."""

from __future__ import annotations

import numpy as np
import rerun as rr

from orchestrator.viewer.events import IterationEvent
from orchestrator.viewer.palette import QUIET, Palette
from shared.arrays import FloatArray
from shared.chordal import chordal_distance, riemann_sphere

GAINS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Circles of latitude of the grid: responses of equal gain |z|."""

PHASES = 12
"""Meridians of the grid: responses of equal phase."""


class Sphere:
    """The sphere (radius ½, standing on the plane at z = 0), the robots on it and the chords."""

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette
        self._drawn: set[str] = set()

    def begin(self) -> None:
        """Draw the grid."""
        self._stream.log(
            "sphere/grid",
            rr.LineStrips3D(_grid(), colors=[QUIET], radii=[0.0015]),
            static=True,
        )

    def draw(self, event: IterationEvent) -> None:
        """Draw one round: the robots at its first tone; the time is set."""
        responses = {robot: np.array(z[:1]) for robot, z in event.responses.items()}
        for gone in self._drawn - responses.keys():
            self._stream.log(f"sphere/points/{gone}", rr.Clear(recursive=False))
            self._stream.log(f"sphere/chords/{gone}", rr.Clear(recursive=False))
        self._drawn = set(responses)
        target = responses.get(event.target)
        for robot, z in responses.items():
            colour = self._palette.of(robot)
            place = riemann_sphere(z)
            is_target = robot == event.target
            self._stream.log(
                f"sphere/points/{robot}",
                rr.Points3D(
                    place,
                    colors=[colour],
                    radii=[0.02 if is_target else 0.014],
                    labels=[robot],
                ),
            )
            if target is not None and not is_target:
                psi = float(chordal_distance(z, target)[0])
                self._stream.log(
                    f"sphere/chords/{robot}",
                    rr.LineStrips3D(
                        [np.concatenate([place, riemann_sphere(target)])],
                        colors=[colour],
                        radii=[0.005],
                        labels=[f"ψ = {psi:.3f}"],
                    ),
                )


def _grid() -> list[FloatArray]:
    around = np.linspace(-np.pi, np.pi, 97)
    latitudes = [riemann_sphere(gain * np.exp(1j * around)) for gain in GAINS]
    gains = np.tan(np.linspace(0, np.pi / 2, 49)[:-1])
    phases = np.arange(PHASES) * 2 * np.pi / PHASES
    return latitudes + [riemann_sphere(gains * np.exp(1j * phase)) for phase in phases]
