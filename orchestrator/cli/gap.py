"""`nufleet gap`: measure how far apart two models are, and whether a controller suits both."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("first", metavar="MODEL", type=click.Path(path_type=Path))
@click.argument("second", metavar="MODEL", type=click.Path(path_type=Path))
@click.option(
    "--band",
    type=(float, float),
    metavar="LO HI",
    help="Also the largest chordal distance between these frequencies, in rad/s.",
)
@click.option(
    "--controller",
    type=click.Path(path_type=Path),
    metavar="MODEL",
    help="A controller C of the first model, u = -C y: does it stabilise the second, too?",
)
@click.option("--json", "as_json", is_flag=True, help="Print one document on stdout.")
def gap(
    first: Path,
    second: Path,
    band: tuple[float, float] | None,
    controller: Path | None,
    as_json: bool,
) -> None:
    """Tell how far apart two models are: Vinnicombe's ν-gap, 0 (the same) to 1.

    \b
    MODEL is a file:
      .json  {"num": [1], "den": [1, 2, 1], "dt": 0}       a transfer function
      .json  {"A": [[..]], "B": .., "C": .., "D": .., "dt": 0.02}
      .json  {"omega_rad_s": [..], "real": [..], "imag": [..]}   measured
      .csv   omega_rad_s,real,imag[,variance]                     measured
    For several inputs and outputs num and den are lists of rows of polynomials.
    Between a measured response and anything else there is only the largest chordal
    distance over the common band, which is a lower bound of the ν-gap.
    """
    from nufleet.orchestrator.gap.report import gap_report, gap_table
    from nufleet.orchestrator.runs.console import stderr_console

    report = gap_report(first, second, band, controller)
    if as_json:
        click.echo(report.model_dump_json(by_alias=True, indent=2))
    else:
        stderr_console().print(gap_table(report))
