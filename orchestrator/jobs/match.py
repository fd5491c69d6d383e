"""The work of `nufleet match`: the same tests on a robot and on simulators of it, compared."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Annotated

import click
from pydantic import Field
from rich.console import Console
from rich.table import Table

from nufleet.orchestrator.conduct.preflight import check_names
from nufleet.orchestrator.conduct.simulator_copy import SimulatorCopy
from nufleet.orchestrator.jobs.consent import carried_out
from nufleet.orchestrator.jobs.rank import RankCommand, rank
from nufleet.orchestrator.jobs.terminal import bars_shown, stderr_console
from nufleet.orchestrator.repository.records import TrialStatus
from nufleet.orchestrator.runs.folder import study_id_of
from nufleet.orchestrator.study.settings_fit import fit_settings
from nufleet.orchestrator.study.simulator_match import (
    Difference,
    SimulatorMatch,
    match_simulator,
)
from nufleet.shared.command_line import restart_within
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
    fit: dict[str, Difference] | None = None
    """Fitted value of each setting with its standard error, by path; None without --fit, and where
    the tests do not tell them."""
    psi_left: NonNegative | None = None
    """Distance that the fit leaves; None as for `fit`."""

    @property
    def psi(self) -> float:
        """Distance of the best simulator, with fitted settings if there are some."""
        return self.simulators[0].psi if self.psi_left is None else self.psi_left


@dataclass(frozen=True, kw_only=True)
class MatchCommand(RankCommand):
    """The options of one `nufleet match`; the target is the robot, the sources its simulators."""

    psi_max: float | None = None
    """Largest distance of the best simulator that counts as a match; None for any."""
    fit: tuple[str, ...] | None = None
    """Names of the settings of the simulator to fit; None to fit none."""


def match_and_print(command: MatchCommand) -> bool:
    """Compare, print the result, and return whether the best simulator is close enough."""
    _check_robots(command)
    simulator = None if command.fit is None else _to_fit(command, command.fit)
    result = carried_out(command, match)
    if result is None:
        return True
    console = stderr_console()
    console.print(match_table(result))
    for one in result.simulators:
        console.print(f"{one.simulator}: {one.words}")
    if simulator is not None:
        result = fitted(command, result, simulator, console)
    if command.as_json:
        click.echo(result.document())
    if command.psi_max is None or result.psi <= command.psi_max:
        return True
    console.print(
        f"[red]{result.simulators[0].simulator} differs from {result.robot} by ψ "
        f"{result.psi:.3f}, and at most {command.psi_max:g} is allowed[/]"
    )
    return False


def _check_robots(command: MatchCommand) -> None:
    """Raise InvalidInputError unless there are a robot and simulators to compare with it."""
    choice = command.fleet()
    robot = choice.target(command.target, "which robot are they to match? Name it with --robot")
    if robot in (command.sources or ()):
        raise InvalidInputError(f"{robot} is the robot, and cannot be among its --simulators")
    if choice.file is not None and set(choice.file.robots) <= {robot}:
        raise InvalidInputError(f"there is no simulator besides {robot} in the fleet file")


def _to_fit(command: MatchCommand, names: tuple[str, ...]) -> SimulatorCopy:
    """Return the simulator whose settings are fitted; restarts the process if it needs other
    environment variables.

    Raises:
        InvalidInputError: There are several simulators, or the settings cannot be fitted.
        FleetFileError: The fleet file is not valid.
    """
    choice = command.fleet()
    if choice.file is None or choice.reach.fleet_file is None:
        raise InvalidInputError("--fit requires --fleet, whose file holds the settings")
    robots, target = tuple(choice.file.robots), choice.target(command.target)
    sources = command.sources or tuple(name for name in robots if name != target)
    check_names(target, sources, robots)
    if len(sources) != 1:
        raise InvalidInputError(
            f"--fit fits one simulator: choose one of {', '.join(sources)} with --simulators"
        )
    simulator = SimulatorCopy(choice.file, Path(choice.reach.fleet_file), sources[0], names)
    restart_within(simulator.environment)
    simulator.check()
    return simulator


def fitted(
    command: MatchCommand, result: MatchResult, simulator: SimulatorCopy, console: Console
) -> MatchResult:
    """Fit the simulator to the robot, print how, and return the result with the fit.

    Raises:
        StudyError: The tests have too few tones.
        RobotError: The simulator cannot play the tests.
    """
    name = simulator.robot
    with command.storage.open() as repository:
        studies, study = repository.studies, study_id_of(Path(result.run))
        trials = [one for one in studies.trials(study) if one.status is TrialStatus.MEASURED]
        played = [
            (one.plan, studies.result(one.intent.goal_id).reference)
            for one in trials
            if one.intent.robot == name and one.plan is not None
        ]
    own = [one.response for one in trials if one.intent.robot == result.robot and one.response]
    with bars_shown(console, "simulations at most") as shown:
        fit = fit_settings(
            own,
            lambda values: simulator.responses(values, played),
            simulator.settings(),
            partial(shown, "fitting"),
        )
    console.print(fit.words(result.robot, name))
    if fit.untold:
        return result
    values = {path: found.value for path, found in fit.settings.items()}
    console.print(simulator.lines(values), markup=False)
    return result.model_copy(update={"fit": fit.settings, "psi_left": fit.psi_left})


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
