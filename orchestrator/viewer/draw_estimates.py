"""Draws the estimates ψ̂*_n after each round and the ranking they give. Imports Rerun."""

from __future__ import annotations

import rerun as rr

from orchestrator.viewer.events import IterationEvent, RankingRow
from orchestrator.viewer.palette import Palette


class Estimates:
    """ψ̂*_n with one standard deviation over time, and the ranking as a table."""

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette

    def draw(self, event: IterationEvent) -> None:
        """Draw one round; the time is set."""
        for row in event.ranking:
            self._stream.log(
                f"psi/worst/{row.robot}",
                rr.Measurements(
                    values=[row.psi],
                    variances=[row.psi_std**2],
                    colors=[self._palette.of(row.robot)],
                    widths=[2.0],
                    names=[row.robot],
                ),
            )
        self._stream.log(
            "ranking", rr.TextDocument(ranking_table(event), media_type=rr.MediaType.MARKDOWN)
        )


def ranking_table(event: IterationEvent) -> str:
    """Return the ranking as Markdown, best source first."""
    tones = ", ".join(f"{omega:.3g}" for omega in event.omega_rad_s[:6])
    if len(event.omega_rad_s) > 6:
        tones += f", … ({len(event.omega_rad_s)} tones)"
    lines = [
        f"**Iteration {event.iteration}**, tested at ω = {tones} rad/s, target **{event.target}**",
        "",
        "| | source | worst ψ | ± σ | at ω [rad/s] | tests |",
        "|---:|:---|---:|---:|---:|---:|",
        *(_line(place, row) for place, row in enumerate(event.ranking, start=1)),
    ]
    return "\n".join(lines)


def _line(place: int, row: RankingRow) -> str:
    mark = "**" if place == 1 else ""
    return (
        f"| {place} | {mark}{row.robot}{mark} | {mark}{row.psi:.4f}{mark} | {row.psi_std:.4f} "
        f"| {row.omega_rad_s:.3g} | {row.tests} |"
    )
