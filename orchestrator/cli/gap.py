"""`nufleet gap`: measure how far apart two models are, and whether a controller suits both."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from nufleet.orchestrator.cli.options import json_option
from nufleet.orchestrator.cli.types import Number


@click.command()
@click.argument("first", metavar="MODEL", type=click.Path(path_type=Path))
@click.argument("second", metavar="MODEL", type=click.Path(path_type=Path))
@click.option(
    "--band",
    "band_rad_s",
    type=(Number(unit="rad/s"), Number(unit="rad/s")),
    metavar="LO HI",
    help="Also the largest chordal distance between these frequencies, in rad/s.",
)
@click.option(
    "--controller",
    type=click.Path(path_type=Path),
    metavar="MODEL",
    help="Controller C of the first model, u = -C y: does it stabilise the second model, too?",
)
@json_option
def gap(**options: Any) -> None:
    """Print how far apart two models are: Vinnicombe's ν-gap, from 0 (equal) to 1.

    \b
    MODEL is a file:
      .json  {"num": [1], "den": [1, 2, 1], "dt": 0}       a transfer function
      .json  {"A": [[..]], "B": .., "C": .., "D": .., "dt": 0.02}
      .json  {"omega_rad_s": [..], "real": [..], "imag": [..]}   measured
      .csv   omega_rad_s,real,imag[,variance]                     measured
    With several inputs and outputs, num and den are lists of rows of polynomials.
    A measured response has no ν-gap; the largest chordal distance over the common
    band, a lower bound of the ν-gap, is printed instead.
    """
    from nufleet.orchestrator.jobs.gap import gap_and_print

    gap_and_print(**options)
