"""Draws the estimates ψ̂*_n after each round and the ranking they give. Imports Rerun."""

from __future__ import annotations

import rerun as rr

from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.orchestrator.viewer.draw.palette import Palette
from nufleet.orchestrator.viewer.events import IterationEvent

TONES_NAMED = 6
"""Limit on the number of frequencies that the table and the log list."""


class Estimates:
    """A view of ψ̂*_n and its 95 % interval over time, and of the ranking as a table."""

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette

    def draw(self, event: IterationEvent) -> None:
        """Draw one round at the time that is set on the stream."""
        for row in event.ranking:
            # Rerun draws a value with a symmetric band, so that a skewed interval takes two series.
            for part, value in (("", row.psi), ("/low", row.psi_low), ("/high", row.psi_high)):
                self._stream.log(
                    f"psi/worst/{row.robot}{part}",
                    rr.Measurements(
                        values=[value],
                        variances=[0.0],
                        colors=[self._palette.of(row.robot)],
                        widths=[0.7 if part else 2.0],
                        names=[f"{row.robot}{part}"],
                    ),
                )
        self._stream.log(
            "ranking", rr.TextDocument(ranking_table(event), media_type=rr.MediaType.MARKDOWN)
        )


def ranking_table(event: IterationEvent) -> str:
    """Return the ranking as Markdown, best source first."""
    lines = [
        f"**Iteration {event.iteration}**, tested at {_tones(event)}, target **{event.target}**",
        "",
        "| | source | worst ψ | 95 % interval | at ω [rad/s] | measured | tests |",
        "|---:|:---|---:|---:|---:|---:|---:|",
        *(_line(place, row) for place, row in enumerate(event.ranking, start=1)),
    ]
    return "\n".join(lines)


def summary(event: IterationEvent) -> str:
    """Return the result of a round in one line for the log."""
    said = f"round {event.iteration} at {_tones(event)}"
    if not event.ranking:
        return said
    best = event.ranking[0]
    return f"{said}: {best.robot} is closest, worst ψ = {best.stated}"


def _tones(event: IterationEvent) -> str:
    some = ", ".join(f"{omega:.3g}" for omega in event.omega_rad_s[:TONES_NAMED])
    if len(event.omega_rad_s) > TONES_NAMED:
        some += f", … ({len(event.omega_rad_s)} tones)"
    return f"ω = {some} rad/s"


def _line(place: int, row: SourceEstimate) -> str:
    mark = "**" if place == 1 else ""
    return (
        f"| {place} | {mark}{row.robot}{mark} | {mark}{row.psi:.4f}{mark} "
        f"| {row.psi_low:.4f} to {row.psi_high:.4f} | {row.omega_rad_s:.3g} | {row.measured} "
        f"| {row.tests} |"
    )
