"""The work of `nufleet match`: the same tests on a robot and on simulators of it, compared."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated

import click
from pydantic import Field
from rich.console import Console
from rich.table import Table

from nufleet.orchestrator.jobs.consent import carried_out
from nufleet.orchestrator.jobs.rank import RankCommand, rank
from nufleet.orchestrator.jobs.terminal import stderr_console
from nufleet.orchestrator.study.simulator_match import SimulatorMatch, match_simulator
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.strict import Document, Name, NonNegative


class MatchResult(Document):
    """The document that `nufleet match --json` prints."""

    robot: Name
    """Name of the robot."""
    axis: Name
    """Axis that was tested."""
    band_rad_s: tuple[float, float]
    """Band of the tests."""
    simulators: Annotated[tuple[SimulatorMatch, ...], Field(min_length=1)]
    """Simulators, best match first."""
    robot_time_s: NonNegative
    """Time that all robots moved, on their own clocks."""
    run: str
    """Folder of the run."""


@dataclass(frozen=True, kw_only=True)
class MatchCommand(RankCommand):
    """The options of one `nufleet match`; the target is the robot, the sources its simulators."""

    psi_max: float | None = None
    """Largest distance of the best simulator that counts as a match; None for any."""


def match_and_print(command: MatchCommand) -> bool:
    """Compare, print the result, and return whether the best simulator is close enough."""
    result = carried_out(command, match)
    if result is None:
        return True
    console = stderr_console()
    console.print(match_table(result))
    for one in result.simulators:
        console.print(f"{one.simulator}: {one.words}")
    if command.as_json:
        click.echo(result.document())
    best = result.simulators[0]
    if command.psi_max is None or best.psi <= command.psi_max:
        return True
    console.print(
        f"[red]{best.simulator} differs from {result.robot} by ψ {best.psi:.3f}, "
        f"and at most {command.psi_max:g} is allowed[/]"
    )
    return False


def match(command: MatchCommand, console: Console) -> MatchResult:
    """Test a robot and its simulators, and return how well each matches.

    Raises:
        InvalidInputError: The limit is no distance, or as for `rank`.
        NufleetError: As for `rank`.
    """
    limit = command.psi_max
    if limit is not None and not 0 < limit <= 1:
        raise InvalidInputError(f"--max is a chordal distance above 0 and up to 1, got {limit:g}")
    options = {field.name: getattr(command, field.name) for field in fields(RankCommand)}
    record = rank(RankCommand(**{**options, "rehearses": False, "algorithm": "match"}), console)
    responses = {
        robot: [test.response() for test in tests] for robot, tests in record.responses.items()
    }
    robot = record.result.target
    own = responses.pop(robot)
    matches = [match_simulator(name, own, tests) for name, tests in responses.items() if tests]
    return MatchResult(
        robot=robot,
        axis=record.axis,
        band_rad_s=record.result.band_rad_s,
        simulators=tuple(sorted(matches, key=lambda one: one.psi)),
        robot_time_s=record.result.robot_time_s,
        run=record.result.run,
    )


def match_table(result: MatchResult) -> Table:
    """Return one row per simulator: distance, worst frequency, and the three differences."""
    numbers = ("ψ", "95 %", "at rad/s", "later, ms", "stiffness, %", "gain, %", "ψ explained")
    table = Table("simulator", *numbers, title=f"simulators of {result.robot}, axis {result.axis}")
    table.title_justify = "left"
    for one in result.simulators:
        differences = (
            "-" if value is None else f"{scale * value.value:+.2g} ± {scale * value.std:.1g}"
            for value, scale in ((one.delay_s, 1e3), (one.stiffness, 100), (one.gain, 100))
        )
        table.add_row(
            one.simulator,
            f"{one.psi:.4f}",
            f"{one.psi_low:.4f} to {one.psi_high:.4f}",
            f"{one.omega_rad_s:.3g}",
            *differences,
            "-" if one.psi_explained is None else f"{one.psi_explained:.4f}",
        )
    return table
