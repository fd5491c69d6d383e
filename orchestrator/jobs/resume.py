"""The work of `nufleet runs resume`: find an interrupted run and continue it."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import click
from rich.console import Console

from nufleet.orchestrator.conduct.first_round import outlook
from nufleet.orchestrator.conduct.rank_run import ReadyStudy, prepare_again
from nufleet.orchestrator.conduct.recipe import make_study, recipe_of
from nufleet.orchestrator.conduct.replay import resume as replay
from nufleet.orchestrator.conduct.replay import tried_again
from nufleet.orchestrator.fleet.reach import REACH, FleetChoice, Reach
from nufleet.orchestrator.flights.planned import Outlook
from nufleet.orchestrator.history.catalogue import read_run
from nufleet.orchestrator.jobs.commands import MovingCommand
from nufleet.orchestrator.jobs.consent import carried_out
from nufleet.orchestrator.jobs.evaluate import ResumedCommand, resume_evaluation
from nufleet.orchestrator.jobs.opening import Opening
from nufleet.orchestrator.jobs.study import show_study
from nufleet.orchestrator.repository.errors import UnknownRecordError
from nufleet.orchestrator.repository.records import (
    StudyRecord,
    StudyStatus,
    TrialRecord,
)
from nufleet.orchestrator.repository.repository import Repository
from nufleet.orchestrator.runs.folder import (
    CONFIGURATION,
    find_run,
    list_runs,
    read_configuration,
    study_id_of,
)
from nufleet.orchestrator.runs.headline import Headline, write_headline
from nufleet.orchestrator.runs.rank_result import RunRecord
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.strict import Document, validation_errors_as

LATEST = "latest"


@dataclass(frozen=True, kw_only=True)
class ResumeCommand(MovingCommand):
    """The options of one `nufleet runs resume`."""

    run: str = LATEST
    """Name of the run, path of its folder, or `latest` for the latest that can be resumed."""
    connect: str | None = None
    """Endpoint of the fleet; None for the one that the run used before."""
    wait_s: float = 0.0
    """Time to wait for the fleet's router and robots."""
    live: bool = False
    """Whether to serve the recording to live viewers."""
    draws: bool = True
    """Whether to draw a recording and plots."""
    rehearses: bool = True
    """Whether the target is asked what error it expects of each way to fly."""


def resume_and_print(command: ResumeCommand) -> None:
    """Resume a run, with progress on stderr and, if wanted, the document on stdout."""
    document = carried_out(command, resume)
    if document is not None and command.as_json:
        click.echo(document.document())


def resume(command: ResumeCommand, console: Console) -> Document:
    """Resume a ranking or an evaluation, and return the document that it prints.

    Raises:
        InvalidInputError: The run cannot be resumed, or a robot that it needs is missing.
        StudyError: The study cannot continue, because the target or every source is gone.
    """
    with command.storage.open() as repository:
        path = _interrupted_run(command, repository)
    if not _evaluates(path):
        return resume_run(replace(command, run=str(path)), console).result
    resumed = ResumedCommand(
        runs_root=command.runs_root,
        repository=command.repository,
        as_json=command.as_json,
        live=command.live,
        plans=command.plans,
        picture=command.picture,
        yes=command.yes,
    )
    return resume_evaluation(path, _reach(command, path), resumed, console)


def resume_run(command: ResumeCommand, console: Console) -> RunRecord:
    """Resume a ranking and return its record, as stored in its folder; see `resume`."""
    with Opening(command, console) as run:
        path = _interrupted_run(command, run.repository)
        study = _unfinished(path, run.repository)
        reach, trials = _reach(command, path), _trials(study, run.repository)
        specs, untestable = recipe_of(study).specs, recipe_of(study).untestable
        gone = {*untestable, *(trial.intent.robot for trial in trials if trial.given_up)}
        needed = tuple(robot for robot in specs if robot not in gone)
        console.print(f"resuming {path.name}")
        fleet, _, there = run.reach(FleetChoice.again(reach), needed, wait_s=command.wait_s)
        _check_there(needed, there, study)
        ready = prepare_again(fleet, study, gone)
        run.go_on(
            path,
            {robot: ready.descriptions[robot] for robot in needed},
            lambda: _open_round(study, ready, run.repository, trials),
        )
        run.say_how_to_resume()
        run.record(live=command.live, draws=command.draws)
        # Read again: the orchestrator that held the robots until now may have ended the study.
        had_failed, study = study.status is StudyStatus.FAILED, _unfinished(path, run.repository)
        if study.status is StudyStatus.FAILED:
            if not had_failed:
                raise InvalidInputError(f"{path.name} has failed meanwhile: {study.reason}")
            study = run.archive.try_again(study)
            write_headline(path, Headline())
        return show_study(run, ready, study, rehearses=command.rehearses)


def _open_round(
    study: StudyRecord,
    ready: ReadyStudy,
    repository: Repository,
    trials: tuple[TrialRecord, ...],
) -> Outlook:
    """Return what the robots have left to do of the round that was interrupted."""
    at = replay(study.study_id, make_study(study, repository.studies), trials)
    if at.open is None:
        return Outlook(headline="all tests of the study are complete", motions=())
    specs = {robot: one.spec for robot, one in ready.descriptions.items()}
    missing = {test.robot for test in at.open.tests}
    return outlook(study.plan, at.open.question, specs, missing)


def _reach(command: ResumeCommand, path: Path) -> Reach:
    given = {} if command.connect is None else {"connect": command.connect}
    return reach_of(path).model_copy(update=given)


def _evaluates(path: Path) -> bool:
    return read_configuration(path).get("kind") in ("evaluate", "pairs")


def can_reach_again(folder: Path) -> bool:
    """Return whether a run's folder records how the run connected to its fleet; rankings and
    evaluations do so."""
    try:
        reach_of(folder)
    except InvalidInputError:
        return False
    return True


def reach_of(folder: Path) -> Reach:
    """Return how a run connected to its fleet; raises InvalidInputError when that is not known."""
    path, found = folder / CONFIGURATION, read_configuration(folder).get(REACH)
    if found is None:
        raise InvalidInputError(
            f"{path} does not say how the run reached its fleet; it cannot be resumed"
        )
    with validation_errors_as(InvalidInputError, f"{path}: {REACH}"):
        return Reach.model_validate_json(json.dumps(found))


def _interrupted_run(command: ResumeCommand, repository: Repository) -> Path:
    if command.run != LATEST:
        return find_run(command.runs_root, command.run)
    resumable = {study.study_id for study in repository.studies.studies(StudyStatus.OPEN)}
    runs = [
        path
        for path in list_runs(command.runs_root)
        if can_reach_again(path)
        and (read_run(path).result is None if _evaluates(path) else study_id_of(path) in resumable)
    ]
    if not runs:
        raise InvalidInputError(
            f"no run in {command.runs_root} was interrupted; name one that `nufleet runs list` "
            "shows, also to try again what made it fail, or the repository that keeps it (this is "
            f"{repository.name})"
        )
    return runs[-1]


def _trials(study: StudyRecord, repository: Repository) -> tuple[TrialRecord, ...]:
    """Return the trials of a study; of one that failed, as if those that ended it were repeated."""
    trials = repository.studies.trials(study.study_id)
    return tried_again(trials) if study.status is StudyStatus.FAILED else trials


def _unfinished(path: Path, repository: Repository) -> StudyRecord:
    """Return the study of a run, which is open or has failed since robots were not there.

    What a person has mended meanwhile is tried again: a robot that was lost or stopped, or whose
    tests gave no response.
    """
    try:
        study = repository.studies.study(study_id_of(path))
    except UnknownRecordError as error:
        raise InvalidInputError(
            f"{repository.name} keeps nothing of {path.name}: it ended before anything moved, so "
            "run it again; or name its repository with --repository"
        ) from error
    if study.status is StudyStatus.COMPLETE:
        raise InvalidInputError(f"{path.name} is complete: `nufleet runs show {path.name}`")
    if study.status is StudyStatus.FAILED:
        trials = repository.studies.trials(study.study_id)
        if tried_again(trials) == trials:
            raise InvalidInputError(f"{path.name} has failed: {study.reason}; start a new study")
    return study


def _check_there(needed: tuple[str, ...], there: tuple[str, ...], study: StudyRecord) -> None:
    missing = [robot for robot in needed if robot not in there]
    if missing:
        raise InvalidInputError(
            f"{', '.join(missing)} of fleet {study.fleet} must be present to resume; start what "
            "is missing, or wait for it with --wait"
        )
