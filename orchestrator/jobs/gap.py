"""The work of `nufleet gap`."""

from __future__ import annotations

from pathlib import Path

import click

from nufleet.orchestrator.gap.report import gap_report, gap_table
from nufleet.orchestrator.jobs.terminal import stdout_console


def gap_and_print(
    first: Path,
    second: Path,
    band_rad_s: tuple[float, float] | None,
    controller: Path | None,
    *,
    as_json: bool,
) -> None:
    """Compare two models or responses, and print the result.

    Args:
        first: File of the first model or response.
        second: File of the second model or response.
        band_rad_s: Band to compare, in rad/s; None for the default of `gap_report`.
        controller: File of a controller whose loops are examined, if any.
        as_json: Whether to print the result as JSON on stdout instead of a table.
    """
    report = gap_report(first, second, band_rad_s, controller)
    if as_json:
        click.echo(report.model_dump_json(by_alias=True, indent=2))
    else:
        stdout_console().print(gap_table(report))
