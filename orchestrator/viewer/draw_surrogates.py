"""Draws ψ_n(ω) as it is believed. Imports Rerun."""

from __future__ import annotations

import rerun as rr

from orchestrator.viewer.events import IterationEvent
from orchestrator.viewer.palette import Palette


class Surrogates:
    """The posterior mean, its bands and the samples of every source, over frequency."""

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette

    def draw(self, event: IterationEvent) -> None:
        """Draw one round; the time is set."""
        for curve in event.curves:
            self._stream.log(
                f"psi/mean/{curve.source}",
                rr.BarChart(
                    curve.mean, abscissa=curve.omega_rad_s, color=self._palette.of(curve.source)
                ),
            )
