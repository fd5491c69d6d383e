"""Draws the estimates ψ̂*_n after each round and the ranking they give. Imports Rerun."""

from __future__ import annotations

from collections.abc import Mapping

import rerun as rr

from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.orchestrator.viewer.draw.palette import Palette
from nufleet.orchestrator.viewer.events import Answers, IterationEvent
from nufleet.orchestrator.viewer.running_tests import largest_psi

TONES_NAMED = 6
"""Limit on the number of frequencies that the table and the log list."""


class Estimates:
    """A view of ψ̂*_n and its 95 % interval over time, and of the ranking as a table."""

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette
        self._styled: set[str] = set()
        self._ranked = False

    def draw_running(self, answers: Answers) -> None:
        """Draw what the tests in progress have shown; before the first round, as the ranking."""
        if answers.target not in answers.responses:
            return
        farthest = largest_psi(answers)
        for source in answers.leaders:
            self._draw_series(source, "running", farthest[source], 0.7)
        if not self._ranked:
            text = running_table(answers, farthest)
            self._stream.log("ranking", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def _draw_series(self, source: str, part: str, psi: float, width: float) -> None:
        """Draw a value on one of a source's lines, with a mark that is seen by itself too."""
        path = f"psi/worst/{source}/{part}"
        if path not in self._styled:
            self._styled.add(path)
            colour, name = self._palette.of(source), f"{source} {part}"
            line = rr.SeriesLines(colors=[colour], widths=[width], names=[name])
            mark = rr.SeriesPoints(colors=[colour], marker_sizes=[1.5 * width], names=[name])
            self._stream.log(path, line, mark, static=True)
        self._stream.log(path, rr.Scalars([psi]))

    def draw(self, event: IterationEvent) -> None:
        """Draw one round at the time that is set on the stream."""
        self._ranked = True
        for row in event.ranking:
            self._draw_series(row.robot, "median", row.psi, 2.0)
            self._draw_series(row.robot, "low", row.psi_low, 1.0)
            self._draw_series(row.robot, "high", row.psi_high, 1.0)
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


def running_table(answers: Answers, farthest: Mapping[str, float]) -> str:
    """Return what tests in progress have shown as Markdown, the closest source first.

    Args:
        answers: Responses up to now.
        farthest: Largest chordal distance up to now, by source.
    """
    rows = sorted(farthest, key=lambda source: farthest[source])
    lines = [
        f"**Tests in progress**, heard: {_tones(answers)}, target **{answers.target}**",
        "",
        "| | source | largest ψ up to now |",
        "|---:|:---|---:|",
        *(f"| {k} | {source} | {farthest[source]:.4f} |" for k, source in enumerate(rows, 1)),
    ]
    return "\n".join(lines)


def summary(event: IterationEvent) -> str:
    """Return the result of a round in one line for the log."""
    said = f"round {event.iteration} at {_tones(event)}"
    if not event.ranking:
        return said
    best = event.ranking[0]
    return f"{said}: {best.robot} is closest, worst ψ = {best.stated}"


def _tones(event: Answers | IterationEvent) -> str:
    some = ", ".join(f"{omega:.3g}" for omega in event.omega_rad_s[:TONES_NAMED])
    if len(event.omega_rad_s) > TONES_NAMED:
        some += f", … ({len(event.omega_rad_s)} tones)"
    return f"ω = {some} rad/s"


def _line(place: int, row: SourceEstimate) -> str:
    mark = "**" if place == 1 else ""
    return (
        f"| {place} | {mark}{row.robot}{mark} | {mark}{row.psi:.4f}{mark} "
        f"| {row.psi_low:.4f} to {row.psi_high:.4f} | {row.omega_rad_s:.3g}{row.on_axis} "
        f"| {row.measured} "
        f"| {row.tests} |"
    )
